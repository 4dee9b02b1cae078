"""The rate that pictures may have: what the link to a boat leaves. No socket and no clock.

The delay tells: as soon as data waits in a queue somewhere, the rate falls below what then comes through, long before orders
and state are late. A radio that loses some datagrams and delays none is not slowed down by that; one that loses many is.
"""

import math
from collections import deque
from typing import Final

START_BPS: Final = 20_000.0
LEAST_BPS: Final = 8_000.0
MOST_BPS: Final = 2_000_000.0
ASK_S: Final = 0.5  # between two asks: the rate changes with each
RISE: Final = 1.25
NEAR, SLOWLY = 0.8, 1.05  # of the rate at which a queue was found: from there on it rises slowly
FALL: Final = 0.7
QUEUED_S: Final = 0.04  # longer than the least round trip, and a queue is there;
PIECE_BITS: Final = 2600.0  # so does one piece before another on a slow link
LOSS_MAX: Final = 0.15
BASE_S: Final = 60.0  # the least round trip of so long counts: a route may change
SHARE: Final = 0.5  # of a rate must be used for it to rise: else nothing is known of a higher one
LATEST: Final = 4  # round trips: the least of them tells of the queue, and not of a radio's whims
SILENT: Final = 3  # asks without an answer


class PictureRate:
    """Of one boat. `loss` is a part of 1."""

    def __init__(self) -> None:
        self.bps, self.loss = START_BPS, 0.0
        self._knee_bps, self._knee_s = math.inf, -math.inf  # what came through the last queue, and when
        self._bases = deque[tuple[float, float]]()  # when, and the least round trip of that ask
        self._rounds = deque[float](maxlen=LATEST)
        self._least_s, self._bits, self._first, self._last, self._count = math.inf, 0, -1, -1, 0
        self._silent, self._drains = 0, False

    def answered(self, round_s: float) -> None:
        """The answer to an ask came so late."""
        self._least_s = min(self._least_s, round_s)
        self._rounds.append(round_s)

    def came(self, number: int, size: int, round_s: float) -> None:
        """A datagram came, of `size` bytes with all headers; its number tells of losses before it."""
        self.answered(round_s)
        self._bits += 8 * size
        self._count += 1
        self._first = number if self._first < 0 else min(self._first, number)
        self._last = max(self._last, number)

    def came_beside(self, size: int) -> None:
        """So many bytes came by another way, of the same link."""
        self._bits += 8 * size

    def next(self, now_s: float, hold: bool) -> int:
        """The rate of the next ask, due each ASK_S. `hold`: an order is under way, or the link is weak: as little as can be."""
        sent = self._last - self._first + 1 if self._first >= 0 else 0
        if sent:
            self.loss += 0.3 * (max(1.0 - self._count / sent, 0.0) - self.loss)
        drains, self._drains = self._drains, False  # it had fallen with the last ask
        if self._is_queued(now_s) and not drains:
            self._drains = True
            came_bps = min(self.bps, max(self._bits / ASK_S, FALL * self.bps))
            self._knee_bps, self._knee_s = came_bps, now_s
            self.bps = max(FALL * came_bps, LEAST_BPS)
        elif self.loss > LOSS_MAX or self._silent >= SILENT:
            self.bps = max(FALL * self.bps, LEAST_BPS)
        elif not drains and self._bits >= SHARE * self.bps * ASK_S:
            is_near = now_s - self._knee_s < BASE_S and NEAR < self.bps / self._knee_bps < 1.0 / NEAR
            self.bps = min((SLOWLY if is_near else RISE) * self.bps, MOST_BPS)
        self._least_s, self._bits, self._first, self._last, self._count = math.inf, 0, -1, -1, 0
        self._rounds.clear()
        return round(LEAST_BPS if hold else self.bps)

    def _is_queued(self, now_s: float) -> bool:
        """Whether what came last had waited."""
        self._silent = 0 if self._rounds else self._silent + 1
        if self._rounds:
            self._bases.append((now_s, self._least_s))
        while self._bases and self._bases[0][0] < now_s - BASE_S:
            self._bases.popleft()
        if not self._rounds:
            return False
        return min(self._rounds) - min(each for _, each in self._bases) > QUEUED_S + PIECE_BITS / self.bps
