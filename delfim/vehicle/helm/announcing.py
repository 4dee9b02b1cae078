"""Actions of the mission that the boat has come to: announced to payloads, consoles and log. The boat does nothing by them."""

from typing import Final

from delfim.base.modes import Mode
from delfim.vehicle.plans.mission import Mission, PayloadItem
from delfim.vehicle.report import Announced
from delfim.vehicle.state import State, StateLog

KEPT: Final = 20  # the newest


class Announcing:
    """Call `news` ten times a second. Actions come as the boat sets out on the leg behind them, those behind the last waypoint
    at the end of play. A leg that goes on after a pause announces nothing again, one that is begun again after idle does."""

    def __init__(self, state: State, log: StateLog) -> None:
        self._state, self._log = state, log
        self._on: tuple[int, int] = 0, -1  # the number of the plan, and the leg whose actions were announced
        self._count = 0

    def news(self, mission: Mission | None) -> tuple[Announced, ...]:
        """The newest of all that were announced, oldest first."""
        state, plan = self._state, self._state.setpoint.plan
        number = plan.number if plan is not None else 0
        if state.mode is Mode.PLAY:
            now = number, state.reference.leg
        elif state.mode is Mode.IDLE:
            now = 0, -1
        elif plan is not None and self._on[0] == number and state.reason.startswith("play done"):
            now = number, len(plan.waypoints)
        else:
            return state.announced
        before, self._on = self._on, now
        same = now[0] == before[0]
        if mission is None or (same and now[1] == before[1]):
            return state.announced
        first = max(before[1] + 1 if same and before[1] < now[1] else 0, state.setpoint.leg)  # short legs come several at once
        new = [self._announced(each) for each in mission.action if min(first, now[1]) <= each.after <= now[1]]
        return (*state.announced, *new)[-KEPT:]

    def _announced(self, action: PayloadItem) -> Announced:
        given = (*action.params, float(action.x), float(action.y), action.z)
        params = tuple(None if isinstance(each, str) else each for each in given)
        self._count += 1
        self._log.note(
            f"action: command {action.command}: {', '.join('-' if each is None else f'{each:g}' for each in params)}"
        )
        return Announced(self._count, action.command, params)
