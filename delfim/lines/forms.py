"""What is said of lines and pins without them: only Linux opens those."""

from typing import Literal, NamedTuple, Protocol

Form = Literal["8N1", "8E2"]  # data bits, parity, stop bits of a serial line
Bias = Literal["pull-up", "pull-down", "none"]  # the resistor of a pin


class Level(NamedTuple):
    """A pin since the last look, true is high."""

    is_high: bool
    was: frozenset[bool]  # every level that it had, the present one included: a short touch counts


class InputPin(Protocol):
    """A pin that is read. Nothing here waits or raises."""

    trouble: str  # why it cannot be read, in words

    def fileno(self) -> int: ...
    def rebind(self) -> bool: ...
    def read(self) -> Level | None: ...  # None: it cannot be read
