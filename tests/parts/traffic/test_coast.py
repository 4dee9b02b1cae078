"""The guard beside charted land: what it orders for ships leads into no no-go water, and a boat that has no way says so."""

import math
from pathlib import Path
from random import Random

import pytest

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import Memory, decide
from delfim.parts.traffic.trialways import RouteAhead
from delfim.parts.traffic.watchkeeper import LED_ASIDE
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.plans.clearance import laid
from delfim.vehicle.plans.clearancefile import read
from delfim.vehicle.plans.fence import Fence, is_clear
from delfim.vehicle.plans.zones import charted
from delfim.vehicle.state import NoLog
from tests.parts.traffic.encounters import LIMITS, Ship, exactly, moved, place
from tests.vehicle.charted import Shoal, chart, written
from tests.vehicle.test_charted import AT, VEHICLE

KEPT_BACK = 20261128  # coasts and ships that nobody has looked at while the guard was made
BEGIN, GOAL = (-230.0, 0.0), (230.0, 0.0)
END_S, MPS = 700, 1.5


def coast(random: Random) -> list[Shoal]:
    """Land to both sides of a fairway of 30 to 160 m, as shoals one beside the other, with spits into it."""
    half_m = random.uniform(15.0, 80.0)
    found = list[Shoal]()
    for north_m in range(-280, 281, 20):
        for side in (-1.0, 1.0):
            radius_m = random.uniform(12.0, 25.0)
            found.append((north_m, side * (half_m + radius_m + random.uniform(0.0, 15.0)), radius_m))
    return found


def met(random: Random) -> Ship:
    """A ship that meets the boat after 40 to 200 s; most come along the fairway."""
    tcpa_s, mps, length_m = random.uniform(40.0, 200.0), random.uniform(0.8, 4.0), random.choice((6.0, 12.0, 30.0))
    course_rad = math.radians(random.choice((0.0, 180.0)) + random.gauss(0.0, 10.0))
    if random.random() < 0.3:
        course_rad = random.uniform(0.0, math.tau)
    north_m, east_m = BEGIN[0] + MPS * tcpa_s, random.uniform(-20.0, 20.0)
    back_m = mps * tcpa_s
    return Ship(
        north_m - back_m * math.cos(course_rad), east_m - back_m * math.sin(course_rad), course_rad, mps, length_m, "", tcpa_s
    )


def sailed(seed: int) -> tuple[float, bool, str, float]:
    """The smallest clearance, m, whether the boat arrived, the words of its last order, and the least of ships' domains."""
    random = Random(f"coast {seed}")
    field = laid(read(chart(AT, coast(random))).water(""), AT)
    around = Fence((charted("no-go water", field),), config.FenceTable())
    ships = [met(random) for _ in range(random.randint(1, 3))]
    if not is_clear(around, BEGIN, GOAL)[0]:
        return math.inf, True, "", math.inf
    own, memory, words, nearest_m, nearness, stops = Own(*BEGIN, 0.0, MPS), Memory(), "", math.inf, math.inf, 0
    for t in range(END_S):
        now = [each.at(float(t)) for each in ships]
        memory, order, _ = decide(LIMITS, memory, own, RouteAhead((GOAL,), MPS), exactly(float(t), now), around, float(t))
        course_rad = math.atan2(GOAL[1] - own.east_m, GOAL[0] - own.north_m) if order is None else order.course_rad
        words = "" if order is None else order.words
        stops += order is not None and order.speed_part == 0.0 and "stopped" not in order.words
        own = moved(own, course_rad, MPS if order is None else order.speed_mps, LIMITS)
        nearest_m = min(nearest_m, field.clear_m(own.north_m, own.east_m))
        nearness = min(nearness, *(place(own, each)[0] for each in now))
        if math.dist((own.north_m, own.east_m), GOAL) < 8.0:
            return nearest_m, True, words, nearness
    assert not stops
    return nearest_m, False, words, nearness


@pytest.mark.parametrize("seed", range(KEPT_BACK, KEPT_BACK + 6))
def test_beside_charted_land_the_guard_leads_into_none_and_says_where_there_is_no_way(seed: int) -> None:
    nearest_m, has_arrived, words, _ = sailed(seed)
    assert nearest_m > 0.0
    assert has_arrived or words


def led_aside(random: Random, folder: Path) -> Lockstep:
    """A boat off a gap between two spits, with ships that meet it on its way."""
    shoals, ships = list[Shoal](), list[str]()
    for side in (1, -1):
        north_m, east_m = random.uniform(60.0, 150.0), random.uniform(14.0, 22.0)
        shoals += [(north_m + random.uniform(0.0, 6.0), side * (east_m + 10.0 * i), 8.0) for i in range(random.randint(3, 8))]
    for _ in range(random.randint(1, 2)):
        t_s, mps = random.uniform(50.0, 120.0), random.uniform(0.8, 2.5)
        course_deg = random.choice((180.0, random.uniform(90.0, 270.0)))
        north_m = MPS * t_s - mps * t_s * math.cos(math.radians(course_deg))
        east_m = -mps * t_s * math.sin(math.radians(course_deg))
        ships.append(f"{{{north_m=},{east_m=},{course_deg=},speed_mps={mps},length_m=12.0}}")
    overrides = [written(folder, chart(AT, shoals)), 'sensors.names=["sysstat","nmea2000"]']
    overrides += ['simulation.traffic.heard="perfect"', f"simulation.traffic.vessel=[{','.join(ships)}]"]
    return Lockstep(config.load(VEHICLE, overrides), 1, lambda clock: NoLog())


@pytest.mark.parametrize("seed", [0, 4, 6])
def test_a_goto_that_ships_led_aside_finds_its_way_through_a_gap_of_the_shore(seed: int, tmp_path: Path) -> None:
    run = led_aside(Random(f"led aside {seed}"), tmp_path)
    for _ in run.cycles(10.0):
        pass
    latitude_rad, longitude_rad = from_plane(AT, 210.0, 0.0)
    assert run.command(console.Goto(math.degrees(latitude_rad), math.degrees(longitude_rad))) is None
    reasons = set[str]()
    for state in run.cycles(500.0):
        reasons.add(state.reason)
        if state.mode is not Mode.GOTO:
            break
    assert any(words.startswith(f"{LED_ASIDE}; by ") for words in reasons)
    assert (run.state.mode, run.state.reason) == (Mode.HOLD, "goto done")
