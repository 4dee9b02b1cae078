"""AIS as a receiver sends it over NMEA 0183: sentences VDM with the messages 1, 5, 18 and 24 of ITU-R M.1371.

What is None is sent as not available.
"""

import math
from collections.abc import Iterator
from typing import Final

from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.lines.nmea0183.framing import checksum

KNOT_MPS: Final = 1852.0 / 3600.0
PER_DEG: Final = 600_000.0  # units of a position: ten-thousandths of a minute
CHARACTERS_MAX: Final = 60  # of a payload in one sentence, which has 82 characters at most
_LEAVE: Final = 0


class _Bits:
    """A message that is being written: numbers of so many bits, the most significant first."""

    def __init__(self, kind: int, mmsi: int) -> None:
        self._value, self._length = 0, 0
        self.add((kind, 6), (0, 2), (mmsi, 30))

    def add(self, *fields: tuple[int, int]) -> None:
        for value, width in fields:
            self._value = self._value << width | value & (1 << width) - 1
            self._length += width

    def text(self, words: str | None, characters: int) -> None:
        """Add a text in the six-bit alphabet; "@" fills up."""
        for each in (words or "").upper().ljust(characters, "@")[:characters]:
            code = ord(each) if 32 <= ord(each) < 96 else ord("?")
            self.add((code & 63, 6))

    def sentences(self, number: int) -> bytes:
        """`number` tells the parts of one message from those of another."""
        fill = -self._length % 6
        value, count = self._value << fill, (self._length + fill) // 6
        six = (value >> 6 * (count - 1 - i) & 63 for i in range(count))
        payload = "".join(chr(each + (48 if each < 40 else 56)) for each in six)
        parts = [payload[i : i + CHARACTERS_MAX] for i in range(0, count, CHARACTERS_MAX)]
        together = str(number % 10) if len(parts) > 1 else ""
        said = b""
        for i, part in enumerate(parts, 1):
            left = fill if i == len(parts) else 0
            body = f"AIVDM,{len(parts)},{i},{together},A,{part},{left}".encode("ascii")
            said += b"!%s*%02X\r\n" % (body, checksum(body))
        return said


def position_said(told: VesselPosition, status: int | None, second: int) -> bytes:
    """The sentences of message 1, or of 18 where there is no `status`. `second`: of UTC, 0..59."""
    bits = _Bits(18 if status is None else 1, told.mmsi)
    knots = 1023 if told.speed_mps is None else min(round(told.speed_mps / KNOT_MPS * 10.0), 1022)
    if status is None:
        bits.add((_LEAVE, 8))
    else:
        bits.add((status, 4), (_turning(told.rate_radps), 8))
    longitude, latitude = _place(told.longitude_rad, 181.0), _place(told.latitude_rad, 91.0)
    bits.add((knots, 10), (1, 1), (longitude, 28), (latitude, 27))
    bits.add((3600 if told.course_rad is None else round(math.degrees(told.course_rad) * 10.0) % 3600, 12))
    bits.add((511 if told.heading_rad is None else round(math.degrees(told.heading_rad)) % 360, 9), (second, 6))
    if status is None:
        bits.add((0, 2), (1, 1), (0, 5), (0, 1), (0, 20))  # a unit of class B "CS"
    else:
        bits.add((0, 2), (0, 3), (0, 1), (0, 19))
    return bits.sentences(0)


def facts_said(told: VesselFacts, is_class_a: bool, number: int) -> Iterator[bytes]:
    """The sentences of message 5, or of the two parts of message 24."""
    size = _distances(told)
    if is_class_a:
        bits = _Bits(5, told.mmsi)
        bits.add((0, 2), (0, 30))
        bits.text(told.call_sign, 7)
        bits.text(told.name, 20)
        bits.add((told.kind or 0, 8), *size, (1, 4), (0, 4), (0, 5), (24, 5), (60, 6), (0, 8))
        bits.text(None, 20)
        bits.add((0, 2))
        yield bits.sentences(number)
        return
    name = _Bits(24, told.mmsi)
    name.add((0, 2))
    name.text(told.name, 20)
    name.add((0, 8))
    yield name.sentences(0)
    rest = _Bits(24, told.mmsi)
    rest.add((1, 2), (told.kind or 0, 8), (0, 42))
    rest.text(told.call_sign, 7)
    rest.add(*size, (0, 6))
    yield rest.sentences(0)


def _distances(told: VesselFacts) -> list[tuple[int, int]]:
    """The distances of the antenna from bow, stern, port and starboard, m; all 0: not known."""
    length_m, beam_m, bow_m, starboard_m = told.length_m, told.beam_m, told.from_bow_m, told.from_starboard_m
    if length_m is None or beam_m is None or bow_m is None or starboard_m is None:
        return [(0, 9), (0, 9), (0, 6), (0, 6)]
    bow_m, starboard_m = max(bow_m, 0.0), max(starboard_m, 0.0)
    stern_m, port_m = max(length_m - bow_m, 0.0), max(beam_m - starboard_m, 0.0)
    along = [(min(round(each), 511), 9) for each in (bow_m, stern_m)]
    return along + [(min(round(each), 63), 6) for each in (port_m, starboard_m)]


def _place(angle_rad: float | None, unknown_deg: float) -> int:
    return round((unknown_deg if angle_rad is None else math.degrees(angle_rad)) * PER_DEG)


def _turning(rate_radps: float | None) -> int:
    """The rate of turn by M.1371: 4.733 times the root of degrees a minute, signed."""
    if rate_radps is None:
        return -128
    return round(math.copysign(min(4.733 * math.sqrt(abs(math.degrees(rate_radps)) * 60.0), 126.0), rate_radps))
