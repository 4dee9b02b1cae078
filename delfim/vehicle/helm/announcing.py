"""Actions of the mission that the boat has come to: announced to payloads, consoles and log. The boat does nothing by them."""

from typing import Final

from delfim.base.modes import Mode
from delfim.vehicle.control.modes.path import piece_of
from delfim.vehicle.plans.mission import Mission, PayloadItem
from delfim.vehicle.report import Announced
from delfim.vehicle.state import State, StateLog

KEPT: Final = 20  # the newest
WAYPOINTS: Final = "after"  # keys of an action
PIECES: Final = "after_piece"

Place = tuple[int, int, str]
NOWHERE: Final[Place] = 0, -1, ""


class Announcing:
    """Call `news` ten times a second. Actions come as the boat sets out on the leg or piece behind them, those behind the last
    one at the end of play or path. A path that connects the waypoints has their actions. A leg that goes on after a pause
    announces nothing again, one that is begun again after idle does."""

    def __init__(self, state: State, log: StateLog) -> None:
        self._state, self._log = state, log
        self._on = NOWHERE  # the plan's number, its leg or piece whose actions were announced, and which of the two
        self._count = 0

    def news(self, mission: Mission | None, leg: int) -> tuple[Announced, ...]:
        """The newest of all that were announced, oldest first. `leg`: of the mode's memory."""
        state, before = self._state, self._on
        begin, self._on = self._now(mission, leg)
        here, now = self._on[1:]
        same = (before[0], before[2]) == (self._on[0], now)
        if mission is None or self._on == before or not now:
            return state.announced
        first = max(before[1] + 1 if same and before[1] < here else 0, begin)  # short legs come several at once
        places = ((each, getattr(each, now)) for each in mission.action)
        new = [self._announced(each) for each, at in places if at is not None and min(first, here) <= at <= here]
        return (*state.announced, *new)[-KEPT:]

    def _now(self, mission: Mission | None, leg: int) -> tuple[int, Place]:
        """The leg or piece with which the boat began, and where it is."""
        state, plan = self._state, self._state.setpoint.plan
        if state.mode is Mode.IDLE or plan is None or mission is None:
            return 0, NOWHERE if state.mode is Mode.IDLE else self._on
        setpoint, number, is_joined = state.setpoint, plan.number, not mission.path
        is_here = self._on[0] == number
        if state.mode is Mode.PLAY:
            return setpoint.leg, (number, state.reference.leg, WAYPOINTS)
        if state.mode is Mode.PATH and is_joined:  # on piece 1 it has left waypoint 1
            return setpoint.piece, (number, leg + 1 if leg >= 0 else piece_of(leg), WAYPOINTS)
        if state.mode is Mode.PATH:  # on its way to piece 1 it has come to nothing yet
            return setpoint.piece, (number, leg, PIECES) if leg >= 0 else (number, -1, PIECES)
        if is_here and state.reason.startswith("play done"):
            return setpoint.leg, (number, len(plan.waypoints), WAYPOINTS)
        if is_here and state.reason.startswith("path done"):
            return setpoint.piece, (number, len(plan.waypoints), WAYPOINTS) if is_joined else (number, len(plan.path), PIECES)
        return 0, self._on

    def _announced(self, action: PayloadItem) -> Announced:
        given = (*action.params, float(action.x), float(action.y), action.z)
        params = tuple(None if isinstance(each, str) else each for each in given)
        self._count += 1
        self._log.note(
            f"action: command {action.command}: {', '.join('-' if each is None else f'{each:g}' for each in params)}"
        )
        return Announced(self._count, action.command, params)
