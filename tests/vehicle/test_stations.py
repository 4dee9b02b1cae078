"""Stations of a mission: a sample is asked for while the boat stays, tried again, and given up; who may answer, and when."""

from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.console.boats.boat import Boat
from delfim.parts.mavlink.codec import plans, wire
from delfim.parts.mavlink.telemetry import TelemetryView, arrays
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, Waypoint, canonical, parse_mission
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
PROGRAMS = ('payload.pump={command=["/bin/true"], may=["samples"]}', 'payload.eye={command=["/bin/true"], may=["obstacles"]}')
HERE = {"latitude_deg": 38.6907, "longitude_deg": -9.2153}
NORTH = {"latitude_deg": 38.6909, "longitude_deg": -9.2153}
MISSION = Mission(
    version=1, name="Samples", waypoint=(Waypoint(**HERE, hold_s=10.0, tries=2), Waypoint(**NORTH, hold_s=5.0, tries=1))
)


@pytest.fixture
def sea():
    run = Lockstep(config.load(ROOT / "etc/boats/heron.toml", PROGRAMS), 1, lambda clock: NoLog())
    assert run.command(console.LoadMission(canonical(MISSION))) is None
    begun = False
    for _ in run.cycles(60.0):
        begun = begun or run.command(console.Play()) is None
        if run.state.sample.number:
            break
    assert (run.state.sample.number, run.state.sample.leg, run.state.sample.tries) == (1, 0, 2)
    yield run
    run.close()


def sail(sea: Lockstep, seconds: float) -> None:
    for _ in sea.cycles(seconds):
        pass


def told(sea: Lockstep) -> list[str]:
    return [words for words in sea.noted if words.startswith("station")]


def sampled(sea: Lockstep, number: int, ok: bool = True, name: str = "pump") -> str | None:
    return sea.vehicle.on_command(console.Sampled(number, ok, "so"), f"payload:{name}")


def test_without_an_answer_the_boat_tries_again_and_goes_on(sea) -> None:
    began_s = sea.elapsed_s
    for _ in sea.cycles(60.0):
        if sea.state.sample.number == 2 and sea.vehicle.helm.memory.leg == 1:
            break
        if sea.vehicle.helm.memory.leg == 1:
            break
    assert 20.0 <= sea.elapsed_s - began_s <= 25.0, "both tries, and no longer"
    assert told(sea)[-1] == "station: waypoint 1: no sample: no answer for 10 s"
    assert len(told(sea)) == 4
    sail(sea, 120.0)
    assert sea.state.reason == "play done"
    assert "station: waypoint 2: sample 3 is asked for, try 1 of 1" in told(sea)


def test_the_answer_ends_the_stay_at_once(sea) -> None:
    assert sampled(sea, 1) is None
    sail(sea, 1.0)
    assert sea.vehicle.helm.memory.leg == 1
    assert told(sea)[-1] == "station: waypoint 1: payload pump has sample 1: so"
    assert sea.state.mode is Mode.PLAY


def test_only_what_is_asked_is_answered_and_only_by_whom_it_may_be(sea) -> None:
    assert sampled(sea, 2) == "sampled refused: sample 2 is not asked for"
    assert "samples is not among the rights of eye" in (sampled(sea, 1, name="eye") or "")
    assert "only a payload program says this" in (sea.command(console.Sampled(1)) or "")
    sail(sea, 1.0)
    assert sea.state.sample.number == 1, "none of it was an answer"


def test_a_pause_ends_the_question_and_it_is_asked_anew_afterwards(sea) -> None:
    assert sea.command(console.Pause()) is None
    sail(sea, 1.0)
    assert sea.state.sample.number == 0
    assert sampled(sea, 1) == "sampled refused: sample 1 is not asked for"
    assert sea.command(console.Continue()) is None
    sail(sea, 1.0)
    assert sea.state.sample.number == 2
    assert sampled(sea, 2, ok=False) is None
    assert sea.state.sample.attempt == 2


def test_a_mission_played_again_asks_again(sea) -> None:
    assert sampled(sea, 1) is None
    sail(sea, 1.0)
    assert sea.command(console.Play()) is None
    sail(sea, 9.0)
    assert sea.state.sample.number == 2


def test_a_console_that_was_not_there_learns_what_became_of_each_station(sea) -> None:
    heard = Boat(1, 0.0)
    assert heard_of(sea, heard) == {}
    assert sampled(sea, 1) is None
    sail(sea, 120.0)
    assert sea.state.reason == "play done"
    assert sea.state.stations == ((1, True), (2, False))
    assert heard_of(sea, heard) == {1: "sampled", 2: "failed"}
    assert sea.command(console.Play()) is None
    for _ in sea.cycles(120.0):
        if sea.state.sample.number:
            break
    assert sea.state.stations == ((2, False),), "the first one is asked again"


def test_samples_are_those_of_the_mission_aboard_also_after_a_restart(sea) -> None:
    assert sampled(sea, 1) is None
    sail(sea, 1.0)
    sea.restart(2.0)
    sail(sea, 3.0)
    assert sea.state.stations == ((1, True),)
    other = canonical(msgspec.structs.replace(MISSION, waypoint=MISSION.waypoint[::-1]))
    assert sea.command(console.LoadMission(other)) is None
    sail(sea, 1.0)
    assert sea.state.stations == ()


def test_of_many_stations_an_array_tells_a_part_each_time(sea) -> None:
    sea.state.stations = tuple((number, number % 3 > 0) for number in range(1, 101))
    heard = Boat(1, 0.0)
    assert len(heard_of(sea, heard)) == 58
    assert len(heard_of(sea, heard, turn=1)) == 100
    heard.take_stations([0, 5000, -5000])
    assert len(heard.stations) == 100


def heard_of(sea: Lockstep, boat: Boat, turn: int = 0) -> dict[int, str]:
    """The stations as a console has them that heard one telling, and nothing before."""
    view = TelemetryView(sea.vehicle, sea.settings.mavlink, 0, lambda leg: 0, lambda kind: None, sea.elapsed_s, turn)
    for message in arrays(view):
        boat.receive(wire.decode(wire.Sender(1, 1, None, lambda: 0).pack(message)), 0.0, 0.0)
    return {number: each["state"] for number, each in boat.stations.items()}


def test_a_station_is_in_its_file_and_goes_over_the_link() -> None:
    assert parse_mission(canonical(MISSION)) == MISSION
    draft = plans.MissionDraft()
    for number, item in enumerate(plans.mission_items(MISSION)):
        draft.add(number, item)
    assert [row.tries for row in draft.done("x", config.Zones()).waypoint] == [2, 1]
    with pytest.raises(ConfigError, match="a sample needs its time"):
        parse_mission(canonical(MISSION).replace("hold_s = 5.0\n", ""))
