"""Hold with sway: who has it follows from the thrusters; a boat that has it keeps the point, any other does as before."""

import math
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.config import Steer, ThrusterTable
from delfim.simulator.tables import Sea
from delfim.vehicle.control.control import control
from delfim.vehicle.control.hull import craft
from delfim.vehicle.control.memory import Integrals, Memory, lacking, settings_of
from delfim.vehicle.control.sway import keep
from delfim.vehicle.state import Motion, Plan, Setpoint, Wanted, Waypoint
from tests.vehicle.closed_loop import ALL, DT_S, FLOAT, Sample, current, errors, float_, off_m, station

ROOT = Path(__file__).parents[2]
SETTINGS = settings_of(FLOAT)
HERE = Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def row(x_m: float, y_m: float, angle_deg: float = 0.0, most_n: float = 100.0, steer: Steer | None = None) -> ThrusterTable:
    address = round(10 * (x_m + 3) + y_m + 2)
    name = f"t{address}"
    return ThrusterTable(
        name=name,
        driver="pwm",
        address=address % 16,
        x_m=x_m,
        y_m=y_m,
        angle_deg=angle_deg,
        thrust_n=(-most_n, most_n),
        steer=steer,
    )


def azimuth(channel: int, rate_dps: float) -> Steer:
    return Steer(kind="azimuth", address=channel, rate_dps=rate_dps, angle_max_deg=180.0)


STERN = (row(-2.0, 1.0), row(-2.0, -1.0))


@pytest.mark.parametrize(
    ("rows", "has"),
    [
        (STERN, False),
        ((*STERN, row(2.0, 0.0, 90.0)), True),  # the bow thruster turns her, the propellers turn her back
        ((*STERN, row(2.0, 0.0, 90.0, most_n=20.0)), False),  # too weak to be worth it
        ((*STERN, row(2.0, 0.0, 90.0), row(-1.0, 0.0, 90.0)), True),
        ((row(2.0, 0.0, steer=azimuth(8, 360.0)), row(-2.0, 0.0, steer=azimuth(9, 360.0))), True),
        ((row(2.0, 0.0, steer=azimuth(8, 20.0)), row(-2.0, 0.0, steer=azimuth(9, 20.0))), False),  # too slow
    ],
    ids=["twin", "bow thruster", "weak bow thruster", "bow and stern thruster", "quick azimuths", "slow azimuths"],
)
def test_sway_follows_from_the_thrusters(rows: tuple[ThrusterTable, ...], has: bool) -> None:
    boat = config.Vehicle(boat=config.BoatTable(name="test"), thrusters=rows)
    assert (craft(boat).aside_n > 0.0) is has


def test_of_the_boats_to_start_from_the_float_alone_has_sway() -> None:
    files = [*(ROOT / "etc/boats").glob("*.toml"), ROOT / "etc/delfimx.toml"]
    assert [file.stem for file in files if craft(config.load(file)).aside_n] == ["float"]


@pytest.mark.parametrize("seed", range(20))
def test_the_float_keeps_the_point_and_its_heading_in_current_and_wind(seed: int) -> None:
    sea = msgspec.structs.replace(current(seed), wind_mps=8.0, wind_from_deg=18.0 * seed + 90.0)
    samples = station(float_(seed, sea), 180.0)
    off = errors([off_m(x) for x in samples])
    assert off.rms < 0.2
    assert off.most < 0.5
    turned_deg = [math.degrees(wrap(x.truth.heading_rad - samples[0].truth.heading_rad)) for x in samples]
    assert max(map(abs, turned_deg)) < 10.0


def test_without_sway_it_swings_through_the_radius() -> None:
    assert errors([off_m(x) for x in station(float_(1, current(5), sway=False), 180.0)]).rms > 2.0


def test_a_current_that_is_too_strong_from_the_side_turns_the_boat_into_it() -> None:
    samples = station(float_(1, Sea(current_mps=0.9, current_to_deg=90.0)), 600.0)
    assert max(map(off_m, samples)) < 8.0
    late = samples[-600:]
    assert max(map(off_m, late)) < 2.0
    assert all(abs(wrap(x.truth.heading_rad + math.pi / 2.0)) < math.radians(60.0) for x in late)


def test_in_calm_water_it_rests_most_of_the_time() -> None:
    samples = station(float_(1, Sea()), 300.0)
    assert sum(any(x.sent.thrust) for x in samples) < 0.3 * len(samples)


def test_with_a_thruster_that_dropped_out_it_keeps_the_point() -> None:
    boat = float_(1, current(3, mps=0.3))
    assert boat.propulsion.drop(("bow_port",)) == ""
    assert max(map(off_m, station(boat, 180.0))) < 5.0


def test_at_a_waypoint_of_a_mission_it_keeps_the_heading_of_its_arrival() -> None:
    stop = Waypoint(0.0, 40.0, 0.8, 3.0, 60.0)
    plan = Plan("", (Waypoint(30.0, 0.0, 0.8, 3.0, 60.0), stop), ())
    samples = [x for x in float_(1, current(0, mps=0.2)).sail(Mode.PLAY, Setpoint(plan=plan), 300.0) if x.mode is Mode.PLAY]

    def resting(leg: int) -> list[Sample]:
        return [x for x in samples if x.leg == leg and x.reference.leg == leg and x.reference.speed_mps == 0.0][150:]

    for leg, to in enumerate(plan.waypoints):
        assert len(resting(leg)) > 100
        assert max(math.hypot(x.truth.north_m - to.north_m, x.truth.east_m - to.east_m) for x in resting(leg)) < 0.8
    first, second = (resting(leg)[0].reference.heading_rad or 0.0 for leg in (0, 1))
    assert abs(wrap(second - first)) > 1.0


def test_what_the_thrusters_could_not_give_to_the_side_stops_that_integral_alone() -> None:
    _, asked = keep(Integrals(), HERE, 0.0, 2.0, 2.0, SETTINGS, DT_S)
    assert asked.surge_n > 0.0
    assert asked.sway_n > 0.0
    short = lacking(Memory(Integrals()), (0.0, 5.0, 0.0)).integrals
    after, _ = keep(short, HERE, 0.0, 2.0, 2.0, SETTINGS, DT_S)
    assert (after.sway_n, after.surge_n > 0.0) == (0.0, True)
    after, _ = keep(short, HERE, 0.0, 2.0, -2.0, SETTINGS, DT_S)
    assert after.sway_n < 0.0


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, math.pi, -2.0])
def test_it_pushes_towards_the_point_whichever_way_it_looks(heading_rad: float) -> None:
    _, wanted = keep(Integrals(), HERE._replace(heading_rad=heading_rad), heading_rad, 3.0, 0.0, SETTINGS, DT_S)
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    north_n, east_n = wanted.surge_n * c - wanted.sway_n * s, wanted.surge_n * s + wanted.sway_n * c
    assert north_n > 0.0
    assert abs(east_n) < north_n, "more is asked for to the side, where more water is carried along"
    assert wanted.yaw_nm == 0.0


def test_a_boat_without_sway_rests_within_the_radius() -> None:
    plain = SETTINGS._replace(hull=SETTINGS.hull._replace(aside_n=0.0))
    near = HERE._replace(north_m=2.0, north_mps=0.1)
    assert control(Mode.HOLD, Memory(), near, Setpoint(), plain, DT_S)[2] == Wanted()
    assert control(Mode.HOLD, Memory(), near, Setpoint(), SETTINGS, DT_S)[2].surge_n < 0.0
