"""The kill: what a switch or an operator does to it. It outlasts its cause, and only an operator ends it."""

from delfim.base.errors import Refused
from delfim.vehicle.console import Kill
from delfim.vehicle.state import Killed


def killed(before: Killed, command: Kill) -> Killed:
    """The kill after this word. The first reason stays; a switch that is released only permits that the kill is cleared."""
    others = tuple(each for each in before.held if each != command.by)
    held = (*others, command.by) if command.switch == "on" else others
    if command.switch == "off" or before.reason:
        return before._replace(held=held)
    return Killed(f"{command.by}: {command.reason}", command.by, held)


def cleared(before: Killed) -> Killed:
    """Raises Refused where there is no kill, or a switch still says it."""
    if not before.reason:
        raise Refused("clear refused: the boat is not killed")
    if before.held:
        raise Refused(f"clear refused: {' and '.join(before.held)} still says kill; release it first")
    return Killed()
