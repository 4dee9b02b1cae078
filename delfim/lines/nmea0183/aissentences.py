"""AIS over NMEA 0183: sentences VDM of a receiver and VDO of the boat's own transponder, ITU-R M.1371. No sockets, no clock.

A payload is text of six bits a character. Messages 1, 2, 3, 18 and 19 are positions, 5, 19 and 24 tell what a vessel is; long
ones come in several sentences. A value that the vessel does not tell is None. Base stations (4), aids to navigation (21) and
all others are no vessels and are dropped.
"""

import math
from binascii import a2b_base64
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.vessels import MMSI_MAX, STATUS_UNKNOWN, Report, VesselFacts, VesselPosition, readable

KNOT: Final = 1852.0 / 3600.0
PARTS_MAX: Final = 5  # sentences of a message; the longest here, 5, needs two
CHARACTERS_MAX: Final = 82  # of one payload
JOINING: Final = 8  # messages under way at once
JOIN_S: Final = 2.0  # the parts of a message follow each other
_MINUTES: Final = math.radians(1.0 / 600_000.0)  # 1e-4 minutes of arc
_ARMOUR: Final = bytes(range(48, 88)) + bytes(range(96, 120))  # the characters of 0 to 63
_BASE64: Final = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
_TO_BASE64: Final = bytes.maketrans(_ARMOUR, _BASE64)
_TEXT: Final = "@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\]^_ !\"#$%&'()*+,-./0123456789:;<=>?"
_BITS: Final = {1: 143, 2: 143, 3: 143, 5: 270, 18: 139, 19: 301}  # that are read here: some senders leave away spare bits
_PART_BITS: Final = {0: 160, 1: 162}  # of message 24
_CRAFT: Final = 98  # a craft of a mother ship tells that one's number in place of its size


class AisPart(NamedTuple):
    """A sentence VDM or VDO, one of `parts` of a message."""

    parts: int
    number: int  # from 1
    sequence: str  # which message, where there are several parts
    channel: str
    payload: bytes
    fill: int  # bits at the end of the payload that are none
    is_own: bool  # VDO


class _Payload:
    """The bits of a message, first bit first."""

    def __init__(self, payload: bytes, fill: int) -> None:
        """Decode the six-bit characters of a payload. Raises FormatError."""
        if payload.translate(None, _ARMOUR):
            raise FormatError("characters that no payload has")
        coded = payload.translate(_TO_BASE64)
        whole = a2b_base64(coded + b"A" * (-len(coded) % 4))
        self.count = 6 * len(payload) - fill
        self._value, self._width = int.from_bytes(whole, "big"), 8 * len(whole)

    def get(self, start: int, width: int) -> int:
        """The number in these bits; bits beyond the end are 0."""
        shift = self._width - start - width
        return (self._value >> shift if shift >= 0 else self._value << -shift) & ((1 << width) - 1)

    def signed(self, start: int, width: int) -> int:
        value = self.get(start, width)
        return value - (1 << width) if value >> (width - 1) else value

    def text(self, start: int, characters: int) -> str | None:
        return readable("".join(_TEXT[self.get(start + 6 * i, 6)] for i in range(characters)))


def part(f: list[str]) -> AisPart:
    """Parse the fields of !AIVDM or !AIVDO, address first. Raises FormatError."""
    try:
        parts, number, fill = int(f[1]), int(f[2]), int(f[6])
    except ValueError:
        raise FormatError("parts or fill bits are no numbers") from None
    if not 1 <= number <= parts <= PARTS_MAX or not 0 <= fill <= 5:
        raise FormatError("parts or fill bits out of range")
    if not 0 < len(f[5]) <= CHARACTERS_MAX or (parts > 1 and not (len(f[3]) == 1 and f[3].isdigit())):
        raise FormatError("payload too long or empty, or parts without a number")
    return AisPart(parts, number, f[3], f[4], f[5].encode("ascii", "replace"), fill, f[0].endswith("O"))


class AisMessages:
    """Joins the parts of one line to messages. Parts of other messages may come between them, but each message's in their
    order."""

    def __init__(self) -> None:
        self._waiting = dict[tuple[str, str, int], tuple[float, bytes, int]]()  # since when, the payload so far, its parts

    def join(self, part: AisPart, now_s: float) -> tuple[Report, ...]:
        """The reports that this part completes; none where more parts are to come, or the message is about no vessel. Raises
        FormatError."""
        if part.parts == 1:
            return decode(part.payload, part.fill, part.is_own)
        key = part.sequence, part.channel, part.parts
        before = self._waiting.pop(key, None)
        since_s, payload, parts = (now_s, b"", 0) if part.number == 1 or before is None else before
        if parts != part.number - 1 or now_s - since_s > JOIN_S:
            raise FormatError("a part is missing")
        if part.number == part.parts:
            return decode(payload + part.payload, part.fill, part.is_own)
        if len(self._waiting) >= JOINING:
            del self._waiting[next(iter(self._waiting))]
        self._waiting[key] = since_s, payload + part.payload, part.number
        return ()


def decode(payload: bytes, fill: int = 0, is_own: bool = False) -> tuple[Report, ...]:
    """Decode a whole message to a position, facts, or both; to none where it is about no vessel. Name and size of a
    transponder's own boat are dropped. Raises FormatError."""
    bits = _Payload(payload, fill)
    kind, mmsi, is_second = bits.get(0, 6), bits.get(8, 30), bits.get(38, 2) == 1
    least = _PART_BITS.get(bits.get(38, 2)) if kind == 24 else _BITS.get(kind)
    if least is None:
        return ()
    if bits.count < least:
        raise FormatError(f"message {kind} is too short")
    if not 0 < mmsi <= MMSI_MAX:
        raise FormatError("no vessel has such a number")
    if kind in (1, 2, 3):
        return (_position(bits, mmsi, is_own, 50, is_a=True),)
    if kind == 18:
        return (_position(bits, mmsi, is_own, 46, is_a=False),)
    position = (_position(bits, mmsi, is_own, 46, is_a=False),) if kind == 19 else ()
    if is_own:
        return position
    if kind == 5:
        return (_facts(bits, mmsi, name=112, call_sign=70, ship=232, size=240),)
    if kind == 19:
        return (*position, _facts(bits, mmsi, name=143, ship=263, size=271))
    if is_second:
        return (_facts(bits, mmsi, call_sign=90, ship=40, size=None if mmsi // 10_000_000 == _CRAFT else 132),)
    return (_facts(bits, mmsi, name=40),)


def _position(bits: _Payload, mmsi: int, is_own: bool, start: int, *, is_a: bool) -> VesselPosition:
    """Decode a position report; `start` is the first bit of the speed, from which on all positions are alike."""
    speed, course, heading, second = (bits.get(start + at, width) for at, width in ((0, 10), (66, 12), (78, 9), (87, 6)))
    longitude, latitude = bits.signed(start + 11, 28), bits.signed(start + 39, 27)
    return VesselPosition(
        mmsi,
        latitude * _MINUTES if abs(latitude) <= 54_000_000 else None,
        longitude * _MINUTES if abs(longitude) <= 108_000_000 else None,
        math.radians(course * 0.1) if course < 3600 else None,
        speed * 0.1 * KNOT if speed < 1022 else None,
        math.radians(heading) if heading < 360 else None,
        _rate(bits.signed(42, 8)) if is_a else None,
        "A" if is_a else "B",
        bits.get(38, 4) if is_a else STATUS_UNKNOWN,
        second if second < 60 else None,
        is_own,
    )


def _rate(coded: int) -> float | None:
    """Decode a rate of turn, rad/s; 127 and less than -126 give the side alone."""
    return math.copysign((coded / 4.733) ** 2, coded) * math.radians(1.0 / 60.0) if abs(coded) < 127 else None


def _facts(
    bits: _Payload,
    mmsi: int,
    name: int | None = None,
    call_sign: int | None = None,
    ship: int | None = None,
    size: int | None = None,
) -> VesselFacts:
    """Decode a vessel's facts. Each argument is a first bit; None: this message does not have it. Sizes are metres from the
    antenna to bow, stern, port and starboard; 0 to bow and to port: the place of the antenna is unknown."""
    bow, stern, port, starboard = (0, 0, 0, 0) if size is None else (
        bits.get(size + at, width) for at, width in ((0, 9), (9, 9), (18, 6), (24, 6))
    )  # fmt: skip
    is_placed = bow + port > 0
    return VesselFacts(
        mmsi,
        None if name is None else bits.text(name, 20),
        None if call_sign is None else bits.text(call_sign, 7),
        None if ship is None else bits.get(ship, 8),
        float(bow + stern) or None,
        float(port + starboard) or None,
        float(starboard) if is_placed else None,
        float(bow) if is_placed else None,
    )
