"""Mission files: what is refused and how it is said, the canonical text, the plan."""

import itertools
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base import geodesy
from delfim.base.cooperative import Sliced
from delfim.base.errors import ConfigError
from delfim.config import ControlTable
from delfim.vehicle.control.modes.path import arc_point
from delfim.vehicle.plans.mission import (
    Mission,
    PathPoint,
    Waypoint,
    canonical,
    digest,
    load_mission,
    parse_mission,
    plan,
    save_mission,
)
from delfim.vehicle.state import Arc, Line, Plan
from tests.vehicle.closed_loop import START

HEAD = 'version = 1\nname = "test"\n'
ONE = HEAD + "[[waypoint]]\nlatitude_deg = 38.69\nlongitude_deg = -9.215\n"
SECOND = "[[waypoint]]\nlatitude_deg = 38.691\nlongitude_deg = -9.215\n"
BEGIN = "[[path]]\nlatitude_deg = 38.69\nlongitude_deg = -9.215\n"
ARC = "[[path]]\nlatitude_deg = 38.69\nlongitude_deg = -9.2145\nturn_deg = 90\nradius_m = {}\n"  # centre 43.5 m east


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        ("version = ", "file", "not TOML"),
        (ONE.replace("version = 1", "version = 2"), "version", "1"),
        (ONE.replace("version = 1\n", ""), "version", "missing"),
        (HEAD, "waypoint", "missing"),
        (ONE + "[[action]]\nafter = 1\ncommand = 177\n", "action[0].command", "not a command that a mission carries"),
        (ONE + "[[action]]\nafter = 2\ncommand = 206\n", "action[0].after", "0 to 1"),
        (ONE + "[[action]]\nafter = 1\ncommand = 206\n[[action]]\nafter = 0\ncommand = 206\n", "action[1].after", "1 to 1"),
        (ONE + "[[action]]\nafter = 0\ncommand = 206\n" * 21, "action[20]", "up to 20"),
        (ONE + "[[action]]\nafter = 0\ncommand = 206\nparams = [nan, 0, 0, 0]\n", "action[0].params[0]", "nan"),
        (ONE.replace("version", 'then = "away"\nversion'), "then", "hold, home"),
        (HEAD + "waypoint = []\n", "waypoint", "an empty list is not allowed"),
        (ONE + "speed_kn = 3\n", "waypoint[0].speed_kn", "speed_mps"),
        (ONE + "speed_mps = 99\n", "waypoint[0].speed_mps", "0.0 to 30.0"),
        (ONE + "speed_mps = nan\n", "waypoint[0].speed_mps", "0.0 to 30.0"),
        (ONE + "acceptance_m = -1\n", "waypoint[0].acceptance_m", "0.0 to 1000.0"),
        (ONE + "hold_s = 1e6\n", "waypoint[0].hold_s", "0.0 to 86400.0"),
        (ONE.replace("38.69", "95.0"), "waypoint[0].latitude_deg", "-89.0 to 89.0"),
        (ONE.replace("38.69", '"north"'), "waypoint[0].latitude_deg", "is text, not a number"),
        (ONE.replace("-9.215", "nan"), "waypoint[0].longitude_deg", "-180.0 to 180.0"),
        (ONE.replace('"test"', '""'), "name", "1 to 64 characters"),
        (ONE + SECOND.replace("38.691", "38.690001"), "waypoint[1]", "0.11 m from the one before"),
        (ONE + SECOND.replace("38.691", "38.9"), "waypoint[1]", "0.5 to 20000.0 m"),
        (ONE + BEGIN, "path", "single point"),
        (ONE + BEGIN + "turn_deg = 90\n" + SECOND.replace("waypoint", "path"), "path[0].turn_deg", "where the path begins"),
        (ONE + BEGIN + BEGIN, "path[1]", "0.00 m from the one before"),
        (ONE + BEGIN + SECOND.replace("waypoint", "path") + "radius_m = 5\n", "path[1].radius_m", "without turn_deg"),
        (ONE + BEGIN + ARC.format(0), "path[1].radius_m", "needs its radius"),
        (ONE + BEGIN + ARC.format(40), "path[1]", "begins 43.50 m from its centre, not 40.0 m"),
        (ONE + BEGIN + ARC.format(43.5).replace("90", "0.001"), "path[1]", "0.00 m from the one before"),
    ],
)
def test_what_is_wrong_is_said(text: str, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_mission(text, "sea.toml")
    assert refused.value.file == "sea.toml"
    assert refused.value.key == key
    assert says in str(refused.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_mission(tmp_path / "none.toml")


def test_the_least_mission() -> None:
    mission = parse_mission(ONE)
    laid = planned(mission, START, ControlTable())
    assert [w[2:] for w in laid.waypoints] == [(1.5, 5.0, 0.0, 0, 0)]  # cruising speed, the boat's own acceptance radius
    assert laid.path == ()


def planned(mission: Mission, at: geodesy.Origin, control: ControlTable) -> Plan:
    return Sliced(plan(mission, at, control)).finish()


def test_a_mission_without_a_path_gets_the_one_that_connects_its_waypoints() -> None:
    laid = planned(parse_mission(ONE + SECOND + "speed_mps = 1.0\n"), START, ControlTable())
    first, second = laid.waypoints
    assert laid.path == (Line(*first[:2], *second[:2], 1.0),)


def test_pieces_join() -> None:
    text = ONE + BEGIN + ARC.format(43.5) + "[[path]]\nlatitude_deg = 38.691\nlongitude_deg = -9.21\n"
    arc, line = planned(parse_mission(text), START, ControlTable()).path
    assert isinstance(arc, Arc)
    assert isinstance(line, Line)
    begin = geodesy.to_plane(START, math.radians(38.69), math.radians(-9.215))
    assert arc_point(arc, 0.0) == pytest.approx(begin)
    assert arc_point(arc, arc.turn_rad) == pytest.approx((line.north_m, line.east_m))
    assert line.north_m - begin[0] == pytest.approx(43.5, abs=0.1)  # from west of the centre, clockwise, to north of it


def test_what_this_boat_cannot_do_here_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"waypoint\[0\].speed_mps: faster than this boat goes"):
        planned(parse_mission(ONE + "speed_mps = 9.0\n"), START, ControlTable())
    with pytest.raises(ConfigError, match="km from the boat"):
        planned(parse_mission(ONE.replace("38.69", "39.69")), START, ControlTable())


def waypoints() -> st.SearchStrategy[Waypoint]:
    return st.builds(
        Waypoint,
        latitude_deg=st.floats(38.0, 38.1),
        longitude_deg=st.floats(-9.1, -9.0),
        speed_mps=st.floats(0.0, 30.0),
        acceptance_m=st.floats(0.0, 1000.0),
        hold_s=st.floats(0.0, 86_400.0),
    )


def far_apart(mission: Mission) -> bool:
    places = [geodesy.to_plane(START, math.radians(w.latitude_deg), math.radians(w.longitude_deg)) for w in mission.waypoint]
    return all(math.dist(a, b) > 1.0 for a, b in itertools.pairwise(places))


TITLES = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=64)
MISSIONS = st.builds(
    Mission, version=st.just(1), name=TITLES, waypoint=st.lists(waypoints(), min_size=1, max_size=5).map(tuple)
).filter(far_apart)


@given(MISSIONS)
def test_the_canonical_text_round_trips(mission: Mission) -> None:
    again = parse_mission(canonical(mission))
    assert again == mission
    assert canonical(again) == canonical(mission)
    assert digest(again) == digest(mission)


@given(MISSIONS, MISSIONS)
def test_missions_that_differ_have_digests_that_differ(one: Mission, other: Mission) -> None:
    assert (digest(one) == digest(other)) == (one == other)


@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_file_is_a_mission_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_bytes(data)
    with pytest.raises(ConfigError):
        load_mission(path)


@pytest.mark.parametrize("name", ["doca", "lawnmower"])
def test_the_missions_of_the_package(name: str, tmp_path: Path) -> None:
    mission = load_mission(f"etc/missions/{name}.toml")
    assert len(mission.waypoint) >= 6
    assert len(planned(mission, START, ControlTable()).path) >= 4
    save_mission(mission, tmp_path / "saved.toml")
    assert load_mission(tmp_path / "saved.toml") == mission


def test_the_example_of_the_documentation_is_a_mission() -> None:
    text = Path("docs/missions.md").read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    assert [type(piece) for piece in planned(parse_mission(text), START, ControlTable()).path] == [Line, Arc]


def test_the_order_of_keys_and_comments_do_not_change_a_digest() -> None:
    swapped = HEAD + "# a comment\n[[waypoint]]\nlongitude_deg = -9.2150\nspeed_mps = 0\nlatitude_deg = 38.690\n"
    assert digest(parse_mission(swapped)) == digest(parse_mission(ONE))
    assert len(digest(parse_mission(ONE))) == 16


def test_a_path_is_saved_too() -> None:
    path = (PathPoint(latitude_deg=38.0, longitude_deg=-9.0), PathPoint(latitude_deg=38.001, longitude_deg=-9.0))
    mission = Mission(version=1, name="path", waypoint=(Waypoint(latitude_deg=38.0, longitude_deg=-9.0),), path=path)
    assert parse_mission(canonical(mission)) == mission


def test_actions_and_the_way_home_are_part_of_the_text() -> None:
    text = (
        ONE.replace("[[", 'then = "home"\n\n[[')
        + '\n[[action]]\nafter = 1\ncommand = 206\nparams = [25.0, "nan", 1.0, 0.0]\nz = 0.5\n'
    )
    mission = parse_mission(text)
    assert canonical(mission) == text
    assert digest(mission) != digest(parse_mission(ONE))
