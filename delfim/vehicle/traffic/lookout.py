"""The look-out: ten times a second some reports into the tracker, once a second all vessels into the vehicle's state."""

from typing import Final

from delfim.config import TrafficTable
from delfim.vehicle.state import State
from delfim.vehicle.target import NEVER_S, Traffic
from delfim.vehicle.traffic.targets import Tracker
from delfim.vessels import VesselPosition

AT_ONCE: Final = 24  # reports that one step takes; a busy harbour brings one
LOOK_S: Final = 1.0


class TrafficLookout:
    def __init__(self, settings: TrafficTable) -> None:
        self.tracker = Tracker(settings)
        self._looked_s = NEVER_S

    def step(self, state: State, now_s: float) -> None:
        """Call it with the watchdog. Never raises."""
        tracker, waiting = self.tracker, state.heard
        for _ in range(min(len(waiting), AT_ONCE)):
            report = waiting.popleft()
            if isinstance(report.told, VesselPosition):
                tracker.hear(report.told, report.by, report.at_s, report.key)
            else:
                tracker.facts(report.told, report.at_s, report.key)
        if now_s - self._looked_s < LOOK_S or tracker.heard_s == tracker.own_s == NEVER_S:
            return
        self._looked_s, own = now_s, state.motion
        here = (own.north_m, own.east_m) if "position" in own.has else (0.0, 0.0)
        targets = () if state.origin is None else tracker.at(now_s, state.origin, *here)
        heard = Traffic(targets, now_s, tracker.heard_s, tracker.own_s, tuple(tracker.refused.items()))
        state.traffic = Traffic(*heard[:5], *state.traffic[5:])  # the guard's part stays
