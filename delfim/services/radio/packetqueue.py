"""A queue of the packets for a serial line."""

from collections import deque
from typing import Final

QUEUE_MAX: Final = 10  # packets of each kind; a longer queue is only delay
IPTOS_LOWDELAY: Final = 0x10


class PacketQueue:
    """Packets that wait for the line: interactive ones overtake the others; a full queue takes no more."""

    def __init__(self) -> None:
        self.dropped = 0
        self._queues: tuple[deque[bytes], deque[bytes]] = deque(), deque()

    def __bool__(self) -> bool:
        return any(self._queues)

    def put(self, packet: bytes) -> None:
        queue = self._queues[0 if len(packet) > 1 and packet[1] & IPTOS_LOWDELAY else 1]
        if len(queue) < QUEUE_MAX:
            queue.append(packet)
        else:
            self.dropped += 1

    def first(self) -> bytes:
        """The packet whose turn it is. Raises IndexError if there is none."""
        return (self._queues[0] or self._queues[1])[0]

    def pop(self) -> bytes:
        return (self._queues[0] or self._queues[1]).popleft()

    def clear(self) -> None:
        for queue in self._queues:
            self.dropped += len(queue)
            queue.clear()
