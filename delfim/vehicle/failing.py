"""Thrusters that fail drop out, and the rest carry on: until the boat is idle, a thruster that did not do as commanded for
`failsafe.thruster.after_s` gets no command, and the allocation does without it. While the boat can be steered the trouble
`thruster` only warns; afterwards it does what the vehicle's file says. Nothing here is on the critical path.
"""

from delfim import config
from delfim.modes import Mode
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.state import State, StateLog
from delfim.vehicle.troubles import astray


class Failing:
    """Looks ten times a second, before the failsafe."""

    def __init__(self, settings: config.Vehicle, state: State, propulsion: Propulsion, log: StateLog) -> None:
        self._settings, self._state, self._propulsion, self._log = settings, state, propulsion, log
        self._since_s = dict[str, float]()  # of the thrusters that are astray now, by name

    def look(self, now_s: float) -> dict[str, str]:
        """Returns the thrusters that are astray now, by name, each with the reason in words."""
        state = self._state
        found = astray(self._settings, state, now_s)
        self._since_s = {name: self._since_s.get(name, now_s) for name in found}
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
