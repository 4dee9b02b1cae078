"""Sessions recorded, and recordings played again."""

import errno
import math
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import Clock, ManualClock
from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.base.geodesy import origin, to_plane
from delfim.console.boats.fleet import Fleet
from delfim.console.boats.othervessels import around
from delfim.console.link.mavlink import mavlink
from delfim.console.link.session import PENDING_BYTES, Session
from delfim.console.tapes.replay import TapePlayer, open_tapes
from delfim.console.tapes.statetape import States
from delfim.console.tapes.tape import Text, TlogTape
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.log.logbook import Logbook
from tests.console.fakeboat import FakeBoat
from tests.console.test_fleet import Sea
from tests.console.test_othervessels import vessel
from tests.logging.sailing import Day

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes of two boats that move north; boat 2 falls silent after 40 s, and boat 1 enters play after 60."""
    clock = ManualClock(100.0)
    session = Session(tmp_path_factory.mktemp("session"), clock)
    fleet = Fleet(clock, lambda address, data: None, lambda message: None)
    fleet.record = session.put
    boats = [FakeBoat(n, clock, lambda data, n=n: fleet.receive(n, data)) for n in (1, 2)]  # type: ignore[misc]
    for step in range(1200):
        clock.advance(0.1)
        for boat in boats[: 1 if step > 400 else 2]:
            boat.position[0] = 386_900_000 + boat.number * 1000 + step * 10
            boat.tick()
        if step == 600:
            boats[0].mode = 10
            boats[0].say(mavlink.MAVLink_statustext_message(6, b"play: operator", 0, 0))
        fleet.tick()
        session.tick()
    session.flush()
    assert session.file is not None
    return session.file


@pytest.fixture(scope="module")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of the vehicle in the simulator, as its own state log holds it; then two seconds of a payload program."""
    log = tmp_path_factory.mktemp("log")
    more = 'log.state_method="write"', 'sensors.names=["sysstat", "nmea2000"]'
    programs = [f'payload.{name}={{command=["/bin/true"], may=["hold"]}}' for name in ("first", "second")]
    settings = config.load(ROOT / "etc/delfimx.toml", [f'log.directory="{log}"', *more, *programs])
    run = Lockstep(settings, 1, lambda clock: Logbook(settings, clock))
    run.sail((ROOT / "etc/missions/doca.toml").read_text(), 60.0)
    run.order(console.Alive(), "payload:second")
    assert run.order(console.Entrust("second"), "local") is None
    for _ in run.cycles(2.0):
        pass
    run.close()
    return log


class Played:
    def __init__(self, *paths: Path) -> None:
        self.clock, self.told = ManualClock(), list[dict[str, Any]]()
        self.replay = TapePlayer(open_tapes(paths), self.clock, self.told.append)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            self.replay.tick()

    def shown(self, number: int) -> dict[str, Any]:
        return next(boat for boat in self.replay.snapshot() if boat["id"] == number)


def test_a_mission_is_shown_from_when_it_was_read_and_at_its_waypoint(tmp_path: Path) -> None:
    """A change of speed before each waypoint: item 3 is the second waypoint."""
    clock = ManualClock(100.0)
    session = Session(tmp_path, clock)
    boats: list[FakeBoat] = []
    fleet = Fleet(clock, lambda address, data: boats[0].hear(data), lambda message: None)
    fleet.record = session.put
    boats.append(FakeBoat(1, clock, lambda data: fleet.receive(1, data)))
    boats[0].name = "Delfim"
    boats[0].modes, boats[0].mode = [(4, b"idle"), (42, b"dance")], 42
    waypoints = [
        {"latitude_deg": 38.69, "longitude_deg": -9.21 + n / 1e3, "speed_mps": 1.0 + n, "acceptance_m": 3.0, "hold_s": 0.0}
        for n in range(3)
    ]
    for step in range(300):
        clock.advance(0.1)
        boats[0].tick()
        if step == 100:
            fleet.put(1, {"name": "line", "waypoints": waypoints})
            fleet.upload(1, lambda well, why: None)
        if step == 250:
            boats[0].say(mavlink.MAVLink_mission_current_message(3))
        fleet.tick()
        session.tick()
    session.flush()
    assert session.file is not None
    played = Played(session.file)
    assert (played.shown(1)["mission"]["state"], played.shown(1)["mission"]["count"]) == ("unknown", 0)
    played.run(29.0)
    assert (played.shown(1)["mission"]["count"], played.shown(1)["mission"]["current"]) == (3, 1)
    played.replay.seek(played.replay.from_s)
    assert played.shown(1)["mission"]["count"] == 0
    drawn = [len(told["mission"]["waypoints"]) for told in played.told if told["t"] == "mission"]
    assert drawn == [0, 3, 0], "what the console read by itself, what was sent, and nothing before either"
    assert played.shown(1)["name"] == "Delfim", "from the beginning"
    assert (played.shown(1)["mode"], played.shown(1)["modes"]) == ("dance", ["idle", "dance"]), "as well"


def test_a_session_is_read_by_everybodys_reader(recorded: Path) -> None:
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(recorded), dialect="common")
    kinds: dict[str, int] = {}
    while (message := log.recv_match()) is not None:
        kinds[f"{message.get_srcSystem()} {message.get_type()}"] = (
            kinds.get(f"{message.get_srcSystem()} {message.get_type()}", 0) + 1
        )
    log.close()
    assert kinds["1 GLOBAL_POSITION_INT"] == 120
    assert kinds["250 HEARTBEAT"] > 100, "what the console said is there too"
    assert "1 BAD_DATA" not in kinds


def test_a_session_plays_at_the_rate_of_life_and_at_others(recorded: Path) -> None:
    played = Played(recorded)
    begun_s = played.replay.from_s
    assert played.replay.to_s - begun_s == pytest.approx(120.0, abs=1.5)
    played.run(30.0)
    assert played.replay.at_s == pytest.approx(begun_s + 30.0)
    assert {boat["id"]: boat["mode"] for boat in played.replay.snapshot()} == {1: "idle", 2: "idle"}
    assert 28 <= len(played.replay.boats[1].track) <= 32
    played.replay.steer(None, 0.0)
    played.run(5.0)
    assert played.replay.at_s == pytest.approx(begun_s + 30.0)
    played.replay.steer(None, 10.0)
    played.run(4.0)
    assert (played.shown(1)["mode"], played.shown(1)["age_s"]["heard"] <= 1.1) == ("play", True)
    assert [each["text"] for each in played.told] == ["play: operator"]
    played.run(100.0)
    assert played.replay.at_s == played.replay.to_s


def test_the_whole_way_and_what_was_said_are_known_from_the_beginning(recorded: Path) -> None:
    replay = Played(recorded).replay
    assert [(each["text"], each["boat"]) for each in replay.events()] == [("play: operator", 1)]
    assert replay.events()[0]["at_s"] == pytest.approx(replay.from_s + 60.0, abs=1.0)
    tracks = replay.tracks()
    assert (len(tracks[1]), len(tracks[2])) == (120, 41)
    assert tracks[1][-1][0] == pytest.approx(replay.to_s, abs=1.0)


def test_of_many_events_the_gravest_are_kept_in_their_order() -> None:
    class Talk:
        from_s, to_s, tracks, missions, complaint = 0.0, 1000.0, {1: [(t, 0.0, 0.0) for t in range(10_000)]}, {}, ""
        texts = tuple(Text(float(t), 1, 4 if t % 10 else 6, "words") for t in range(1000))

        def seek(self, boats: object, at_s: float) -> None: ...

        def play(self, boats: object, from_s: float, to_s: float) -> list[Text]:
            return []

    replay = TapePlayer([Talk()], ManualClock(), lambda message: None)  # type: ignore[list-item]
    events = replay.events()
    assert len(events) == 300
    assert {each["severity"] for each in events} == {4}
    assert events == sorted(events, key=lambda each: each["at_s"])
    assert 2000 < len(replay.tracks()[1]) <= 4000


def test_any_time_is_shown_as_it_was(recorded: Path) -> None:
    """Played up to a time, and jumped to it from the end: the same."""
    for at_s in (0.0, 25.25, 62.25, 110.25):  # between two messages
        played, jumped = Played(recorded), Played(recorded)
        jumped.replay.seek(jumped.replay.to_s)
        played.run(at_s)
        jumped.replay.seek(played.replay.at_s)
        for number in played.replay.boats:
            one, two = played.shown(number), jumped.shown(number)
            keys = ("latitude_deg", "mode", "rpm", "battery_v", "heading_deg")
            assert {key: one[key] for key in keys} == {key: two[key] for key in keys}, (at_s, number)
            assert one["age_s"]["heard"] == pytest.approx(two["age_s"]["heard"], abs=0.06)
            assert list(played.replay.boats[number].track) == list(jumped.replay.boats[number].track), (at_s, number)


def test_a_boat_that_fell_silent_stays_with_its_age(recorded: Path) -> None:
    played = Played(recorded)
    played.replay.seek(played.replay.from_s + 100.0)
    assert played.shown(2)["age_s"]["heard"] == pytest.approx(60.0, abs=2.0)
    assert played.shown(2)["ghost"] is not None


def test_the_state_log_of_a_vehicle_plays_too(sailed: Path) -> None:
    played = Played(sailed)
    played.run(40.0)
    boat = played.shown(2)
    assert (boat["name"], boat["mode"], boat["armed"]) == ("DelfimX", "play", True)
    assert 0.5 < boat["speed_mps"] < 3.0
    assert all(100 < rpm < 1300 for rpm in boat["rpm"])
    assert 38 <= len(played.replay.boats[2].track) <= 42
    assert "play: operator" in [each.get("text") for each in played.told]
    played.replay.seek(played.replay.to_s)
    assert played.shown(2)["mode"] == "payload second"
    played.replay.seek(played.replay.from_s + 40.0)
    assert played.shown(2)["mode"] == "play"
    track = list(played.replay.boats[2].track)
    at_s = played.replay.at_s
    played.replay.seek(played.replay.from_s)
    played.replay.seek(at_s)
    assert list(played.replay.boats[2].track) == track


def test_a_state_log_has_the_missions_that_the_boat_was_given_and_graphs_of_its_values(tmp_path: Path) -> None:
    more = 'log.state_method="write"', 'sensors.names=["sysstat", "nmea2000"]'
    settings = config.load(ROOT / "etc/delfimx.toml", [f'log.directory="{tmp_path}"', *more])
    books: list[Logbook] = []

    def logbook(clock: Clock) -> Logbook:
        books.append(Logbook(settings, clock))
        return books[0]

    run = Lockstep(settings, 1, logbook)
    text = (ROOT / "etc/missions/doca.toml").read_text()
    for part, refused in ((text[:100], None), ("not a mission", "mission refused"), (text[100:], None)):
        at = 100 if part == text[100:] else 0
        books[0].command(console.LoadMission(text=part, at=at, more=part == text[:100]), refused, run.state)
    run.sail(text, 58.0)
    books[0].command(console.LoadMission(text="no mission"), None, run.state)
    books[0].command(console.Unload(), None, run.state)
    for _ in run.cycles(2.0):
        pass
    run.close()
    played = Played(tmp_path)
    played.run(50.0)
    boat = played.shown(2)
    assert (boat["mission"]["name"], boat["mission"]["count"], boat["mission"]["current"]) == ("Doca", 12, 2)
    played.replay.seek(played.replay.to_s)
    drawn = [len(told["mission"]["waypoints"]) for told in played.told if told["t"] == "mission"]
    assert drawn == [12, 0], "and nothing of what was refused or could not be read"
    graphs = played.replay.graphs()[2]
    assert {"speed_mps", "battery_pct", "depth_m"} <= graphs.keys()
    assert 55 <= len(graphs["speed_mps"]) <= 62
    assert {value for _, value in graphs["depth_m"]} == {12.0}
    assert max(value for _, value in graphs["speed_mps"]) > 1.0


def test_a_session_has_graphs_of_what_the_link_told(tmp_path: Path) -> None:
    sea = Sea(1)
    session = Session(tmp_path, sea.clock)
    sea.fleet.record = session.put
    sea.run(3.0)
    for second in range(30):
        if second < 20:
            sea.boats[1].say(mavlink.MAVLink_named_value_float_message(1000 * second, b"depth_m", 10.0 + second))
        sea.run(1.0)
    session.flush()
    graphs = Played(tmp_path).replay.graphs()[1]
    assert 25 <= len(graphs["speed_mps"]) <= 34
    assert {value for _, value in graphs["battery_pct"]} == {80}
    depths = [value for _, value in graphs["depth_m"]]
    assert (depths[0], depths[-1], 20 <= len(depths) <= 27) == (10.0, 29.0, True), "what is old is not drawn"


def test_session_and_state_logs_play_together(recorded: Path, sailed: Path) -> None:
    played = Played(recorded, sailed)
    played.replay.seek(played.replay.from_s + 30.0)
    assert played.replay.boats
    assert played.replay.from_s < played.replay.to_s


def test_a_replay_commands_nothing(recorded: Path) -> None:
    replay = Played(recorded).replay
    for ask in (
        lambda: replay.command(1, "stop", {}, None),
        lambda: replay.put(1, {}),
        lambda: replay.upload(1, None),
        lambda: replay.download(1, None),
    ):
        with pytest.raises(Refused, match="replay"):
            ask()
    replay.input(1, 1, 100.0, 100.0)
    assert replay.progress() == []


@pytest.mark.parametrize(("at_s", "rate"), [(None, -1.0), (None, 1e9), (None, math.nan), (math.nan, None), (math.inf, None)])
def test_a_time_line_that_means_nothing_is_refused(recorded: Path, at_s: float | None, rate: float | None) -> None:
    played = Played(recorded)
    with pytest.raises(FormatError):
        played.replay.steer(at_s, rate)
    assert played.replay.rate == 1.0


@given(at=st.integers(0, 2000), noise=st.binary(min_size=1, max_size=64))
def test_a_damaged_session_is_read_as_far_as_it_goes(recorded: Path, at: int, noise: bytes) -> None:
    data = recorded.read_bytes()
    file = recorded.with_name("damaged.tlog")
    file.write_bytes(data[:at] + noise + data[at + len(noise) : 3000])
    try:
        recording = TlogTape(file)
    except FormatError:
        return
    boats: dict[int, Any] = {}
    recording.seek(boats, recording.to_s)
    assert all(boat.snapshot(recording.to_s) for boat in boats.values())


def test_a_session_cut_short_says_so(recorded: Path) -> None:
    file = recorded.with_name("cut.tlog")
    file.write_bytes(recorded.read_bytes()[:-5])
    assert "damaged after" in TlogTape(file).complaint
    assert TlogTape(recorded).complaint == ""


@pytest.mark.parametrize("data", [b"", b"x" * 100, b"\0" * 100])
def test_what_is_no_recording_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.tlog").write_bytes(data)
    (tmp_path / "b.state").write_bytes(data)
    for path in (tmp_path / "a.tlog", tmp_path / "b.state", tmp_path / "none.tlog"):
        with pytest.raises(DelfimError):
            open_tapes([path])
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    with pytest.raises(DelfimError, match="nothing to replay"):
        open_tapes([tmp_path])


def test_a_state_log_that_had_just_begun_when_the_power_was_cut_spoils_no_others(sailed: Path, tmp_path: Path) -> None:
    (tmp_path / "b-repaired.state").touch()
    with pytest.raises(DelfimError, match="not a state log"):
        open_tapes([tmp_path])
    shutil.copy(next(sailed.rglob("*.state")), tmp_path / "a.state")
    assert len(open_tapes([tmp_path])) == 1


def test_a_state_log_shows_the_values_of_sensors(sailed: Path) -> None:
    played = Played(sailed)
    played.run(10.0)
    (boat,) = played.replay.snapshot()
    assert boat["measured"]["depth_m"]["value"] == 12.0


def test_a_state_log_without_records_is_refused(sailed: Path, tmp_path: Path) -> None:
    log = next(sailed.rglob("*.state"))
    (tmp_path / "a.state").write_bytes(log.read_bytes()[:4096])
    with pytest.raises(DelfimError):
        States([tmp_path / "a.state"], 1)


def test_sessions_of_one_second_have_names_of_their_own(tmp_path: Path) -> None:
    clock = ManualClock()
    files = []
    for _ in range(3):
        session = Session(tmp_path, clock)
        session.put(b"frame")
        session.flush()
        files.append(session.file)
    assert [file.name for file in files if file] == ["20100101-000000.tlog", "20100101-000000-1.tlog", "20100101-000000-2.tlog"]


def test_a_full_disk_costs_frames_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock()
    session = Session(tmp_path, clock)

    def full(self: Path, *_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        for _ in range(PENDING_BYTES // 500):
            session.put(b"\xfd" * 1000)
            session.tick()
        assert "No space left" in session.reason
        assert session.dropped > 0
        assert len(session._pending) <= PENDING_BYTES
    clock.advance(2.0)
    session.tick()
    assert session.reason == ""
    assert session.file is not None
    assert session.file.stat().st_size > PENDING_BYTES // 2


def test_a_replay_shows_the_vessels_that_the_boat_told_of(tmp_path: Path) -> None:
    sea = Sea(1)
    session = Session(tmp_path, sea.clock)
    sea.fleet.record = session.put
    sea.run(3.0)
    for second in range(20):
        sea.boats[1].say(vessel(north_m=2000.0 - 4.0 * second))
        sea.run(1.0)
    session.flush()
    player = TapePlayer(open_tapes([tmp_path]), sea.clock, lambda message: None)
    player.seek(player.from_s + 10.0)
    (maria,) = around(list(player.boats.values()), player.at_s)["vessels"]
    assert (maria["name"], maria["age_s"] < 2.0) == ("MARIA", True)


def test_a_jump_in_a_replay_shows_those_that_were_told_of_before(tmp_path: Path) -> None:
    """A vessel of many comes seldom, and the sentence of an order once."""
    sea = Sea(1)
    session = Session(tmp_path, sea.clock)
    sea.fleet.record = session.put
    sea.run(3.0)
    sea.boats[1].say(
        vessel(north_m=2000.0, velocity=0, navigational_status=1),
        mavlink.MAVLink_statustext_message(5, b"giving way to TEJO, head-on", 0, 0),
    )
    for _ in range(100):
        sea.boats[1].say(mavlink.MAVLink_named_value_float_message(0, b"ORDER_CRS", 45.0))
        sea.run(1.0)
    session.flush()
    player = TapePlayer(open_tapes([tmp_path]), sea.clock, lambda message: None)
    player.seek(player.from_s + 90.0)
    (maria,) = around(list(player.boats.values()), player.at_s)["vessels"]
    assert (maria["name"], round(maria["age_s"], -1), maria["lost"]) == ("MARIA", 90.0, False)
    assert player.snapshot()[0]["order"] == {"course_deg": 45.0, "words": "giving way to TEJO, head-on"}


SHIPS = (
    'simulation.traffic.vessel=[{name="MARIA", transponder="A", length_m=30.0, beam_m=6.0, north_m=500.0, course_deg=180.0, '
    'speed_mps=2.5},{name="TEJO", transponder="B", east_m=-900.0, course_deg=90.0, speed_mps=2.0}]'
)


def test_the_log_of_a_boat_shows_the_vessels_that_it_knew_and_what_it_did(tmp_path: Path) -> None:
    day = Day(tmp_path, SHIPS, 'sensors.names=["sysstat", "nmea2000"]', "simulation.heading_deg=0.0")
    day.sail(6.0)
    assert day.command(console.Course(course_deg=0.0, speed_mps=1.5)) is None
    for _ in range(30):
        day.command(console.Alive())
        day.sail(1.0)
    knew = day.sailing.state.traffic
    day.end()
    assert knew.order is not None, "it gives way"
    player = TapePlayer(open_tapes([tmp_path]), ManualClock(), lambda message: None)
    player.seek(player.to_s)
    shown = {each["name"]: each for each in around(list(player.boats.values()), player.at_s)["vessels"]}
    assert shown.keys() == {"MARIA", "TEJO"}
    boat = player.boats[2]
    here = origin(math.radians(boat.values["latitude_deg"]), math.radians(boat.values["longitude_deg"]))
    own = day.sailing.state.motion
    for each in knew.targets:
        told = shown[each.name]
        north_m, east_m = to_plane(here, math.radians(told["latitude_deg"]), math.radians(told["longitude_deg"]))
        assert (north_m, east_m) == pytest.approx((each.north_m - own.north_m, each.east_m - own.east_m), abs=15.0)
        assert told["age_s"] == pytest.approx(each.age_s, abs=11.0)
        assert (told["size_known"], told["lost"]) == (each.is_size_known, False)
    words = player.snapshot()[0]["order"]["words"]
    assert re.fullmatch(r"giving way to \w+, head-on, port to port, CPA \d+ m", words)
