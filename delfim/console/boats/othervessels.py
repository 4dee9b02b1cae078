"""Other vessels on the console: what its boats tell of them, merged by number, and how near they come to each of its boats.

A boat is judged as it judges itself (`delfim/parts/traffic/alarm.py`), but by its course and speed of now: the console knows
neither its way nor its file. Lost, kept and guessed are those of docs/traffic.md.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

from delfim.base.cooperative import Sliced
from delfim.base.geodesy import Origin, from_plane, origin
from delfim.base.vessels import THINGS, VesselFacts, VesselPosition
from delfim.config import TrafficNear, TrafficTable
from delfim.console.link.mavlink import GUARD, NUMBERS, facts_of, kind_of, number_of, position_of
from delfim.console.link.statustext import Words
from delfim.parts.traffic.alarm import Alarms, Guarded, dangers
from delfim.parts.traffic.beside import Company, company, danger_beside
from delfim.parts.traffic.encounter import BEGINNINGS, Own
from delfim.parts.traffic.keepclear import measured
from delfim.parts.traffic.reckoning import VesselTrack, begun
from delfim.parts.traffic.targets import DISTRESS, kept_s, silence_s
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.parts.traffic.vesselwords import danger_told, vessel_told
from delfim.vehicle.target import Danger, Target

MOST: Final = 200  # vessels of one boat, and on the page
NEWS_S: Final = 12.0  # the boat tells of its order and its guard each second, by radio each five
TURN_S: Final = 1.0  # a boat tells of one after the other: by radio one a second
AT_ONCE: Final = 8  # boats that are judged in a second, 30 ms of work among 200 vessels; of more, each in its turn
MEETS: Final = 4  # boats that a vessel is told with, the first that it meets
PLACE_S: Final = 10.0  # an older place of a boat is no place to reckon from
AHEAD_S: Final = 3600.0  # the way ahead of a boat that keeps course and speed
SELF_M, SELF_MPS = 40.0, 1.0  # a vessel so near, and so alike, may be the boat's own transponder, as others hear it
LIMITS: Final = TrafficTable()
NEAR: Final = TrafficNear()
BOAT: Final = Caution(length_m=4.0, turn_radps=0.2, ramp_mps2=0.3)  # what the boat has not told matters little beside a domain


class Known(NamedTuple):
    """A vessel, and how much of its silence is that of the link."""

    track: VesselTrack
    untold_s: float

    def silent_s(self, now_s: float) -> float:
        return self.age_s(now_s) - self.untold_s

    def age_s(self, now_s: float) -> float:
        return max(now_s - self.track.at_s, 0.0)

    @property
    def limit_s(self) -> float:
        return silence_s(LIMITS, self.track)

    def target(self, number: int, at: Origin, now_s: float) -> Target:
        return self.track.target(str(number), self.age_s(now_s), self.silent_s(now_s) > self.limit_s, at)


class VesselsTold:
    """What one boat tells: of other vessels, and of its own guard. Bounded; whatever a message has in it does no harm."""

    def __init__(self) -> None:
        self.tracks: dict[int, VesselTrack] = {}  # by number; the last told of stands last
        self._told_s: dict[int, float] = {}  # when that was
        self.heard_s = -math.inf  # the newest report of any of them
        self.alarms: Alarms = {}
        self.company = Company()  # who moves as the boat does
        self.met: dict[str, Danger] = {}  # how near each vessel comes, by key
        self.judged_s = -math.inf  # when that was reckoned
        self._order_deg, self._words, self._order_s = math.nan, "", -math.inf
        self._guard, self._guard_s = "", -math.inf
        self._said = Words()

    def hear(self, message: Any, now_s: float) -> None:
        """AIS_VESSEL."""
        number, told, facts = message.MMSI, position_of(message), facts_of(message)
        name = facts.name if facts is not None and facts.name else ""
        if number < NUMBERS:  # of a boat of the fleet, of what a payload sees, or of a second vessel with one number
            told = told._replace(kind="fleet" if name.startswith("boat ") else "payload")
        elif kind := kind_of(number):
            told = told._replace(kind=kind)
        elif f"{number:09d}".startswith(DISTRESS):
            told = told._replace(kind="distress")
        self._keep(number, begun(told, "", now_s - message.tslc), facts, now_s)

    def recall(self, vessels: Iterable[Mapping[str, Any]], at_s: float) -> None:
        """Those of the boat's own log at that time (`delfim.logging.reading.LoggedVessel`), in place of all that were known."""
        self.tracks.clear()
        self._told_s.clear()
        for each in vessels:
            number, reported_s = number_of(each["key"]), at_s - each["age_s"]
            facts = VesselFacts(number, each["name"], None, None, *_size(each), None, None)
            self._keep(number, begun(_reported(number, each), "", reported_s), facts, at_s)

    def _keep(self, number: int, track: VesselTrack | None, facts: VesselFacts | None, now_s: float) -> None:
        """The newest last; the one that was told of longest ago gives way."""
        if track is None:
            return
        if facts is not None:
            track.measure(facts)
        self.heard_s = max(self.heard_s, track.at_s)
        self.tracks.pop(number, None)
        self.tracks[number], self._told_s[number] = track, now_s
        if len(self.tracks) > MOST:
            self._drop(next(iter(self.tracks)))

    def _drop(self, number: int) -> None:
        del self.tracks[number], self._told_s[number]

    def untold_s(self, number: int, now_s: float) -> float:
        """For how long the boat has said nothing of a vessel, as far as it had to speak of the others meanwhile: so long the
        vessel's silence is the link's."""
        return min(now_s - self._told_s[number], len(self.tracks) * TURN_S)

    def say(self, message: Any) -> None:
        """STATUSTEXT: the sentence of an order is kept."""
        self.says(self._said.hear(message) or "")

    def says(self, text: str) -> None:
        """The same of a whole text. As a trouble it has its action behind it: ": warn"."""
        if text.startswith(BEGINNINGS):
            self._words = text.partition(": ")[0]

    def ordered(self, course_deg: float, now_s: float) -> None:
        """The course of the order; not finite: there is none."""
        self._order_deg, self._order_s = course_deg, now_s
        self._words = self._words if math.isfinite(course_deg) else ""

    def guarded(self, place: int, now_s: float) -> None:
        """Whether the boat keeps clear: a place in `GUARD`."""
        self._guard, self._guard_s = GUARD[place] if 0 <= place < len(GUARD) else "", now_s

    def order(self, now_s: float) -> dict[str, Any] | None:
        """The order in force, as the page shows it."""
        if now_s - self._order_s > NEWS_S or not math.isfinite(self._order_deg):
            return None
        return {"course_deg": round(self._order_deg % 360.0, 1), "words": self._words or "keeping clear of another vessel"}

    def guard(self, now_s: float) -> str | None:
        """None: the boat does not say."""
        return self._guard if self._guard and now_s - self._guard_s <= NEWS_S else None

    def forget(self, now_s: float) -> None:
        """Drops those that were silent for too long."""
        known = [(number, Known(track, self.untold_s(number, now_s))) for number, track in self.tracks.items()]
        for number, each in known:
            is_untold = each.track.kind in THINGS and now_s - self._told_s[number] > len(known) * TURN_S + NEWS_S
            if is_untold or each.silent_s(now_s) > each.limit_s + kept_s(each.track):
                self._drop(number)


def _reported(number: int, told: Mapping[str, Any]) -> VesselPosition:
    """Where a vessel of the log was at its last report: the log has it reckoned on."""
    course_deg, heading_deg, speed_mps = told["course_deg"], told["heading_deg"], told["speed_mps"]
    course_rad = None if course_deg is None else math.radians(course_deg)
    place = math.radians(told["latitude_deg"]), math.radians(told["longitude_deg"])
    if course_rad is not None:
        back_m = -speed_mps * told["age_s"]
        place = from_plane(origin(*place), back_m * math.cos(course_rad), back_m * math.sin(course_rad))
    heading_rad = None if heading_deg is None else math.radians(heading_deg)
    return VesselPosition(number, *place, course_rad, speed_mps, heading_rad, None, told["kind"], told["status"])


def _size(told: Mapping[str, Any]) -> tuple[float | None, float | None]:
    return (told["length_m"], told["beam_m"]) if told["size_known"] else (None, None)


class TellingBoat(Protocol):
    """A boat, as it is needed here."""

    number: int
    heard_s: float
    values: dict[str, Any]
    others: VesselsTold

    def age_s(self, kind: str, now_s: float) -> float | None: ...


def around(boats: Sequence[TellingBoat], now_s: float) -> dict[str, Any]:
    """All vessels for the pages, once a second: JSON-ready, those that any boat meets first, at most MOST."""
    for boat in boats:
        boat.others.forget(now_s)
    tracks = _merged(boats, now_s)
    for boat in sorted(boats, key=lambda boat: boat.others.judged_s)[:AT_ONCE]:
        boat.others.met = {each.key: each for each in _judged(boat, tracks, now_s)}
        boat.others.judged_s = now_s
    met = {boat.number: boat.others.met for boat in boats}
    vessels = [
        _shown(number, track, {boat: known[str(number)] for boat, known in met.items() if str(number) in known}, now_s)
        for number, track in tracks.items()
    ]
    vessels.sort(key=_first_met)
    heard = {boat.number: _since(boat.others.heard_s, now_s) for boat in boats}
    return {"vessels": vessels[:MOST], "heard_s": min((each for each in heard.values() if each is not None), default=None)}


def _merged(boats: Sequence[TellingBoat], now_s: float) -> dict[int, Known]:
    """Of each vessel the newest report; another boat may know its name or size. The console's own boats are left out."""
    found: dict[int, Known] = {}
    own = {f"boat {boat.number}" for boat in boats}
    for boat in boats:
        for number, track in boat.others.tracks.items():
            if track.kind == "fleet" and track.name in own:
                continue
            told, was = Known(track, boat.others.untold_s(number, now_s)), found.get(number)
            if was is None:
                found[number] = told
                continue
            new, old = (told, was) if track.at_s > was.track.at_s else (was, told)
            new.track.size = new.track.size or old.track.size
            new.track.name = old.track.name if new.track.name in ("", str(number)) else new.track.name
            found[number] = new
    return found


def _judged(boat: TellingBoat, tracks: Mapping[int, Known], now_s: float) -> Iterable[Danger]:
    """How near each vessel comes to a boat that keeps course and speed; nothing where its place is not known."""
    own = _own(boat, now_s)
    if own is None:
        boat.others.alarms = {}
        return ()
    at, speed_mps = own
    here = Own(0.0, 0.0, math.radians(boat.values.get("course_deg") or 0.0), speed_mps)
    way_m = speed_mps * AHEAD_S
    ahead = (way_m * math.cos(here.course_rad), way_m * math.sin(here.course_rad))
    targets = [each.target(number, at, now_s) for number, each in tracks.items()]
    targets = [each for each in targets if int(each.key) in boat.others.tracks or not _is_alike(each, here)]
    targets.sort(key=lambda each: math.hypot(each.north_m, each.east_m))
    beside = boat.others.company = company(boat.others.company, here, BOAT.length_m, targets, now_s)
    guard, order = boat.others.guard(now_s), boat.others.order(now_s)
    guarded: Guarded = "no" if guard != "on" else "away" if order else "on its way"
    way = RouteAhead((ahead,), speed_mps)
    apart = [each for each in targets if not beside.has(each.key)]
    judging = dangers(NEAR, BOAT, here, way, apart, (), guarded, boat.others.alarms, now_s)
    found, boat.others.alarms = Sliced(judging).finish()
    return (*found, *(danger_beside(each) for each in targets if beside.has(each.key)))


def _own(boat: TellingBoat, now_s: float) -> tuple[Origin, float] | None:
    """The plane around a boat, and its speed."""
    age_s, values = boat.age_s("GLOBAL_POSITION_INT", now_s), boat.values
    latitude_deg, longitude_deg = values.get("latitude_deg"), values.get("longitude_deg")
    if age_s is None or age_s > PLACE_S or latitude_deg is None or longitude_deg is None or abs(latitude_deg) > 89.0:
        return None
    return origin(math.radians(latitude_deg), math.radians(longitude_deg)), values.get("speed_mps") or 0.0


def _is_alike(target: Target, here: Own) -> bool:
    north_mps = target.speed_mps * math.cos(target.course_rad) - here.speed_mps * math.cos(here.course_rad)
    east_mps = target.speed_mps * math.sin(target.course_rad) - here.speed_mps * math.sin(here.course_rad)
    is_near = math.hypot(target.north_m, target.east_m) < SELF_M + target.margin_m
    return is_near and math.hypot(north_mps, east_mps) < SELF_MPS


def _shown(number: int, told: Known, known: Mapping[int, Danger], now_s: float) -> dict[str, Any]:
    """A vessel, its domain, and its danger to each boat, the first to meet first."""
    plane = origin(told.track.latitude_rad, told.track.longitude_rad)
    target = told.target(number, plane, now_s)
    around = measured(BOAT, Own(0.0, 0.0, 0.0, 0.0), 0.0, target).around
    half_m = [round(1.0 / math.hypot(*axis), 1) for axis in (around[4:6], around[6:8])]
    boats = [{"boat": boat, **danger_told(each), "words": each.words} for boat, each in known.items()]
    boats.sort(key=_order_of)
    return {**vessel_told(target, plane), "domain_m": half_m, "boats": boats[:MEETS]}


def _first_met(vessel: Mapping[str, Any]) -> tuple[Any, ...]:
    return (*_order_of(vessel["boats"][0]), vessel["key"]) if vessel["boats"] else (9, math.inf, vessel["key"])


def _order_of(each: Mapping[str, Any]) -> tuple[int, float]:
    """Dangerous ones, those that draw near by their time, those that draw apart."""
    tcpa_s = each["tcpa_s"] if each["tcpa_s"] is not None else math.inf
    return {"danger": 0, "near": 1}.get(each["danger"], 2 if tcpa_s >= 0.0 else 3), abs(tcpa_s)


def _since(at_s: float, now_s: float) -> float | None:
    return round(now_s - at_s, 1) if math.isfinite(at_s) else None
