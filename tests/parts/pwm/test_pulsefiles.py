"""Motors of every make move the simulated boat: in real time by pulses in files, in lock step as commanded."""

import math
from pathlib import Path

import pytest

from delfim import config
from delfim.base import pulses
from delfim.base.errors import DelfimError
from delfim.parts.pwm import sim as pulsefiles
from delfim.parts.pwm.driver import Pulses
from delfim.parts.pwm.table import Pwm
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.workspace import Workspace, settings_of
from delfim.vehicle import console
from delfim.vehicle.state import Actuation, NoLog


def rows(driver: str, **changes: object) -> tuple[config.ThrusterTable, ...]:
    return tuple(
        config.ThrusterTable(
            name=name, driver=driver, address=n, x_m=-1.0, y_m=0.5 - n, thrust_n=(-100.0, 150.0), rpm_max=1800.0, **changes
        )
        for n, name in enumerate(("starboard", "port"))
    )


def written(vehicle: config.Vehicle) -> str:
    """A vehicle's file with these thrusters."""
    lines = [f'[boat]\nname = "{vehicle.boat.name}"']
    for row in vehicle.thrusters:
        lines.append(f'[[thrusters]]\nname = "{row.name}"\ndriver = "{row.driver}"\naddress = {row.address}\nx_m = -1.0')
        lines.append(f"y_m = {row.y_m}\nthrust_n = [-100.0, 150.0]\nrpm_max = 1800.0")
    return "\n".join(lines)


class Pushed:
    """A model that remembers how its thrusters are told to push."""

    def __init__(self) -> None:
        self.told = dict[str, tuple[float, float]]()

    def push(self, name: str, part: float, angle_rad: float = 0.0, run: bool = True) -> None:
        self.told[name] = round(part, 3), round(angle_rad, 3)


def test_pulses_in_files_push_the_model(tmp_path: Path) -> None:
    row = config.ThrusterTable(
        name="outboard",
        driver="pwm",
        address=2,
        x_m=-1.0,
        thrust_n=(-50.0, 100.0),
        steer=config.Steer(kind="azimuth", address=5, angle_max_deg=30.0),
    )
    boat = config.Vehicle(
        boat=config.BoatTable(name="test"),
        thrusters=(row,),
        pwm=Pwm(chip=f"{tmp_path}/pwmchip0"),
        runtime=config.RuntimeTable(run_directory=str(tmp_path)),
    )
    model = Pushed()
    motor = pulsefiles.nodes(boat, model, 1)["outboard"]
    motor.step(0.0, 0)
    assert model.told == {"outboard": (0.0, 0.0)}, "no pulses yet"
    for channel, pulse_ns in ((2, 1_700_000), (5, 1_300_000)):
        (tmp_path / f"pwmchip0/pwm{channel}/duty_cycle").write_text(f"{pulse_ns}\n")
    motor.step(0.01, 0)
    assert model.told["outboard"][0] == 0.0, "not due yet"
    motor.step(0.05, 0)
    assert model.told == {"outboard": (0.5, -0.262)}
    assert pulsefiles.nodes(config.Vehicle(boat=config.BoatTable(name="test"), thrusters=(row,)), model, 1) == {}, "a real chip"


class Outlet:
    """The outlet's socket, with the last record."""

    def write(self, data: bytes) -> bool:
        self.fractions = pulses.unpack_command(data).fractions
        return True


@pytest.mark.parametrize(
    ("changes", "fractions"),
    [({}, (0.5, -1.0)), ({"reversed": True}, (-0.5, 1.0)), ({"reversed": True, "middle_deg": 6.0}, (-0.3, 1.0))],
)
def test_a_servo_that_is_mounted_anyhow_gets_the_pulse_of_the_angle(changes, fractions) -> None:
    steer = config.Steer(kind="rudder", address=5, angle_max_deg=30.0, **changes)
    row = config.ThrusterTable(name="propeller", driver="pwm", x_m=-1.0, thrust_n=(-50.0, 100.0), steer=steer)
    outlet = Outlet()
    driver = Pulses(config.Vehicle(boat=config.BoatTable(name="test"), thrusters=(row,)), outlet)
    for angle_deg, fraction in zip((15.0, -35.0), fractions, strict=True):
        driver.send(Actuation((0.0,), (math.radians(angle_deg),), True), 0.0)
        assert outlet.fractions[5] == pytest.approx(fraction)


def test_a_servo_of_the_true_boat_turns_as_it_is_mounted(tmp_path: Path) -> None:
    """The simulated servo is straight and not reversed: what is told it differs by how both files have it."""
    files = list[Path]()
    for name, more in (("told", "middle_deg = 4.0"), ("true", "reversed = true, middle_deg = 10.0")):
        files.append(tmp_path / f"{name}.toml")
        files[-1].write_text(
            f"""[boat]\nname = "skiff"\n[[thrusters]]\nname = "outboard"\ndriver = "pwm"\nx_m = -2.0\nthrust_n = [-100.0, 150.0]
steer = {{ kind = "azimuth", address = 1, {more} }}\n"""
        )
    told = settings_of(config.load(files[0]), Workspace(1, tmp_path), (), config.load(files[1]))
    steer = config.load(files[0], told.overrides).thrusters[0].steer
    assert steer is not None
    assert (steer.reversed, steer.middle_deg) == (True, 6.0)


def test_the_motors_of_a_front_seat_are_told_by_pulses_in_a_simulation(tmp_path: Path) -> None:
    boat = config.Vehicle(boat=config.BoatTable(name="skiff"), thrusters=rows("otter"))
    file = tmp_path / "boat.toml"
    file.write_text(written(boat))
    simulated = config.load(file, settings_of(config.load(file), Workspace(1, tmp_path), ()).overrides)
    assert [(row.driver, row.address, row.thrust_n) for row in simulated.thrusters] == [
        ("pwm", 0, (-100.0, 150.0)),
        ("pwm", 1, (-100.0, 150.0)),
    ]
    assert Path(simulated.pwm.chip).is_relative_to(simulated.runtime.run_directory)
    assert not [
        each
        for each in settings_of(config.Vehicle(boat=boat.boat), Workspace(1, tmp_path), ()).overrides
        if "pwm" in each and "pwm.cut" not in each
    ]


def test_more_motors_than_channels_are_refused_in_words(tmp_path: Path) -> None:
    many = tuple(
        config.ThrusterTable(
            name=f"t{n}",
            driver="pwm",
            address=n,
            x_m=-1.0,
            thrust_n=(-50.0, 50.0),
            steer=config.Steer(kind="azimuth", address=n + 8),
        )
        for n in range(8)
    )
    boat = config.Vehicle(boat=config.BoatTable(name="many"), thrusters=(*many, *rows("otter")))
    with pytest.raises(DelfimError, match="16 channels"):
        settings_of(boat, Workspace(1, tmp_path), ())


@pytest.mark.parametrize("driver", ["dronecan", "vesc", "pwm", "otter", "heron", "mavlink_front_seat"])
def test_a_boat_with_motors_of_any_make_sails_in_lock_step(driver: str) -> None:
    boat = config.Vehicle(
        boat=config.BoatTable(name="skiff", length_m=4.0, beam_m=1.6),
        thrusters=rows(driver),
        sysstat=config.Sysstat(required=("gps",)),
    )
    sailing = Lockstep(boat, 1, lambda clock: NoLog())
    for _ in sailing.cycles(3.0):
        pass
    assert sailing.command(console.Manual(starboard=0.6, port=0.6)) is None
    for _ in sailing.cycles(10.0):
        sailing.command(console.Manual(starboard=0.6, port=0.6))
    assert sailing.state.actuation.thrust == pytest.approx((0.6, 0.6))
    assert sailing.nodes.model.surge_mps > 0.5
    assert sailing.command(console.Stop()) is None
    for _ in sailing.cycles(10.0):
        pass
    assert sailing.nodes.model.surge_mps < 0.3
