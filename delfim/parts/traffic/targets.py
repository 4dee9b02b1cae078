"""The tracker: files reports of other vessels, whichever way they came, and gives each one's position now (docs/traffic.md).

Pure but for its own tables, which are bounded: no clock, no input or output, no exception for any report. A report
costs the same however many vessels are known; `at` looks at each vessel once, and `looked` does so in slices.
"""

import math
from collections import Counter
from operator import itemgetter
from typing import Final

from delfim.base.cooperative import Sliced, Work
from delfim.base.geodesy import Origin
from delfim.base.vessels import THINGS, VesselFacts, VesselPosition
from delfim.config import TrafficTable
from delfim.parts.traffic.reckoning import VesselTrack, begun
from delfim.vehicle.target import NEVER_S, Target

MOST: Final = 200  # vessels that are known at once
NUMBER: Final = 9  # digits of a number of AIS
MOST_OF: Final = {"payload": 64, "fleet": 32}  # of these, so that a program gone wrong leaves room for ships
FACTS_MOST: Final = 2 * MOST
DISTRESS: Final = ("970", "972", "974")  # search and rescue transmitter, man over board, emergency beacon
NO_VESSELS: Final = ("00", "99", "111")  # base stations, aids to navigation, aircraft
OTHERS: Final = (" b", " c", " d", " e", " f")  # end the keys of more vessels with one number
ORDER_S: Final = 15.0  # two reports within this time are put in order by the second in which they were taken
SAME_S: Final = 5.0  # the same place by another way within this time is the same report
RIVAL_S: Final = 400.0  # a refused report is compared with the next one for so long
GLITCHES_S: Final = 30.0  # two of them from different places within this time are no accident
KEPT_S: Final = 400.0  # a lost vessel stays on the map for so long ...
KEPT_NEAR_S: Final = 45.0  # ... and one of the fleet or of a payload
SOON_S: Final = 900.0  # a vessel that would be met so soon ought to be known
DRIFT_MPS: Final = 0.3  # who neither closes nor draws apart may yet
RECKONED: Final = 3  # comparisons that where one vessel is now costs


class Tracker:
    """`heard_s` is the time of the last report of anybody else, `own_s` of the boat's own transponder. `refused` counts the
    reports that were not taken, by their reason in words."""

    def __init__(self, settings: TrafficTable) -> None:
        self._settings = settings
        self.heard_s = self.own_s = NEVER_S
        self.refused = dict[str, int]()
        self.disputed = NEVER_S, ""  # when the reports of a vessel contradicted each other last, and which one
        self._tracks = dict[str, VesselTrack]()
        self._facts = dict[str, VesselFacts]()  # by key; the last heard stands last
        self._by_kind = Counter[str]()
        self.left_out_s = NEVER_S  # when a vessel that is met soon was not kept
        self._here: tuple[Origin, tuple[float, float, float, float]] | None = None  # of the last `at`
        self._found = list[tuple[float, Target]]()  # by the last `at`: who is met when
        self._leaving = list[tuple[bool, float, str]]()  # of these: who gives way, the first of them last

    def __len__(self) -> int:
        return len(self._tracks)

    def hear(self, position: VesselPosition, by: str, now_s: float, key: str = "") -> None:
        """Take a report of AIS, or with `key` one of a sister or a payload."""
        number = f"{position.mmsi:09d}"
        if not key and (position.is_own or position.mmsi == self._settings.mmsi):
            self.own_s = now_s
            self.refuse("own transponder")
            return
        self.heard_s = max(now_s, self.heard_s)
        if not key and number.startswith(NO_VESSELS):
            self.refuse("no vessel")
            return
        if not key and number.startswith(DISTRESS):
            position = position._replace(kind="distress")
        new = begun(position, by, now_s)
        if new is None:
            self.refuse("no position, or none that a vessel can have")
        else:
            self._place(key or number, new, bool(key))

    def facts(self, facts: VesselFacts, now_s: float, key: str = "") -> None:
        """Take name and size, or a part of them: what is not reported stays."""
        if not key and (facts.is_own or facts.mmsi == self._settings.mmsi):
            self.own_s = now_s
            return
        self.heard_s = now_s
        key = key or f"{facts.mmsi:09d}"
        before = self._facts.pop(key, None)
        if before is not None:
            told = {name: value for name, value in facts._asdict().items() if value is not None}
            facts = before._replace(**told)
        self._facts[key] = facts
        while len(self._facts) > FACTS_MOST:
            del self._facts[next(iter(self._facts))]
        for each in _keys(key):
            if (track := self._tracks.get(each)) is not None:
                track.measure(facts)

    def at(self, now_s: float, origin: Origin, north_m: float, east_m: float) -> tuple[Target, ...]:
        """All vessels now, at once."""
        return Sliced(self.looked(now_s, origin, north_m, east_m)).finish()

    def looked(
        self, now_s: float, origin: Origin, north_m: float, east_m: float, north_mps: float = 0.0, east_mps: float = 0.0
    ) -> Work[tuple[Target, ...]]:
        """All vessels now, those near this place of the plane first, where the boat is, with its velocity. Forgets who was
        silent for long. Reports may be heard between two slices."""
        found, meets, own = list[tuple[float, Target]](), list[tuple[float, Target]](), (north_m, east_m, north_mps, east_mps)
        for key, track in tuple(self._tracks.items()):
            yield RECKONED
            if self._tracks.get(key) is not track:
                continue  # another one has its place meanwhile
            age_s = max(now_s - track.at_s, 0.0)
            lost_s = silence_s(self._settings, track)
            if age_s > lost_s + kept_s(track):
                self._forget(key)
                continue
            target = track.target(key, age_s, age_s > lost_s, origin)
            found.append((math.hypot(target.north_m - north_m, target.east_m - east_m), target))
            meets.append((met_s(own, *target[2:6]), target))
        found.sort(key=itemgetter(0))
        self._here, self._found, self._leaving = (origin, own), meets, []
        return tuple(target for _, target in found)

    def _place(self, key: str, new: VesselTrack, is_named: bool) -> None:
        """File a report under the vessel it can be of: the one of this key, or another one with the same number. `is_named`: no
        number of AIS, which a program may give to something else."""
        tracks = [track for each in _keys(key) if (track := self._tracks.get(each)) is not None]
        near = [track for track in tracks if track.can_be_at(new)]
        for track in near:
            if track.is_stuck(new):
                self.refuse("the same place of a vessel that moves")
                return
            if _is_known(track, new):
                self.refuse("heard before")
                return
        if near:
            self._go_on(key, near, new, is_named)
            return
        if (first := self._tracks.get(key)) is None:
            self._begin(key, new)
            return
        rival, first.rival = first.rival, new
        passed_s = math.inf if rival is None else new.at_s - rival.at_s
        is_there = rival is not None and passed_s <= RIVAL_S and rival.can_be_at(new)
        if not (is_there or is_named) and passed_s <= GLITCHES_S and self._met_s(new, new.at_s) < SOON_S:
            self._part(key, new)
            self.disputed = new.at_s, first.name or key
            return
        self.refuse("jump faster than 60 kn")
        if is_there and (first.reports == 1 or is_named):
            self._begin(key, new)
        elif is_there:
            self._part(key, new)

    def _go_on(self, key: str, near: list[VesselTrack], new: VesselTrack, is_named: bool) -> None:
        """The next report of one of these, which are not far off; or, where it contradicts all of them, another vessel with
        that number. Which of them is real cannot be known, so both are there until one falls silent."""
        found = [(off > 1.0, unlike, far_m, i) for i, track in enumerate(near) for off, unlike, far_m in (track.strays(new),)]
        contradicts, _, far_m, best = min(found)
        if not contradicts or is_named:
            near[best].take(new)
            if sum(self._speaks(track, new.at_s) for track in near) < 2:
                return
        elif not self._part(key, new):
            near[best].doubt(far_m, new.at_s)
        self.disputed = new.at_s, near[best].name or key

    def _part(self, key: str, new: VesselTrack) -> bool:
        """Another vessel with this number: in a place that is free, in that of a later one that is silent, or else of the one
        that is met last, if this one is met sooner. Returns whether it has one."""
        keys, tracks = _keys(key), self._tracks
        free = next((each for each in keys if each not in tracks), None)
        free = free or next((each for each in keys[1:] if not self._speaks(tracks[each], new.at_s)), None)
        if free is None:
            met = {each: self._met_s(tracks[each], new.at_s) for each in keys}
            free = max(keys, key=lambda each: met[each])
            if self._met_s(new, new.at_s) >= met[free]:
                self.refuse("too many vessels with one number: those met last are not kept")
                return False
        self.refuse("two vessels with one number")
        return self._begin(free, new)

    def _met_s(self, track: VesselTrack, now_s: float) -> float:
        """When a vessel is met by the boat as it moved at the last look."""
        if self._here is None:
            return math.inf
        origin, own = self._here
        return met_s(own, *track.target("", max(now_s - track.at_s, 0.0), False, origin)[2:6])

    def _speaks(self, track: VesselTrack, now_s: float) -> bool:
        return now_s - track.at_s <= silence_s(self._settings, track)

    def _begin(self, key: str, new: VesselTrack) -> bool:
        """A vessel that is new, or another one in the place of this key. Returns whether there is room."""
        if key in self._tracks:
            self._forget(key)
        if self._by_kind[new.kind] >= MOST_OF.get(new.kind, math.inf) or not self._has_room(new):
            self.refuse("too many: those met last are not kept")
            return False
        self._by_kind[new.kind] += 1
        if (facts := self._facts.get(key if new.kind in MOST_OF else key[:NUMBER])) is not None:
            new.measure(facts)
        self._tracks[key] = new
        return True

    def _has_room(self, new: VesselTrack) -> bool:
        """Whether this one fits. When all places are taken the one that is met last gives way, a lost one before those that are
        heard; those that came since the last `at` stay until the next."""
        if len(self._tracks) < MOST:
            return True
        if self._found:
            self._leaving = sorted((target.is_lost, meets_s, target.key) for meets_s, target in self._found)
            self._found = []
        new_s = self._met_s(new, new.at_s)
        while self._leaving:
            is_lost, meets_s, key = self._leaving[-1]
            if key in self._tracks and not is_lost and new_s >= meets_s:
                break
            self._leaving.pop()
            if key in self._tracks:
                self._forget(key)
                self.refuse("too many: those met last are not kept")
                if not is_lost and meets_s < SOON_S:
                    self.left_out_s = new.at_s
                return True
        if new_s < SOON_S:
            self.left_out_s = new.at_s
        return False

    def _forget(self, key: str) -> None:
        self._by_kind[self._tracks.pop(key).kind] -= 1

    def refuse(self, reason: str) -> None:
        """Count a report that is not taken."""
        self.refused[reason] = self.refused.get(reason, 0) + 1


def met_s(own: tuple[float, float, float, float], north_m: float, east_m: float, course_rad: float, speed_mps: float) -> float:
    """When a vessel is met that closes as now, s; of those that draw apart the nearer ones sooner. `own`: the boat's place and
    velocity, to the north and to the east."""
    north_m, east_m = north_m - own[0], east_m - own[1]
    north_mps, east_mps = speed_mps * math.cos(course_rad) - own[2], speed_mps * math.sin(course_rad) - own[3]
    far_m = math.hypot(north_m, east_m)
    closing_mps = -(north_m * north_mps + east_m * east_mps) / max(far_m, 1.0)
    return far_m / max(closing_mps + DRIFT_MPS, 1e-3)


def silence_s(limits: TrafficTable, track: VesselTrack) -> float:
    """The silence after which a vessel is lost: some of the intervals in which its kind reports."""
    if track.kind in MOST_OF:
        return limits.lost_near_s
    if track.kind in THINGS:
        return limits.kept_thing_s
    if track.is_resting:
        return limits.lost_rest_s
    return limits.lost_b_s if track.kind == "B" else limits.lost_a_s * track.haste


def kept_s(track: VesselTrack) -> float:
    """How long a lost vessel stays on the map."""
    return KEPT_NEAR_S if track.kind in MOST_OF or track.kind in THINGS else KEPT_S


def _keys(key: str) -> tuple[str, ...]:
    """The keys of all vessels that send with one number."""
    return key, *(key + other for other in OTHERS)


def _is_known(track: VesselTrack, new: VesselTrack) -> bool:
    """Whether this report was heard before, by another way or again by the same one, or is older than the last."""
    age_s = new.at_s - track.at_s
    if age_s < 0.0:
        return True
    if new.second is None or track.second is None:
        return new.by != track.by and age_s < SAME_S and track.is_at(new)
    later_s = (new.second - track.second) % 60
    if age_s >= ORDER_S or 0 < later_s <= 30:
        return False
    return track.is_at(new) if later_s == 0 else track.strays(new, 60.0 - later_s)[0] <= 1.0
