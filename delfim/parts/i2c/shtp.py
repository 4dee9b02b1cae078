"""The packets of CEVA's BNO085: Sensor Hub Transport Protocol, and of SH-2 what a heading needs (BNO08X data sheet 1.17, SH-2
Reference Manual 1.9).

A packet is its length with these four bytes, its channel, a counter of the channel, and the cargo; little endian.
"""

import math
import struct
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

HEAD: Final = struct.Struct("<HBB")
CONTINUES: Final = 0x8000  # in the length: the head was read before
LENGTH_MAX: Final = 1024  # the longest that a BNO085 sends has some 300 bytes
EXECUTABLE, CONTROL, REPORTS = 1, 2, 3  # channels
RESET, RESET_DONE = 1, 1  # of EXECUTABLE
SET_FEATURE: Final = 0xFD
_FEATURE: Final = struct.Struct("<BBBHIII")
TIME_BASE, TIME_REBASE, GYRO, ROTATION = 0xFB, 0xFA, 0x02, 0x05  # reports
SIZES: Final = {TIME_BASE: 5, TIME_REBASE: 5, GYRO: 10, ROTATION: 14}
_GYRO: Final = struct.Struct("<BBBB3h")
_ROTATION: Final = struct.Struct("<BBBB5h")
RATE_STEP, TURN_STEP, SURE_STEP = 2.0**-9, 2.0**-14, 2.0**-12  # rad/s; of a quaternion; rad
NORM: Final = 0.9, 1.1  # of a quaternion


class Gyro(NamedTuple):
    """Rates about the chip's axes."""

    counter: int
    radps: tuple[float, float, float]


class Rotation(NamedTuple):
    """How the chip's axes are turned against east, magnetic north and up."""

    counter: int
    quality: int  # 0 (unreliable) to 3
    x: float
    y: float
    z: float
    w: float
    deviation_rad: float  # of the heading, as the chip estimates it

    def axis(self, ahead: float, aside: float) -> tuple[float, float, float]:
        """East, north and up of a direction in the plane of x and y."""
        x, y, z, w = self.x, self.y, self.z, self.w
        ex = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
        ey = (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))
        east, north, up = (ahead * a + aside * b for a, b in zip(ex, ey, strict=True))
        return east, north, up

    @property
    def is_upright(self) -> bool:
        return 1.0 - 2.0 * (self.x * self.x + self.y * self.y) > 0.0


def packed(channel: int, counter: int, cargo: bytes) -> bytes:
    return HEAD.pack(HEAD.size + len(cargo), channel, counter & 0xFF) + cargo


def length_of(head: bytes) -> int:
    """The bytes of the packet that begins so; 0: there is none. Raises FormatError."""
    length = HEAD.unpack(head)[0]
    if length == 0xFFFF:
        raise FormatError("nothing but ones came: the bus is not pulled down, or the chip is not there")
    length &= ~CONTINUES
    if length and not HEAD.size <= length <= LENGTH_MAX:
        raise FormatError(f"a packet of {length} bytes")
    return int(length)


def feature(report: int, rate_hz: float) -> bytes:
    """The cargo that asks for a report so often."""
    return _FEATURE.pack(SET_FEATURE, report, 0, 0, round(1e6 / rate_hz), 0, 0)


def reports(cargo: bytes) -> list[Gyro | Rotation]:
    """The reports of a cargo of REPORTS, up to the first that is unknown. Raises FormatError for one that is cut off, or is no
    rotation."""
    found, at = list[Gyro | Rotation](), 0
    while at < len(cargo) and (size := SIZES.get(cargo[at])) is not None:
        if at + size > len(cargo):
            raise FormatError("a report that is cut off")
        if cargo[at] == GYRO:
            _, counter, _, _, *rates = _GYRO.unpack_from(cargo, at)
            x, y, z = (each * RATE_STEP for each in rates)
            found.append(Gyro(counter, (x, y, z)))
        elif cargo[at] == ROTATION:
            found.append(_rotation(cargo, at))
        at += size
    return found


def _rotation(cargo: bytes, at: int) -> Rotation:
    _, counter, status, _, *turned, sure = _ROTATION.unpack_from(cargo, at)
    x, y, z, w = (each * TURN_STEP for each in turned)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not NORM[0] <= norm <= NORM[1] or sure < 0:
        raise FormatError("no rotation")
    return Rotation(counter, status & 3, x / norm, y / norm, z / norm, w / norm, sure * SURE_STEP)
