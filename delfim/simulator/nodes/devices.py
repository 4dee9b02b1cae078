"""Off-the-shelf devices on an NMEA 2000 bus: a receiver of satellite navigation, and a compass, with a gyro if wished.

They are there where the vehicle's file names the source `nmea2000`. Their errors are those of the navigation node; faults are
set by hand.
"""

import math
from random import Random
from typing import Final

from delfim import config
from delfim.canproxy.nmea2000.pgns import (
    CourseSpeed,
    GnssPosition,
    Message,
    NorthReference,
    PositionRapid,
    RateOfTurn,
    VesselHeading,
    encode,
)
from delfim.canproxy.socket import CanAddress
from delfim.frames import Frame
from delfim.geodesy import from_plane
from delfim.simulator.model import Model
from delfim.simulator.nodes.navigation import HDOP, POSITION_ERROR_S, SATELLITES, YAW_RATE_NOISE_RADPS
from delfim.simulator.nodes.period import Period

RECEIVER, COMPASS = 43, 204  # their addresses, as on a boat in docs/nmea2000.md
QUALITY_S: Final = 1.0  # the receiver's period of time, fix and satellites
GNSS: Final = 1  # method of a fix
LEAST_HZ: Final = 1.0  # of a device that is not there, and says nothing


class GnssReceiver:
    """Position, course and speed over ground of an antenna at the boat's centre."""

    def __init__(self, model: Model, here: config.Simulation, seed: int) -> None:
        self._model, self._random = model, Random(f"receiver {seed}")
        self._position_m, self._speed_mps = (here.position_noise_m, here.speed_noise_mps) if here.noise else (0.0, 0.0)
        rate_hz = here.receiver_hz or LEAST_HZ
        self._keep = math.exp(-1.0 / (rate_hz * POSITION_ERROR_S))
        self._error_m = [self._random.gauss(0.0, self._position_m) for _ in "ne"]
        self._due, self._quality = Period(1.0 / rate_hz), Period(QUALITY_S)
        self.silent, self.frozen = not here.receiver_hz, False  # frozen: it repeats its values
        self.jump_m = 0.0  # error of the position to the north
        self._said: tuple[PositionRapid, CourseSpeed] | None = None
        self._number = 0

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._due.passed(now_s):
            return []
        if self._said is None or not self.frozen:
            self._said = self._measured()
        if self.silent:
            return []
        position, velocity = self._said
        said: list[Message] = [position, velocity]
        if self._quality.passed(now_s):
            self._number += 1
            said.append(GnssPosition(utc_ns, position.latitude_rad, position.longitude_rad, GNSS, SATELLITES, HDOP))
        return [frame for message in said for frame in encode(message, RECEIVER, self._number & 7)]

    def _measured(self) -> tuple[PositionRapid, CourseSpeed]:
        model, gauss = self._model, self._random.gauss
        new_m = self._position_m * math.sqrt(1.0 - self._keep * self._keep)
        self._error_m = [self._keep * each + gauss(0.0, new_m) for each in self._error_m]
        north_m, east_m = model.north_m + self._error_m[0] + self.jump_m, model.east_m + self._error_m[1]
        north, east = model.north_mps + gauss(0.0, self._speed_mps), model.east_mps + gauss(0.0, self._speed_mps)
        course = CourseSpeed(NorthReference.TRUE, math.atan2(east, north) % math.tau, math.hypot(north, east))
        return PositionRapid(*from_plane(model.origin, north_m, east_m)), course


class Compass:
    """Heading, and rate of turn where it has a gyro."""

    def __init__(self, model: Model, here: config.Simulation, seed: int) -> None:
        self._model, self._random, self._has_gyro = model, Random(f"compass {seed}"), here.gyro
        self._heading_rad, self._rate_radps = (
            (math.radians(here.heading_noise_deg), YAW_RATE_NOISE_RADPS) if here.noise else (0.0, 0.0)
        )
        self._due = Period(1.0 / (here.compass_hz or LEAST_HZ))
        self.silent, self.frozen = not here.compass_hz, False
        self.jump_rad = 0.0  # error of the heading
        self.cable_rad_per_a = 0.0  # error of the heading beside the cable of the first motor
        self.bias_radps = self.drift_radps2 = 0.0  # of the gyro, and its growth
        self._began_s: float | None = None
        self._said: tuple[float, float] | None = None

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._due.passed(now_s):
            return []
        self._began_s = now_s if self._began_s is None else self._began_s
        model, gauss = self._model, self._random.gauss
        heading_rad = model.heading_rad + gauss(0.0, self._heading_rad) + self.jump_rad
        heading_rad += self.cable_rad_per_a * next(iter(model.drives.values())).motor_a
        rate_radps = model.yaw_rate_radps + gauss(0.0, self._rate_radps) + self.bias_radps
        rate_radps += self.drift_radps2 * (now_s - self._began_s)
        if self._said is None or not self.frozen:
            self._said = heading_rad, rate_radps
        if self.silent:
            return []
        heading_rad, rate_radps = self._said
        frames = encode(VesselHeading(heading_rad, None, None, NorthReference.TRUE), COMPASS)
        return frames + (encode(RateOfTurn(rate_radps), COMPASS) if self._has_gyro else [])


class Devices:
    """All devices of the bus."""

    hears: tuple[CanAddress, ...] = ()

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        self.interface = settings.nmea2000.interface
        self.receiver = GnssReceiver(model, settings.simulation, seed)
        self.compass = Compass(model, settings.simulation, seed)

    @property
    def due_s(self) -> float:
        """When `step` is due next."""
        return min(self.receiver.due_s, self.compass.due_s)

    def feed(self, frame: Frame, now_s: float) -> None:
        """They listen to nobody."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """The frames that they send now; the model was advanced by the nodes."""
        return [*self.compass.step(now_s, utc_ns), *self.receiver.step(now_s, utc_ns)]


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> Devices | None:
    return Devices(settings, model, seed) if "nmea2000" in settings.navigation.sources else None
