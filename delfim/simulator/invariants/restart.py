"""After a restart of its program a boat has what was aboard, and does what docs/restart.md demands for the mode that it was
in."""

from collections.abc import Iterator
from typing import Final

from delfim.base.modes import Mode
from delfim.simulator.invariants.cycle import Before, CycleSeen
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.loop import VehicleLoop

AFTER: Final = {"hold": (Mode.HOLD,), "home": (Mode.HOME, Mode.HOLD), "idle": ()}  # hold where the mode is refused


class Returns:
    """The rules of a restart; `was` is the boat when its program died."""

    def __init__(self, run: Lockstep, was: Before) -> None:
        self._was = was
        row, name = run.settings.failsafe.restarted, was.mode.name.lower()
        own = row.action if was.mode is Mode.IDLE or getattr(row, name) == "same" else getattr(row, name)
        self._after = () if was.mode is Mode.IDLE else AFTER.get(own, (was.mode, Mode.HOLD))
        assert isinstance(was.handed, VehicleLoop)
        self._before = was.handed
        self._is_first = True

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, old, helm = cycle.state, self._before.state, cycle.run.vehicle.helm
        if self._is_first:
            self._is_first = False
            if old.killed.reason and not state.killed.reason:
                yield f"killed ({old.killed.reason}), and not after the restart"
            if old.has_left_idle is not state.has_left_idle:
                yield "what was at sea is on the quay after the restart, or the other way round"
        if state.mode is cycle.was.mode or not state.reason.startswith("restarted: "):
            return
        name, was, now = self._was.mode.name.lower(), self._was.setpoint, state.setpoint
        if state.mode not in self._after or old.killed.reason:
            yield f"it was in {name}, and the restart brings {state.mode.name.lower()}"
        if f"it was in {name}" not in state.reason:
            yield f"it was in {name}, and tells otherwise"
        plans, kept = helm.plans, self._before.helm.plans
        for what, has, had in (
            ("mission", plans.mission, kept.mission),
            ("rally points", plans.rally, kept.rally),
            ("changed parameters", helm.changed, self._before.helm.changed),
            ("set points", (now.heading_rad, now.speed_mps, now.target), (was.heading_rad, was.speed_mps, was.target)),
        ):
            if has != had:
                yield f"the {what} aboard are others after the restart"
        if state.mode is self._was.mode is Mode.PLAY and helm.memory.leg != self._was.memory.leg:
            yield f"it was on leg {self._was.memory.leg + 1}, and goes on with leg {helm.memory.leg + 1}"
