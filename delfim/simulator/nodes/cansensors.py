"""Sensors on a DroneCAN bus: a receiver, a compass, with a gyro and an accelerometer if wished, and the batteries of the first
two thrusters. They are there where the vehicle's file names the source, or the sensor, `dronecan`.

The compass measures the earth's field, bent as the calibration of the file undoes it, and lies as the file says.
"""

import math
from typing import Final

from delfim import config
from delfim.base.frames import Frame
from delfim.canproxy.dronecan.datatypes import (
    AUXILIARY,
    BATTERY_INFO,
    FIX2,
    MAGNETIC_FIELD_FINE,
    NODE_STATUS,
    RAW_IMU,
    node_status,
)
from delfim.canproxy.dronecan.fields import DataType, pack
from delfim.canproxy.dronecan.transfers import NODE_MAX, SENSOR, Publisher
from delfim.canproxy.socket import CanAddress
from delfim.simulator.model import Model
from delfim.simulator.nodes.measuring import AntennaMotion, Compass, GnssReceiver, Turn
from delfim.simulator.nodes.navigation import HDOP
from delfim.simulator.nodes.period import Period
from delfim.simulator.tables import Simulation

Vector = tuple[float, float, float]
FIRST_NODE: Final = 40
WORD_S: Final = 1.0  # between two words of a node on itself, two of the receiver's dilution, and two of the batteries
LEAST_S: Final = 1e-3
LEVEL_GA, DEEP_GA = 0.27, 0.35  # the earth's field at Lisbon
GRAVITY_MPS2: Final = 9.80665
GAUSS_PER_UT: Final = 0.01
KELVIN: Final = 273.15
FIX_3D, UTC = 3, 2
UNKNOWN: Final = math.nan
UNKNOWN_PERCENT: Final = 127
_new = tuple.__new__  # a third of the time of Frame(...)
STILL: Final[Vector] = (0.0, 0.0, 0.0)  # integrals, which nobody reads


class CanSensors:
    """All sensors of the bus."""

    hears: tuple[CanAddress, ...] = ()

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        table = settings.table("dronecan")
        self.interface, self._model = table.interface, model
        self._variation_rad, arrow_rad = math.radians(table.variation_deg), math.radians(table.compass_deg)
        self._arrow = math.cos(arrow_rad), math.sin(arrow_rad)
        xx, yy, zz, xy, xz, yz = table.soft_iron
        a, b, c = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
        self._columns = cross(b, c), cross(c, a), cross(a, b)  # of the inverse, times the determinant
        self._whole = xx * self._columns[0][0] + xy * self._columns[0][1] + xz * self._columns[0][2]
        self._own_ga = [each * GAUSS_PER_UT for each in table.hard_iron_ut]
        self._navigates = "dronecan" in settings.navigation.sources
        self._drives = [*model.drives.values()][:2] if "dronecan" in settings.sensors.names else []
        self.receiver = GnssReceiver(model, settings.of(Simulation), seed, "receiver dronecan")
        self.compass = Compass(model, settings.of(Simulation), seed, "compass dronecan")
        self._has_gyro = settings.of(Simulation).gyro
        self._gnss, self._heading, self._battery = [each for each in range(FIRST_NODE, NODE_MAX) if each != table.node][:3]
        self._publishers = dict[tuple[int, int], Publisher]()
        self._words = Period(WORD_S)
        self._began_s: float | None = None
        self._said = list[tuple[DataType, bytes]]()  # by the compass
        self._down: Vector | None = None  # as the compass last lay ...
        self._turned_s = 0.0  # ... and when

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        return min(self.receiver.due_s, self.compass.due_s) if self._navigates else self._words.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame: the sensors listen to nobody."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """The frames that the sensors send now; the model was advanced by the nodes."""
        self._began_s = now_s if self._began_s is None else self._began_s
        frames: list[Frame] = []
        if self._navigates:
            if (turn := self.compass.step(now_s)) is not None:
                frames += self._turning(turn, now_s)
            if (moved := self.receiver.step(now_s)) is not None:
                frames += self._located(moved, utc_ns)
        if self._words.passed(now_s):
            status = node_status(now_s - self._began_s)
            for node in (self._gnss, self._heading) if self._navigates else ():
                frames += self._frames(NODE_STATUS, node, status)
            if self._navigates and not self.receiver.silent:
                count = self.receiver.satellites
                told = UNKNOWN, UNKNOWN, HDOP, *(UNKNOWN,) * 4, count, count
                frames += self._frames(AUXILIARY, self._gnss, pack(AUXILIARY, told))
            frames += self._batteries(status)
        return frames

    def _frames(self, kind: DataType, node: int, payload: bytes) -> list[Frame]:
        publisher = self._publishers.get((kind.id, node))
        if publisher is None:
            publisher = self._publishers[kind.id, node] = Publisher(kind, node, SENSOR)
        return [_new(Frame, (arb, data, 0, 0, False)) for arb, data in publisher.frames(payload)]

    def _located(self, moved: AntennaMotion, utc_ns: int) -> list[Frame]:
        place = round(math.degrees(moved.longitude_rad) * 1e8), round(math.degrees(moved.latitude_rad) * 1e8)
        head = 0, utc_ns // 1000, UTC, 0, *place, 0, 0, moved.north_mps, moved.east_mps, 0.0
        state = self.receiver.satellites, FIX_3D, 0, 0, 0
        return self._frames(FIX2, self._gnss, pack(FIX2, (*head, *state), (UNKNOWN,)))

    def _turning(self, turn: Turn, now_s: float) -> list[Frame]:
        """The reading of the compass; the same as before while it is frozen."""
        if not (self.compass.frozen and self._said):
            self._said = self._measured(turn, now_s)
        return [frame for kind, payload in self._said for frame in self._frames(kind, self._heading, payload)]

    def _measured(self, turn: Turn, now_s: float) -> list[tuple[DataType, bytes]]:
        """The magnetic field, and the values of gyro and accelerometer, in the axes of the device."""
        north, down = self._axes(turn.heading_rad)
        (nx, ny, nz), (dx, dy, dz) = north, down
        earth_ga = LEVEL_GA * nx + DEEP_GA * dx, LEVEL_GA * ny + DEEP_GA * dy, LEVEL_GA * nz + DEEP_GA * dz
        field = MAGNETIC_FIELD_FINE, pack(MAGNETIC_FIELD_FINE, (0, *self._bent(earth_ga)))
        before, dt_s = self._down or down, max(now_s - self._turned_s, LEAST_S)
        self._down, self._turned_s = down, now_s
        if not self._has_gyro:
            return [field]
        bx, by, bz = before
        lx, ly, lz = cross(((dx - bx) / dt_s, (dy - by) / dt_s, (dz - bz) / dt_s), down)
        r, g = turn.rate_radps, -GRAVITY_MPS2
        rates, force = (r * dx + lx, r * dy + ly, r * dz + lz), (g * dx, g * dy, g * dz)
        return [field, (RAW_IMU, pack(RAW_IMU, (0, dt_s, *rates, *STILL, *force, *STILL)))]

    def _axes(self, heading_rad: float) -> tuple[Vector, Vector]:
        """The directions of magnetic north and of down, in the axes of the device."""
        model, (ca, sa) = self._model, self._arrow
        heading_rad -= self._variation_rad
        roll_rad, pitch_rad = model.roll_rad, model.pitch_rad
        ch, sh, cr, sr = math.cos(heading_rad), math.sin(heading_rad), math.cos(roll_rad), math.sin(roll_rad)
        cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
        x, y, z = cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh
        dx, dy = -sp, sr * cp
        return (x * ca + y * sa, y * ca - x * sa, z), (dx * ca + dy * sa, dy * ca - dx * sa, cr * cp)

    def _bent(self, field_ga: Vector) -> Vector:
        """The field as disturbed as the calibration of the file corrects it."""
        (x, y, z), (a, b, c), whole, own = field_ga, self._columns, self._whole, self._own_ga
        return (
            (x * a[0] + y * b[0] + z * c[0]) / whole + own[0],
            (x * a[1] + y * b[1] + z * c[1]) / whole + own[1],
            (x * a[2] + y * b[2] + z * c[2]) / whole + own[2],
        )

    def _batteries(self, status: bytes) -> list[Frame]:
        frames = self._frames(NODE_STATUS, self._battery, status) if self._drives else []
        for number, drive in enumerate(self._drives):
            kelvin, percent = drive.temperature_c + KELVIN, round(100.0 * drive.charge)
            told = kelvin, drive.voltage_v, drive.current_a, *(UNKNOWN,) * 4, 1, UNKNOWN_PERCENT, percent, 0, number, 0
            frames += self._frames(BATTERY_INFO, self._battery, pack(BATTERY_INFO, told))
        return frames


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> CanSensors | None:
    sensing = "dronecan" in (*settings.navigation.sources, *settings.sensors.names)
    return CanSensors(settings, model, seed) if sensing else None
