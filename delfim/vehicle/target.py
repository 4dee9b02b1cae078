"""Other vessels as the vehicle knows them at one instant. SI units, no behaviour."""

import math
from typing import Final, Literal, NamedTuple

import msgspec

NEVER_S: Final = -1e9
STATUS_UNKNOWN: Final = 15
BESIDE_MAX: Final = 8  # vessels that moved as the boat did and are remembered


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
    kind: str  # "A" and "B", the classes of AIS, "fleet", "payload", "distress" (970, 972, 974), "thing", "person"
    status: int  # navigational status of ITU-R M.1371: 0 under way, 1 at anchor, 5 moored, ...; 15: not known


class CourseOrder(NamedTuple):
    """A course and a speed in place of the mode's own, to keep clear of another vessel."""

    course_rad: float  # over ground
    speed_part: float  # of the speed asked for, 0 to 1
    speed_mps: float  # the same
    words: str  # for people
    key: str  # of the vessel it is for; empty: it is for the fence
    nearness: float  # of all vessels the least to come, in domains; below 1: nothing is clear
    at_s: float  # monotonic time


class Danger(NamedTuple):
    """How near a vessel comes. Domains are those of `Caution`; 1 is the edge."""

    key: str
    cpa_m: float  # if both keep course and speed
    tcpa_s: float  # negative: they draw apart
    nearness: float  # least to come, in domains, as the boat sails now
    level: Literal["none", "near", "danger"]
    words: str = ""  # why; empty: there is none


VesselTold = dict[str, object]  # a vessel for people and programs, JSON-ready (docs/traffic.md)


class Traffic(NamedTuple):
    """All other vessels now, and who was heard when. Times are monotonic."""

    targets: tuple[Target, ...] = ()  # the nearest first
    at_s: float = NEVER_S  # the time that they are reckoned to
    heard_s: float = NEVER_S  # the last report of anybody else
    own_s: float = NEVER_S  # the last report of the boat's own transponder
    refused: tuple[tuple[str, int], ...] = ()  # reports that were not taken, by reason in words, and how many
    unclear: str = ""  # why these may not be all, in words
    order: CourseOrder | None = None  # in force
    dangers: tuple[Danger, ...] = ()  # of each vessel
    guard: str = "off"  # "on", "off", "cannot avoid: " and why
    nearness: float = math.nan  # the least of all dangers; nan: there is nobody
    unjudged: str = ""  # why the guard cannot heed all of them, in words
    beside: tuple[str, ...] = ()  # keys of those that moved as the boat did, also before a restart
    told: tuple[msgspec.Raw, ...] = ()  # the vessels in words, each as JSON, of this look or the one before

    @property
    def is_empty(self) -> bool:
        """Whether nobody was ever heard, and nothing is seen."""
        return self.heard_s == self.own_s == NEVER_S and not self.targets
