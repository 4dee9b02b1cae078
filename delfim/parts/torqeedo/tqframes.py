"""The messages of TQ bus between a master and a motor, as ArduPilot's `AP_Torqeedo` knows them; the maker's document is under a
non-disclosure agreement.

A frame is AC, address, message, data, CRC-8/MAXIM, AD; big endian. AC, AD and AE within are told as AE and the byte with the
high bit turned over. A reply has the address of the master and no number of its message: its length tells which it is.
"""

import struct
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.binaryframes import HEAD_MAX, Framing

BEGIN, END, ESCAPE, TURNED = 0xAC, 0xAD, 0xAE, 0x80
MASTER, MOTOR = 0x00, 0x30  # addresses
STATUS, PARAMETERS, DRIVE = 0x01, 0x03, 0x82  # messages to a motor
ENABLE, CLEAR = 0x01, 0x04  # flags of DRIVE: turn; forget what went wrong
FULL: Final = 1000  # of a speed
FRAME_MAX: Final = HEAD_MAX  # bytes; a message has up to 35 before those within are turned over
EMERGENCY: Final = 0x04  # of the status
ERRORS: Final = (  # bits of the status, from the lowest
    "too much current",
    "the propeller is blocked",
    "voltage too high",
    "voltage too low",
    "voltage too high under load",
    "voltage too low under load",
    "motor too hot",
    "electronics too hot",
    "heard no command for too long",
    "temperature sensor broken",
    "tilted out of the water",
)
_DRIVE: Final = struct.Struct(">BBBBh")
_STATUS: Final = struct.Struct(">BH")
_PARAMETERS: Final = struct.Struct(">hHHHhh")


class TorqeedoStatus(NamedTuple):
    stopped: bool  # by its emergency stop
    errors: int  # bits, ERRORS


class TorqeedoParameters(NamedTuple):
    rpm: int
    voltage_v: float
    current_a: float
    temperature_c: float  # of the electronics or the windings, whichever is hotter


def crc8(data: bytes) -> int:
    """CRC-8/MAXIM."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8C if crc & 1 else 0)
    return crc


def framed(body: bytes) -> bytes:
    """Frame address, message and data."""
    told = bytearray((BEGIN,))
    for byte in (*body, crc8(body)):
        told += bytes((ESCAPE, byte ^ TURNED)) if byte in (BEGIN, END, ESCAPE) else bytes((byte,))
    return bytes((*told, END))


def unframed(frame: bytes) -> bytes:
    """Address, message, data and CRC of a frame."""
    first, *rest = frame[1:-1].split(bytes((ESCAPE,)))
    return first + b"".join(bytes((each[0] ^ TURNED,)) + each[1:] if each else b"" for each in rest)


def _size(head: bytes) -> int | None:
    end, again = head.find(END), head.find(BEGIN, 1)
    if end < 0 and again < 0:
        return None if len(head) < FRAME_MAX else 0
    return end + 1 if end > 0 and not 0 < again < end else 0


def _sound(frame: bytes) -> bool:
    body = unframed(frame)
    return len(body) > 2 and crc8(body[:-1]) == body[-1]


FRAMING: Final = Framing(bytes((BEGIN,)), _size, _sound)


def drive(part: float, power_percent: int) -> bytes:
    """A command: a part of the full speed, -1 to 1. At 0 the motor forgets what went wrong, too: it would not turn again."""
    speed = max(-FULL, min(FULL, round(FULL * part)))
    return framed(_DRIVE.pack(MOTOR, DRIVE, ENABLE if speed else CLEAR, power_percent if speed else 0, speed))


def asked(message: int) -> bytes:
    """A question for STATUS or PARAMETERS."""
    return framed(bytes((MOTOR, message)))


def replied(frame: bytes) -> TorqeedoStatus | TorqeedoParameters | None:
    """What a motor replied; None: it is of something else. Raises FormatError."""
    body = unframed(frame)[:-1]
    if body[0] != MASTER:
        return None
    data = body[2:]
    if len(data) == _STATUS.size:
        status, errors = _STATUS.unpack(data)
        return TorqeedoStatus(bool(status & EMERGENCY), errors)
    if len(data) == _PARAMETERS.size:
        rpm, _, centivolts, deciamperes, electronics, windings = _PARAMETERS.unpack(data)
        return TorqeedoParameters(rpm, centivolts / 100.0, deciamperes / 10.0, max(electronics, windings) / 10.0)
    if data:
        raise FormatError(f"a reply with {len(data)} bytes of data")
    return None
