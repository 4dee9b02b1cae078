"""Sequence numbers of received frames, by sender: finds repeated and late frames, and two consoles with one number."""

import math
from typing import Final, NamedTuple

from delfim.parts.mavlink.codec.wire import Address, Speaker

LATE_FRAMES, LATE_S = 16, 3.0  # a frame this far behind its sender's newest, within this time, is late or repeated
SOURCES: Final = 64  # senders whose frames are counted
NAMESAKES_S: Final = 3.0  # two consoles with one number, both heard within this time, are two and not one that moved


class NewestFrame(NamedTuple):
    """The newest frame of a sender: its number, when it came, and since when the sender is heard."""

    number: int
    at_s: float
    since_s: float


class Sequences:
    """The sequence numbers of all senders."""

    def __init__(self) -> None:
        self._newest: dict[tuple[Address, Speaker], NewestFrame] = {}

    def is_late(self, address: Address, source: Speaker, number: int, now_s: float) -> bool:
        """Whether a frame came twice, or after one sent later. Otherwise it becomes the newest."""
        key = (address, source)
        newest, at_s, since_s = self._newest.get(key, NewestFrame(number - 1 & 0xFF, -math.inf, now_s))
        if -number + newest & 0xFF < LATE_FRAMES and now_s - at_s < LATE_S:
            return True
        if key not in self._newest and len(self._newest) >= SOURCES:
            del self._newest[min(self._newest, key=lambda each: self._newest[each].at_s)]
        self._newest[key] = NewestFrame(number, now_s, since_s if now_s - at_s < NAMESAKES_S else now_s)
        return False

    def namesake(self, source: Speaker, address: Address, now_s: float) -> Address | None:
        """The address of another console that uses the same number, was heard just now, and was there first."""
        since_s = self._newest[address, source].since_s
        for (where, who), heard in self._newest.items():
            if who.party == source.party and where != address and now_s - heard.at_s < NAMESAKES_S and heard.at_s > since_s:
                return where
        return None
