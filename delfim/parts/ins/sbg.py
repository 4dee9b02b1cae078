"""SBG Systems' sbgECom (firmware reference manual, "Frame definition", and the maker's library sbgECom 5.1).

A frame is FF 5A, number and class of the message, length, payload, a CRC of all from the number on, and 33; little endian.
"""

import math
import struct
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

from delfim.base.errors import FormatError
from delfim.lines.binaryframes import Framing, mirrored_crc
from delfim.lines.utc import utc_ns
from delfim.parts.ins.insmessages import RECKONED, InsState, Language, Readings, degrees, radians

BEGIN, END = b"\xff\x5a", 0x33
PAYLOAD_MAX: Final = 4086
UTC_TIME, IMU, EULER, NAV, RECEIVER, IMU_SHORT = 2, 3, 6, 8, 14, 44  # messages of class 0
_HEAD: Final = struct.Struct("<BBH")  # after BEGIN
_UTC: Final = struct.Struct("<IHH5biI")
_IMU: Final = struct.Struct("<IH3f3f")
_IMU_SHORT: Final = struct.Struct("<IH3i3i")
_EULER: Final = struct.Struct("<I3f3fI")
_NAV: Final = struct.Struct("<I3f3f3df3fI")
_RECEIVER: Final = struct.Struct("<III3d4fBHH")
SCALE, HIGH_SCALE, IS_HIGH = 2.0**26, 12_304_174.0, 1 << 10  # rates of `IMU_SHORT` in a rad/s, and the flag of the second one
AHRS, NAVIGATES, PLACED = 2, 3, 4  # modes of the filter: it knows the heading; velocity, too; position, too
FIXES: Final = (0, 2, 3, 4, 4, 4, 6, 5, 6, 5, 3)  # as Navigation.fix, by the receiver's type of solution
TYPES: Final = {0: 0, 2: 1, 3: 2, 4: 4, 6: 6, 5: 7}


def _size(head: bytes) -> int | None:
    if len(head) < 6:
        return None
    length = _HEAD.unpack_from(head, 2)[2]
    return length + 9 if length <= PAYLOAD_MAX else 0


def _sound(frame: bytes) -> bool:
    return frame[-1] == END and mirrored_crc(frame[2:-3]) == int.from_bytes(frame[-3:-1], "little")


def _time(payload: bytes) -> Readings:
    _, status, year, month, day, hour, minute, second, nano, _ = _UTC.unpack_from(payload)
    return {"time": (utc_ns(year, month, day, hour, minute, second, nano),)} if status >> 6 & 0xF else {}


def _imu(payload: bytes) -> Readings:
    return {"rate": _IMU.unpack_from(payload)[7:]}


def _imu_short(payload: bytes) -> Readings:
    told = _IMU_SHORT.unpack_from(payload)
    return {"rate": (told[7] / (HIGH_SCALE if told[1] & IS_HIGH else SCALE),)}


def _euler(payload: bytes) -> Readings:
    _, roll, pitch, yaw, _, _, deviation, status = _EULER.unpack_from(payload)
    mode = status & 0xF
    heading = (yaw,) if mode >= AHRS else None
    return {"attitude": (roll, pitch) if mode else None, "heading": heading, "deviation": (deviation,)}


def _nav(payload: bytes) -> Readings:
    told = _NAV.unpack_from(payload)
    mode = told[-1] & 0xF
    return {
        "velocity": told[1:3] if mode >= NAVIGATES else None,
        "accuracy": (math.hypot(*told[11:13]),),
        "position": radians(*told[7:9]) if mode >= PLACED else None,
    }


def _receiver(payload: bytes) -> Readings:
    told = _RECEIVER.unpack_from(payload)
    bad, kind, satellites = told[1] & 0x3F, told[1] >> 6 & 0x3F, told[10]
    fix = FIXES[kind] if not bad and kind < len(FIXES) else 0
    return {"receiver": (fix, 0 if satellites == 0xFF else satellites)}


READERS: Final[dict[int, tuple[int, Callable[[bytes], Readings]]]] = {  # with the least length; newer ones have more behind
    UTC_TIME: (_UTC.size, _time),
    IMU: (_IMU.size, _imu),
    EULER: (_EULER.size, _euler),
    NAV: (_NAV.size, _nav),
    RECEIVER: (_RECEIVER.size, _receiver),
    IMU_SHORT: (_IMU_SHORT.size, _imu_short),
}


def read(frame: bytes) -> Readings:
    """Raises FormatError."""
    number, kind, _ = _HEAD.unpack_from(frame, 2)
    if kind or number not in READERS:
        return {}
    length, reader = READERS[number]
    if len(frame) - 9 < length:
        raise FormatError("a message is shorter than it is known")
    return reader(frame[6:-3])


def framed(number: int, payload: bytes) -> bytes:
    body = _HEAD.pack(number, 0, len(payload)) + payload
    return BEGIN + body + mirrored_crc(body).to_bytes(2, "little") + bytes((END,))


def told(state: InsState) -> bytes:
    """The messages of one instant; the position comes last, as all others belong to it."""
    at, stamp = datetime.fromtimestamp(state.utc_ns // 1_000_000_000, UTC), state.utc_ns // 1000 & 0xFFFF_FFFF
    calendar = at.year, at.month, at.day, at.hour, at.minute, at.second, state.utc_ns % 1_000_000_000
    yaw, sure, deviation = (
        (state.heading_rad + math.pi) % math.tau - math.pi,
        state.deviation_rad,
        state.accuracy_m / math.sqrt(2.0),
    )
    place, status = (*degrees(*state.position), 0.0), PLACED | 0xF0
    kind = TYPES[state.fix if state.fix > RECKONED else 0] << 6
    tail = 0.0, deviation, deviation, deviation
    return b"".join((
        framed(UTC_TIME, _UTC.pack(stamp, 2 << 6, *calendar, 0)),
        framed(IMU, _IMU.pack(stamp, 0, 0.0, 0.0, -9.81, 0.0, 0.0, state.rate_radps) + bytes(28)),
        framed(EULER, _EULER.pack(stamp, *state.attitude, yaw, sure / 4.0, sure / 4.0, sure, status)),
        framed(RECEIVER, _RECEIVER.pack(stamp, kind, 0, *place, *tail, state.satellites, 0xFFFF, 0xFFFF)),
        framed(NAV, _NAV.pack(stamp, *state.velocity, 0.0, 0.05, 0.05, 0.05, *place, *tail, status)),
    ))  # fmt: skip


LANGUAGE: Final = Language(Framing(BEGIN, _size, _sound), read, told)
