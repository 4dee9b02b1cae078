"""The model of boat and sea: what physics demands of it, and the figures that docs/simulator.md states."""

import math
import statistics
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim.base.geodesy import to_plane
from delfim.config import BoatTable, Steer, ThrusterTable, Vehicle, load
from delfim.simulator.model import Hull, Model, hull_of
from delfim.simulator.propulsor import Drive
from delfim.simulator.tables import Sea

CALM = Sea()


def boat(sea: Sea = CALM, seed: int = 1, heading_rad: float = 0.0, hull: Hull | None = None) -> Model:
    return Model(hull or Hull(), sea, seed, math.radians(38.69), math.radians(-9.21), heading_rad)


def drive(model: Model, starboard: float, port: float, seconds: float, dt_s: float = 0.2) -> Model:
    model.command("starboard", starboard, True)
    model.command("port", port, True)
    return drift(model, seconds, dt_s)


def drift(model: Model, seconds: float, dt_s: float = 0.2) -> Model:
    for _ in range(round(seconds / dt_s)):
        model.advance(dt_s)
    return model


def bytes_of(model: Model) -> tuple[str, ...]:
    """Everything that can be read off, to the last bit."""
    numbers = [
        *(model.north_m, model.east_m, model.heading_rad, model.surge_mps, model.sway_mps, model.yaw_rate_radps),
        *(model.latitude_rad, model.longitude_rad, model.north_mps, model.east_mps, model.roll_rad, model.pitch_rad),
        *(model.wind_north_mps, model.wind_east_mps, model.starboard.rpm, model.port.rpm),
        *(model.starboard.current_a, model.port.charge, model.starboard.voltage_v, model.port.temperature_c),
    ]
    return tuple(number.hex() for number in numbers)


def energy_j(model: Model) -> float:
    """Kinetic energy of boat and added water."""
    hull = model.hull
    return 0.5 * (
        (hull.mass_kg + hull.added_surge_kg) * model.surge_mps**2
        + (hull.mass_kg + hull.added_sway_kg) * model.sway_mps**2
        + (hull.inertia_kgm2 + hull.added_yaw_kgm2) * model.yaw_rate_radps**2
    )


def test_a_boat_at_rest_stays_at_rest() -> None:
    model = drift(boat(heading_rad=1.0), 600)
    assert (model.north_m, model.east_m, model.heading_rad, model.surge_mps, model.sway_mps, model.yaw_rate_radps) == (
        0,
        0,
        1,
        0,
        0,
        0,
    )


@pytest.mark.parametrize("heading_deg", [0.0, 77.0, 215.0])
def test_without_propellers_it_drifts_as_fast_as_the_water(heading_deg: float) -> None:
    model = drift(boat(Sea(current_mps=0.7, current_to_deg=120.0), heading_rad=math.radians(heading_deg)), 600)
    assert math.hypot(model.north_mps, model.east_mps) == pytest.approx(0.7, rel=1e-12)
    assert model.north_m == pytest.approx(420 * math.cos(math.radians(120)), rel=1e-9)
    assert model.east_m == pytest.approx(420 * math.sin(math.radians(120)), rel=1e-9)
    assert model.heading_rad == pytest.approx(math.radians(heading_deg))


def test_motion_through_the_water_knows_nothing_of_the_current() -> None:
    """Added mass and Coriolis terms act on the velocity through the water: a steady current carries everything alike."""
    still, carried = drive(boat(), 600, 900, 60), drive(boat(Sea(current_mps=1.5, current_to_deg=90.0)), 600, 900, 60)
    assert carried.surge_mps == pytest.approx(still.surge_mps, abs=1e-12)
    assert carried.heading_rad == pytest.approx(still.heading_rad, abs=1e-12)
    assert carried.north_m == pytest.approx(still.north_m, abs=1e-9)
    assert carried.east_m == pytest.approx(still.east_m + 90.0, abs=1e-9)


@given(st.floats(-1200, 1200), st.floats(-1200, 1200), st.floats(0, 0.6))
@settings(deadline=None, max_examples=30)
def test_a_turn_to_port_mirrors_one_to_starboard(one: float, other: float, current_mps: float) -> None:
    sea = Sea(current_mps=current_mps, current_to_deg=180.0)
    left, right = drive(boat(sea), one, other, 20), drive(boat(sea), other, one, 20)
    assert left.north_m == pytest.approx(right.north_m, abs=1e-9)
    assert left.east_m == pytest.approx(-right.east_m, abs=1e-9)
    assert math.remainder(left.heading_rad + right.heading_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_it_turns_away_from_the_faster_propeller() -> None:
    model = drive(boat(), 500, 900, 3)
    assert model.yaw_rate_radps > 0
    assert 0 < model.heading_rad < math.pi
    assert model.sway_mps < 0, "the boat slides outwards"


@pytest.mark.parametrize(
    ("rpm", "low_mps", "high_mps"),
    [(500, 0.85, 0.95), (1000, 1.9, 2.1), (1200, 2.3, 2.5), (-1000, -1.5, -1.2)],
)
def test_speed_ahead_and_astern(rpm: float, low_mps: float, high_mps: float) -> None:
    model = drive(boat(), rpm, rpm, 60)
    assert low_mps <= model.surge_mps <= high_mps
    assert model.sway_mps == model.yaw_rate_radps == 0.0


@pytest.mark.parametrize(
    ("starboard", "port", "low_degps", "high_degps"),
    [(500, 1000, 13, 16), (0, 1000, 16, 20), (-1000, 1000, 33, 39), (850, 950, 2.5, 4.0)],
)
def test_rate_of_turn(starboard: float, port: float, low_degps: float, high_degps: float) -> None:
    model = drive(boat(), starboard, port, 60)
    assert low_degps <= math.degrees(model.yaw_rate_radps) <= high_degps
    assert abs(math.atan2(model.sway_mps, model.surge_mps)) < math.radians(30), "a catamaran does not sail sideways"


@pytest.mark.parametrize("rpm", [800, 1200, -800])
def test_a_kick_dies_out_and_the_boat_runs_straight(rpm: float) -> None:
    model = drive(boat(), rpm, rpm, 30)
    model.yaw_rate_radps = math.radians(5)
    drift(model, 30)
    assert abs(model.yaw_rate_radps) < math.radians(0.01)
    assert abs(model.sway_mps) < 0.001


@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1))
@settings(deadline=None)
def test_without_propellers_the_water_only_takes_energy(surge: float, sway: float, rate: float) -> None:
    model = boat()
    model.surge_mps, model.sway_mps, model.yaw_rate_radps = surge, sway, rate
    before = energy_j(model)
    for _ in range(100):
        model.advance(0.1)
        after = energy_j(model)
        assert after <= before * (1 + 1e-9)
        before = after


@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1))
@settings(deadline=None)
def test_without_drag_energy_is_kept(surge: float, sway: float, rate: float) -> None:
    """Coriolis terms and Munk's moment do no work: they only move energy between the three motions."""
    drag = ("surge_n_per_mps", "surge_n_per_mps2", "sway_n_per_mps", "sway_n_per_mps2", "yaw_nm_per_radps", "yaw_nm_per_radps2")
    model = boat(hull=Hull()._replace(lift_kg_per_m=0.0, **dict.fromkeys(drag, 0.0)))
    model.surge_mps, model.sway_mps, model.yaw_rate_radps = surge, sway, rate
    before = energy_j(model)
    drift(model, 5.0, 0.01)
    assert energy_j(model) == pytest.approx(before, rel=1e-3, abs=1e-12)


def test_it_stops_when_the_motors_are_switched_off() -> None:
    model = drive(boat(), 1000, 1000, 60)
    before = model.north_m
    model.command("starboard", 1000, False)
    model.command("port", 1000, False)
    assert drift(model, 0.8, 0.1).starboard.rpm == pytest.approx(1000 / math.e, rel=0.01)
    assert drift(model, 9.2).surge_mps < 0.4
    assert drift(model, 110).surge_mps < 0.001
    assert 3 < model.north_m - before < 8, "stopping distance"
    assert model.starboard.rpm == pytest.approx(0.0, abs=1e-9)


def test_a_motor_follows_its_reference_within_rate_and_limit() -> None:
    model = boat()
    model.command("port", 5000, True)
    seen = [0.0]
    for _ in range(100):
        model.advance(0.05)
        seen.append(model.port.rpm)
    assert max(after - before for before, after in pairwise(seen)) <= model.hull.rpm_per_s_max * 0.05 + 1e-9
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(model.hull.rpm_max, rel=1e-3)
    assert model.starboard.rpm == 0.0


@pytest.mark.parametrize("rpm", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_motor_off(rpm: float) -> None:
    model = drive(boat(), 800, 800, 10)
    model.command("port", rpm, True)
    assert drift(model, 20).port.rpm == pytest.approx(0.0, abs=1e-6)
    assert model.starboard.rpm == pytest.approx(800.0, abs=1.0)


@pytest.mark.parametrize("failure", ["contactor", "empty"])
def test_no_current_no_propeller(failure: str) -> None:
    model = boat()
    if failure == "contactor":
        model.port.connected = False
    else:
        model.port.charge = 0.0
    drive(model, 800, 800, 10)
    assert model.port.rpm == 0.0
    assert model.port.current_a == 0.0
    assert model.starboard.rpm == pytest.approx(800.0, abs=1.0)
    assert model.yaw_rate_radps < 0, "turns towards the dead side"


def test_batteries_pay_for_the_propellers() -> None:
    model = drive(boat(), 1000, 0, 600)
    assert 15 < model.starboard.current_a < 35
    assert model.port.current_a == pytest.approx(model.hull.idle_a)
    given_ah = (1.0 - model.starboard.charge) * model.hull.capacity_ah
    assert given_ah == pytest.approx(model.starboard.current_a / 6, rel=0.1)
    assert model.starboard.voltage_v < model.port.voltage_v
    assert model.starboard.temperature_c > model.port.temperature_c


def test_wind_carries_the_boat_downwind_slower_than_a_tenth_of_its_speed() -> None:
    model = drift(boat(Sea(wind_mps=10.0, wind_from_deg=270.0, gusts=0.0)), 300)
    assert 0.2 < model.east_mps < 1.0
    assert abs(model.north_mps) < 0.2
    assert (model.wind_north_mps, model.wind_east_mps) == (pytest.approx(0.0, abs=1e-12), pytest.approx(10.0))


def test_head_wind_costs_speed() -> None:
    against, before = (
        boat(Sea(wind_mps=10.0, wind_from_deg=0.0, gusts=0.0)),
        boat(Sea(wind_mps=10.0, wind_from_deg=180.0, gusts=0.0)),
    )
    calm = drive(boat(), 800, 800, 60).surge_mps
    assert drive(against, 800, 800, 60).surge_mps < calm - 0.05
    assert drive(before, 800, 800, 60).surge_mps > calm + 0.05


@pytest.mark.parametrize("dt_s", [0.05, 1.0])
def test_gusts_have_the_asked_mean_and_deviation_whatever_the_step(dt_s: float) -> None:
    model = boat(Sea(wind_mps=10.0, wind_from_deg=180.0, gusts=0.2))
    along, across = [], []
    for _ in range(4000):
        model._gust(dt_s)
        along.append(model.wind_north_mps)
        across.append(model.wind_east_mps)
    assert statistics.fmean(along) == pytest.approx(10.0, abs=1.0)
    assert statistics.fmean(across) == pytest.approx(0.0, abs=1.0)
    for component in (along, across):
        assert statistics.stdev(component) == pytest.approx(2.0, rel=0.25)
        assert statistics.correlation(component[1:], component[:-1]) == pytest.approx(math.exp(-dt_s / 5.0), abs=0.03)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not() -> None:
    sea = Sea(current_mps=0.5, wind_mps=6.0)
    one, same, other = (bytes_of(drive(boat(sea, seed), 700, 800, 60)) for seed in (5, 5, 6))
    assert one == same
    assert one != other


def zigzag(dt_s: float) -> Model:
    model = boat(Sea(current_mps=0.5, current_to_deg=90.0, wind_mps=5.0, gusts=0.0))
    for leg in range(8):
        more = 200 if leg % 2 else -200
        drive(model, 900 + more, 900 - more, 6, dt_s)
    return model


def test_smaller_steps_change_little_and_less_each_time() -> None:
    """The midpoint rule is of second order: half the step, a quarter of the error."""
    exact = zigzag(0.002)
    errors_m = [math.hypot(m.north_m - exact.north_m, m.east_m - exact.east_m) for m in map(zigzag, (0.1, 0.05, 0.025))]
    assert errors_m[0] < 0.1
    assert errors_m[1] < errors_m[0] / 3
    assert errors_m[2] < errors_m[1] / 3


def test_a_long_step_is_divided() -> None:
    at_once, by_and_by = boat(), boat()
    for model in (at_once, by_and_by):
        model.command("port", 800, True)
    at_once.advance(5.0)
    drift(by_and_by, 5.0, 0.1)
    assert at_once.heading_rad == pytest.approx(by_and_by.heading_rad, abs=1e-9)
    assert at_once.time_s == pytest.approx(by_and_by.time_s)


def test_position_agrees_with_the_plane_and_velocity_with_position() -> None:
    model = drive(boat(Sea(current_mps=0.3, current_to_deg=45.0)), 900, 1000, 30)
    north_m, east_m = to_plane(model.origin, model.latitude_rad, model.longitude_rad)
    assert (north_m, east_m) == (pytest.approx(model.north_m, abs=1e-6), pytest.approx(model.east_m, abs=1e-6))
    before = model.north_m, model.east_m, model.north_mps, model.east_mps
    model.advance(0.01)
    assert model.north_m - before[0] == pytest.approx(0.01 * before[2], abs=1e-4)
    assert model.east_m - before[1] == pytest.approx(0.01 * before[3], abs=1e-4)


def test_it_rolls_and_pitches_more_in_wind_but_never_far() -> None:
    calm, windy = boat(), boat(Sea(wind_mps=10.0))
    rolls = [(abs(drift(calm, 0.2).roll_rad), abs(drift(windy, 0.2).roll_rad), abs(windy.pitch_rad)) for _ in range(200)]
    calm_most, windy_most, pitch_most = (max(column) for column in zip(*rolls, strict=True))
    assert 0 < calm_most < math.radians(1) < windy_most < math.radians(5)
    assert 0 < pitch_most < windy_most


def test_the_hull_of_delfimx_is_the_published_one() -> None:
    told = hull_of(load("etc/delfimx.toml"))
    assert told == Hull()._replace(length_m=4.5, propeller_m=1.029)


def test_a_hull_of_twice_the_length_and_eight_times_the_mass_moves_as_the_same_boat_slowed_down() -> None:
    """Froude: at the root of two times the speed its forces are eight times as large."""
    small, large = (hull_of(Vehicle(boat=BoatTable(name="x", length_m=2.25 * k, mass_kg=50.0 * k**3))) for k in (1.0, 2.0))

    def drag_n(hull: Hull, speed_mps: float) -> float:
        return (hull.surge_n_per_mps + hull.surge_n_per_mps2 * speed_mps) * speed_mps

    def turn_nm(hull: Hull, rate_radps: float) -> float:
        return (hull.yaw_nm_per_radps + hull.yaw_nm_per_radps2 * rate_radps) * rate_radps

    assert (large.mass_kg, large.inertia_kgm2) == pytest.approx((8 * small.mass_kg, 32 * small.inertia_kgm2))
    assert drag_n(large, math.sqrt(2.0)) == pytest.approx(8 * drag_n(small, 1.0))
    assert turn_nm(large, math.sqrt(0.5)) == pytest.approx(16 * turn_nm(small, 1.0))


OUTBOARD = ThrusterTable(
    name="motor",
    driver="dsor",
    x_m=-2.0,
    thrust_n=(-50.0, 200.0),
    steer=Steer(kind="azimuth", angle_max_deg=35.0, rate_dps=20.0),
)


def other(row: ThrusterTable, **more: object) -> ThrusterTable:
    """A row of another driver than that of DelfimX."""
    row = msgspec.structs.replace(row, **more)
    msgspec.structs.force_setattr(row, "driver", "vesc")
    return row


def driven(*rows: ThrusterTable, hull: Hull | None = None) -> Model:
    return Model(hull or Hull(), CALM, 1, math.radians(38.69), math.radians(-9.21), 0.0, rows)


def test_the_curve_of_a_row_gives_its_force_and_the_drag_the_speed() -> None:
    model = driven(other(OUTBOARD, steer=None), hull=Hull()._replace(surge_n_per_mps=0.0, surge_n_per_mps2=50.0))
    model.push("motor", 1.0)
    assert drift(model, 60).surge_mps == pytest.approx(2.0, rel=1e-3)
    model.push("motor", -1.0)
    assert drift(model, 60).surge_mps == pytest.approx(-1.0, rel=1e-3)


def test_an_outboard_turns_the_boat_at_the_rate_that_it_turns_itself() -> None:
    model = driven(other(OUTBOARD))
    model.push("motor", 0.5, math.radians(30.0))
    drift(model, 1.0)
    assert math.degrees(model.drives["motor"].angle_rad) == pytest.approx(20.0)
    drift(model, 5.0)
    assert math.degrees(model.drives["motor"].angle_rad) == pytest.approx(30.0)
    assert model.yaw_rate_radps < -0.05, "the stern is pushed to starboard"
    model.push("motor", 0.0, 0.0, run=False)
    drift(model, 5.0)
    assert math.degrees(model.drives["motor"].angle_rad) == pytest.approx(30.0), "a stop leaves it where it points"


def test_a_rudder_steers_ahead_and_not_astern() -> None:
    for part, turns in ((0.5, True), (-0.5, False)):
        model = driven(other(OUTBOARD, steer=Steer(kind="rudder")))
        model.push("motor", part, math.radians(30.0))
        assert (drift(model, 10.0).yaw_rate_radps < -0.01) is turns


def test_a_bow_thruster_pushes_aside_and_a_stuck_one_keeps_its_revolutions_and_angle() -> None:
    model = driven(other(OUTBOARD), other(OUTBOARD, name="bow", x_m=2.0, angle_deg=90.0, steer=None))
    model.push("bow", 1.0)
    drift(model, 10.0)
    assert model.sway_mps > 0.05
    assert model.yaw_rate_radps > 0.05
    stuck = model.drives["motor"]
    stuck.fault = "stuck"
    model.push("motor", 1.0, 0.5)
    drift(model, 5.0)
    assert (stuck.rpm, stuck.angle_rad) == (0.0, 0.0)
    model.drives["bow"].fault = "reversed"
    assert drift(model, 10.0).sway_mps < -0.05


@given(
    st.lists(st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000), st.booleans()), min_size=1, max_size=20),
    st.floats(0, 5),
    st.floats(0, 30),
)
@settings(deadline=None, max_examples=50)
def test_nothing_explodes(commands: list[tuple[float, float, bool]], current_mps: float, wind_mps: float) -> None:
    model = boat(Sea(current_mps=current_mps, wind_mps=wind_mps, wind_from_deg=100.0))
    for starboard, port, run in commands:
        model.command("starboard", starboard, run)
        model.command("port", port, run)
        drift(model, 2.0, 0.2)
        assert math.hypot(model.surge_mps, model.sway_mps) < 8.0
        assert abs(model.yaw_rate_radps) < 3.0
        assert 0.0 <= model.heading_rad <= math.tau


@given(st.floats(-180.0, 180.0), st.floats(-1.0, 1.0))
def test_a_thruster_that_does_not_turn_pushes_where_it_was_mounted(angle_deg: float, part: float) -> None:
    row = ThrusterTable("one", "vesc", thrust_n=(-30.0, 50.0), angle_deg=angle_deg)
    drive = Drive(row, 1000.0, 4000.0)
    assert drive.curve is not None
    force_n, to_rad = drive.curve.force(part), math.radians(angle_deg)
    assert drive.push_n(part) == (force_n * math.cos(to_rad), force_n * math.sin(to_rad))
