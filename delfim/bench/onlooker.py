"""The critical path as the bus sees it: from a navigation message to the propulsion command that answers it, by the kernel's
stamps of both. It needs no log, so it can be used where logs are what is tried."""

import contextlib
import threading
from collections.abc import Sequence
from typing import Final, Self

from delfim.canproxy import dsor
from delfim.canproxy.socket import CanAddress, open_can
from delfim.messages import BATTERIES_PORT, BATTERIES_STARBOARD, PROPELLER_PORT, PROPELLER_STARBOARD, Node

COMMANDS: Final = (PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT)
BUFFER_BYTES: Final = 16 << 20  # the machine may keep the onlooker from looking for seconds
MESSAGE_NS: Final = 1_000_000  # frames of navigation that are so close belong to one message
WAIT_S: Final = 0.2


class Onlooker:
    """Listens to a bus, in a thread, from `__enter__` to `__exit__`."""

    def __init__(self, interface: str) -> None:
        self._can = open_can(interface, receive_buffer_bytes=BUFFER_BYTES)
        self._can.bind(CanAddress(*dsor.message_filter(source=Node.NAVIGATION)), *(CanAddress(arb) for arb in COMMANDS))
        self._can.settimeout(WAIT_S)
        self._asked: list[int] = []  # ns, the last frame of each navigation message
        self._answered: list[int] = []  # ns, the fourth frame of each command
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._can.close()

    def _listen(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(TimeoutError):
                frame = self._can.recvmsg()
                if frame.arb not in COMMANDS:
                    if self._asked and frame.t_ns - self._asked[-1] < MESSAGE_NS:
                        self._asked[-1] = frame.t_ns
                    else:
                        self._asked.append(frame.t_ns)
                elif frame.arb == COMMANDS[-1]:
                    self._answered.append(frame.t_ns)

    def paths_us(self, begin_ns: int, end_ns: int) -> list[float]:
        """Lengths of the critical paths that began in this time (wall clock), ascending."""
        return paths_us(self._asked, self._answered, begin_ns, end_ns)


def paths_us(asked: Sequence[int], answered: Sequence[int], begin_ns: int, end_ns: int) -> list[float]:
    """The way from each message to its command, us, ascending, for messages of this time. Of several messages before one
    command the oldest is answered, which is the longest way; the others only by further commands that come before the next
    message, and otherwise never."""
    events = sorted([(t_ns, False) for t_ns in asked] + [(t_ns, True) for t_ns in answered])
    paths, waiting, was_command = [], list[int](), False
    for t_ns, is_command in events:
        if not is_command:
            if was_command:
                waiting.clear()
            waiting.append(t_ns)
        elif waiting:
            began_ns = waiting.pop(0)
            if begin_ns <= began_ns < end_ns:
                paths.append((t_ns - began_ns) / 1e3)
        was_command = is_command
    return sorted(paths)
