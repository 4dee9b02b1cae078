"""Hidden hulls for the fit, none of them by its own equations, and a trial of each with sensors as bad as a small boat's."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from random import Random
from typing import NamedTuple

import msgspec

from delfim import config
from delfim.adoption.record import BoatRecord, Manoeuvre, Series
from delfim.simulator.measured import MeasuredModel
from delfim.simulator.model import Model
from delfim.simulator.tables import Sea, SimulatedHull

Forces = tuple[float, float, float]
HERON = {  # [simulation.hull] as a fit found that of a Heron with late motors
    "mass_kg": 29.4,
    "mass_aside_kg": 70.0,
    "mass_turning_kg": 54.0,
    "inertia_kgm2": 9.0,
    "surge_n_per_mps": 7.2,
    "surge_n_per_mps2": 22.0,
    "sway_n_per_mps": 12.0,
    "sway_n_per_mps2": 190.0,
    "sway_ahead_n_per_mps2": 40.0,
    "yaw_nm_per_radps": 3.5,
    "yaw_nm_per_radps2": 3.0,
    "yaw_ahead_nm_s_per_m": 4.0,
    "munk_nm_per_mps2": 8.0,
}


class Coefficients(NamedTuple):
    """Fossen's letters, all positive: full mass matrix, Coriolis of the added masses, linear and quadratic damping, strips."""

    m11: float
    m22: float
    m33: float
    m23: float = 0.0
    xu: float = 0.0
    xuu: float = 0.0
    yv: float = 0.0
    yvv: float = 0.0
    nr: float = 0.0
    nrr: float = 0.0
    nur: float = 0.0
    munk: float = 1.0  # share of the moment of the added masses that a skeg leaves
    draught_m: float = 0.0  # of strips of cross-flow
    length_m: float = 1.0

    def accelerations(self, u: float, v: float, r: float, push: Forces) -> Forces:
        x, y, n = push
        x += (self.m22 * v + self.m23 * r) * r - (self.xu + self.xuu * abs(u)) * u
        y -= self.m11 * u * r + (self.yv + self.yvv * abs(v)) * v
        n -= (self.m22 - self.m11) * u * v * self.munk + self.m23 * u * r
        n -= (self.nr + self.nrr * abs(r) + self.nur * abs(u)) * r
        for strip in range(10) if self.draught_m else ():
            at = ((strip + 0.5) / 10 - 0.5) * self.length_m
            across = v + at * r
            drag = 0.5 * 1025.0 * self.draught_m * abs(across) * across * self.length_m / 10
            y, n = y - drag, n - at * drag
        all_of = self.m22 * self.m33 - self.m23**2
        return x / self.m11, (self.m33 * y - self.m23 * n) / all_of, (self.m22 * n - self.m23 * y) / all_of


class OtherHull(MeasuredModel):
    """The simulator's sea, wind and late motors under the hull of another hand."""

    def __init__(self, coefficients: Coefficients, settings: config.Vehicle, sea: Sea, seed: int) -> None:
        only_forces = SimulatedHull(mass_kg=1.0, mass_aside_kg=1.0, inertia_kgm2=1.0)
        super().__init__(settings, only_forces, sea, seed, math.radians(38.69), math.radians(-9.21), 0.3, settings.thrusters)
        self.coefficients = coefficients

    def _accelerations(self, u, v, r, c, s, pushes, air):  # type: ignore[no-untyped-def]
        push = Model._accelerations(self, u, v, 0.0, c, s, pushes, air)
        return self.coefficients.accelerations(u, v, r, push)


class Hidden(NamedTuple):
    """A boat: what its owner's file says, and what is true."""

    told: config.Vehicle
    rows: tuple[config.ThrusterTable, ...]  # with delay and lag
    coefficients: Coefficients

    def model(self, sea: Sea, seed: int = 1) -> OtherHull:
        return OtherHull(self.coefficients, msgspec.structs.replace(self.told, thrusters=self.rows), sea, seed)

    @property
    def late_s(self) -> float:
        """Delay and lag of a motor."""
        return self.rows[0].delay_s + (self.rows[0].lag_s or 0.0)


def rows(
    thrust_n: float, astern: float, y_m: float, dead: float, power: float, delay_s: float = 0.0, lag_s: float | None = None
) -> tuple[config.ThrusterTable, ...]:
    return tuple(
        config.ThrusterTable(
            name=name,
            driver="pwm",
            address=index,
            x_m=-0.5,
            y_m=side * y_m,
            thrust_n=(-astern * thrust_n, thrust_n),
            dead=dead,
            power=power,
            rate_per_s=4.0,
            delay_s=delay_s,
            lag_s=lag_s,
        )
        for index, (name, side) in enumerate((("starboard", 1.0), ("port", -1.0)))
    )


def told(length_m: float, beam_m: float, mass_kg: float, thrust_n: float, y_m: float) -> config.Vehicle:
    """What an owner would write: a mass from the scales, a thrust from the shop's page."""
    boat = config.BoatTable(name="Unknown", length_m=length_m, beam_m=beam_m, mass_kg=mass_kg)
    return config.Vehicle(boat=boat, thrusters=rows(thrust_n, 0.6, y_m, 0.0, 2.0))


def otter() -> Hidden:
    """Fossen's Otter with its payload (Handbook, 2021): 80 kg, linear drag to 3 m/s, time constants of 1 s."""
    total, ahead = 80.0, (55.0 * 0.2 + 25.0 * 0.05) / 80.0
    m33 = 55.0 * (0.25 + ahead**2) + 0.0625 + total * ahead**2
    m33 *= 1.0 + 1.7 / 2.7
    linear = 24.4 * 9.81 / 3.0864
    draught = total / 1025.0 / (2 * 0.4 * 0.25 * 2.0)
    its = Coefficients(85.5, 162.5, m33, total * ahead, linear, 0.0, 162.5, 0.0, m33, 10 * m33, 0.0, 1.0, draught, 2.0)
    return Hidden(told(2.0, 1.08, 72.0, 150.0, 0.395), rows(119.7, 0.557, 0.395, 0.04, 2.0, 0.15, 0.1), its)


def heron() -> Hidden:
    """The Heron as PX4's simulation has it: linear drag of 20 in all three."""
    its = Coefficients(33.0, 33.0, 5.0, 0.0, 20.0, 4.0, 20.0, 20.0, 7.0, 6.0)
    return Hidden(told(1.35, 0.98, 30.0, 45.0, 0.37), rows(33.6, 0.59, 0.37, 0.08, 1.3, 0.1, 0.2), its)


def slim() -> Hidden:
    """A monohull of 3 m by strip theory: little drag, little authority."""
    its = Coefficients(63.0, 102.0, 65.0, 2.0, 6.0, 9.0, 12.0, 138.0, 12.0, 110.0, 29.0, 0.5)
    return Hidden(told(3.0, 0.7, 60.0, 50.0, 0.25), rows(60.0, 0.5, 0.25, 0.1, 2.0, 0.3, 0.4), its)


Step = tuple[str, float, float, float]  # its name, parts of the starboard and the port motor, seconds


def manoeuvres(seed: int, quick: float = 0.5) -> Iterator[Step]:
    """Circles, steps ahead and astern, spins, random differential: as a trial has them, without its way back."""
    random = Random(seed)
    yield "drift", 0.0, 0.0, 8.0
    for way in (1.0, -1.0):
        yield "circle", 0.25 - 0.12 * way, 0.25 + 0.12 * way, 40.0
    for part in (0.3, 0.6, 1.0):
        yield "ahead", part, part, 7.0
        yield "coast", 0.0, 0.0, 5.0
        yield "turn", 0.2, 0.5, 4.0
        yield "ahead", part, part, 7.0
        yield "coast", 0.0, 0.0, 5.0
    for part in (-0.4, -0.8):
        yield "astern", part, part, 5.0
        yield "coast", 0.0, 0.0, 3.0
    for part in (0.35, 0.7):
        for way in (1.0, -1.0):
            yield "spin", -way * part * quick * 2.0, way * part * quick * 2.0, 5.0
            yield "coast", 0.0, 0.0, 3.0
    for base in (0.35, 0.7):
        for _ in range(26):
            aside = random.choice((-1.0, -0.5, 0.5, 1.0)) * 0.25
            yield "differential", base - aside, base + aside, random.uniform(0.8, 2.5)


class Sensors(NamedTuple):
    """What is wrong with them."""

    late_s: float = 0.15  # receiver
    ahead_m: float = 0.3  # its antenna
    aside_m: float = -0.1
    offset_rad: float = math.radians(7.0)
    hard: tuple[float, float] = (0.08, -0.05)
    soft: tuple[float, float] = (0.02, 0.01)
    bias_radps: float = math.radians(0.5)
    noise: float = 1.0  # of all, as a part of a usual one's

    def said(self, heading: float) -> float:
        c, s = math.cos(heading), math.sin(heading)
        along = (1.0 + self.soft[0]) * c - self.soft[1] * s + self.hard[0]
        across = self.soft[1] * c - (1.0 - self.soft[0]) * s + self.hard[1]
        return math.atan2(-across, along) + self.offset_rad


USUAL = Sensors()


def sailed(hidden: Hidden, sea: Sea, seed: int = 1, sensors: Sensors = USUAL, steps: Sequence[Step] = ()) -> BoatRecord:
    """A trial of the hidden boat: 10 Hz for motors, compass and gyro, 5 Hz for the receiver."""
    model, random = hidden.model(sea, seed), Random(seed)
    told, velocity, heading, turn, position = (list[tuple[float, ...]]() for _ in range(5))
    names, done = tuple(row.name for row in hidden.rows), list[Manoeuvre]()
    past = deque[tuple[float, float, float]]()
    tick, step_s, now_s = 0, 0.05, 0.0
    for name, starboard, port, lasts_s in steps or tuple(manoeuvres(seed)):
        began_s = now_s
        for _ in range(round(lasts_s / step_s)):
            now_s = tick * step_s
            if tick % 2 == 0:
                told.append((now_s, starboard, port))
                for each, part in zip(names, (starboard, port), strict=True):
                    model.push(each, part)
                heading.append((now_s, sensors.said(model.heading_rad) + random.gauss(0.0, math.radians(1.5)) * sensors.noise))
                turn.append(
                    (now_s, model.yaw_rate_radps + sensors.bias_radps + random.gauss(0.0, math.radians(0.2)) * sensors.noise)
                )
            c, s, r = math.cos(model.heading_rad), math.sin(model.heading_rad), model.yaw_rate_radps
            north, east = sensors.ahead_m * c - sensors.aside_m * s, sensors.ahead_m * s + sensors.aside_m * c
            past.append((now_s, model.north_mps - r * east, model.east_mps + r * north))
            while past[0][0] < now_s - sensors.late_s - 1e-9:
                past.popleft()
            if tick % 4 == 0:
                velocity.append((now_s, *(each + random.gauss(0.0, 0.05) * sensors.noise for each in past[0][1:])))
                position.append((now_s, model.north_m, model.east_m))
            model.advance(step_s)
            tick += 1
        done.append(Manoeuvre(name, began_s, now_s))
    columns = ((told, 2), (position, 2), (velocity, 2), (heading, 1), (turn, 1))
    return BoatRecord(names, *(Series.of(rows, count) for rows, count in columns), manoeuvres=tuple(done), source="a trial")


def steady(model: Model, parts: tuple[float, float], seconds: float = 40.0) -> Model:
    """The model after this time of these parts."""
    for name, part in zip(model.drives, parts, strict=True):
        model.push(name, part)
    for _ in range(round(seconds / 0.05)):
        model.advance(0.05)
    return model


def after(hidden: Hidden, starboard: float, port: float) -> Model:
    """The hidden boat in calm water at the end of a long time of these parts."""
    return steady(hidden.model(Sea()), (starboard, port))


def stopping_m(hidden: Hidden, part: float) -> float:
    """Its way from an order to stop until it lies."""
    model = steady(hidden.model(Sea()), (part, part))
    north, east = model.north_m, model.east_m
    steady(model, (0.0, 0.0), 60.0)
    return math.hypot(model.north_m - north, model.east_m - east)
