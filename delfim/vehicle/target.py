"""Other vessels as the vehicle knows them at one instant. SI units, no behaviour."""

from typing import Final, NamedTuple

NEVER_S: Final = -1e9
STATUS_UNKNOWN: Final = 15


class Target(NamedTuple):
    """Another vessel, reckoned on from its last report to `Traffic.at_s`, in the local plane of `State.origin`."""

    key: str  # "244660123" of AIS, "boat 3" of the fleet, "radar 7" of a payload
    name: str  # the key where the vessel's name is not known
    north_m: float  # the middle of its hull
    east_m: float
    course_rad: float  # over ground, 0..2 pi; where that is not known the heading, where neither is 0.0
    speed_mps: float  # over ground; 0.0 where it lies, or is not known
    heading_rad: float  # 0..2 pi; nan: not known
    length_m: float
    beam_m: float
    is_size_known: bool  # otherwise they are guessed from its kind
    margin_m: float  # how far it may be from there: grows with its age
    age_s: float  # of its last position
    is_lost: bool  # silent past the limit of its kind: kept on the map
    kind: str  # "A" and "B", the classes of AIS, "fleet", "payload", "distress" (970, 972, 974)
    status: int  # navigational status of ITU-R M.1371: 0 under way, 1 at anchor, 5 moored, ...; 15: not known


class Traffic(NamedTuple):
    """All other vessels now, and who was heard when. Times are monotonic."""

    targets: tuple[Target, ...] = ()  # the nearest first
    at_s: float = NEVER_S  # the time that they are reckoned to
    heard_s: float = NEVER_S  # the last report of anybody else
    own_s: float = NEVER_S  # the last report of the boat's own transponder
    refused: tuple[tuple[str, int], ...] = ()  # reports that were not taken, by reason in words, and how many
