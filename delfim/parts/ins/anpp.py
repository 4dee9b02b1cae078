"""Advanced Navigation's packet protocol, ANPP (reference manual of Spatial and Certus, "Packet structure").

A frame is a sum of the next four bytes, the packet's number, its length, a CRC of the payload, and the payload; little endian.
"""

import math
import struct
from binascii import crc_hqx
from typing import Final

from delfim.lines.binaryframes import Framing
from delfim.parts.ins.insmessages import RECKONED, InsState, Language, Readings

HEAD: Final = 5  # bytes before the payload
STATE, ANGLE_DEVIATIONS = 20, 26
_STATE: Final = struct.Struct("<HHII3d3f3ff3f3f3f")
_DEVIATIONS: Final = struct.Struct("<3f")
ATTITUDE_KNOWN, PLACED, HEADING_KNOWN, UTC_KNOWN = 1, 2, 4, 8  # of the filter's status
FIXES: Final = (0, 2, 3, 4, 4, 4, 6, 5)  # as Navigation.fix, by bits 4 to 6 of the filter's status
TYPES: Final = {0: 0, 2: 1, 3: 2, 4: 4, 6: 6, 5: 7}


def _size(head: bytes) -> int | None:
    if len(head) < HEAD:
        return None
    return head[2] + HEAD if sum(head[:HEAD]) & 0xFF == 0 and head[1] else 0


def _sound(frame: bytes) -> bool:
    return crc_hqx(frame[HEAD:], 0xFFFF) == int.from_bytes(frame[3:5], "little")


def read(frame: bytes) -> Readings:
    if frame[1] == ANGLE_DEVIATIONS and len(frame) == HEAD + _DEVIATIONS.size:
        return {"deviation": _DEVIATIONS.unpack_from(frame, HEAD)[2:]}
    if frame[1] != STATE or len(frame) != HEAD + _STATE.size:
        return {}
    told = _STATE.unpack_from(frame, HEAD)
    status = told[1]
    return {
        "attitude": told[14:16] if status & ATTITUDE_KNOWN else None,
        "heading": told[16:17] if status & HEADING_KNOWN else None,
        "rate": told[19:20],
        "receiver": (FIXES[status >> 4 & 7], 0),
        "time": (told[2] * 1_000_000_000 + told[3] * 1000,) if status & UTC_KNOWN else None,
        "velocity": told[7:9] if status & PLACED else None,
        "accuracy": (math.hypot(*told[20:22]),),
        "position": told[4:6] if status & PLACED else None,
    }


def framed(number: int, payload: bytes) -> bytes:
    body = bytes((number, len(payload))) + crc_hqx(payload, 0xFFFF).to_bytes(2, "little")
    return bytes((-sum(body) & 0xFF,)) + body + payload


def told(state: InsState) -> bytes:
    kind = TYPES[state.fix if state.fix > RECKONED else 0] << 4
    sure, deviation = state.deviation_rad, state.accuracy_m / math.sqrt(2.0)
    values = (
        *(0, ATTITUDE_KNOWN | PLACED | HEADING_KNOWN | UTC_KNOWN | kind),
        *divmod(state.utc_ns // 1000, 1_000_000),
        *(*state.position, 0.0),
        *(*state.velocity, 0.0),
        *(0.0, 0.0, -9.81, 1.0),
        *(*state.attitude, state.heading_rad % math.tau),
        *(0.0, 0.0, state.rate_radps),
        *(deviation, deviation, deviation),
    )
    return framed(ANGLE_DEVIATIONS, _DEVIATIONS.pack(sure / 4.0, sure / 4.0, sure)) + framed(STATE, _STATE.pack(*values))


LANGUAGE: Final = Language(Framing(b"", _size, _sound), read, told)
