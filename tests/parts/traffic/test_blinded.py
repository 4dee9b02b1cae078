"""Who would blind the guard: forged reports beside a real ship that comes head-on, through the whole boat in lock step."""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random

import msgspec
import pytest

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.base.vessels import VesselPosition
from delfim.parts.traffic.targets import MOST
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes.other_vessels import Vessel
from delfim.simulator.tables import SimulatedTraffic, SimulatedVessel
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
SET = ("simulation.heading_deg=0.0", 'sensors.names=["sysstat", "nmea2000"]')
MMSI = 244_660_123
BOAT_MPS, SHIP_MPS, MEETS_S = 1.5, 5.0, 260.0
SECOND_S = 5  # by which forged reports are newer
Place = tuple[float, float]  # north and east of the boat, m


class Voyage:
    """The boat steers north; a ship of 60 m comes exactly the other way, and is heard as ships are."""

    def __init__(self, **row: float | str) -> None:
        settings, replace = config.load(VEHICLE, SET), msgspec.structs.replace
        told: dict[str, object] = {"north_m": BOAT_MPS * (MEETS_S - 10.0) + SHIP_MPS * MEETS_S, "speed_mps": SHIP_MPS}
        ship = SimulatedVessel(
            name="MARIA",
            mmsi=MMSI,
            transponder="A",
            length_m=60.0,
            course_deg=180.0,
            **(told | row),  # type: ignore[arg-type]
        )
        world = replace(settings.simulation, traffic=SimulatedTraffic(vessel=(ship,)))
        self.run = Lockstep(replace(settings, simulation=world), 1, lambda clock: NoLog())
        self.told = set[str]()
        list(self.run.cycles(10.0))
        assert self.run.command(console.Course(0.0, BOAT_MPS)) is None

    @property
    def ship(self) -> Vessel:
        return self.run.nodes.vessels[0]

    @property
    def second(self) -> int:
        return self.run.clock.time_ns() // 1_000_000_000 % 60

    def told_at(self, north_m: float, east_m: float, course_rad: float, speed_mps: float, number: int, **more: object) -> None:
        """A forged report."""
        assert self.run.state.origin is not None
        at = from_plane(self.run.state.origin, north_m, east_m)
        kind = str(more.get("kind", "A"))
        told = VesselPosition(number, *at, course_rad, speed_mps, None, None, kind, second=more.get("second"))  # type: ignore[arg-type]
        self.run.state.hear(told, "ais", self.run.elapsed_s)

    def sail(self, seconds: float) -> Iterator[None]:
        for state in self.run.cycles(seconds):
            assert state.mode is Mode.COURSE
            self.told |= {each.reason for each in state.notices}
            yield


def test_alone_the_ship_is_passed_well_clear() -> None:
    voyage = Voyage()
    list(voyage.sail(MEETS_S + 60.0))
    assert voyage.ship.nearest > 1.0


def offsets(kind: str) -> Iterable[tuple[float, float, float, float]]:
    """(north_m, east_m, course_rad, speed_mps) of each forged report of an instant, from the ship's own place."""
    match kind:
        case "beside":
            return [(0.0, 130.0, math.pi, SHIP_MPS)] * 2
        case "near":
            return [(0.0, 60.0, math.pi, SHIP_MPS)] * 2
        case "stopped":
            return [(0.0, 0.0, math.pi, 0.0)] * 2
        case "away":
            return [(0.0, 0.0, 0.0, SHIP_MPS)] * 2
        case "three places":
            return [(0.0, each, math.pi, SHIP_MPS) for each in (130.0, -130.0, 90.0)]
    raise AssertionError


@pytest.mark.parametrize(
    ("kind", "newer_s"),
    [
        *(("beside", SECOND_S), ("near", SECOND_S), ("stopped", SECOND_S), ("away", SECOND_S), ("three places", SECOND_S)),
        *(("beside", None), ("away", None)),
    ],
)
def test_a_ship_whose_number_is_forged_beside_it_is_kept_clear_of(kind: str, newer_s: int | None) -> None:
    voyage = Voyage()
    for _ in voyage.sail(MEETS_S + 60.0):
        ship = voyage.ship
        for north_m, east_m, course_rad, speed_mps in offsets(kind):
            second = None if newer_s is None else (voyage.second + newer_s) % 60
            voyage.told_at(ship.north_m + north_m, ship.east_m + east_m, course_rad, speed_mps, MMSI, second=second)
    assert voyage.ship.nearest > 0.9
    assert any("contradict each other" in each for each in voyage.told)


@pytest.mark.parametrize(("far_m", "course_rad"), [(140.0, 1.0), (1000.0, None)])
def test_a_ship_whose_number_is_told_all_over_the_place_is_kept_clear_of(far_m: float, course_rad: float | None) -> None:
    voyage, random = Voyage(), Random(1)
    for _ in voyage.sail(MEETS_S + 30.0):
        north_m, east_m = random.uniform(-far_m, far_m), random.uniform(-far_m, far_m)
        moves_rad = random.uniform(0.0, math.tau) if course_rad is None else course_rad
        voyage.told_at(voyage.ship.north_m + north_m, voyage.ship.east_m + east_m, moves_rad, SHIP_MPS, MMSI)
    assert voyage.ship.nearest > 0.9
    assert "reports of MARIA contradict each other: there may be more than one" in voyage.told


@pytest.mark.parametrize(("places", "at_once"), [([(0.0, 2000.0)], True), ([(0.0, 2000.0), (0.0, -2000.0)], False)])
def test_a_ship_is_heeded_although_its_number_was_heard_at_the_boat_and_elsewhere(places: list[Place], at_once: bool) -> None:
    """Who comes along is left alone; a ship that comes under that number is not. `at_once`: all places are told together."""
    voyage = Voyage(silent_from_s=0.0, silent_to_s=130.0)
    for i, _ in enumerate(voyage.sail(MEETS_S + 30.0)):
        if i % 5:
            continue
        own = voyage.run.state.motion
        moves = math.atan2(own.east_mps, own.north_mps), math.hypot(own.north_mps, own.east_mps)
        told = [(0.0, 0.0), *(places if at_once else [places[i // 5 % len(places)]])]
        for north_m, east_m in told if voyage.run.elapsed_s > 100.0 else told[:1]:
            voyage.told_at(own.north_m + north_m, own.east_m + east_m, *moves, MMSI, second=voyage.second)
    assert any("moves as this boat does" in each for each in voyage.told)
    assert voyage.ship.nearest > 0.9


def test_a_ship_that_had_the_number_of_who_came_along_is_heeded_after_a_restart() -> None:
    voyage = Voyage(silent_from_s=0.0, silent_to_s=130.0)
    for i, _ in enumerate(voyage.sail(90.0)):
        own = voyage.run.state.motion
        if i % 5 == 0:
            moves = math.atan2(own.east_mps, own.north_mps), math.hypot(own.north_mps, own.east_mps)
            voyage.told_at(own.north_m, own.east_m, *moves, MMSI, second=voyage.second)
    assert voyage.run.state.traffic.beside == (str(MMSI),)
    voyage.run.restart(1.0)
    list(voyage.run.cycles(5.0))
    assert voyage.run.command(console.Course(0.0, BOAT_MPS)) is None
    list(voyage.sail(MEETS_S - 60.0))
    assert voyage.ship.nearest > 0.9
    assert voyage.run.state.traffic.beside == ()


def test_harmless_boats_around_hide_no_ship() -> None:
    """Twelve of them abeam, on the boat's course and at its speed."""
    voyage = Voyage()
    for i, _ in enumerate(voyage.sail(MEETS_S + 60.0)):
        own = voyage.run.state.motion
        for k in range(12):
            east_m = (100.0 + 4.0 * k) * (1.0 if k % 2 else -1.0)
            if i % 5 == k % 5:
                voyage.told_at(own.north_m + 6.0 * (k - 6), own.east_m + east_m, 0.0, BOAT_MPS, 263_100_000 + k, kind="B")
    assert voyage.ship.nearest > 0.9


def test_boats_that_draw_apart_take_no_ship_its_place() -> None:
    """Of 250 of class B, astern, each report comes every three seconds."""
    voyage, random = Voyage(), Random(1)
    places = [(random.uniform(-260.0, -60.0), random.uniform(-200.0, 200.0)) for _ in range(250)]
    for i, _ in enumerate(voyage.sail(MEETS_S + 60.0)):
        own = voyage.run.state.motion
        for k, (north_m, east_m) in enumerate(places):
            if k % 15 == i % 15:
                voyage.told_at(own.north_m + north_m, own.east_m + east_m, math.pi, 2.0, 263_100_000 + k, kind="B")
    assert len(voyage.run.state.traffic.targets) > 0.9 * MOST
    assert voyage.ship.nearest > 0.9


def test_a_flood_of_reports_keeps_no_ship_out_and_is_told_of() -> None:
    """Five hundred a second, of 400 vessels that lie around."""
    voyage, random, known = Voyage(), Random(1), False
    places = [(random.uniform(-700.0, 700.0), random.choice((-1.0, 1.0)) * random.uniform(250.0, 700.0)) for _ in range(400)]
    for _ in voyage.sail(150.0):
        for k in random.choices(range(400), k=100):
            voyage.told_at(*places[k], 0.0, 0.0, 263_100_000 + k)
        away_m = voyage.ship.north_m - voyage.run.state.motion.north_m
        known = known or (away_m > 900.0 and any(each.key == str(MMSI) for each in voyage.run.state.traffic.targets))
    assert known
    assert any(each.startswith("more reports of other vessels than the boat can take") for each in voyage.told)


def test_more_vessels_in_the_way_than_are_judged_are_told_of() -> None:
    voyage = Voyage()
    for i, _ in enumerate(voyage.sail(60.0)):
        for k in range(15):
            if i % 5 == k % 5:
                voyage.told_at(500.0 + 10.0 * k, 5.0 * (k - 7), math.pi, 0.5, 263_100_000 + k, kind="B")
    assert any(each.endswith("vessels in the way at once: the boat heeds the 12 that it meets first") for each in voyage.told)
