"""Stations of a mission: while play stays at one, payload programs are asked for a sample, and their answer ends the stay."""

from typing import Final

from delfim.base.errors import Refused
from delfim.base.modes import Mode
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.plans.mission import STATION_S
from delfim.vehicle.report import SampleAsked
from delfim.vehicle.state import State, StateLog, Waypoint

NOBODY: Final = SampleAsked()


class Stations:
    """Call `look` ten times a second. Each try has the time that the mission gives it; after the last one the boat goes on
    without a sample. A station that was left is asked anew when the boat is back."""

    def __init__(self, state: State, log: StateLog) -> None:
        self._state, self._log = state, log
        self._asked, self._since_s = 0, 0.0  # of all programs, so far; and when last
        self._aboard: tuple[Waypoint, ...] | None = None  # whose samples the state has; None: those of before a restart

    def look(self, memory: Memory, now_s: float) -> None:
        self._of_this_plan()
        state, here = self._state, self._here(memory)
        now, setpoint = state.sample, state.setpoint
        if here is None:
            state.sample = NOBODY
            if setpoint.sampled:
                state.setpoint = setpoint._replace(sampled=0)
        elif setpoint.sampled == memory.leg + 1:  # the boat goes on with its next step
            state.sample = NOBODY
        elif now == NOBODY:
            self._ask(memory.leg, 1, here, now_s)
        elif now_s - self._since_s >= (here.hold_s - STATION_S) / here.tries:
            self._again(f"no answer for {now_s - self._since_s:.0f} s", now_s)

    def _of_this_plan(self) -> None:
        """Samples of another mission are none of this one."""
        plan = self._state.setpoint.plan
        if plan is None or plan.waypoints is self._aboard:
            return
        if self._aboard is not None and plan.waypoints != self._aboard:
            self._state.stations = ()
        self._aboard = plan.waypoints

    def answer(self, program: str, number: int, ok: bool, reason: str, now_s: float) -> None:
        """A program has the sample, or could not take it. Raises Refused where it was not asked for this one."""
        now = self._state.sample
        if now == NOBODY or number != now.number:
            raise Refused(f"sampled refused: sample {number} is not asked for")
        if not ok:
            self._again(f"payload {program}: {reason or 'it failed'}", now_s)
            return
        self._end(f"payload {program} has sample {number}{f': {reason}' if reason else ''}", True)

    def _here(self, memory: Memory) -> Waypoint | None:
        """The station at which the boat stays now."""
        state = self._state
        plan = state.setpoint.plan
        if state.mode is not Mode.PLAY or plan is None or not memory.left_s or memory.leg >= len(plan.waypoints):
            return None
        return plan.waypoints[memory.leg] if plan.waypoints[memory.leg].tries else None

    def _ask(self, leg: int, attempt: int, here: Waypoint, now_s: float) -> None:
        self._asked, self._since_s = self._asked + 1, now_s
        self._state.sample = SampleAsked(number=self._asked, leg=leg, attempt=attempt, tries=here.tries)
        self._keep(leg)
        self._note(leg, f"sample {self._asked} is asked for, try {attempt} of {here.tries}")

    def _again(self, why: str, now_s: float) -> None:
        now, plan = self._state.sample, self._state.setpoint.plan
        assert plan is not None
        if now.attempt < now.tries:
            self._note(now.leg, why)
            self._ask(now.leg, now.attempt + 1, plan.waypoints[now.leg], now_s)
        else:
            self._end(f"no sample: {why}", False)

    def _end(self, words: str, ok: bool) -> None:
        state = self._state
        self._keep(state.sample.leg, ok)
        self._note(state.sample.leg, words)
        state.setpoint, state.sample = state.setpoint._replace(sampled=state.sample.leg + 1), NOBODY

    def _keep(self, leg: int, *ok: bool) -> None:
        """Keep how a station ended; without a word it is open."""
        others = tuple(each for each in self._state.stations if each[0] != leg + 1)
        self._state.stations = (*others, *((leg + 1, each) for each in ok))

    def _note(self, leg: int, words: str) -> None:
        self._state.station = f"station: waypoint {leg + 1}: {words}"
        self._log.note(self._state.station)
