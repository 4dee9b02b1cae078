"""Model and control in one loop, without bus, clock or messages: the bounds of control's tests are held there. A day at sea
takes seconds. The figures of docs/control.md are those of the whole program, by campaigns.
"""

import math
import random
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, cast

import msgspec

from delfim.base.cooperative import Sliced
from delfim.base.geodesy import Origin, origin, wrap
from delfim.base.modes import Mode
from delfim.canproxy.socket import CanSocket
from delfim.config import Vehicle, load
from delfim.simulator.model import WATER, Hull, Model, hull_of
from delfim.simulator.tables import Sea
from delfim.vehicle.control.control import admit, control, enter, lacking, settings_of
from delfim.vehicle.control.modes.path import APPROACH, nearest
from delfim.vehicle.plans.mission import load_mission, plan
from delfim.vehicle.plans.track import Track
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import Actuation, Arc, Line, Motion, Plan, Reference, Setpoint, State, Waypoint

DELFIMX, FLOAT = load("etc/delfimx.toml"), load("etc/boats/float.toml")
SETTINGS = settings_of(DELFIMX)
ALL = frozenset({"position", "heading", "velocity"})
DT_S = 0.2
PLACE = DELFIMX.simulation
START: Origin = origin(math.radians(PLACE.latitude_deg), math.radians(PLACE.longitude_deg))
DOCA = Sliced(plan(load_mission("etc/missions/doca.toml"), START, SETTINGS.control)).finish()
LAWNMOWER = Sliced(plan(load_mission("etc/missions/lawnmower.toml"), START, SETTINGS.control)).finish()
OTHERS = {
    "heavy": Hull(mass_kg=420.0, inertia_kgm2=1900.0, added_sway_kg=400.0, added_yaw_kgm2=800.0, surge_n_per_mps2=110.0),
    "damped": Hull(  # of the size of Fossen's Otter, whose damping of a turn grows tenfold at 1 rad/s; propellers for its 120 N
        length_m=2.0,
        mass_kg=80.0,
        inertia_kgm2=20.0,
        added_surge_kg=5.5,
        added_sway_kg=5.5,  # as that model has it: no moment of the added masses
        added_yaw_kgm2=25.0,
        surge_n_per_mps=77.5,
        surge_n_per_mps2=0.0,
        sway_n_per_mps=20.0,
        sway_n_per_mps2=200.0,
        yaw_nm_per_radps=45.0,
        yaw_nm_per_radps2=450.0,
        lift_kg_per_m=0.0,
        propeller_m=0.395,
        propeller_diameter_m=0.189,
        thrust_per_j=0.0,
        astern=0.58,
    ),
    "light": Hull(mass_kg=100.0, inertia_kgm2=250.0, added_sway_kg=100.0, added_yaw_kgm2=100.0),
}
CORNER_S = 20.0  # a boat that comes onto a path across it gets this long; smooth joints get nothing


class Sample(NamedTuple):
    """One cycle: the true state, and what control saw and answered."""

    t_s: float
    mode: Mode
    leg: int
    truth: Motion
    seen: Motion
    reference: Reference
    sent: Actuation


class Boat:
    """A boat in the sea: `sail` runs a mode and yields a sample each 200 ms; what is done goes to hold, as the loop does.

    `noise` scales the sensors' errors; 1 is position 0.3 m, heading 0.5 degrees, speed 0.03 m/s, rate of turn 0.2 degrees/s.
    """

    def __init__(
        self,
        seed: int = 1,
        sea: Sea | None = None,
        heading_rad: float = 0.0,
        noise: float = 1.0,
        rate_sensor: bool = True,
        hull: Hull | None = None,
        vehicle: Vehicle = DELFIMX,
        model: Any = None,
    ) -> None:
        self.model = model or Model(hull or Hull(), sea or Sea(), seed, START.latitude_rad, START.longitude_rad, heading_rad)
        self.t_s, self.state = DT_S, State()
        self.noise, self.rate_sensor, self.vehicle = noise, rate_sensor, vehicle
        self.settings = SETTINGS if vehicle is DELFIMX else settings_of(vehicle)
        self.propulsion = Propulsion((), cast(CanSocket, None), vehicle.thrusters, self.state)
        self._gauss = random.Random(seed).gauss

    def truth(self) -> Motion:
        m = self.model
        return Motion(ALL, m.north_m, m.east_m, m.heading_rad, m.yaw_rate_radps, m.north_mps, m.east_mps)

    def seen(self) -> Motion:
        gauss, noise, m = self._gauss, self.noise, self.truth()
        return Motion(
            ALL,
            m.north_m + gauss(0.0, 0.3 * noise),
            m.east_m + gauss(0.0, 0.3 * noise),
            m.heading_rad + gauss(0.0, math.radians(0.5 * noise)),
            m.yaw_rate_radps + gauss(0.0, math.radians(0.2 * noise)) if self.rate_sensor else 0.0,
            m.north_mps + gauss(0.0, 0.03 * noise),
            m.east_mps + gauss(0.0, 0.03 * noise),
        )

    def sail(self, mode: Mode, setpoint: Setpoint, seconds: float) -> Iterator[Sample]:
        seen = self.seen()
        assert admit(mode, seen.has, setpoint) is None
        memory = enter(mode, seen, setpoint, self.settings)
        for _ in range(round(seconds / DT_S)):
            leg = memory.leg
            if self.propulsion.short is not None:
                memory = lacking(memory, self.propulsion.short)
            memory, reference, wanted = control(mode, memory, seen, setpoint, self.settings, DT_S)
            sent = self.propulsion.send(wanted, self.t_s)
            self.memory = memory
            yield Sample(self.t_s, mode, leg, self.truth(), seen, reference, sent)
            if reference.done:
                mode = Mode.HOLD
                memory = enter(mode, seen, setpoint, self.settings)
            for row, part, angle_rad in zip(self.vehicle.thrusters, sent.thrust, sent.angle_rad, strict=True):
                if row.driver == "dsor":
                    self.model.command(row.name, part * self.vehicle.dsor.rpm_max, sent.run)
                else:
                    self.model.push(row.name, part, angle_rad, sent.run)
            self.model.advance(DT_S)
            self.t_s += DT_S
            seen = self.seen()


class Errors(NamedTuple):
    rms: float
    most: float


def errors(values: Sequence[float]) -> Errors:
    return Errors(math.sqrt(sum(v * v for v in values) / len(values)), max(abs(v) for v in values))


def current(seed: int, of: int = 20, mps: float = 0.5) -> Sea:
    """A current that sets all around the compass as the seed goes from 0 to `of`."""
    return Sea(current_mps=mps, current_to_deg=360.0 * seed / of)


def heading_step(boat: Boat, degrees: float, speed_mps: float) -> tuple[float, float, Errors]:
    """(overshoot in degrees, settling time to 5 % or 3 degrees in s, steady error in degrees) from steady speed due north."""
    start_s = [x.t_s for x in boat.sail(Mode.HEADING, Setpoint(speed_mps=speed_mps), 60.0)][-1]
    turn = boat.sail(Mode.HEADING, Setpoint(speed_mps=speed_mps, heading_rad=math.radians(degrees)), 120.0)
    left = [(x.t_s - start_s, math.degrees(wrap(math.radians(degrees) - x.truth.heading_rad))) for x in turn]
    settled_s = max((t for t, e in left if abs(e) > max(0.05 * degrees, 3.0)), default=0.0)
    near = [e for _, e in left if abs(e) < 90.0]
    return max(0.0, -min(near)), settled_s, errors([e for t, e in left if t > 60.0])


def path_errors(boat: Boat, path: tuple[Line | Arc, ...]) -> tuple[list[float], list[float]]:
    """True cross-track errors on lines and on arcs, from CORNER_S after the first began; fails where the end is not reached."""
    on_lines: list[float] = []
    on_arcs: list[float] = []
    began_s = 0.0
    for x in boat.sail(Mode.PATH, Setpoint(plan=Plan("", (), path)), 3600.0):
        if x.mode is Mode.HOLD:
            return on_lines, on_arcs
        if x.leg == APPROACH:
            began_s = x.t_s
        elif x.t_s - began_s > CORNER_S:
            piece = path[x.leg]
            (on_arcs if isinstance(piece, Arc) else on_lines).append(nearest(piece, x.truth, 0.0)[1])
    raise AssertionError("the end of the path was not reached in an hour")


def play(boat: Boat, mission: Plan) -> tuple[list[float], float]:
    """(true closest approach to each waypoint, time) of a mission played to its end."""
    closest = [math.inf] * len(mission.waypoints)
    for x in boat.sail(Mode.PLAY, Setpoint(plan=mission), 3600.0):
        for index, to in enumerate(mission.waypoints):
            closest[index] = min(closest[index], math.hypot(x.truth.north_m - to.north_m, x.truth.east_m - to.east_m))
        if x.mode is Mode.HOLD:
            return closest, x.t_s
    raise AssertionError("the mission was not finished in an hour")


def float_(seed: int, sea: Sea, sway: bool = True) -> Boat:
    """The holonomic boat of `etc/boats/`; without `sway` its control does not use that."""
    boat = Boat(
        seed,
        vehicle=FLOAT,
        model=Model(hull_of(FLOAT), sea, seed, START.latitude_rad, START.longitude_rad, 0.0, FLOAT.thrusters),
    )
    if not sway:
        boat.settings = boat.settings._replace(hull=boat.settings.hull._replace(aside_n=0.0))
    return boat


def station(boat: Boat, seconds: float) -> list[Sample]:
    """Hold of a boat that lay at rest for half a minute, from a minute after it began."""
    for _ in boat.sail(Mode.HEADING, Setpoint(), 30.0):
        pass
    return list(boat.sail(Mode.HOLD, Setpoint(), seconds))[round(60.0 / DT_S) :]


def off_m(x: Sample) -> float:
    """True distance to the point that is held."""
    return math.hypot(x.truth.north_m - (x.reference.north_m or 0.0), x.truth.east_m - (x.reference.east_m or 0.0))


def hold_distances(boat: Boat, way_mps: float = 0.0) -> list[float]:
    """Distances to the held point, m, one each cycle of ten minutes; the boat has that way on it when hold is asked for."""
    for _ in boat.sail(Mode.HEADING, Setpoint(speed_mps=way_mps), 30.0):
        pass
    return [x.reference.distance_m or 0.0 for x in boat.sail(Mode.HOLD, Setpoint(), 600.0)]


def home_errors(boat: Boat) -> tuple[list[float], float, int]:
    """(distances to the track driven before, distance to the start in the end, points left of the track) on the way home."""
    track = Track(boat.settings.control.home)
    out = tuple(Waypoint(north, east, 1.5, 5.0) for north, east in ((80.0, 0.0), (80.0, 60.0), (20.0, 60.0), (20.0, 120.0)))
    driven: list[Motion] = []
    for x in boat.sail(Mode.PLAY, Setpoint(plan=Plan("out", out, ())), 600.0):
        track.add(x.seen.north_m, x.seen.east_m)
        driven.append(x.truth)
        if x.mode is Mode.HOLD:
            break
    off: list[float] = []
    for x in boat.sail(Mode.HOME, Setpoint(track=track.points()), 900.0):
        if x.mode is Mode.HOLD:
            return off, math.hypot(x.truth.north_m, x.truth.east_m), len(track.points())
        track.add(x.seen.north_m, x.seen.east_m)
        off.append(min(math.hypot(x.truth.north_m - d.north_m, x.truth.east_m - d.east_m) for d in driven[::2]))
    raise AssertionError("home was not reached in 15 minutes")


def described(hull: Hull) -> Vehicle:
    """The vehicle's file of somebody who has this boat and knows its length, beam, mass, and its propellers at rest."""
    replace, rows = msgspec.structs.replace, []
    full_n = WATER * hull.thrust * hull.hull_efficiency * hull.propeller_diameter_m**4 * (DELFIMX.dsor.rpm_max / 60.0) ** 2
    for row in DELFIMX.thrusters:
        y_m = math.copysign(hull.propeller_m, row.y_m)
        rows.append(replace(row, y_m=y_m, thrust_n=(-hull.astern * full_n, full_n)))
    told = {"length_m": hull.length_m, "beam_m": hull.propeller_m / 0.42, "mass_kg": hull.mass_kg, "full_mps": None}
    return replace(DELFIMX, boat=replace(DELFIMX.boat, **told), thrusters=tuple(rows))
