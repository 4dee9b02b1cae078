"""A voyage of a hidden boat with its state log on disk: the whole program in lock step, which sails courses and speeds."""

import math
from pathlib import Path

import msgspec

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import Model
from delfim.simulator.tables import Sea
from delfim.vehicle import console
from delfim.vehicle.log.logbook import Logbook
from tests.adoption.hulls import Hidden

SEA = Sea(current_mps=0.2, current_to_deg=70.0, wind_mps=2.0, wind_from_deg=200.0)
LEGS = ((30, 0.6), (100, 1.0), (190, 1.4), (250, 0.8), (20, 1.2), (80, 0.5), (200, 1.0), (300, 1.4), (10, 1.0))  # deg, m/s
VEHICLE = """\
# A boat for tests, as its owner wrote it.
[boat]
name = "{name}"
length_m = {length:g}
beam_m = {beam:g}
mass_kg = {mass:g}  # by the scales

[control.speed]
cruise_mps = 1.0
max_mps = 1.5

# Motors, starboard first.
{rows}"""
ROW = """\
[[thrusters]]
name = "{name}"
driver = "pwm"
address = {address}
x_m = -0.5
y_m = {y:g}
thrust_n = [{astern:g}, {ahead:g}]  # of the shop's page
rate_per_s = 4.0

"""


def file_of(hidden: Hidden, place: Path) -> Path:
    """Write the owner's file of a hidden boat."""
    boat = hidden.told.boat
    rows = "".join(
        ROW.format(name=row.name, address=row.address, y=row.y_m, astern=row.thrust_n[0], ahead=row.thrust_n[1])
        for row in hidden.told.thrusters
    )
    text = VEHICLE.format(name=boat.name, length=boat.length_m, beam=boat.beam_m, mass=boat.mass_kg, rows=rows)
    place.write_text(text)
    return place


def sail(hidden: Hidden | None, file: Path, log: Path, seed: int = 1) -> None:
    """Sail the legs, and log them; without a hidden boat, with the simulator's own of that file."""
    overrides = [
        f'log.directory="{log}"',
        'log.state_method="zwrite"',
        "log.free_bytes_min=0",
        'can.interface="canloop:lockstep"',
    ]
    told = config.load(file, overrides)
    run = Lockstep(told, seed, lambda clock: Logbook(told, clock), hidden.model(SEA, seed) if hidden else None)
    for _ in run.cycles(4.0):
        pass
    _legs(run, 1.0)
    assert run.order(console.LoadMission(_square(run)), "test") is None
    assert run.order(console.Play(), "test") is None
    for state in run.cycles(200.0):
        if state.mode is not Mode.PLAY:
            break
    assert run.command(console.Stop()) is None
    for _ in run.cycles(10.0):
        pass
    run.close()


def sail_legs(told: config.Vehicle, model: Model, log: Path, seed: int = 1) -> None:
    """Sail the legs by this model, as quickly as the file lets this boat, and log them."""
    logs = msgspec.structs.replace(told.log, directory=str(log), state_method="zwrite", free_bytes_min=0)
    told = msgspec.structs.replace(told, log=logs)
    run = Lockstep(told, seed, lambda clock: Logbook(told, clock), model)
    for _ in run.cycles(6.0):
        pass
    _legs(run, told.control.speed.max_mps / max(speed_mps for _, speed_mps in LEGS))
    assert run.command(console.Stop()) is None
    for _ in run.cycles(10.0):
        pass
    run.close()


def _legs(run: Lockstep, share: float) -> None:
    """Courses and speeds, each so much of what stands in LEGS."""
    for heading_deg, speed_mps in LEGS:
        assert run.command(console.Heading(float(heading_deg), share * speed_mps)) is None
        for _ in run.cycles(20.0):
            pass


def _square(run: Lockstep) -> str:
    """A mission about where the boat is."""
    here, rows = run.nodes.model, list[str]()
    for north_m, east_m in ((20.0, 0.0), (50.0, 0.0), (50.0, 30.0), (20.0, 30.0)):
        place = from_plane(here.origin, here.north_m + north_m, here.east_m + east_m)
        latitude, longitude = (math.degrees(each) for each in place)
        rows.append(f"[[waypoint]]\nlatitude_deg = {latitude:.9f}\nlongitude_deg = {longitude:.9f}\nspeed_mps = 1.0\n")
    return "\n".join(['version = 1\nname = "Square"\n', *rows])
