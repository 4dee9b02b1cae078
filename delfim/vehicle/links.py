"""Links to the outside: CAN buses and serial lines, handed to the boat's parts. At sea they are real; lock step, replay
and tests hand in their own.
"""

from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Final, NamedTuple, Protocol

from delfim.base.errors import BusError
from delfim.base.frames import Frame
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Bias, Form, InputPin
from delfim.vehicle.state import State

KEPT: Final = 64  # pieces of a shared line that nobody has read; beyond, the oldest are lost
FRAMES_PER_READ: Final = 64  # bounds one call on a flooded input; the rest stays readable


class Readable(Protocol):
    """An input to wait for: a CAN socket or a serial line."""

    def fileno(self) -> int: ...
    def rebind(self) -> bool: ...  # take up an input that failed; True when it can be used


class LoopInput(Protocol):
    """An input of the loop beside navigation: a sensor, or the reports of an actuator. `read` never raises and never waits."""

    input: Readable  # to be read when it is readable

    def read(self, state: State, now_s: float) -> None: ...  # all waiting input, into the state


class ReadableLine(Readable, Protocol):
    """A line, as delfim.lines.serialline and delfim.lines.networkline have it. Nothing here waits or raises."""

    t_ns: int  # since 1970: when the data of the last `read` came

    def read(self) -> bytes: ...  # received data; empty: none
    def write(self, data: bytes) -> bool: ...  # False when not all was taken


class OpenLine(Protocol):
    def __call__(self, device: str, baud: int, form: Form = "8N1", /) -> ReadableLine: ...


OpenGpio = Callable[[str, str, Bias], InputPin]  # chip, name of the line, its resistor


class Links(NamedTuple):
    """Opens links. The caller keeps a link open, reopens it after a failure, and closes it. Each raises DelfimError."""

    bus: Callable[[str, tuple[CanAddress, ...]], CanSocket]
    """A socket on an interface: never blocks, receives what the filters accept; without filters, nothing."""

    line: OpenLine
    """The line of a device: a serial port, at this speed in baud, in this form, or one over the network."""

    gpio: OpenGpio | None = None
    """A pin of the computer; None: there are none, as in lock step, and in a replay, whose log has the orders of a switch."""


def received(socket: CanSocket, state: State, name: str) -> list[Frame]:
    """Receive the frames that wait, FRAMES_PER_READ at most. A bus that fails is counted, as NAME_bus_errors."""
    frames: list[Frame] = []
    try:
        frames.extend(islice(iter(socket.receive, None), FRAMES_PER_READ))  # those before a failure stay
    except BusError:
        state.count(f"{name}_bus_errors")
    return frames


class SecondEnd:
    """A line for its second user, who is handed what the first has read, and must not wait for it."""

    def __init__(self, line: ReadableLine) -> None:
        self._line, self._pieces, self.t_ns = line, deque[bytes](maxlen=KEPT), 0

    def fileno(self) -> int:
        return -1

    def rebind(self) -> bool:
        return True  # by the first

    def hand(self, data: bytes) -> None:
        self._pieces.append(data)
        self.t_ns = self._line.t_ns

    def read(self) -> bytes:
        return self._pieces.popleft() if self._pieces else b""

    def write(self, data: bytes) -> bool:
        return self._line.write(data)
