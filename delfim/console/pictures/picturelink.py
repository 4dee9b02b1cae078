"""One boat's cameras, as the console asks them: asks go out, pieces come in, pictures come together. No socket.

Of pages that look by WebRTC it carries offers and answers, tells the rate, and counts what the boat sends: those pictures go
from the boat to the page and not through here.
"""

import secrets
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.console.pictures.picturerate import ASK_S, LEAST_BPS, PictureRate
from delfim.parts.camera import jpegblocks, livewire, wire

JOINING: Final = 3  # pictures whose pieces come at once
SILENT_S: Final = 3.0
UDP_BYTES: Final = 28
RATED_S: Final = 2.0
FROM_BPS: Final = 500_000.0  # with so much, a page may begin;
LEAST_LIVE_BPS: Final = 250_000.0  # with less it goes back to stills,
LOSS_MAX: Final = 0.1  # and so with more losses


class HeardPicture(NamedTuple):
    """A picture, and what its camera said of it."""

    jpeg: bytes
    taken_s: float  # by the console's monotonic clock, never younger than it is
    taken_ms: int  # since 1970, by the boat's clock
    same_s: int  # since it was another one
    width: int
    height: int


class PageOffer(NamedTuple):
    """Of a page."""

    payload: int
    certificate: str  # SHA-256, in hex
    user: str
    password: str


class LiveLink:
    """Of one boat. `names` are the cameras that it shows so."""

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.is_shown = False  # all who look do so by WebRTC: stills are small and few
        self._streams = dict[int, tuple[PageOffer, int]]()  # of each page: its offer, and the number of its stream
        self._sent = dict[int, int]()  # bytes, of each stream
        self._is_good = False

    def look(self, page: int, offer: PageOffer | None) -> None:
        """What this page asks for now."""
        known = self._streams.get(page)
        if offer is None:
            self.forget(page)
        elif known is None or known[0] != offer:
            self.forget(page)
            self._streams[page] = offer, secrets.randbits(32)

    def forget(self, page: int) -> None:
        if page in self._streams:
            self._sent.pop(self._streams.pop(page)[1], None)

    def is_wise(self, name: str, rate: PictureRate) -> bool:
        """Whether this camera is better seen by WebRTC now."""
        least_bps = LEAST_LIVE_BPS if self._is_good else FROM_BPS
        self._is_good = rate.bps >= least_bps and rate.loss < LOSS_MAX
        return self._is_good and name in self.names

    def shares(self, rate_bps: int) -> tuple[int, int]:
        """Of the rate: that of stills, and that of each stream."""
        count = len(self._streams)
        if not count:
            return rate_bps, 0
        stills = round(LEAST_BPS) if self.is_shown else rate_bps // (count + 1)
        return stills, max(rate_bps - stills, 1) // count or 1

    def offers(self, at_us: int, rate_bps: int, camera: int, cookie: bytes) -> list[livewire.LiveOffer]:
        """What the boat is told, twice a second."""
        found = []
        for (payload, certificate, user, password), stream in self._streams.values():
            page = payload, bytes.fromhex(certificate), user, password
            found.append(livewire.LiveOffer(at_us, rate_bps, camera, cookie, stream, *page))
        return found

    def heard(self, answer: livewire.LiveAnswer) -> int:
        """The bytes that the boat has sent since its last answer."""
        if all(stream != answer.stream for _, stream in self._streams.values()):
            return 0
        before = self._sent.get(answer.stream, 0)
        self._sent[answer.stream] = max(before, answer.sent)
        return max(answer.sent - before, 0)

    def told(self, answer: livewire.LiveAnswer, host: str) -> tuple[int, dict[str, Any]] | None:
        """The page that this is for, and what it is told."""
        if answer.state == livewire.WAITS:
            return None
        for page, (offer, stream) in self._streams.items():
            if stream == answer.stream:
                login = {"user": answer.user, "password": answer.password, "certificate": answer.certificate.hex()}
                place = {"host": host, "port": answer.port, "ssrc": answer.ssrc}
                return page, {"t": "live", "of": offer.user, "why": answer.why, **login, **place}
        return None


class PictureLink:
    """`send` puts a datagram on its way to the boat's cameras."""

    def __init__(self, key: bytes, send: Callable[[bytes], object], now_s: float) -> None:
        self._key, self._send = key, send
        self.rate, self.live = PictureRate(), LiveLink()
        self.names: tuple[str, ...] = ()
        self.camera = 0
        self.picture: HeardPicture | None = None
        self.kbps = self.refused = 0
        self._told = ""
        self._cookie = bytes(wire.COOKIE_BYTES)
        self._since_s, self._heard_s, self._due_s = now_s, -1.0, now_s
        self._joining = dict[int, wire.Joining]()
        self._whole = -1
        self._bytes, self._rated_s = 0, now_s

    def why(self, now_s: float) -> str:
        """Why there is no picture, in words; empty: there is."""
        if self._heard_s < 0.0:
            return "" if now_s - self._since_s < SILENT_S else "no camera of this boat answers"
        if now_s - self._heard_s > SILENT_S:
            return "the boat’s cameras are not heard"
        return self._told

    def look(self, name: str) -> None:
        """From now on at the camera of this name, if there is one."""
        at = self.names.index(name) if name in self.names else self.camera
        if at != self.camera:
            self.camera, self.picture, self._whole = at, None, -1
            self._joining.clear()

    def tick(self, now_s: float, hold: bool) -> None:
        """Often: asks when it is due."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + ASK_S
        if now_s - self._rated_s >= RATED_S:
            self.kbps, self._bytes, self._rated_s = round(self._bytes * 8e-3 / (now_s - self._rated_s)), 0, now_s
        at_us, (stills_bps, live_bps) = round(now_s * 1e6), self.live.shares(self.rate.next(now_s, hold))
        self._send(wire.ask_bytes(self._key, wire.PictureAsk(at_us, stills_bps, self.camera, self._cookie)))
        for offer in self.live.offers(at_us, live_bps, self.camera, self._cookie):
            self._send(livewire.offer_bytes(self._key, offer))

    @property
    def is_live_wise(self) -> bool:
        """Whether the camera is better seen by WebRTC now."""
        return self.live.is_wise(self.names[self.camera] if self.camera < len(self.names) else "", self.rate)

    def hear_live(self, datagram: bytes, now_s: float) -> livewire.LiveAnswer | None:
        """Takes the answer to a page's offer."""
        try:
            answer = livewire.read_answer(self._key, datagram)
        except FormatError:
            self.refused += 1
            return None
        self._heard_s = now_s
        count = self.live.heard(answer)
        self.rate.answered(now_s - answer.at_us * 1e-6)
        self.rate.came_beside(count)
        self._bytes += count
        return answer

    def hear(self, datagram: bytes, now_s: float) -> HeardPicture | None:
        """Takes a datagram; returns the picture that it makes whole."""
        try:
            answer = wire.read_answer(self._key, datagram)
        except FormatError:
            self.refused += 1
            return None
        self._heard_s = now_s
        if isinstance(answer, wire.PictureTold):
            self.rate.answered(now_s - answer.at_us * 1e-6)
            self.names, self._told, self._cookie, self.live.names = answer.names, answer.why, answer.cookie, answer.live
            return None
        size = len(datagram) + UDP_BYTES
        self._bytes += size
        round_s = now_s - (answer.at_us + answer.held_us) * 1e-6
        self.rate.came(answer.number, size, round_s)
        return self._join(answer, now_s - round_s - answer.age_us * 1e-6) if answer.camera == self.camera else None

    def _join(self, piece: wire.PicturePiece, taken_s: float) -> HeardPicture | None:
        if piece.picture <= self._whole and self._whole - piece.picture < 1000:  # else the boat began anew
            return None
        joining = self._joining.get(piece.picture)
        if joining is None:
            joining = self._joining[piece.picture] = wire.Joining(piece)
            while len(self._joining) > JOINING:
                del self._joining[next(iter(self._joining))]
        jpeg = joining.add(piece)
        if jpeg is None:
            return None
        self._whole = piece.picture
        self._joining = {number: each for number, each in self._joining.items() if number > piece.picture}
        try:
            width, height = jpegblocks.size_of(jpeg)
        except FormatError:
            self.refused += 1
            return None
        self.picture = HeardPicture(jpeg, taken_s, piece.taken_ms, piece.same_s, width, height)
        return self.picture
