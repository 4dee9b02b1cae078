"""The numbers of the frames that came, by sender: which came twice or late, and whether two consoles have one number."""

import math
from typing import Final, NamedTuple

from delfim.vehicle.mavlink.wire import Address, Speaker

LATE_FRAMES, LATE_S = 16, 3.0  # a frame so far behind the newest of its sender, within this time, came late or twice
SOURCES: Final = 64  # senders whose frames are counted
NAMESAKES_S: Final = 3.0  # two consoles of one number that were both heard within this time are two, and not one that moved


class NewestFrame(NamedTuple):
    """The newest frame of a sender: its number, when it came, and since when the sender is heard."""

    number: int
    at_s: float
    since_s: float


class Sequences:
    """Of all senders."""

    def __init__(self) -> None:
        self._newest: dict[tuple[Address, Speaker], NewestFrame] = {}

    def is_late(self, address: Address, source: Speaker, number: int, now_s: float) -> bool:
        """Whether a frame came twice, or after one that was sent later. One that did not is the newest."""
        key = (address, source)
        newest, at_s, since_s = self._newest.get(key, NewestFrame(number - 1 & 0xFF, -math.inf, now_s))
        if -number + newest & 0xFF < LATE_FRAMES and now_s - at_s < LATE_S:
            return True
        if key not in self._newest and len(self._newest) >= SOURCES:
            del self._newest[min(self._newest, key=lambda each: self._newest[each].at_s)]
        self._newest[key] = NewestFrame(number, now_s, since_s if now_s - at_s < NAMESAKES_S else now_s)
        return False

    def namesake(self, source: Speaker, address: Address, now_s: float) -> Address | None:
        """Where somebody else was heard just now who calls himself by the same number, and was there before."""
        since_s = self._newest[address, source].since_s
        for (where, who), heard in self._newest.items():
            if who.party == source.party and where != address and now_s - heard.at_s < NAMESAKES_S and heard.at_s > since_s:
                return where
        return None
