"""How the boat's parts reach what is outside: CAN buses and serial lines, which are handed to them. At sea they are real,
elsewhere those who run the vehicle give their own.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from delfim.canproxy.socket import CanAddress, CanSocket


class Readable(Protocol):
    """What is waited for: a CAN socket or a serial line."""

    def fileno(self) -> int: ...
    def rebind(self) -> bool: ...  # take up an input that failed; True when it can be used


class ReadableLine(Readable, Protocol):
    """A serial line, as delfim.serialline has it. Nothing here waits or raises."""

    t_ns: int  # since 1970, when that was read which `read` gave last

    def read(self) -> bytes: ...  # what has come; empty: nothing
    def write(self, data: bytes) -> bool: ...  # False where it was not taken whole


class Links(NamedTuple):
    """Whoever opens a link keeps it open, takes it up again after a failure, and closes it. Both raise DelfimError."""

    bus: Callable[[str, tuple[CanAddress, ...]], CanSocket]
    """A socket on an interface that never blocks and receives what the filters accept: none, nothing."""

    line: Callable[[str, int], ReadableLine]
    """The serial line of a device, at this speed in baud."""
