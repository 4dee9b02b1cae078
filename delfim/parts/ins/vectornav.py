"""VectorNav's binary output (VN-200, VN-300 interface control documents, "Binary output").

A frame is FA, a byte with a bit for each group, for each of these two bytes with a bit for each field, the fields, and a CRC of
all but the first byte. Which fields come, says the file of the device; each whose length is known is passed over or read.
"""

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Final

from delfim.lines.binaryframes import Framing
from delfim.lines.utc import utc_ns
from delfim.parts.ins.insmessages import RECKONED, InsState, Language, Readings, degrees, radians

BEGIN: Final = b"\xfa"
COMMON, TIME, IMU, RECEIVER, ATTITUDE, INS, RECEIVER2 = range(7)  # groups, by their bits
LENGTHS: Final = {  # of the fields of each group, bytes, by their bits; 0: of no such field, or of one without a fixed length
    COMMON: (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),
    TIME: (8, 8, 8, 2, 8, 8, 8, 4, 4, 1),
    IMU: (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40),
    RECEIVER: (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
    ATTITUDE: (2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24, 12),
    INS: (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64),
    RECEIVER2: (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
}
FIELDS: Final = {  # that are read: what each is, and its code; a later one of the same kind counts
    (COMMON, 3): ("angles", "<3f"),
    (COMMON, 5): ("rates", "<3f"),
    (COMMON, 6): ("place", "<3d"),
    (COMMON, 7): ("velocity", "<3f"),
    (COMMON, 12): ("status", "<H"),
    (TIME, 6): ("utc", "<b5BH"),
    (TIME, 9): ("clock", "<B"),
    (IMU, 10): ("rates", "<3f"),
    (RECEIVER, 3): ("satellites", "<B"),
    (RECEIVER, 4): ("fix", "<B"),
    (ATTITUDE, 1): ("angles", "<3f"),
    (ATTITUDE, 8): ("deviations", "<3f"),
    (INS, 0): ("status", "<H"),
    (INS, 1): ("place", "<3d"),
    (INS, 4): ("velocity", "<3f"),
    (INS, 9): ("accuracy", "<f"),
}
FIXES: Final = {0: 0, 1: 0, 2: 2, 3: 3, 4: 4, 7: 6, 8: 5}  # as Navigation.fix; 1 has the time alone
FIX_TOLD: Final = {0: 0, 2: 2, 3: 3, 4: 4, 6: 7, 5: 8}
ALIGNING, TRACKING = 1, 2  # modes of the filter in which position and velocity count; 0: not yet, 3: no receiver for 45 s
UTC_VALID: Final = 4
ASKED: Final = ((COMMON, 0x0020), (TIME, 0x0240), (RECEIVER, 0x0018), (ATTITUDE, 0x0102), (INS, 0x0613))  # docs/ins.md


def _bits(field: int) -> Iterator[int]:
    return (bit for bit in range(16) if field >> bit & 1)


def _size(head: bytes) -> int | None:
    if len(head) < 2:
        return None
    groups = [group for group in range(8) if head[1] >> group & 1]
    size = 2 + 2 * len(groups)
    if not groups or groups[-1] > RECEIVER2:
        return 0
    if len(head) < size:
        return None
    for place, group in enumerate(groups):
        for bit in _bits(int.from_bytes(head[2 + 2 * place : 4 + 2 * place], "little")):
            length = LENGTHS[group][bit] if bit < len(LENGTHS[group]) else 0
            if not length:
                return 0
            size += length
    return size + 2


def _sound(frame: bytes) -> bool:
    return crc_hqx(frame[1:], 0) == 0  # the CRC is behind what it is of, high byte first


def read(frame: bytes) -> Readings:
    """Raises FormatError."""
    found = dict[str, tuple[float, ...]]()
    groups = [group for group in range(7) if frame[1] >> group & 1]
    at = 2 + 2 * len(groups)
    for place, group in enumerate(groups):
        for bit in _bits(int.from_bytes(frame[2 + 2 * place : 4 + 2 * place], "little")):
            if (field := FIELDS.get((group, bit))) is not None:
                found[field[0]] = struct.unpack_from(field[1], frame, at)
            at += LENGTHS[group][bit]
    return _readings(found)


def _readings(found: dict[str, tuple[float, ...]]) -> Readings:
    said: Readings = {}
    mode = int(found["status"][0]) & 3 if "status" in found else None
    navigates = mode in (None, ALIGNING, TRACKING)
    if "angles" in found:
        yaw, pitch, roll = radians(*found["angles"])
        said["attitude"] = roll, pitch
        said["heading"] = (yaw,) if mode or "deviations" in found else None
    if "deviations" in found:
        said["deviation"] = radians(found["deviations"][0])
    if "rates" in found:
        said["rate"] = found["rates"][2:]
    if "fix" in found:
        said["receiver"] = FIXES.get(int(found["fix"][0]), 0), *found.get("satellites", (0,))
    if "utc" in found and int(found.get("clock", (0,))[0]) & UTC_VALID:
        year, month, day, hour, minute, second, ms = map(int, found["utc"])
        said["time"] = (utc_ns(2000 + year, month, day, hour, minute, second, ms * 1_000_000),)
    if "accuracy" in found:
        said["accuracy"] = found["accuracy"]
    if "velocity" in found:
        said["velocity"] = found["velocity"][:2] if navigates else None
    if "place" in found:
        said["position"] = radians(*found["place"][:2]) if navigates and found["place"][:2] != (0.0, 0.0) else None
    return said


def told(state: InsState) -> bytes:
    """The frame with the fields of ASKED."""
    at = datetime.fromtimestamp(state.utc_ns // 1_000_000_000, UTC)
    ms = state.utc_ns // 1_000_000 % 1000
    roll, pitch, yaw, sure = degrees(*state.attitude, state.heading_rad, state.deviation_rad)
    status = TRACKING | 4 * (state.fix > RECKONED)
    head = BEGIN + bytes((sum(1 << group for group, _ in ASKED),)) + b"".join(struct.pack("<H", field) for _, field in ASKED)
    frame = head + b"".join((
        struct.pack("<3f", 0.0, 0.0, state.rate_radps),
        struct.pack("<b5BHB", at.year - 2000, at.month, at.day, at.hour, at.minute, at.second, ms, 7),
        struct.pack("<BB", state.satellites, FIX_TOLD[state.fix]),
        struct.pack("<6f", yaw, pitch, roll, sure, sure / 4.0, sure / 4.0),
        struct.pack("<H3d3f2f", status, *degrees(*state.position), 0.0, *state.velocity, 0.0, state.accuracy_m, 0.05),
    ))  # fmt: skip
    return frame + crc_hqx(frame[1:], 0).to_bytes(2, "big")


LANGUAGE: Final = Language(Framing(BEGIN, _size, _sound), read, told)
