"""A boat that is not as its file says: for trying out adoption. Hull, motors, wiring, delay, sea and sensors are drawn."""

import math
from collections import deque
from collections.abc import Sequence
from random import Random
from typing import Final, NamedTuple

import msgspec

from delfim import config
from delfim.adoption.suited import is_several
from delfim.config import CompassTable, ThrusterTable
from delfim.simulator.model import Hull, Model, hull_of
from delfim.simulator.nodes import Nodes
from delfim.simulator.nodes.measuring import Compass, felt
from delfim.simulator.tables import Sea, Simulation

UNEQUAL: Final = 0.7, 1.3  # how strong one of three or more motors is, of what it should be
STEP_S: Final = 0.05  # a late command comes within one


class HiddenSensors(NamedTuple):
    """What is wrong with the sensors."""

    iron: CompassTable = CompassTable()  # about a magnetic compass, in the frame of true north
    ahead_m: float = 0.0  # the antenna, from the boat's centre
    aside_m: float = 0.0
    late_s: float = 0.0  # the receiver
    bias_radps: float = 0.0  # of the gyro
    gyro_sign: float = 1.0  # -1: mounted upside down

    def said(self, heading_rad: float) -> float:
        """The heading that the compass tells, for the true one."""
        return felt(self.iron, heading_rad)

    def put(self, nodes: Nodes) -> None:
        """Make the sensors of a simulated boat so."""
        beside = nodes.instruments.sensors if nodes.instruments else ()  # a gyro of its own has a port of its own
        for each in (*nodes.compasses, *(one for one in beside if isinstance(one, Compass))):
            each.bias_radps, each.gyro_sign = self.bias_radps, self.gyro_sign
            each.bent = self.said if self.iron != CompassTable() else None
        for receiver in nodes.receivers:
            receiver.ahead_m, receiver.aside_m, receiver.late_s = self.ahead_m, self.aside_m, self.late_s

    @property
    def deviation_rad(self) -> float:
        """The most that the iron bends a heading, but for the offset."""
        off = [self.said(math.radians(each)) - math.radians(each + self.iron.offset_deg) for each in range(0, 360, 5)]
        return max(abs(math.remainder(each, math.tau)) for each in off)


class Hidden(NamedTuple):
    """What was drawn."""

    hull: Hull
    rows: tuple[ThrusterTable, ...]  # what the motors do that the rows of the file reach
    swapped: bool
    reversed: tuple[bool, ...]
    delay_s: float
    sea: Sea
    heading_rad: float
    sensors: HiddenSensors = HiddenSensors()
    turned: bool = False  # what turns its motor turns it the other way ...
    middle_rad: float = 0.0  # ... and is told so much when it points straight
    places: tuple[int, ...] = ()  # of three or more thrusters: the row of the file in whose place the motor is

    def words(self) -> str:
        """The truth, in a line."""
        back = [row.name for row, is_so in zip(self.rows, self.reversed, strict=True) if is_so]
        moved = "in the places of " + ", ".join(self.rows[at].name for at in self.places) + ", " if self.places else ""
        wired = (moved or ("exchanged, " if self.swapped else "")) + (
            f"reversed: {' and '.join(back)}" if back else "none reversed"
        )
        wired += f", turned the other way: {self.turned}" if self.rows[0].steer is not None else ""
        dead = ", ".join(f"{row.dead:.2f}" for row in self.rows)
        wind, current = self.sea.wind_mps, self.sea.current_mps
        told = f"{wired}; dead band {dead}; delay {self.delay_s:.2f} s; wind {wind:.1f}, current {current:.2f} m/s"
        its = self.sensors
        bent = f"compass off by {its.iron.offset_deg:.0f} and bent by {math.degrees(its.deviation_rad):.0f} degrees"
        return f"{told}; {bent}; antenna {its.ahead_m:.1f} m ahead, {its.late_s:.2f} s late"


def drawn(settings: config.Vehicle, seed: int, hull: int | None = None) -> Hidden:
    """A boat near that of the file: coefficients up to 40 % off, inertia by up to three times, its two motors wired anyhow, its
    compass mounted askew near iron. `hull`: another seed for what does not change from day to day, hull and motors."""
    random = Random(f"hidden hull {seed if hull is None else hull}")
    of_day = Random(f"hidden day {seed} {hull}")

    def about(value: float, by: float = 1.4) -> float:
        return value * float(by ** random.uniform(-1.0, 1.0))

    told = hull_of(settings)
    its = told._replace(
        mass_kg=about(told.mass_kg, 1.2),
        inertia_kgm2=about(told.inertia_kgm2, 3.0),
        surge_n_per_mps=about(told.surge_n_per_mps),
        surge_n_per_mps2=about(told.surge_n_per_mps2),
        sway_n_per_mps=about(told.sway_n_per_mps),
        sway_n_per_mps2=about(told.sway_n_per_mps2),
        yaw_nm_per_radps=about(told.yaw_nm_per_radps),
        yaw_nm_per_radps2=about(told.yaw_nm_per_radps2),
        motor_s=random.uniform(0.1, 0.4),
    )
    is_swapped = of_day.random() < 0.5 and len(settings.thrusters) == 2
    backwards = tuple(of_day.random() < 0.5 for _ in settings.thrusters)
    dead, power, push = random.uniform(0.0, 0.15), random.uniform(1.3, 2.0), random.uniform(0.7, 1.3)
    rows, wired = list[ThrusterTable](), Random(f"hidden wiring {seed} {hull}")
    several = is_several(settings.thrusters)
    places = tuple(wired.sample(range(len(settings.thrusters)), len(settings.thrusters))) if several else ()
    for index, row in enumerate(settings.thrusters):
        at = settings.thrusters[places[index]] if several else settings.thrusters[::-1][index] if is_swapped else row
        ahead_n = (at if several else row).ends_n[1] * push * random.uniform(*(UNEQUAL if several else (0.9, 1.1)))
        astern_n = ahead_n * random.uniform(0.4, 0.7)
        is_back = (
            backwards[index] and row.steer is None
        )  # what its file calls ahead pushes astern, with the strength that it has astern
        ends_n = (-ahead_n, astern_n) if is_back else (-astern_n, ahead_n)
        angle_deg = math.remainder(at.angle_deg + (180.0 if is_back else 0.0), 360.0) if several else 180.0 if is_back else 0.0
        changed = {"thrust_n": ends_n, "angle_deg": angle_deg, "curve": (), "dead": dead, "power": power}
        x_m = at.x_m if several else row.x_m
        rows.append(msgspec.structs.replace(row, x_m=x_m, y_m=at.y_m, **changed))
    there = settings.of(Simulation).sea
    sea = msgspec.structs.replace(
        there,
        current_mps=of_day.uniform(0.0, 0.3),
        current_to_deg=of_day.uniform(0.0, 360.0),
        wind_mps=of_day.uniform(0.0, 4.0),
        wind_from_deg=of_day.uniform(0.0, 360.0),
    )
    wiring, heading_rad = (is_swapped, backwards), of_day.uniform(0.0, math.tau)
    late_s, sensors = random.uniform(0.0, 0.5), _sensors(settings, of_day)
    turned = (of_day.random() < 0.5, math.radians(of_day.uniform(-6.0, 6.0))) if len(rows) == 1 else (False, 0.0)
    return Hidden(its, tuple(rows), *wiring, late_s, sea, heading_rad, sensors, *turned, places)


def _sensors(settings: config.Vehicle, random: Random) -> HiddenSensors:
    """An offset up to 20 degrees, a deviation up to 10, an antenna up to a third of the length from the centre."""
    hard, soft = random.uniform(0.0, 0.139), random.uniform(0.0, 0.035)  # 8 and 2 degrees at the most
    at, across = random.uniform(0.0, math.tau), random.uniform(0.0, math.tau)
    iron = CompassTable(
        hard_ahead=hard * math.cos(at),
        hard_aside=hard * math.sin(at),
        soft_along=soft * math.cos(across),
        soft_across=soft * math.sin(across),
        offset_deg=random.uniform(-20.0, 20.0),
    )
    length_m, beam_m = settings.boat.length_m, settings.boat.beam_m
    ahead_m, aside_m = random.uniform(-0.33, 0.33) * length_m, random.uniform(-0.33, 0.33) * beam_m
    return HiddenSensors(iron, ahead_m, aside_m, random.uniform(0.05, 0.3), math.radians(random.uniform(-0.5, 0.5)))


def rewired(hidden: Hidden, rows: Sequence[ThrusterTable]) -> Hidden:
    """The same boat for a file whose rows reach the motor at their side, and push ahead with it."""
    found = list[ThrusterTable]()
    for row in rows:
        if hidden.places:  # the row says which motor it reaches
            motor = next(each for each in hidden.rows if (each.driver, each.address) == (row.driver, row.address))
            is_back = abs(math.remainder(motor.angle_deg - row.angle_deg, 360.0)) > 90.0
            low, high = motor.thrust_n
            turned = {"thrust_n": (-high, -low), "angle_deg": math.remainder(motor.angle_deg + 180.0, 360.0)} if is_back else {}
            found.append(msgspec.structs.replace(motor, name=row.name, **turned))
            continue
        motor = next(each for each in hidden.rows if each.y_m * row.y_m > 0.0 or row.steer is not None)
        low, high = motor.thrust_n
        ends_n = (low, high) if motor.angle_deg == 0.0 else (-high, -low)
        found.append(msgspec.structs.replace(motor, name=row.name, thrust_n=ends_n, angle_deg=0.0))
    told_rad = rows[0].steer.as_told[1] if rows[0].steer is not None else 0.0
    off_rad = (-1.0 if hidden.turned else 1.0) * (hidden.middle_rad - told_rad)
    straight = (False,) * len(found)
    return hidden._replace(rows=tuple(found), swapped=False, reversed=straight, turned=False, middle_rad=off_rad)


class LateModel(Model):
    """The model of a hidden boat, whose motors hear their commands late, and so does what turns one."""

    def __init__(self, settings: config.Vehicle, hidden: Hidden, seed: int) -> None:
        there = settings.of(Simulation)
        place = math.radians(there.latitude_deg), math.radians(there.longitude_deg)
        super().__init__(hidden.hull, hidden.sea, seed, *place, hidden.heading_rad, hidden.rows)
        self._delay_s, self._late = hidden.delay_s, deque[tuple[float, str, float, float, bool]]()
        self._way, self._middle_rad = -1.0 if hidden.turned else 1.0, hidden.middle_rad
        self._signs = {
            row.name: -1.0 if is_back and row.steer is not None else 1.0
            for row, is_back in zip(hidden.rows, hidden.reversed, strict=True)
        }

    def push(self, name: str, part: float, angle_rad: float = 0.0, run: bool = True) -> None:
        if run and self.drives[name].row.steer is not None:
            angle_rad = self._way * (angle_rad - self._middle_rad)
        self._late.append((self.time_s + self._delay_s, name, self._signs[name] * part, angle_rad, run))

    def command(self, name: str, rpm: float, run: bool) -> None:
        self.push(name, rpm / self.drives[name].rpm_max, run=run)

    def advance(self, dt_s: float) -> None:
        steps = max(1, math.ceil(dt_s / STEP_S - 1e-9))
        for _ in range(steps):
            while self._late and self._late[0][0] <= self.time_s + 1e-9:
                _, name, part, angle_rad, run = self._late.popleft()
                if run and self.drives[name].row.steer is not None:
                    self.drives[name].reference_rad = angle_rad
                super().command(name, part * self.drives[name].rpm_max, run)
            super().advance(dt_s / steps)
