"""One boat's cameras, as the console asks them: asks go out, pieces come in, pictures come together. No socket."""

from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.console.pictures.picturerate import ASK_S, PictureRate
from delfim.parts.camera import jpegblocks, wire

JOINING: Final = 3  # pictures whose pieces come at once
SILENT_S: Final = 3.0
UDP_BYTES: Final = 28
RATED_S: Final = 2.0


class HeardPicture(NamedTuple):
    """A picture, and what its camera said of it."""

    jpeg: bytes
    taken_s: float  # by the console's monotonic clock, never younger than it is
    taken_ms: int  # since 1970, by the boat's clock
    same_s: int  # since it was another one
    width: int
    height: int


class PictureLink:
    """`send` puts a datagram on its way to the boat's cameras."""

    def __init__(self, key: bytes, send: Callable[[bytes], object], now_s: float) -> None:
        self._key, self._send = key, send
        self.rate = PictureRate()
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
        ask = wire.PictureAsk(round(now_s * 1e6), self.rate.next(now_s, hold), self.camera, self._cookie)
        self._send(wire.ask_bytes(self._key, ask))

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
            self.names, self._told, self._cookie = answer.names, answer.why, answer.cookie
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
