"""The time and the energy of a survey are foretold by a few lines that the simulated boat sails."""

import math
from itertools import pairwise
from pathlib import Path

import pytest
from shapely.geometry import MultiPolygon, Point, box

from delfim import config
from delfim.base.geodesy import origin
from delfim.simulator.lockstep import Lockstep
from delfim.survey.ground import Ground, in_degrees
from delfim.survey.planning import LinesWanted, SurveyPlan, mission, planned, wanted_of
from delfim.survey.trialsail import SailedLines, SharpTurns, SurveyLeg, Taken, foretold, legs, sailed
from delfim.vehicle import console
from delfim.vehicle.plans.mission import canonical
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
AT = origin(math.radians(38.6907), math.radians(-9.2153))
CALM = "simulation.sea={current_mps=0.0, wind_mps=0.0}"
UNTIL_S = 3600.0
WEATHER = 1.04
KNOWN = SailedLines(
    LinesWanted(10.0, 2.0),
    8.0,
    100.0,
    Taken(5.0, 50.0),
    Taken(4.0, 800.0),
    SharpTurns(Taken(10.0, 400.0), 20.0, Taken(12.0, 300.0), Taken(10.0, 200.0)),
)


def straight(*places: tuple[float, float], slow: tuple[int, ...] = ()) -> list[SurveyLeg]:
    found = list[SurveyLeg]()
    for number, ((x, y), (to_x, to_y)) in enumerate(pairwise(places)):
        heading_rad = math.atan2(to_x - x, to_y - y)
        length_m = math.hypot(to_x - x, to_y - y)
        found.append(SurveyLeg((x, y), (to_x, to_y), heading_rad, heading_rad, length_m, is_slow=number in slow))
    return found


def taken(told: SailedLines, pieces: list[SurveyLeg]) -> tuple[float, float]:
    its = told.summed(pieces)
    return its.s, its.j


def voyage(settings: config.Vehicle, plan: SurveyPlan) -> tuple[float, float]:
    """What it takes, s and Wh."""
    run = Lockstep(settings, 1, lambda clock: NoLog())
    assert run.command(console.LoadMission(canonical(mission(plan, "lines")))) is None
    begun_s, before_s, joules = math.inf, 0.0, 0.0
    for state in run.cycles(UNTIL_S):
        if math.isinf(begun_s):
            begun_s = run.elapsed_s if run.command(console.SetMode("path")) is None else math.inf
        else:
            power_w = sum(each.voltage_v * each.current_a for each in run.nodes.model.drives.values())
            joules += power_w * (run.elapsed_s - before_s)
            if state.mode.name != "PATH":
                break
        before_s = run.elapsed_s
    reason, took_s = state.reason, run.elapsed_s - begun_s
    run.close()
    assert reason == "path done"
    return took_s, joules / 3600.0


@pytest.mark.parametrize(
    ("boat", "by"),
    [("otter", 0.02), *(pytest.param(*each, marks=pytest.mark.long) for each in (("wam-v", 0.02), ("skiff", 0.05)))],
)
def test_time_and_energy_of_lines_that_end_at_an_island_are_foretold(boat: str, by: float) -> None:
    island, file = Point(20.0, 35.0).buffer(6.0), ROOT / f"etc/boats/{boat}.toml"
    ground = Ground(AT, MultiPolygon([box(0.0, 0.0, 44.0, 70.0).difference(island)]), MultiPolygon([island]))
    settings = config.load(file)
    plan = planned(ground, wanted_of(settings, spacing_m=11.0, heading_deg=0.0), settings.fence)
    places = zip(("latitude", "longitude"), in_degrees(AT, *plan.begin), strict=True)
    here = config.load(file, [CALM, *(f"simulation.{name}_deg={deg:.9f}" for name, deg in places)])
    took_s, took_wh = voyage(here, plan)
    time_s, energy_wh = foretold(settings, plan)
    assert took_s == pytest.approx(time_s, rel=by)
    assert energy_wh is not None
    assert took_wh == pytest.approx(energy_wh / WEATHER, rel=max(2.0 * by, 0.05))


@pytest.mark.long
def test_what_a_boat_that_steers_takes_for_many_close_lines_is_foretold() -> None:
    """Taken by two and three; among four lines alone half of the arcs are loops, which take her longer."""
    ground = Ground(AT, MultiPolygon([box(0.0, 0.0, 100.0, 20.0)]), MultiPolygon())
    settings = config.load(ROOT / "etc/boats/skiff.toml")
    plan = planned(ground, wanted_of(settings, spacing_m=5.0, heading_deg=0.0), settings.fence)
    places = zip(("latitude", "longitude"), in_degrees(AT, *plan.begin), strict=True)
    here = config.load(ROOT / "etc/boats/skiff.toml", [CALM, *(f"simulation.{name}_deg={deg:.9f}" for name, deg in places)])
    took_s, took_wh = voyage(here, plan)
    time_s, energy_wh = foretold(settings, plan)
    assert took_s == pytest.approx(time_s, rel=0.03)
    assert energy_wh is not None
    assert took_wh == pytest.approx(energy_wh / WEATHER, rel=0.05)


def test_a_boat_says_what_its_turns_and_lines_take() -> None:
    short, long = (
        sailed(vehicle, wanted_of(vehicle, spacing_m=10.0), is_sharp=False)
        for vehicle in (config.load(ROOT / f"etc/boats/{name}.toml") for name in ("otter", "wam-v"))
    )
    assert short.turn.s < 0.0 < 3.0 < long.turn.s, "a long boat turns slowly"
    assert short.power_w < long.power_w
    assert short.sharp is None is long.sharp


def test_a_way_takes_its_length_its_ends_and_its_corners() -> None:
    ahead = straight((0.0, 0.0), (0.0, 50.0), (0.0, 100.0))
    assert taken(KNOWN, ahead) == pytest.approx((5.0 + 50.0, 50.0 + 5000.0))
    corner = straight((0.0, 0.0), (0.0, 50.0), (50.0, 50.0))
    assert taken(KNOWN, corner) == pytest.approx((55.0 + 2.0, 5050.0 + 400.0)), "half of a turn"
    back = straight((0.0, 0.0), (0.0, 50.0), (0.0, 0.0))
    assert taken(KNOWN, back) == pytest.approx((55.0 + 10.0, 5050.0 + 400.0))
    gentle, _ = taken(KNOWN, straight((0.0, 0.0), (0.0, 50.0), (35.355339, 85.355339)))
    assert 55.0 < gentle < 56.5


def test_a_slow_way_takes_longer_and_less() -> None:
    ahead = straight((0.0, 0.0), (0.0, 50.0), (0.0, 100.0), slow=(1,))
    assert taken(KNOWN, ahead) == pytest.approx((5.0 + 25.0 + 50.0, 50.0 + 2500.0 + 1000.0))
    back = straight((0.0, 0.0), (0.0, 50.0), (0.0, 100.0), (0.0, 50.0), slow=(1, 2))
    assert taken(KNOWN, back) == pytest.approx((5.0 + 25.0 + 100.0 + 12.0, 50.0 + 2500.0 + 2000.0 + 300.0))
    faster = straight((0.0, 0.0), (0.0, 50.0), (0.0, 0.0), slow=(0,))
    assert taken(KNOWN, faster) == pytest.approx((5.0 + 50.0 + 25.0 + 10.0, 50.0 + 1000.0 + 2500.0 + 200.0))


def test_a_boat_goes_straight_on_where_a_piece_back_is_left_as_it_begins() -> None:
    """Twelve metres back and on again: the boat leaves each piece eight metres before its end."""
    zigzag, _ = taken(KNOWN, straight((0.0, 0.0), (0.0, 50.0), (0.0, 38.0), (0.0, 88.0)))
    ahead, _ = taken(KNOWN, straight((0.0, 0.0), (0.0, 88.0)))
    assert zigzag == pytest.approx(ahead)


def test_a_boat_that_steers_takes_a_turn_for_each_arc_from_line_to_line() -> None:
    settings = config.load(ROOT / "etc/boats/skiff.toml")
    ground = Ground(AT, MultiPolygon([box(0.0, 0.0, 20.0, 60.0)]), MultiPolygon())
    plan = planned(ground, wanted_of(settings, spacing_m=10.0, heading_deg=0.0), config.Zones())
    pieces = legs(plan)
    assert len(plan.lines) == 2
    arcs = sum(leg.is_arc for leg in pieces)
    assert arcs == 3, "the lines are nearer to each other than a half circle"
    assert all(a.corner_rad(b) < 0.02 for a, b in pairwise(pieces)), "arcs lead from line to line"
    assert sum(leg.long_m for leg in pieces) == pytest.approx(plan.way_m)
    known = KNOWN._replace(wanted=plan.wanted)
    assert taken(known, pieces)[0] == pytest.approx(5.0 + plan.way_m / plan.wanted.speed_mps + 4.0 * arcs)
