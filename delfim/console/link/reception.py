"""How well a boat is heard: bytes a second and the part of messages that were lost, by the gaps in their numbers."""

from collections import deque
from typing import Any, Final

SPAN_S: Final = 20.0


class Reception:
    """Of one boat, over the last SPAN_S."""

    def __init__(self, now_s: float) -> None:
        self._since_s, self._bytes, self._missing = now_s, 0, 0
        self._seen: dict[int, int] = {}  # by component: the last sequence number
        self._arrivals: deque[tuple[float, int, int]] = deque()  # time, bytes, messages missing before it

    def count(self, message: Any, now_s: float) -> None:
        component, sequence = message.get_srcComponent(), message.get_seq()
        ahead = (sequence - self._seen.get(component, sequence - 1)) & 0xFF
        if 0 < ahead < 128:
            self._seen[component] = sequence
        missing = ahead - 1 if 0 < ahead < 128 else -1 if ahead else 0  # a frame that comes late had counted as missing
        size = len(message.get_msgbuf())
        self._arrivals.append((now_s, size, missing))
        self._bytes += size
        self._missing += missing
        self._forget(now_s)

    def loss_pct(self, now_s: float) -> float:
        self._forget(now_s)
        missing, heard = max(self._missing, 0), len(self._arrivals)
        return round(100.0 * missing / (heard + missing), 1) if heard else 0.0

    def bytes_per_s(self, now_s: float) -> int:
        self._forget(now_s)
        return round(self._bytes / min(max(now_s - self._since_s, 1.0), SPAN_S))

    def _forget(self, now_s: float) -> None:
        arrivals = self._arrivals
        while arrivals and arrivals[0][0] < now_s - SPAN_S:
            _, size, missing = arrivals.popleft()
            self._bytes -= size
            self._missing -= missing
