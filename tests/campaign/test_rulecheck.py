"""How a run kept the rules of the road, by geometry: tapes of motions that keep them, and that break them."""

import math
import sys
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.campaign.colreg import Instant, RuleTape, alterations
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios.encounters import START_S
from delfim.simulator.tables import SimulatedTraffic, SimulatedVessel, Simulation
from delfim.vehicle.state import NoLog

OWN_MPS = 1.5
LENGTH_M = 20.0


def met(meeting: str, course_deg: float, mps: float, meets_s: float) -> SimulatedVessel:
    """A vessel that the boat meets at that time if it goes on to the north."""
    course_rad = math.radians(course_deg)
    north_m = OWN_MPS * meets_s - mps * (meets_s + START_S) * math.cos(course_rad)
    east_m = -mps * (meets_s + START_S) * math.sin(course_rad)
    place = {"north_m": north_m, "east_m": east_m, "course_deg": course_deg, "speed_mps": mps, "length_m": LENGTH_M}
    return SimulatedVessel(transponder="none", meeting=meeting, meets_s=meets_s + START_S, **place)


def tape(row: SimulatedVessel, turn_s: float, turn_deg: float, part: float = 1.0, back_s: float = 300.0) -> RuleTape:
    """The boat goes north, and from `turn_s` to `back_s` on another course, at a part of its speed."""
    traffic = SimulatedTraffic(vessel=(row,))
    run = Lockstep(
        config.Vehicle(
            boat=config.BoatTable(name="test"),
            simulation=Simulation(traffic=traffic),
            control=config.ControlTable(speed=config.SpeedTable(max_mps=OWN_MPS)),
        ),
        1,
        lambda clock: NoLog(),
    )
    (vessel,) = run.nodes.vessels
    made, north_m, east_m = RuleTape(run), 0.0, 0.0
    for t in range(10, 600):
        vessel.sail(float(t))
        away = turn_s <= t < back_s
        course_rad, mps = (math.radians(turn_deg), OWN_MPS * part) if away else (0.0, OWN_MPS)
        north_m, east_m = north_m + mps * math.cos(course_rad), east_m + mps * math.sin(course_rad)
        vessel._model = SimpleNamespace(north_m=north_m, east_m=east_m)  # type: ignore[assignment]
        vessel._measure()
        made.instants.append(
            Instant(float(t), north_m, east_m, course_rad, mps, ((vessel.north_m, vessel.east_m, vessel.course_rad),))
        )
    return made


def broken(*given: Any, **more: Any) -> set[str]:
    return {each.rule for each in tape(*given, **more).checks() if not each.is_kept}


HEAD_ON = met("head-on", 180.0, 2.0, 300.0)
FROM_STARBOARD = met("give-way", 270.0, 2.0, 300.0)
FROM_PORT = met("stand-on", 90.0, 2.0, 300.0)
OVERTAKEN = met("overtaking", 0.0, 0.5, 300.0)


@pytest.mark.parametrize(
    ("row", "turn_s", "turn_deg", "part", "rules"),
    [
        (HEAD_ON, 100, 45.0, 1.0, set()),
        (HEAD_ON, 250, -60.0, 1.0, {"14, 15 not to port", "14 port to port"}),
        (HEAD_ON, 290, 45.0, 1.0, {"8a in ample time"}),
        (HEAD_ON, 100, 20.0, 1.0, {"8b readily apparent"}),
        (HEAD_ON, 1000, 0.0, 1.0, {"8a in ample time", "8b readily apparent"}),
        (FROM_STARBOARD, 100, 60.0, 1.0, set()),
        (FROM_STARBOARD, 100, 0.0, 0.4, set()),
        (FROM_STARBOARD, 50, -60.0, 1.0, {"14, 15 not to port", "15 not ahead of it"}),
        (FROM_PORT, 230, 60.0, 1.0, set()),
        (FROM_PORT, 230, -60.0, 1.0, {"17c not to port"}),
        (FROM_PORT, 60, 60.0, 1.0, {"17a holds on"}),
        (OVERTAKEN, 100, -40.0, 1.0, set()),
    ],
)
def test_a_manoeuvre_keeps_the_rules_or_breaks_them(row, turn_s, turn_deg, part, rules):
    assert broken(row, turn_s, turn_deg, part) == rules


def test_a_boat_is_judged_by_the_speed_that_its_file_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cruising speed is 1.5 m/s, of which it may make 1.0: that is no slowing down."""
    monkeypatch.setattr(sys.modules[__name__], "OWN_MPS", 1.0)
    assert broken(met("head-on", 180.0, 2.0, 300.0), 100, 45.0) == set()


def test_who_passes_ahead_of_one_from_starboard_is_told():
    later = msgspec.structs.replace(FROM_STARBOARD, east_m=FROM_STARBOARD.east_m + 40.0)
    assert "15 not ahead of it" in broken(later, 1000, 0.0)


def test_alterations_are_courses_that_were_kept():
    made = tape(HEAD_ON, 100, 45.0)
    assert alterations(made.instants) == 2, "away and back"
    assert made.off_m == pytest.approx(200 * 1.5 * math.sin(math.radians(45.0)), rel=0.01)


def test_vessels_without_a_meeting_are_not_judged():
    row = SimulatedVessel(north_m=500.0, speed_mps=2.0)
    assert tape(row, 100, 45.0).checks() == []
