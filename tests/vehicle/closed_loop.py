"""Model and control in one loop, without bus, clock or messages. Control's tests stand on it, and

    python -m tests.vehicle.closed_loop

prints the figures of docs/control.md. A day at sea takes seconds.
"""

import itertools
import math
import random
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from delfim.config import ControlTable, Propulsion, Sea, Simulation
from delfim.geodesy import Origin, origin, wrap
from delfim.simulator.model import Hull, Model
from delfim.vehicle.control.control import Settings, admit, control, enter, limited
from delfim.vehicle.control.path_following import APPROACH, nearest
from delfim.vehicle.mission import load_mission, plan
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Arc, Line, Mode, Motion, Plan, Reference, Setpoint, Waypoint
from delfim.vehicle.track import Track

SETTINGS = Settings(ControlTable(), Propulsion())
ALL = frozenset({"position", "heading", "velocity"})
DT_S = 0.2
START: Origin = origin(math.radians(Simulation().latitude_deg), math.radians(Simulation().longitude_deg))
DOCA = plan(load_mission("etc/missions/doca.toml"), START, SETTINGS.control)
LAWNMOWER = plan(load_mission("etc/missions/lawnmower.toml"), START, SETTINGS.control)
SETTLED_S = 10.0  # after the beginning of a line or arc


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

    def __init__(self, seed: int = 1, sea: Sea | None = None, heading_rad: float = 0.0, noise: float = 1.0) -> None:
        self.model = Model(Hull(), sea or Sea(), seed, START.latitude_rad, START.longitude_rad, heading_rad)
        self.t_s, self.sent, self.noise, self.rate_sensor = 0.0, STOP, noise, True
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
        memory = enter(mode, seen, setpoint, SETTINGS)
        for _ in range(round(seconds / DT_S)):
            leg = memory.leg
            memory, reference, wanted = control(mode, memory, seen, setpoint, SETTINGS, DT_S)
            self.sent = limited(wanted, self.sent, SETTINGS.propulsion, DT_S)
            yield Sample(self.t_s, mode, leg, self.truth(), seen, reference, self.sent)
            if reference.done:
                mode = Mode.HOLD
                memory = enter(mode, seen, setpoint, SETTINGS)
            self.model.command("starboard", self.sent.starboard_rpm, self.sent.run)
            self.model.command("port", self.sent.port_rpm, self.sent.run)
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


def heading_step(
    degrees: float, speed_mps: float, sea: Sea | None = None, rate_sensor: bool = True
) -> tuple[float, float, Errors]:
    """(overshoot in degrees, settling time to 5 % or 3 degrees in s, steady error in degrees) from steady speed due north."""
    boat = Boat(sea=sea)
    boat.rate_sensor = rate_sensor
    start_s = [x.t_s for x in boat.sail(Mode.HEADING, Setpoint(speed_mps=speed_mps), 60.0)][-1]
    turn = boat.sail(Mode.HEADING, Setpoint(speed_mps=speed_mps, heading_rad=math.radians(degrees)), 120.0)
    left = [(x.t_s - start_s, math.degrees(wrap(math.radians(degrees) - x.truth.heading_rad))) for x in turn]
    settled_s = max((t for t, e in left if abs(e) > max(0.05 * degrees, 3.0)), default=0.0)
    near = [e for _, e in left if abs(e) < 90.0]
    return max(0.0, -min(near)), settled_s, errors([e for t, e in left if t > 60.0])


def path_errors(path: tuple[Line | Arc, ...], sea: Sea, seed: int = 1) -> tuple[list[float], list[float]]:
    """True cross-track errors on lines and on arcs, once each is settled; fails where the end is not reached."""
    on_lines: list[float] = []
    on_arcs: list[float] = []
    leg, began_s = APPROACH, 0.0
    for x in Boat(seed, sea).sail(Mode.PATH, Setpoint(plan=Plan("", (), path)), 3600.0):
        if x.mode is Mode.HOLD:
            return on_lines, on_arcs
        if x.leg != leg:
            leg, began_s = x.leg, x.t_s
        if leg >= 0 and x.t_s - began_s > SETTLED_S:
            cross_m = nearest(path[leg], x.truth, 0.0)[1]
            (on_arcs if isinstance(path[leg], Arc) else on_lines).append(cross_m)
    raise AssertionError("the end of the path was not reached in an hour")


def play(mission: Plan, sea: Sea, seed: int) -> tuple[list[float], float]:
    """(true closest approach to each waypoint, time) of a mission played to its end."""
    closest = [math.inf] * len(mission.waypoints)
    for x in Boat(seed, sea).sail(Mode.PLAY, Setpoint(plan=mission), 3600.0):
        for index, to in enumerate(mission.waypoints):
            closest[index] = min(closest[index], math.hypot(x.truth.north_m - to.north_m, x.truth.east_m - to.east_m))
        if x.mode is Mode.HOLD:
            return closest, x.t_s
    raise AssertionError("the mission was not finished in an hour")


def hold_distances(sea: Sea, seed: int = 1, way_mps: float = 0.0, seconds: float = 600.0) -> list[float]:
    """Distances to the held point, m, one each cycle; the boat has that way on it when hold is asked for."""
    boat = Boat(seed, sea)
    for _ in boat.sail(Mode.HEADING, Setpoint(speed_mps=way_mps), 30.0):
        pass
    return [x.reference.distance_m or 0.0 for x in boat.sail(Mode.HOLD, Setpoint(), seconds)]


def home_errors(sea: Sea, seed: int = 1) -> tuple[list[float], float, int]:
    """(distances to the track driven before, distance to the start in the end, points left of the track) on the way home."""
    boat, track = Boat(seed, sea), Track(SETTINGS.control.home)
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


def control_us(mode: Mode) -> float:
    """Time of one call of control(), µs: the best of 20 means."""
    track = tuple((0.0, 5.0 * index) for index in range(500))
    setpoint = Setpoint(1.5, 0.3, 0.3, 0.4, plan=DOCA, guest_heading_rad=1.0, guest_speed_mps=1.0, track=track)
    motion = Motion(ALL, -200.0, 30.0, 0.2, 0.01, 1.4, 0.3)
    memory = enter(mode, motion._replace(north_m=-150.0) if mode is Mode.HOLD else motion, setpoint, SETTINGS)
    best_s = math.inf
    for _ in range(20):
        start_s = time.perf_counter()
        for _ in range(1000):
            control(mode, memory, motion, setpoint, SETTINGS, DT_S)
        best_s = min(best_s, time.perf_counter() - start_s)
    return best_s * 1e3


def main() -> None:
    for degrees, speed_mps in itertools.product((20.0, 90.0, 180.0), (0.0, 1.5)):
        overshoot, settled_s, steady = heading_step(degrees, speed_mps)
        print(
            f"heading {degrees:3.0f} deg at {speed_mps} m/s: {overshoot:.1f} deg over, {settled_s:.1f} s, rms {steady.rms:.2f}"
        )
    print("heading 90 deg, no rate of turn: {:.1f} deg over, {:.1f} s".format(*heading_step(90.0, 1.5, rate_sensor=False)[:2]))
    gale = Sea(wind_mps=8.0, wind_from_deg=0.0)
    print("heading 90 deg, wind 8 m/s abeam: {:.1f} deg over, {:.1f} s, {}".format(*heading_step(90.0, 1.5, gale)))
    for mission in (DOCA, LAWNMOWER):
        runs = [path_errors(mission.path, current(seed), seed) for seed in range(20)]
        on_lines, on_arcs = errors(sum((r[0] for r in runs), [])), errors(sum((r[1] for r in runs), []))
        print(f"path {mission.name}: lines rms {on_lines.rms:.2f} max {on_lines.most:.2f}, ", end="")
        print(f"arcs rms {on_arcs.rms:.2f} max {on_arcs.most:.2f} m")
        played = [play(mission, current(seed), seed) for seed in range(20)]
        miss = max(c - to.acceptance_m for closest, _ in played for c, to in zip(closest, mission.waypoints, strict=True))
        print(f"play {mission.name}: {min(t for _, t in played):.0f} to {max(t for _, t in played):.0f} s, miss {miss:.2f} m")
    for name, sea in (
        ("calm", Sea()),
        ("0.5 m/s", current(0)),
        ("0.5 m/s, wind 8", Sea(current_mps=0.5, wind_mps=8.0, wind_from_deg=90.0)),
    ):
        distances = hold_distances(sea, way_mps=1.5)
        print(f"hold in {name}: max {max(distances):.1f} m, mean {sum(distances) / len(distances):.1f} m")
    for degrees in (0, 90, 180, 270):
        off, end_m, points = home_errors(current(degrees, 360))
        print(
            f"home, current to {degrees}: rms {errors(off).rms:.1f} max {errors(off).most:.1f} m, end {end_m:.1f} m, {points} points"
        )
    print("control():", ", ".join(f"{mode.name.lower()} {control_us(mode):.1f}" for mode in Mode), "µs")


if __name__ == "__main__":
    main()
