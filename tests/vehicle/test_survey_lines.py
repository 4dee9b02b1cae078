"""Lines of a survey in a mission: which one the boat is on, from which one it begins, what is announced at both ends, and
stays on a path."""

import json
import math
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import plans
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.orders.payloadlines import lines
from delfim.vehicle.plans.mission import Mission, PathPoint, PayloadItem, Waypoint, canonical, parse_mission
from delfim.vehicle.snapshot import report
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
HERE = 38.6925, -9.2150
NORTH_DEG, EAST_DEG = 1.0 / 111_000.0, 1.0 / 86_800.0  # of a metre
PLACES = (0.0, 0.0), (15.0, 0.0), (45.0, 0.0), (60.0, 0.0), (60.0, 15.0), (45.0, 15.0), (15.0, 15.0), (0.0, 15.0)
LINES = 0, 0, 1, 0, 0, 0, 2, 0


def photo(number: float, **place: int) -> PayloadItem:
    return PayloadItem(command=2000, params=(number, 0.0, 0.0, 0.0), **place)


def at(north_m: float, east_m: float) -> dict[str, float]:
    return {"latitude_deg": HERE[0] + north_m * NORTH_DEG, "longitude_deg": HERE[1] + east_m * EAST_DEG}


def waypoints(hold_s: float = 0.0) -> tuple[Waypoint, ...]:
    """Two lines with run-ins, and a stay at the end of the first."""
    rows = zip(PLACES, LINES, strict=True)
    return tuple(Waypoint(**at(*place), line=line, hold_s=hold_s if line == 1 else 0.0) for place, line in rows)


def pieces(hold_s: float = 0.0) -> tuple[PathPoint, ...]:
    rows = zip(PLACES, LINES, strict=True)
    return tuple(PathPoint(**at(*place), line=line, hold_s=hold_s if line == 1 else 0.0) for place, line in rows)


JOINED = Mission(
    version=1,
    name="Joined",
    waypoint=waypoints(),
    action=(photo(0, after=0), photo(1, after=2), photo(2, after=8)),
)
LAID = Mission(
    version=1,
    name="Laid",
    waypoint=waypoints(),
    path=pieces(20.0),
    action=(photo(9, after=1), *(photo(number, after_piece=place) for number, place in enumerate((0, 1, 2, 7)))),
)


@pytest.fixture
def sea():
    latitude, longitude = f"simulation.latitude_deg={HERE[0] - 8.0 * NORTH_DEG}", f"simulation.longitude_deg={HERE[1]}"
    run = Lockstep(config.load(ROOT / "etc/boats/heron.toml", [latitude, longitude]), 1, lambda clock: NoLog())
    yield run
    run.close()


def sailed(sea: Lockstep, mission: Mission, order: console.Commands, until_s: float = 400.0) -> list[tuple[int, float]]:
    """The lines that the boat was on, one after the other, and how long."""
    assert sea.command(console.LoadMission(canonical(mission))) is None
    told, begun, before_s = list[tuple[int, float]](), False, 0.0
    for _ in sea.cycles(until_s):
        if not begun:
            begun = sea.command(order) is None
            continue
        line, now_s = sea.state.reference.line, sea.elapsed_s
        if not told or told[-1][0] != line:
            told.append((line, 0.0))
        told[-1] = line, told[-1][1] + now_s - before_s
        before_s = now_s
        if sea.state.mode is Mode.HOLD:
            break
    assert sea.state.reason.endswith("done"), sea.state.reason
    return told


def numbers(sea: Lockstep) -> list[float]:
    return [each.params[0] for each in sea.state.announced]


@pytest.mark.parametrize("mode", ["play", "path"])
@pytest.mark.parametrize("mission", [JOINED, LAID], ids=lambda each: each.name)
def test_the_boat_knows_the_line_that_it_is_on(sea, mode, mission) -> None:
    told = sailed(sea, mission, console.SetMode(mode) if mode == "path" else console.Play())
    assert [line for line, _ in told] == [0, 1, 0, 2, 0]
    expected = {("Laid", "path"): [0, 1, 2, 3], ("Laid", "play"): [9]}
    assert numbers(sea) == expected.get((mission.name, mode), [0, 1, 2])


def test_a_boat_stays_at_the_end_of_a_piece_and_goes_on(sea) -> None:
    assert sea.command(console.LoadMission(canonical(LAID))) is None
    begun, stayed = False, list[tuple[float, float, int, int]]()
    for _ in sea.cycles(400.0):
        begun = begun or sea.command(console.SetMode("path")) is None
        its, at_s = sea.state.reference, sea.elapsed_s
        if sea.vehicle.helm.memory.left_s > 0.0:
            stayed.append((at_s, its.distance_m or 0.0, its.line, its.leg))
        if sea.state.mode is Mode.HOLD:
            break
    assert sea.state.reason == "path done"
    assert stayed[-1][0] - stayed[0][0] == pytest.approx(20.0, abs=0.3), "as long as the mission says"
    assert max(far_m for _, far_m, _, _ in stayed) < 5.0
    assert {each[2:] for each in stayed[1:]} == {(0, 1)}


def test_a_path_begins_with_the_run_in_of_a_line(sea) -> None:
    told = sailed(sea, LAID, console.SetMode("path", line=2))
    assert [line for line, _ in told] == [0, 2, 0]
    assert numbers(sea) == [3]
    assert sea.command(console.SetMode("path", line=3)) == "path refused: the mission has no line 3"


@pytest.mark.parametrize("way", ["paused", "restarted"])
@pytest.mark.parametrize("late", [(0, 14.0), (1, 0.0), (1, 12.0)], ids=["before the line", "as it begins", "in its middle"])
def test_a_line_that_was_left_goes_on_where_it_was_left(sea, way, late) -> None:
    """By true places: the water carries the boat on and aside while it lies there."""
    assert sea.command(console.LoadMission(canonical(LAID))) is None
    begun, on_s, left_s, places = False, 0.0, None, list[tuple[float, float]]()
    model = sea.nodes.model
    model.current_north_mps, model.current_east_mps = 0.15, 0.2
    for _ in sea.cycles(600.0):
        begun = begun or sea.command(console.SetMode("path")) is None
        on_s += 0.2 if sea.state.mode is Mode.PATH and sea.state.reference.line == late[0] else 0.0
        if sea.state.reference.line == 1:
            places.append(tuple(math.degrees(each) for each in (model.latitude_rad, model.longitude_rad)))
        if left_s is None and on_s > late[1]:
            left_s = sea.elapsed_s
            if way == "paused":
                assert sea.command(console.Pause()) is None
            else:
                sea.restart(40.0)
        if left_s is not None and sea.elapsed_s - left_s > 50.0 and sea.state.mode is Mode.HOLD:
            if sea.state.reason.endswith("done"):
                break
            assert sea.command(console.Continue()) is None
            assert sea.state.reference.line == 0
    assert sea.state.reason == "path done"
    flat = [((lat - HERE[0]) / NORTH_DEG, (lon - HERE[1]) / EAST_DEG) for lat, lon in places]
    for north_m in range(17, 45):
        assert min(math.dist(place, (north_m, 0.0)) for place in flat) < 2.5, north_m
    assert numbers(sea) == [0, 1, 2, 3], "nothing twice"


def test_programs_are_told_when_a_line_begins_and_ends(sea) -> None:
    assert sea.command(console.LoadMission(canonical(JOINED))) is None
    before, told, begun = None, list[dict[str, object]](), False
    for _ in sea.cycles(300.0):
        begun = begun or sea.command(console.SetMode("path")) is None
        now = report(sea.state, sea.elapsed_s)
        told += [json.loads(line) for line in lines(now, before)]
        before = now
        if sea.state.mode is Mode.HOLD:
            break
    events = [each["line"] for each in told if each.get("event") == "line"]
    assert events == [1, 0, 2, 0]
    assert {each["line"] for each in told if "event" not in each} == {0, 1, 2}


def test_a_mission_keeps_its_lines_in_its_file_and_over_the_link() -> None:
    for mission in (JOINED, LAID):
        assert parse_mission(canonical(mission)) == mission
        draft = plans.MissionDraft()
        for number, item in enumerate(plans.mission_items(mission)):
            draft.add(number, item)
        back = draft.done(mission.name, config.Zones())
        assert [row.line for row in back.waypoint] == list(LINES)
        assert [(row.line, row.hold_s) for row in back.path] == [(row.line, row.hold_s) for row in mission.path]
        assert back.action == mission.action


def test_a_mission_of_old_has_the_text_that_it_had() -> None:
    old = parse_mission((ROOT / "etc/missions/doca.toml").read_text())
    assert "line" not in canonical(old)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("[[action]]\ncommand = 2000\n", "it needs its place"),
        ("[[action]]\ncommand = 2000\nafter = 1\nafter_piece = 1\n", "it needs its place"),
        ("[[action]]\ncommand = 2000\nafter_piece = 0\n", "the mission has no [[path]]: say after"),
    ],
)
def test_an_action_has_one_place(change: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why.replace("[", r"\[")):
        parse_mission(canonical(Mission(version=1, name="x", waypoint=waypoints())) + change)


def test_there_must_be_room_to_stay_at_the_end_of_a_piece(sea) -> None:
    reef = config.Area(name="reef", centre=((at(45.0, 7.5)["latitude_deg"], at(45.0, 7.5)["longitude_deg"]),), radius_m=1.0)
    zones = config.Zones(keep_out=(reef,))
    narrow = Mission(version=1, name="n", waypoint=waypoints(), path=pieces(20.0), fence=zones)
    refused = sea.command(console.LoadMission(canonical(narrow)))
    assert refused is not None
    assert "no room to wait at the end of piece 2 of the path: reef" in refused
