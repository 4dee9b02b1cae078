"""Other vessels as they report themselves, whichever way the report came, and things that programs aboard see. SI units; what
is not reported is None."""

from typing import Final, NamedTuple

MMSI_MAX: Final = 999_999_999
STATUS_UNKNOWN: Final = 15
_UNUSED: Final = "@\x00\xff"


class VesselPosition(NamedTuple):
    """Position and motion of a vessel."""

    mmsi: int  # 0: it has none
    latitude_rad: float | None
    longitude_rad: float | None
    course_rad: float | None  # over ground, 0..2 pi, true
    speed_mps: float | None  # over ground
    heading_rad: float | None  # 0..2 pi, true
    rate_radps: float | None  # positive to starboard; class A alone
    kind: str = "A"  # "A" or "B", the class of AIS; "fleet", "payload"
    status: int = STATUS_UNKNOWN  # navigational status of ITU-R M.1371, 0..15; class A alone
    second: int | None = None  # of UTC, 0..59, when the position was taken
    is_own: bool = False  # by the boat's own transponder, about itself


class VesselFacts(NamedTuple):
    """Name, kind and size of a vessel. Each message of class B carries a part of them."""

    mmsi: int
    name: str | None
    call_sign: str | None
    kind: int | None  # of ITU-R M.1371: 30 fishing, 36 sailing, 70 cargo, 80 tanker, ...
    length_m: float | None
    beam_m: float | None
    from_starboard_m: float | None  # of the antenna
    from_bow_m: float | None
    is_own: bool = False  # by the boat's own transponder, about itself


class ThingSeen(NamedTuple):
    """What a program aboard sees in the water that is no vessel under way."""

    latitude_rad: float  # of its middle
    longitude_rad: float
    radius_m: float
    kind: str = "thing"  # stands; or "person", a swimmer
    confidence: float = 1.0  # 0 to 1; 0 takes back what was told of there
    course_rad: float | None = None  # over ground, and its speed, where the program knows its motion
    speed_mps: float | None = None


THINGS: Final = ("thing", "person")
Report = VesselPosition | VesselFacts


def readable(text: str) -> str | None:
    """The printable characters of a name up to its first unused one; None if nothing is left."""
    for each in _UNUSED:
        text = text.partition(each)[0]
    return "".join(each for each in text if " " <= each <= "~").strip() or None
