"""What an ESC tells of itself on its telemetry wire: KISS telemetry, 115200 baud, ten bytes with nothing that begins them.

Big endian: degrees (signed), 0.01 V, 0.01 A, mAh, 100 electrical revolutions a minute, CRC-8 with the polynomial 0x07. An ESC
has no direction in it: the sign is that of the last command.
"""

import struct
from typing import Final, NamedTuple

from delfim.lines.binaryframes import BinaryFrames, Framing
from delfim.vehicle.links import Readable, ReadableLine
from delfim.vehicle.state import State

BAUD: Final = 115_200
SILENT_S: Final = 1.0  # an ESC tells each 30 to 100 ms
_TOLD: Final = struct.Struct(">bHHHHB")


class EscReport(NamedTuple):
    rpm: float  # of the shaft, without direction
    current_a: float
    voltage_v: float
    temperature_c: float


def crc8(data: bytes) -> int:
    """CRC-8 with the polynomial 0x07: 0 over a whole frame."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x07 if crc & 0x80 else 0)) & 0xFF
    return crc


FRAMING: Final = Framing(b"", lambda head: _TOLD.size, lambda frame: not crc8(frame))


class EscTelemetry:
    """The telemetry of one ESC. `fault` says why there is none; empty: it tells."""

    def __init__(self, line: ReadableLine, pole_pairs: int) -> None:
        self.input: Readable = line
        self._line, self._pole_pairs = line, pole_pairs
        self._frames, self._passed_over = BinaryFrames(FRAMING), -1
        self._told: EscReport | None = None
        self._heard_s = 0.0

    def read(self, state: State, now_s: float) -> None:
        """Take its frames. A sum of eight bits is often right by chance: a frame counts that follows another one at once."""
        before = self._frames.refused
        while data := self._line.read():
            for frame in self._frames.feed(data):
                is_next, self._passed_over = self._frames.refused == self._passed_over, self._frames.refused
                celsius, centivolts, centiamperes, _, hundreds, _ = _TOLD.unpack(frame)
                if is_next and centivolts:  # a wire without power is ten zeros, whose sum is right
                    self._heard_s = now_s
                    rpm = 100.0 * hundreds / self._pole_pairs
                    self._told = EscReport(rpm, centiamperes / 100.0, centivolts / 100.0, float(celsius))
        if self._frames.refused > before:
            state.count("esc_malformed", self._frames.refused - before)

    def told(self, now_s: float) -> tuple[EscReport | None, str]:
        """What it told last, unless that is old, and what is wrong, in words."""
        if self._told is None:
            return None, "its ESC has told nothing yet"
        age_s = now_s - self._heard_s
        return (self._told, "") if age_s <= SILENT_S else (None, f"its ESC has told nothing for {age_s:.0f} s")


class NoTelemetry:
    """The telemetry of an ESC whose line could not be opened: a motor is driven without it."""

    def __init__(self, why: str) -> None:
        self._why = f"its ESC's telemetry, until the next start: {why}"

    def told(self, now_s: float) -> tuple[EscReport | None, str]:
        return None, self._why
