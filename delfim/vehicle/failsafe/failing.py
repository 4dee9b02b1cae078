"""Thrusters that fail drop out, and the rest carry on: until the boat is idle, a thruster that did not do as commanded for
`failsafe.thruster.after_s` gets no command, and the allocation does without it. While the boat can be steered the trouble
`thruster` only warns; afterwards it does what the vehicle's file says. One that turns on although it was switched off is told
as overdue after the same time, whatever is ordered meanwhile. Nothing here is on the critical path.
"""

from delfim import config
from delfim.base.modes import Mode
from delfim.vehicle.failsafe.troubles import astray
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import State, StateLog


class Failing:
    """Looks ten times a second, before the failsafe."""

    def __init__(self, settings: config.Vehicle, state: State, propulsion: Propulsion, log: StateLog) -> None:
        self._settings, self._state, self._propulsion, self._log = settings, state, propulsion, log
        self._since_s = dict[str, float]()  # of the thrusters that are astray now, by name
        self._off_s = dict[str, float]()  # and when they were first switched off since then

    def look(self, now_s: float) -> dict[str, str]:
        """Returns the thrusters that are astray now, by name, each with the reason in words."""
        state = self._state
        found = astray(self._settings, state, now_s)
        self._since_s = {name: self._since_s.get(name, now_s) for name in found}
        self._wait_for_rest(now_s)
        if state.mode is Mode.IDLE:
            if state.failed:
                state.failed, state.unsteerable = {}, self._propulsion.drop(())
            return found
        if not found:
            return found
        after_s = self._settings.failsafe.thruster.after_s
        lasting = {name: words for name, words in found.items() if now_s - self._since_s[name] >= after_s}
        if new := lasting.keys() - state.failed.keys():
            state.failed = lasting | state.failed
            state.unsteerable = self._propulsion.drop(state.failed)
            told = state.unsteerable or "the others carry on"
            self._log.note(f"{' and '.join(sorted(new))} dropped out: {told}")
        return found

    def _wait_for_rest(self, now_s: float) -> None:
        """A thruster that was switched off has its time to come to rest. An order to go does not begin that time anew: only one
        that was seen to do as commanded has obeyed."""
        state = self._state
        is_off = state.mode is Mode.IDLE and not state.actuation.run
        self._off_s = {
            name: self._off_s.get(name, max(since_s, state.off_s))
            for name, since_s in self._since_s.items()
            if is_off or name in self._off_s or state.off_s >= since_s
        }
        limits = self._settings.failsafe.thruster
        late = [name for name, off_s in self._off_s.items() if now_s - off_s >= limits.after_s]
        state.overdue = tuple(late) if limits.disconnect else ()
