"""Sequence numbers of received frames, by sender: finds repeated and late frames, orders that a newer one overtook on another
link, and two consoles with one number.
"""

import math
from typing import Final, NamedTuple

from delfim.parts.mavlink.codec.signing import OVERTAKEN_S, PER_S
from delfim.parts.mavlink.codec.wire import Address, Speaker

LATE_FRAMES, LATE_S = 16, 3.0  # a frame this far behind its sender's newest, within this time, is late or repeated
SOURCES: Final = 64  # senders whose frames are counted
_OVERTAKEN: Final = round(OVERTAKEN_S * PER_S)
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
        self._ordered: dict[Speaker, int] = {}  # the stamp of his newest order

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

    def is_overtaken(self, source: Speaker, stamp: int) -> bool:
        """Whether a signed order comes after one that was given later. Otherwise it is the newest."""
        newest = self._ordered.pop(source, 0)  # whoever orders now is last in order, and the first one gives way
        is_overtaken = 0 < newest - stamp <= _OVERTAKEN  # more: his clock was set back
        self._ordered[source] = newest if is_overtaken else stamp
        if len(self._ordered) > SOURCES:
            del self._ordered[next(iter(self._ordered))]
        return is_overtaken

    def namesake(self, source: Speaker, address: Address, now_s: float) -> Address | None:
        """The address of another console that uses the same number, was heard just now, and was there first. One with a link
        number of its own is one console at however many addresses."""
        since_s = self._newest[address, source].since_s
        for (where, who), heard in self._newest.items():
            if (
                who.party == source.party
                and where != address
                and not (who == source and who.link)
                and now_s - heard.at_s < NAMESAKES_S
                and heard.at_s > since_s
            ):
                return where
        return None
