"""Sends pictures to consoles that ask for them, each at the rate that it names, in the size that this rate carries. No socket.

Pieces leave evenly spaced, never in a burst: an order that follows waits for one piece, which takes 30 ms of the rate.
"""

import hmac
import math
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from delfim.base.clock import Clock
from delfim.base.errors import FormatError
from delfim.parts.camera import livewire, wire
from delfim.parts.camera.grabber import Picture

LEASE_S: Final = 3.0  # after the last ask nothing more is sent
VIEWERS: Final = 4
PIECE_S: Final = 0.03  # of the rate
PIECE_MIN: Final = 240
PICTURE_S: Final = 0.2  # a larger size is taken when its picture takes no longer
AHEAD_S: Final = 0.005
OVER_BYTES: Final = 28 + 45 + wire.MAC_BYTES  # of a datagram: IP, UDP, our head and MAC


class PictureSource(Protocol):
    """What is known of a camera."""

    name: str
    latest: list[Picture | None]  # by size, the largest first
    same_since_s: float

    @property
    def why(self) -> str: ...


class LiveSource(Protocol):
    """What shows cameras by WebRTC."""

    names: tuple[str, ...]

    def ask(self, address: Any, offer: livewire.LiveOffer) -> livewire.LiveAnswer: ...


class PictureViewer:
    """A console that asks."""

    def __init__(self, address: Any, ask: wire.PictureAsk, now_s: float) -> None:
        self.address, self.ask, self.asked_s = address, ask, now_s
        self.pieces = deque[bytes]()
        self.picture: Picture | None = None  # that is being sent, or was sent last
        self.step, self.at, self.count = 0, 0, 0
        self.free_s = now_s
        self.begun_bps = 0  # the rate when the picture was begun


class PictureSender:
    """`send` puts a datagram on the way to an address."""

    def __init__(
        self,
        key: bytes,
        cameras: Sequence[PictureSource],
        clock: Clock,
        send: Callable[[Any, bytes], object],
        live: LiveSource | None = None,
    ) -> None:
        self._key, self._cameras, self._clock, self._send, self._live = key, cameras, clock, send, live
        self._secret = secrets.token_bytes(16)
        self._viewers = dict[Any, PictureViewer]()
        self.refused = self._number = 0

    @property
    def is_watched(self) -> bool:
        return bool(self._viewers)

    def hear(self, address: Any, datagram: bytes) -> None:
        """Takes an ask and answers it; pictures follow if its cookie is the one of this address."""
        try:
            if self._live is not None and datagram.startswith(livewire.OFFER):
                self._hear_offer(self._live, address, livewire.read_offer(self._key, datagram))
                return
            ask = wire.read_ask(self._key, datagram)
        except FormatError:
            self.refused += 1
            return
        now_s, cookie = self._clock.monotonic_s(), self._cookie(address)
        names = tuple(each.name for each in self._cameras)
        live = self._live.names if self._live is not None else ()
        why = self._cameras[ask.camera].why if ask.camera < len(names) else "there is no such camera"
        self._send(address, wire.told_bytes(self._key, wire.PictureTold(ask.at_us, cookie, names, why, live)))
        if ask.camera >= len(names) or not hmac.compare_digest(ask.cookie, cookie):
            return
        viewer = self._viewers.get(address)
        if viewer is None or viewer.ask.camera != ask.camera:
            if viewer is None and len(self._viewers) >= VIEWERS:
                return
            self._viewers[address] = PictureViewer(address, ask, now_s)
        elif ask.at_us > viewer.ask.at_us:
            viewer.ask, viewer.asked_s = ask, now_s
            if 2 * ask.rate_bps < viewer.begun_bps:  # a large picture would go on for long
                viewer.pieces.clear()

    def tick(self) -> None:
        """Often: sends what is due."""
        now_s = self._clock.monotonic_s()
        for viewer in list(self._viewers.values()):
            if now_s - viewer.asked_s > LEASE_S:
                del self._viewers[viewer.address]
            elif viewer.ask.rate_bps:
                self._serve(viewer, now_s)

    def _hear_offer(self, live: LiveSource, address: Any, offer: livewire.LiveOffer) -> None:
        """Nothing is said to who has not its address's cookie."""
        if hmac.compare_digest(offer.cookie, self._cookie(address)):
            self._send(address, livewire.answer_bytes(self._key, live.ask(address, offer)))

    def _cookie(self, address: Any) -> bytes:
        return hmac.digest(self._secret, repr(address).encode(), "sha256")[: wire.COOKIE_BYTES]

    def _serve(self, viewer: PictureViewer, now_s: float) -> None:
        viewer.free_s = max(viewer.free_s, now_s - 2 * PIECE_S)
        while viewer.free_s <= now_s + AHEAD_S:
            if not viewer.pieces and not self._begin(viewer):
                return
            data = self._piece(viewer, now_s)
            self._send(viewer.address, data)
            viewer.free_s += (len(data) + 28) * 8.0 / viewer.ask.rate_bps

    def _begin(self, viewer: PictureViewer) -> bool:
        """Takes the newest picture, in the size that the rate carries; False when it was sent already."""
        rate = viewer.ask.rate_bps
        step = round(min(max(rate / 8.0 * PIECE_S - OVER_BYTES, PIECE_MIN), wire.PIECE_MAX))
        there = [each for each in self._cameras[viewer.ask.camera].latest if each is not None]
        fits = [each for each in there if _takes_s(len(each.jpeg), step, rate) <= PICTURE_S]
        picture = next(iter(fits), there[-1] if there else None)
        if picture is None or (viewer.picture is not None and picture.taken_s <= viewer.picture.taken_s):
            return False
        viewer.picture, viewer.step, viewer.at, viewer.count = picture, step, 0, viewer.count + 1
        viewer.begun_bps = rate
        viewer.pieces.extend(wire.cut(picture.jpeg, step))
        return True

    def _piece(self, viewer: PictureViewer, now_s: float) -> bytes:
        picture = viewer.picture
        assert picture is not None
        same_s = min(max(now_s - self._cameras[viewer.ask.camera].same_since_s, 0.0), 65535.0)
        self._number = self._number + 1 & 0xFFFFFFFF
        piece = wire.PicturePiece(
            viewer.ask.at_us,
            round((now_s - viewer.asked_s) * 1e6),
            self._number,
            viewer.count,
            round(min(now_s - picture.taken_s, 4000.0) * 1e6),
            int(same_s),
            picture.taken_ms,
            len(picture.jpeg),
            viewer.step,
            viewer.at,
            viewer.ask.camera,
            viewer.pieces.popleft(),
        )
        viewer.at += 1
        return wire.piece_bytes(self._key, piece)


def _takes_s(size: int, step: int, rate_bps: int) -> float:
    """With all that goes with it."""
    pieces = math.ceil(size / step)
    groups = math.ceil(pieces / wire.GROUP)
    return (size + groups * step + (pieces + groups) * OVER_BYTES) * 8.0 / rate_bps
