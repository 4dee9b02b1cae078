"""Measurements of the model by off-the-shelf sensors, with their errors from the seed; devices.py and talkers.py send them.

Each is asked by `step` and answers when it is due, unless it is silent. Faults are set by hand, or by `delfim fault`.
"""

import math
from collections import deque
from collections.abc import Callable
from random import Random
from typing import Final, NamedTuple

from delfim.base.geodesy import from_plane
from delfim.config import CompassTable
from delfim.simulator.model import Model
from delfim.simulator.nodes.navigation import POSITION_ERROR_S, SATELLITES, YAW_RATE_NOISE_RADPS
from delfim.simulator.nodes.period import Period
from delfim.simulator.seabed import Echoes
from delfim.simulator.tables import Simulation

LEAST_HZ: Final = 1.0  # of a sensor that is not there, and says nothing
CORRECTED_S: Final = 1.0  # age of the corrections of a receiver that gets them
DEPTH_NOISE: Final = 0.01  # of the depth
WIND_NOISE_MPS: Final = 0.2  # of each component
_new = tuple.__new__  # in half the time of Turn(...)


class AntennaMotion(NamedTuple):
    """Position of the antenna, and its motion over ground."""

    latitude_rad: float
    longitude_rad: float
    north_mps: float
    east_mps: float


class Turn(NamedTuple):
    """Attitude and rate of turn of the boat, positive to starboard."""

    heading_rad: float
    rate_radps: float


class ApparentWind(NamedTuple):
    """Apparent wind: its direction, from the bow to starboard, and its speed."""

    angle_rad: float
    speed_mps: float


def felt(iron: CompassTable, heading_rad: float) -> float:
    """The heading that a compass beside this iron says for a true one, or for both magnetic."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    along = (1.0 + iron.soft_along) * c - iron.soft_across * s + iron.hard_ahead
    across = iron.soft_across * c - (1.0 - iron.soft_along) * s + iron.hard_aside
    return math.atan2(-across, along) + math.radians(iron.offset_deg)


def bent_by(iron: CompassTable, variation_rad: float) -> Callable[[float], float] | None:
    """How the iron of the vehicle's file bends true headings, which the boat then undoes; None where there is none."""
    if iron == CompassTable():
        return None
    return lambda heading_rad: felt(iron, heading_rad - variation_rad) + variation_rad


class GnssReceiver:
    """Position and velocity of an antenna, at the boat's centre unless `ahead_m` and `aside_m` say otherwise."""

    def __init__(self, model: Model, here: Simulation, seed: int, name: str = "receiver") -> None:
        self._model, self._random = model, Random(f"{name} {seed}")
        self.position_m, self._speed_mps = (here.position_noise_m, here.speed_noise_mps) if here.noise else (0.0, 0.0)
        rate_hz = here.receiver_hz or LEAST_HZ
        self._keep = math.exp(-1.0 / (rate_hz * POSITION_ERROR_S))
        self._error_m = [self._random.gauss(0.0, self.position_m) for _ in "ne"]
        self._period_s = 1.0 / rate_hz
        self._due, self._lacks = Period(self._period_s), not here.receiver_hz
        self.silent = self.frozen = False  # frozen: it repeats its values
        self.jump_m = 0.0  # error of the position to the north
        self.satellites = SATELLITES
        self.stated_m = self.position_m  # standard deviation per axis, as it says
        self.corrections_s: float | None = None  # age of its last correction, as it says; None: it gets none
        self.uncorrected = False  # no more corrections come
        self.ahead_m = self.aside_m = 0.0  # of its antenna, from the boat's centre
        self.late_s = 0.0  # age of what it says
        self._past = deque[tuple[float, tuple[float, ...]]]()  # what it has not said yet
        self._said: AntennaMotion | None = None

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float) -> AntennaMotion | None:
        if not self._due.passed(now_s):
            return None
        if self.uncorrected or self.corrections_s is not None:
            self.corrections_s = (self.corrections_s or 0.0) + self._period_s if self.uncorrected else CORRECTED_S
        if self._said is None or not self.frozen:
            self._said = self._measured(now_s)
        return None if self.silent or self._lacks else self._said

    def _measured(self, now_s: float) -> AntennaMotion:
        model, gauss = self._model, self._random.gauss
        new_m = self.position_m * math.sqrt(1.0 - self._keep * self._keep)
        self._error_m = [self._keep * each + gauss(0.0, new_m) for each in self._error_m]
        north_m, east_m, north, east = self._moved(now_s)
        north_m, east_m = north_m + self._error_m[0] + self.jump_m, east_m + self._error_m[1]
        north, east = north + gauss(0.0, self._speed_mps), east + gauss(0.0, self._speed_mps)
        return AntennaMotion(*from_plane(model.origin, north_m, east_m), north, east)

    def _moved(self, now_s: float) -> tuple[float, ...]:
        """Place and velocity of the antenna, m and m/s north and east, as they were `late_s` ago."""
        model = self._model
        moved = model.north_m, model.east_m, model.north_mps, model.east_mps
        if self.ahead_m or self.aside_m:
            c, s, r = math.cos(model.heading_rad), math.sin(model.heading_rad), model.yaw_rate_radps
            north_m, east_m = self.ahead_m * c - self.aside_m * s, self.ahead_m * s + self.aside_m * c
            moved = moved[0] + north_m, moved[1] + east_m, moved[2] - r * east_m, moved[3] + r * north_m
        if not self.late_s:
            return moved
        past, then_s = self._past, now_s - self.late_s
        past.append((now_s, moved))
        while len(past) > 2 and past[1][0] <= then_s:
            past.popleft()
        (from_s, first), (to_s, second) = past[0], past[min(1, len(past) - 1)]
        part = min(max((then_s - from_s) / (to_s - from_s), 0.0), 1.0) if to_s > from_s else 0.0
        return tuple(a + part * (b - a) for a, b in zip(first, second, strict=True))


class Compass:
    """Heading, and the rate of turn of a gyro in the same box."""

    def __init__(self, model: Model, here: Simulation, seed: int, name: str = "compass") -> None:
        self._model, self._random = model, Random(f"{name} {seed}")
        self._heading_rad, self._rate_radps = (
            (math.radians(here.heading_noise_deg), YAW_RATE_NOISE_RADPS) if here.noise else (0.0, 0.0)
        )
        self._period_s = 1.0 / (here.compass_hz or LEAST_HZ)
        self._due, self._lacks = Period(self._period_s), not here.compass_hz
        self.silent = self.frozen = False
        self.jump_rad = 0.0  # error of the heading
        self.cable_rad_per_a = 0.0  # error of the heading beside the cable of the first motor
        self.bias_radps = self.drift_radps2 = 0.0  # of the gyro, and its growth
        self.gyro_sign = 1.0  # -1: mounted upside down
        self.bent: Callable[[float], float] | None = None  # by iron: what a magnetic compass says for a true heading
        self._said: Turn | None = None

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float) -> Turn | None:
        if not self._due.passed(now_s):
            return None
        model, gauss = self._model, self._random.gauss
        true_rad = model.heading_rad if self.bent is None else self.bent(model.heading_rad)
        heading_rad = true_rad + gauss(0.0, self._heading_rad) + self.jump_rad
        heading_rad += self.cable_rad_per_a * next(iter(model.drives.values())).motor_a
        rate_radps = self.gyro_sign * model.yaw_rate_radps + gauss(0.0, self._rate_radps) + self.bias_radps
        self.bias_radps += self.drift_radps2 * self._period_s
        if self._said is None or not self.frozen:
            self._said = _new(Turn, (heading_rad, rate_radps))
        return None if self.silent or self._lacks else self._said


class Sounder:
    """Depth below the transducer, which is at the water line."""

    def __init__(self, model: Model, here: Simulation, seed: int) -> None:
        self._model, self._random = model, Random(f"sounder {seed}")
        self._noise, self._due = DEPTH_NOISE if here.noise else 0.0, Period(1.0 / here.sounder_hz)
        self._echoes = Echoes(here, seed, "sounder")
        self.silent = False

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float) -> float | None:
        if not self._due.passed(now_s) or self.silent:
            return None
        return self._echoes.heard(self._model.depth_m * (1.0 + self._random.gauss(0.0, self._noise)))


class Vane:
    """Apparent wind as a vane and cups on the mast measure it."""

    def __init__(self, model: Model, here: Simulation, seed: int) -> None:
        self._model, self._random = model, Random(f"vane {seed}")
        self._noise_mps, self._due = WIND_NOISE_MPS if here.noise else 0.0, Period(1.0 / here.wind_hz)
        self.silent = False

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float) -> ApparentWind | None:
        if not self._due.passed(now_s) or self.silent:
            return None
        model, gauss = self._model, self._random.gauss
        north = model.wind_north_mps - model.north_mps + gauss(0.0, self._noise_mps)
        east = model.wind_east_mps - model.east_mps + gauss(0.0, self._noise_mps)
        return ApparentWind((math.atan2(-east, -north) - model.heading_rad) % math.tau, math.hypot(north, east))
