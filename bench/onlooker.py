"""The critical path as the bus sees it: from a navigation message to the propulsion command that answers it, by the kernel's
stamps of both. It needs no log, so it can be used where logs are what is tried."""

from collections.abc import Sequence
from typing import Final, Self

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor.messages import BATTERIES_PORT, BATTERIES_STARBOARD, PROPELLER_PORT, PROPELLER_STARBOARD, Node
from delfim.canproxy.dsor.protocol import message_filter
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress

COMMANDS: Final = (PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT)
BUFFER_BYTES: Final = 64 << 20  # a minute and a half at 100 Hz
MESSAGE_NS: Final = 1_000_000  # frames of navigation that are so close belong to one message
BATCH: Final = 256


class Onlooker:
    """Listens to a bus from `__enter__` to `__exit__`. Nobody runs for it meanwhile: whoever is woken by each frame is in the
    way of what is measured. The kernel stamps the frames and keeps them until somebody asks."""

    def __init__(self, interface: str) -> None:
        self._can = open_can(interface, receive_buffer_bytes=BUFFER_BYTES, batch=BATCH)
        self._can.bind(CanAddress(*message_filter(source=Node.NAVIGATION)), *(CanAddress(arb) for arb in COMMANDS))
        self._dropped = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._can.close()

    def paths_us(self, begin_ns: int, end_ns: int) -> list[float]:
        """Lengths of the critical paths that began in this time (wall clock), ascending. What is asked for later must have come
        later. Raises DelfimError where it was too much to keep."""
        asked: list[int] = []  # ns, the last frame of each navigation message
        answered: list[int] = []  # ns, the fourth frame of each command
        while frames := self._can.receive_many():
            for frame in frames:
                if frame.arb == COMMANDS[-1]:
                    answered.append(frame.t_ns)
                elif frame.arb not in COMMANDS:
                    if asked and frame.t_ns - asked[-1] < MESSAGE_NS:
                        asked[-1] = frame.t_ns
                    else:
                        asked.append(frame.t_ns)
        dropped, self._dropped = self._can.dropped - self._dropped, self._can.dropped
        if dropped:
            raise DelfimError(f"{dropped} frames were lost to the measurement: ask for shorter slices (--seconds)")
        return paths_us(asked, answered, begin_ns, end_ns)


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
