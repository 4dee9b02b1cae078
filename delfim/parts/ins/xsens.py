"""Xsens' MTData2 (MT low-level communication protocol documentation, MT0605P), of an MTi that has a receiver: MTi-7, MTi-G-710,
MTi-670, MTi-680G.

A frame is FA FF, the number of the message, its length, the data, and a byte that makes the sum of all but the first zero. The
data is a row of items, each with number, length and value, big endian. An item's number says in which axes and numbers it is.
"""

import math
import struct
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Final

from delfim.base.errors import FormatError
from delfim.lines.binaryframes import Framing
from delfim.lines.utc import utc_ns
from delfim.parts.ins.insmessages import RECKONED, InsState, Language, Readings, degrees, radians

BEGIN: Final = b"\xfa\xff"
MTDATA2: Final = 0x36
LENGTH_MAX: Final = 2048  # bytes of data that the maker allows
LONG: Final = 0xFF  # in place of a length: two bytes follow with it
UTC_TIME, QUATERNION, EULER, LATLON, PVT, RATES, VELOCITY, STATUS, STATUS_BYTE = (
    0x1010, 0x2010, 0x2030, 0x5040, 0x7010, 0x8020, 0xD010, 0xE020, 0xE010,
)  # fmt: skip
ENU, NED, NWU = 0x0, 0x4, 0x8  # axes
_NUMBERS: Final = (("f", 1.0), ("i", 2.0**-20), ("", 2.0**-32), ("d", 1.0))  # by the two low bits of an item's number
_UTC: Final = struct.Struct(">IH6B")
_PVT: Final = struct.Struct(">IH6BIi4BiiiiII5iIIi7H")  # the receiver's: 94 bytes
UTC_VALID, VALID, HAS_FIX = 0x4, 0x2, 0x4  # flags of the time; of the status: filter valid, receiver has a fix
ACCURACY_MAX_M: Final = 10_000.0  # a receiver without a fix tells more
PVT_FIXES: Final = {2: 2, 3: 3, 4: 3}
CORRECTED: Final = 2  # flag of the receiver
CARRIER: Final = {1: 6, 2: 5}  # float and fixed, as Navigation.fix


def _size(head: bytes) -> int | None:
    if len(head) < 4:
        return None
    if head[3] != LONG:
        return head[3] + 5
    if len(head) < 6:
        return None
    length = int.from_bytes(head[4:6], "big")
    return length + 7 if length <= LENGTH_MAX else 0


def _sound(frame: bytes) -> bool:
    return sum(frame[1:]) & 0xFF == 0


def _items(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(data):
        number, length = int.from_bytes(data[at : at + 2], "big"), int.from_bytes(data[at + 2 : at + 3], "big")
        at += 3
        if at + length > len(data):
            raise FormatError("an item is longer than its message")
        yield number, data[at : at + length]
        at += length


def _numbers(number: int, data: bytes, count: int) -> tuple[float, ...]:
    """The numbers of an item, in the kind that its own number says. Raises FormatError."""
    code, unit = _NUMBERS[number & 3]
    if len(data) != count * (6 if not code else struct.calcsize(code)):
        raise FormatError(f"an item of {len(data)} bytes")
    if code:
        return tuple(each * unit for each in struct.unpack(f">{count}{code}", data))
    pairs = struct.iter_unpack(">Ih", data)  # the low 32 bits first
    return tuple((high * 2.0**32 + low) * unit for low, high in pairs)


def _turned(axes: int, roll: float, pitch: float, yaw: float) -> Readings:
    """Attitude and heading of angles that turn from these axes into those of the device; all but NED have z upwards."""
    if axes == NED:
        return {"attitude": (roll, pitch), "heading": (yaw,)}
    return {"attitude": (roll, -pitch), "heading": ((math.pi / 2.0 if axes == ENU else 0.0) - yaw,)}


def _quaternion(number: int, data: bytes) -> Readings:
    w, x, y, z = _numbers(number, data, 4)
    roll = math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z))))
    return _turned(number & 0xC, roll, pitch, math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))


def _euler(number: int, data: bytes) -> Readings:
    return _turned(number & 0xC, *radians(*_numbers(number, data, 3)))


def _latlon(number: int, data: bytes) -> Readings:
    return {"position": radians(*_numbers(number, data, 2))}


def _rates(number: int, data: bytes) -> Readings:
    upwards = _numbers(number, data, 3)[2]
    return {"rate": (upwards if number & 0xC == NED else -upwards,)}


def _velocity(number: int, data: bytes) -> Readings:
    x, y, _ = _numbers(number, data, 3)
    return {"velocity": {ENU: (y, x), NED: (x, y)}.get(number & 0xC, (x, -y))}


def _time(number: int, data: bytes) -> Readings:
    if len(data) != _UTC.size:
        raise FormatError("a time of another length")
    nano, *calendar, flags = _UTC.unpack(data)
    year, month, day, hour, minute, second = calendar
    return {"time": (utc_ns(year, month, day, hour, minute, second, nano),)} if flags & UTC_VALID else {}


def _pvt(number: int, data: bytes) -> Readings:
    if len(data) != _PVT.size:
        raise FormatError("a receiver's data of another length")
    told = _PVT.unpack(data)
    kind, flags, satellites, accuracy_m = told[10], told[11], told[12], told[18] / 1e3
    placed = PVT_FIXES.get(kind, 0) if not flags & CORRECTED else 4
    fix = CARRIER.get(flags >> 6, placed) if flags & 1 else 0
    return {"receiver": (fix, satellites), "accuracy": (accuracy_m,) if fix and accuracy_m < ACCURACY_MAX_M else None}


READERS: Final[dict[int, Callable[[int, bytes], Readings]]] = {
    UTC_TIME: _time,
    QUATERNION: _quaternion,
    EULER: _euler,
    LATLON: _latlon,
    PVT: _pvt,
    RATES: _rates,
    VELOCITY: _velocity,
}


def read(frame: bytes) -> Readings:
    """Raises FormatError."""
    if frame[2] != MTDATA2:
        return {}
    said: Readings = {}
    status = None
    for number, data in _items(frame[6 if frame[3] == LONG else 4 : -1]):
        if number in (STATUS, STATUS_BYTE):
            status = int.from_bytes(data, "big")
        elif (reader := READERS.get(number & 0xFFF0)) is not None:
            said |= reader(number, data)
    if status is not None and not status & VALID:
        said |= dict.fromkeys(("position", "velocity", "heading") & said.keys())
    return said


def _item(number: int, data: bytes) -> bytes:
    return number.to_bytes(2, "big") + bytes((len(data),)) + data


def told(state: InsState) -> bytes:
    """A frame as of an MTi-680G that tells NED in double numbers, and its receiver's data."""
    at = datetime.fromtimestamp(state.utc_ns // 1_000_000_000, UTC)
    calendar = at.year, at.month, at.day, at.hour, at.minute, at.second
    fixed, carrier = state.fix > RECKONED, {4: CORRECTED, 6: 0x40, 5: 0x80}.get(state.fix, 0)
    pvt = (0, *calendar, 7, 50, 0, 3 * fixed, fixed | carrier, state.satellites, 0, 0, 0, 0, 0)
    deviation, status = round(state.accuracy_m * 1e3), VALID | HAS_FIX * fixed
    roll, pitch, yaw = degrees(*state.attitude, state.heading_rad)
    data = (
        _item(UTC_TIME, _UTC.pack(state.utc_ns % 1_000_000_000, *calendar, 7))
        + _item(EULER | NED | 3, struct.pack(">3d", roll, pitch, (yaw + 180.0) % 360.0 - 180.0))
        + _item(RATES | NED | 3, struct.pack(">3d", 0.0, 0.0, state.rate_radps))
        + _item(LATLON | NED | 3, struct.pack(">2d", *degrees(*state.position)))
        + _item(VELOCITY | NED | 3, struct.pack(">3d", *state.velocity, 0.0))
        + _item(PVT, _PVT.pack(*pvt, deviation, deviation, *(0,) * 5, 50, 0, 0, *(100,) * 7))
        + _item(STATUS, status.to_bytes(4, "big"))
    )
    body = b"\xff" + bytes((MTDATA2, len(data))) + data
    return b"\xfa" + body + bytes((-sum(body) & 0xFF,))


LANGUAGE: Final = Language(Framing(BEGIN, _size, _sound), read, told)
