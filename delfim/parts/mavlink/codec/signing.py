"""Signed MAVLink 2 frames: only holders of the key, no frame twice or late (mavlink.io/en/guide/message_signing.html).

A speaker may have several links at once, of which one is slower: a frame may come up to OVERTAKEN_S after one that was signed
later, once. Whoever commands by several links numbers what he says by its stamps (`stamp_of` in `wire.py`).

A signature is the first 48 bits of SHA-256 over key and frame, with a time stamp that only grows: authentication, not secrecy.
Hashing a frame takes about a microsecond, so the loop does it.
"""

import hashlib
import hmac
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import msgspec

from delfim.base.clock import MADE_NS, Clock
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.input.untrusted import read_file
from delfim.parts.mavlink.codec.wire import stamp_of

EPOCH_NS: Final = 1_420_070_400_000_000_000  # time stamps count 10 us since 2015
PER_S: Final = 100_000  # of them
OFF_S: Final = 60.0  # a speaker's clock may be this far ahead of this one, and a new speaker's this far behind
STREAMS: Final = 64  # speakers at most
WAYS: Final = 4  # addresses of a speaker, on the average, whose delays are known
DRIFT: Final = 1e-4  # of two clocks against each other, generously
OVERTAKEN_S: Final = 3.0  # by a frame on a faster link
RECENT: Final = 1024  # stamps of a speaker that are known one by one
_OFF: Final = round(OFF_S * PER_S)
_OVERTAKEN: Final = round(OVERTAKEN_S * PER_S)

Stream = tuple[int, int, int]  # link, system, component
TimeStamp = Annotated[int, msgspec.Meta(ge=0, lt=1 << 48)]


class FrameVerdict(NamedTuple):
    """`fault` names the error of a frame, under which it is counted; empty: none. `age_s`: how much longer than the fastest
    frame of its speaker it was on the way. `off_s`: how far ahead of this clock a frame is that is refused for its time."""

    fault: str
    age_s: float = 0.0
    off_s: float = 0.0

    @property
    def words(self) -> str:
        """Why a frame with the right signature is refused for its time alone; empty: it is not."""
        if not self.off_s:
            return ""
        far, what = abs(self.off_s), "ahead of" if self.off_s > 0.0 else "behind"
        length = f"{far / 86_400.0:,.0f} days" if far >= 2 * 86_400.0 else f"{far / 60.0:,.0f} minutes"
        return f"signs {length} {what} the clock here, and is not believed: one of the two clocks is wrong"


class Kept(msgspec.Struct):
    """The time stamps that last over a restart: the last sent, the last of each speaker, the last of those forgotten; and the
    number by which this one is known on all of its links, 0: none."""

    sent: TimeStamp = 0
    forgotten: TimeStamp = 0
    heard: list[tuple[Stream, TimeStamp]] = []
    link: Annotated[int, msgspec.Meta(ge=0, le=255)] = 0


class RecentStamps:
    """The last stamps of one speaker: which of them came, and up to which one none is new."""

    def __init__(self, floor: int) -> None:
        self._floor, self._came, self._order = floor, set[int](), deque[int]()

    def take(self, stamp: int, newest: int) -> bool:
        """Whether this stamp is new."""
        while self._order and (self._order[0] < newest - _OVERTAKEN or len(self._order) >= RECENT):
            oldest = self._order.popleft()
            self._came.discard(oldest)
            self._floor = max(self._floor, oldest)
        if stamp <= max(self._floor, newest - _OVERTAKEN) or stamp in self._came:
            return False
        self._came.add(stamp)
        self._order.append(stamp)
        return True


class Signing:
    """The time stamps heard of each speaker, of so many at most, and the next one to send. `kept`: those of the run before.

    `is_right`: whether the clock is known to be right. Before that, as aboard without a fix, no frame is too new: only the
    order counts, and this clock goes on where the run before ended. From then on no stamp more than OFF_S ahead is taken,
    and those that were taken or kept are cut to that: no wrong clock shuts anybody out for longer.
    """

    def __init__(
        self,
        key: bytes,
        clock: Clock,
        kept: Kept | None = None,
        streams: int = STREAMS,
        is_right: Callable[[], bool] = lambda: True,
    ) -> None:
        kept = kept or Kept()
        self.key, self._clock, self._streams, self._is_right = key, clock, streams, is_right
        self.heard = dict(kept.heard[:streams])
        self._sent, self._forgotten, self.link = kept.sent, kept.forgotten, kept.link
        self._recent: dict[Stream, RecentStamps] = {}
        self._greatest = max((*self.heard.values(), kept.forgotten))
        self._begin = kept.sent - self._ran()
        self._least_s: dict[
            tuple[Stream, object], tuple[float, float]
        ] = {}  # least delay, clocks' difference included; and when

    def kept(self) -> Kept:
        return Kept(self._sent, self._forgotten, list(self.heard.items()), self.link)

    def stamp(self) -> int:
        """The stamp of the next frame to send: this clock's time, but later than the stamp before. A clock that is set back by
        less than OFF_S goes on for those who hear it: stamps that stood still would look like frames that came late."""
        now = self._running()
        self._sent = max(self._sent + 1, now)
        return self._sent

    def judge(self, frame: bytes, way: object = None) -> FrameVerdict:
        """A frame as it came, and by which way. A valid frame is remembered, and is not valid a second time."""
        if not frame[2] & 1:
            return FrameVerdict("unsigned")
        signature = hashlib.sha256(self.key + frame[:-6]).digest()[:6]
        if not hmac.compare_digest(signature, frame[-6:]):
            return FrameVerdict("forged")
        stream, stamp = (frame[-13], frame[5], frame[6]), stamp_of(frame)
        is_set = self._is_set()
        now = self._now() if is_set else self._running()
        if is_set and self._greatest > now + _OFF:
            self._cut(now + _OFF)
        if is_set and stamp > now + _OFF:
            return FrameVerdict("ahead", 0.0, (stamp - now) / PER_S)
        last = self.heard.get(stream)
        if last is None and stamp < now - _OFF:
            return FrameVerdict("replayed", 0.0, (stamp - now) / PER_S if is_set else 0.0)
        if last is None and (stamp <= self._forgotten or not self._has_room(stamp)):
            return FrameVerdict("replayed")
        recent = self._recent.setdefault(stream, RecentStamps(stamp - 1 if last is None else last))
        if not recent.take(stamp, max(stamp, last or 0)):
            return FrameVerdict("replayed")
        self.heard[stream] = max(stamp, last or 0)
        self._greatest = max(self._greatest, stamp)
        return FrameVerdict("", self._age_s((stream, way), stamp))

    def _has_room(self, stamp: int) -> bool:
        """Forgets the speaker whose last frame is the oldest, if there are too many. A new one must be newer than that: what
        was heard of those who are forgotten is never new again."""
        if len(self.heard) < self._streams:
            return True
        oldest = min(self.heard, key=self.heard.__getitem__)
        if stamp <= self.heard[oldest]:
            return False
        self._forgotten = max(self._forgotten, self.heard.pop(oldest))
        self._recent.pop(oldest, None)
        return True

    def _cut(self, most: int) -> None:
        """No stamp is greater from now on."""
        self._recent.clear()
        self._least_s = {way: least for way, least in self._least_s.items() if self.heard.get(way[0], 0) <= most}
        self.heard = {stream: min(stamp, most) for stream, stamp in self.heard.items()}
        self._forgotten, self._greatest = min(self._forgotten, most), most

    def _age_s(self, way: tuple[Stream, object], stamp: int) -> float:
        """Clocks of two computers that have one number, at two addresses, differ."""
        now_s = self._clock.monotonic_s()
        delay_s = now_s - stamp / PER_S
        least_s, at_s = self._least_s.pop(way, (delay_s, now_s))
        least_s = min(least_s + DRIFT * (now_s - at_s), delay_s)
        self._least_s[way] = least_s, now_s
        if len(self._least_s) > WAYS * self._streams:
            del self._least_s[next(iter(self._least_s))]
        return delay_s - least_s

    def _is_set(self) -> bool:
        return self._clock.time_ns() >= MADE_NS and self._is_right()

    def _now(self) -> int:
        return max(self._clock.time_ns() - EPOCH_NS, 0) // (1_000_000_000 // PER_S)

    def _running(self) -> int:
        """This clock's time, or what its stamps came to before it was set back."""
        now, ran = self._now(), self._ran()
        ahead = self._begin + ran - now
        if ahead < 0 or (ahead > _OFF and self._is_set()):
            self._begin, self._sent = now - ran, min(self._sent, now)
        return self._begin + ran

    def _ran(self) -> int:
        return round(self._clock.monotonic_s() * PER_S)


def read_stamps(path: str | Path) -> Kept:
    """The stamps of the run before; none if the file is missing or unreadable."""
    try:
        kept = msgspec.json.decode(read_file(path), type=Kept | list[tuple[Stream, TimeStamp]])
    except (OSError, *UNREADABLE):
        return Kept()
    return kept if isinstance(kept, Kept) else Kept(heard=kept)  # as files were before


def write_stamps(path: str | Path, kept: Kept) -> None:
    """Write the file whole or not at all. Raises OSError."""
    fresh = Path(f"{path}.new")
    fresh.write_bytes(msgspec.json.encode(kept))
    fresh.replace(path)
