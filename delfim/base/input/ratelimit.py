"""The rate limit of a line: what comes beyond it is dropped in whole sentences, counted, and reported in words.

It is the same for all lines: at an adapter of USB or on the network the baud rate of the vehicle's file bounds nothing.
"""

from collections.abc import Callable
from typing import Final

PIECE_BYTES: Final = (
    256  # read at once, so that its sentences take at most 0.2 ms; the rest is read in another turn of the loop
)
SECOND_BYTES: Final = 100_000  # twice what the fastest serial line brings
BURST_S: Final = 0.25
NO_BOUND: Final = 1e15
UNREAD_BYTES: Final = 4096  # read at once of what is dropped
LONGEST: Final = 200  # bytes until a sentence has ended; a line with longer ones is no line of sentences


class Allowance:
    """The rate limit of one line. `words` report a flood at the last look; empty: there was none."""

    def __init__(self, bytes_per_s: float = NO_BOUND, now_s: Callable[[], float] = lambda: 0.0) -> None:
        """`now_s` is monotonic. A limit that was not used for a while may be used at once, up to BURST_S of it."""
        self.words = ""
        self.sentences = self.bytes = 0  # dropped, in all
        self._rate, self._now_s, self._at_s = bytes_per_s, now_s, now_s()
        self._left = self._most = bytes_per_s * BURST_S
        self._cut = 0  # bytes that may still belong to a sentence that began among the dropped ones
        self._flood = self._told = 0, 0  # sentences and bytes dropped when this flood began, and when it was last told

    def at_once(self, most: int) -> int:
        """The number of bytes to read now, where `most` are read at a time; `of` takes them next."""
        now_s = self._now_s()
        self._left = min(self._left + (now_s - self._at_s) * self._rate, self._most)
        self._at_s = now_s
        return most if self._left > 0.0 else UNREAD_BYTES

    def of(self, data: bytes) -> bytes:
        """Return the part of these data that is used: all of it, none, or what follows the rest of a dropped sentence."""
        if self._left <= 0.0:
            self._cut = LONGEST
            self._drop(data)
            return b""
        self._left -= len(data)
        if not self._cut:
            return data
        end = data.find(b"\n", 0, self._cut) + 1
        rest = end or min(len(data), self._cut)
        self._cut = 0 if end else self._cut - rest
        self._drop(data[:rest])
        return data[rest:]

    def look(self) -> None:
        """Update `words`; call it about once a second."""
        now = self.sentences, self.bytes
        if now == self._told:
            self._flood, self.words = now, ""
            return
        sentences, spare = now[0] - self._flood[0], now[1] - self._flood[1]
        self._told, self.words = now, f"more than it may say: {sentences:,} sentences dropped, {spare:,} bytes"

    def _drop(self, data: bytes) -> None:
        self.sentences += data.count(b"\n")
        self.bytes += len(data)
