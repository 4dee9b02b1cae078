"""The look-out: files some reports into the tracker ten times a second, and once a second all vessels into the vehicle's state,
a slice of them at a time."""

import math
from itertools import islice
from typing import Final

from delfim.base.cooperative import Sliced, Work
from delfim.base.geodesy import Origin, from_plane
from delfim.base.vessels import ThingSeen, VesselFacts, VesselPosition
from delfim.config import TrafficTable
from delfim.parts.traffic.targets import MOST, Tracker
from delfim.parts.traffic.things import Things
from delfim.vehicle.state import Sighting, State
from delfim.vehicle.target import NEVER_S, Target

AT_ONCE: Final = 24  # reports that one step takes; a busy harbour brings one
OF_THING: Final = 2  # so many a sighting of a thing counts: it is compared with all that are known, ...
NEAR: Final = 12  # ... and one more for each so many things that it must be measured against
LOOK_S: Final = 1.0
TOLD_S: Final = 10.0  # what was missed is told for so long
SLICE: Final = 200  # comparisons of one step


class TrafficLookout:
    def __init__(self, settings: TrafficTable) -> None:
        self.tracker, self.things = Tracker(settings), Things(settings)
        self._had_things = False  # the last look found some
        self._looked_s = self._flooded_s = NEVER_S
        self._dropped = 0
        self._look: Sliced[tuple[Target, ...]] | None = None

    def hear(self, state: State) -> None:
        """File waiting reports; call it with the watchdog. Never raises."""
        waiting = state.heard
        if waiting:
            left = AT_ONCE
            for name in tuple(islice(waiting, AT_ONCE)):
                left -= self._take(waiting.pop(name))
                if left <= 0:
                    return

    def look(self, state: State, now_s: float) -> None:
        """Do a slice of work; call it after `hear` where nothing else has one to do. Never raises."""
        tracker = self.tracker
        if self._look is None:
            has_nobody = tracker.heard_s == tracker.own_s == NEVER_S and not (self.things or self._had_things)
            if now_s - self._looked_s < LOOK_S or has_nobody:
                return
            self._looked_s, own = now_s, state.motion
            here = (own.north_m, own.east_m) if "position" in own.has else (0.0, 0.0)
            origin = state.origin
            self._look = Sliced(
                _nobody() if origin is None else self._looked(now_s, origin, *here, own.north_mps, own.east_mps)
            )
        if self._look.step(SLICE):
            targets, self._look = self._look.result, None
            state.traffic = state.traffic._replace(
                targets=targets,
                at_s=self._looked_s,
                heard_s=tracker.heard_s,
                own_s=tracker.own_s,
                refused=self._refused(),
                unclear=self._unclear(state),
            )

    def _looked(self, now_s: float, origin: Origin, north_m: float, east_m: float, *mps: float) -> Work[tuple[Target, ...]]:
        """All vessels and things now, the nearest first."""
        found = yield from self.tracker.looked(now_s, origin, north_m, east_m, *mps)
        self._had_things = bool(self.things)
        if not self.things:
            return found
        things = yield from self.things.looked(now_s, origin, *from_plane(origin, north_m, east_m))
        return tuple(sorted((*found, *things), key=lambda each: math.hypot(each.north_m - north_m, each.east_m - east_m)))

    def _refused(self) -> tuple[tuple[str, int], ...]:
        """Reports and sightings that were not taken, by reason, and how many."""
        refused = tuple(self.tracker.refused.items())
        return (*refused, ("things without a place, or without room", self.things.refused)) if self.things.refused else refused

    def _unclear(self, state: State) -> str:
        """The reason, in words, why the vessels that are known may not be all; empty: there is none."""
        now_s, dropped, (disputed_s, name) = self._looked_s, state.counts.get("traffic_dropped", 0), self.tracker.disputed
        if dropped > self._dropped:
            self._dropped, self._flooded_s = dropped, now_s
        if now_s - self._flooded_s < TOLD_S:
            return f"more reports of other vessels than the boat can take: {dropped} dropped"
        if now_s - self.tracker.left_out_s < TOLD_S:
            return f"more vessels than the boat can know: of those that come near it knows {MOST}"
        return f"reports of {name} contradict each other: there may be more than one" if now_s - disputed_s < TOLD_S else ""

    def _take(self, sighting: Sighting) -> int:
        """Take it into what is known, and return how many it counts of AT_ONCE."""
        told, by, at_s, key = sighting
        if isinstance(told, ThingSeen):
            return OF_THING + self.things.hear(told, key, at_s) // NEAR
        if isinstance(told, VesselPosition):
            self.tracker.hear(told, by, at_s, key)
        elif isinstance(told, VesselFacts):
            self.tracker.facts(told, at_s, key)
        else:
            self.tracker.refuse(told)
        return 1


def _nobody() -> Work[tuple[Target, ...]]:
    """No vessels: without a plane none has a position."""
    yield 0
    return ()
