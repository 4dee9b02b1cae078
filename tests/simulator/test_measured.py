"""The simulator sails a hull that was measured, and motors that are late."""

import math
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.measured import MeasuredModel, measured, model_of
from delfim.simulator.model import Model, hull_of
from delfim.simulator.tables import Sea, SimulatedHull, Simulation
from delfim.vehicle import console
from delfim.vehicle.control.hull import craft, gains
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
CURRENT = Sea(current_mps=0.2, current_to_deg=40.0)
SEA = Sea(current_mps=0.2, current_to_deg=40.0, wind_mps=5.0, wind_from_deg=100.0, gusts=0.0)


def blueboat(*overrides: str) -> config.Vehicle:
    return config.load(ROOT / "etc/boats/blueboat.toml", overrides)


@pytest.mark.parametrize(("lifts", "sea"), [(False, SEA), (True, CURRENT)])
def test_the_measured_hull_moves_as_its_numbers_say(lifts: bool, sea: Sea) -> None:
    """Those of the simulator's own hull give the same way, with its lift in calm air."""
    told = blueboat()
    hull = hull_of(told) if lifts else hull_of(told)._replace(lift_kg_per_m=0.0)
    rest = sea, 1, 0.67, -0.16, 0.3, told.thrusters
    one, other = Model(hull, *rest), MeasuredModel(told, measured(hull), *rest)
    for seconds, parts in ((8.0, (0.6, 0.9)), (5.0, (-0.4, 0.5)), (5.0, (0.0, 0.0))):
        for model in (one, other):
            for name, part in zip(("starboard", "port"), parts, strict=True):
                model.push(name, part)
            for _ in range(round(seconds / 0.2)):
                model.advance(0.2)
    assert (other.north_m, other.east_m, other.heading_rad) == pytest.approx(
        (one.north_m, one.east_m, one.heading_rad), abs=1e-9
    )
    assert math.hypot(one.north_m, one.east_m) > 3.0


def test_a_motor_with_a_delay_obeys_so_much_later() -> None:
    told = blueboat()
    rows = tuple(msgspec.structs.replace(row, delay_s=0.35) for row in told.thrusters)
    late = model_of(msgspec.structs.replace(told, thrusters=rows), 1)
    late.push("port", 0.5)
    late.advance(0.3)
    assert late.drives["port"].rpm == 0.0
    late.push("port", 0.0)
    late.advance(0.25)
    assert late.drives["port"].rpm > 0.0  # the first command is obeyed for as long as it lasted
    late.advance(5.0)
    assert late.drives["port"].rpm == pytest.approx(0.0, abs=1.0)


def test_thrust_is_lost_with_way_but_never_reversed() -> None:
    base = SimulatedHull(mass_kg=20.0, mass_aside_kg=30.0, inertia_kgm2=5.0, surge_n_per_mps=10.0, yaw_nm_per_radps=5.0)
    speeds = []
    for loss in (0.0, 0.1, 1.0):
        hull = msgspec.structs.replace(base, thrust_loss_s_per_m=loss)
        model = MeasuredModel(blueboat(), hull, Sea(), 1, 0.67, -0.16, 0.0, blueboat().thrusters)
        for name in ("starboard", "port"):
            model.push(name, 1.0)
        for _ in range(300):
            model.advance(0.1)
        speeds.append(model.surge_mps)
    assert speeds[0] > speeds[1] > speeds[2] > 0.0
    assert speeds[1] == pytest.approx(2 * 51.4 / (10.0 + 0.1 * 2 * 51.4), rel=0.01)


def test_delays_and_a_hull_come_from_the_vehicles_file_and_the_boat_sails() -> None:
    hull = ["mass_kg=21.0", "mass_aside_kg=40.0", "mass_turning_kg=40.0", "inertia_kgm2=5.0", "surge_n_per_mps=4.0"]
    hull += ["surge_n_per_mps2=8.0", "sway_n_per_mps2=60.0", "yaw_nm_per_radps=6.0", "yaw_nm_per_radps2=10.0"]
    settings = blueboat(*(f"simulation.hull.{each}" for each in hull))
    assert settings.of(Simulation).hull.mass_kg == 21.0
    run = Lockstep(settings, 1, lambda clock: NoLog())
    assert isinstance(run.nodes.model, MeasuredModel)
    for _ in run.cycles(5.0):
        pass
    assert run.command(console.Heading(90.0, 1.0)) is None
    for _ in run.cycles(40.0):
        pass
    assert math.degrees(run.nodes.model.heading_rad) == pytest.approx(90.0, abs=15.0)
    assert run.nodes.model.surge_mps > 0.7


def test_a_hull_is_told_whole() -> None:
    with pytest.raises(config.ConfigError, match="mass_kg, mass_aside_kg and inertia_kgm2 go together"):
        blueboat("simulation.hull.mass_kg=20.0")


def test_without_measured_numbers_the_model_is_the_one_it_was() -> None:
    assert type(model_of(blueboat(), 1)) is Model
    assert hull_of(blueboat()).motor_s == 0.3
    lags = [msgspec.structs.replace(row, lag_s=0.1) for row in blueboat().thrusters]
    assert hull_of(msgspec.structs.replace(blueboat(), thrusters=tuple(lags))).motor_s == pytest.approx(0.1)


def test_the_autopilot_takes_a_measured_inertia_and_damping() -> None:
    guessed = craft(blueboat())
    found = craft(blueboat("boat.inertia_kgm2=3.0", "boat.yaw_nm_per_radps=2.0", "boat.yaw_nm_per_radps2=4.0"))
    assert found.inertia_kgm2 == 3.0
    assert found.damping_nm_per_radps == pytest.approx(2.6)
    assert gains(blueboat(), found).turn_nm_per_radps == pytest.approx(2.6)
    assert gains(blueboat(), found).p_nm_per_rad < gains(blueboat(), guessed).p_nm_per_rad
