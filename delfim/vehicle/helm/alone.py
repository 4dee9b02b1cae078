"""One thruster by itself, while the boat is idle: tried on the bench through the boat's own program (docs/bench.md).

It turns as long as the operator keeps asking for it, and no longer than he said at the beginning. The loop commands it as it
commands thrust by hand, behind the last gate. Any stop and any mode end it.
"""

from collections.abc import Sequence
from typing import Final

from delfim.base.errors import Refused, did_you_mean
from delfim.base.modes import Mode
from delfim.config import ThrusterTable
from delfim.vehicle import console
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import State, StateLog

KEPT_S: Final = 0.8  # that a word counts: the operator's program repeats it five times a second while he holds the key


class Alone:
    def __init__(self, rows: Sequence[ThrusterTable], state: State, propulsion: Propulsion, log: StateLog) -> None:
        self._rows = {row.name: index for index, row in enumerate(rows)}
        self._state, self._propulsion, self._log = state, propulsion, log
        self._name, self._asked_s, self._ends_s = "", -1e9, 0.0

    def ask(self, command: console.Actuate, now_s: float) -> None:
        """Begin, go on, or end with a thrust of 0. Raises Refused."""
        state, name = self._state, command.thruster
        if not command.part:
            if not self._name:  # an operator who ends nothing does not take the boat
                raise Refused("actuate refused: no thruster is tried")
            self._end("operator ended it", now_s)
            return
        is_held, self._asked_s = now_s - self._asked_s < KEPT_S, now_s
        if state.mode is not Mode.IDLE:
            raise Refused(f"actuate refused: the boat is in mode {state.mode.name.lower()}; stop it first")
        if state.killed.reason:
            raise Refused(f"actuate refused: kill: {state.killed.reason}")
        if name not in self._rows:
            raise Refused(f"actuate refused: there is no thruster {name!r}{did_you_mean(name, self._rows)}")
        if is_held and name != self._name:
            raise Refused(f"actuate refused: {state.reason}; let go for {KEPT_S:g} s")
        if not self._name:
            self._name, self._ends_s = name, now_s + command.for_s
            self._propulsion.alone(self._rows[name])
            self._tell(f"operator tries {name} alone at {command.part:.0%}")
        state.setpoint = state.setpoint._replace(alone=command.part)

    def fade(self, now_s: float) -> None:
        """Call ten times a second: it ends in silence, and in time."""
        if self._name and now_s - self._asked_s > KEPT_S:
            self._end("nobody asks for it any more", now_s)
        elif self._name and now_s >= self._ends_s:
            self._end("its time is over", now_s)

    def release(self) -> None:
        """Thrusters are commanded as usual again; the caller commands them."""
        if self._name:
            self._name = ""
            self._propulsion.alone(None)
            self._state.setpoint = self._state.setpoint._replace(alone=0.0)

    def _end(self, why: str, now_s: float) -> None:
        if name := self._name:
            self.release()
            self._tell(f"{name} tried: {why}")
            self._state.actuation, self._state.off_s = self._propulsion.send(STOP, now_s), now_s

    def _tell(self, words: str) -> None:
        self._state.reason = words
        self._log.note(words)
