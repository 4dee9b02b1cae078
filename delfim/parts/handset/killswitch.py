"""A kill switch at a pin of the computer. It is wired normally closed, so that a broken wire kills, too."""

from collections.abc import Iterator
from typing import Final

from delfim import config
from delfim.lines.forms import InputPin
from delfim.vehicle import console
from delfim.vehicle.links import Readable
from delfim.vehicle.state import State

NAME: Final = "kill switch"


def change(name: str, reason: str, state: State) -> Iterator[console.Kill]:
    """The order of a switch that demands a kill for this reason, or does not (empty), if that is new."""
    if bool(reason) != (name in state.killed.held):
        yield console.Kill(name, reason, "on") if reason else console.Kill(name, switch="off")


class KillSwitch:
    """A kill switch as a `Hand`. The level counts at each look, not only its changes: one may have come before anybody
    listened."""

    name = NAME

    def __init__(self, settings: config.KillTable, line: InputPin) -> None:
        self.input: Readable = line
        self._line, self._kills_at_high = line, settings.kills_at == "high"
        self._reason, self._was_touched = "", False

    def read(self, state: State, now_s: float) -> None:
        level = self._line.read()
        if level is None:
            self._reason = f"it cannot be read: {self._line.trouble}"
            return
        self._was_touched = self._was_touched or self._kills_at_high in level.was
        self._reason = "pressed, or its wire is open" if level.is_high is self._kills_at_high else ""

    def orders(self, state: State, now_s: float) -> Iterator[console.Commands]:
        """A short touch kills; the next look releases."""
        if self._was_touched and not self._reason:
            yield console.Kill(NAME, "pressed, or its wire is open", "on")
        self._was_touched = False
        yield from change(NAME, self._reason, state)
