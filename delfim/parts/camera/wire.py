"""What the console and the boat's cameras say to each other, in UDP datagrams; both ends use this.

The console asks twice a second: which camera, how many bit/s may be used. Each ask is answered, and its pictures follow in
pieces. All carry a MAC of the boat's key of MAVLink. An ask counts only with the cookie that the boat drew for the address it
comes from, so that nobody has pictures sent to another one. Times are differences of one clock: the pieces name the time of
the ask they follow, and how long it was held, so that no clock is compared with that of another computer.
"""

import hashlib
import hmac
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

MAC_BYTES: Final = 8
COOKIE_BYTES: Final = 8
PICTURE_MAX: Final = 1 << 20
PIECE_MAX: Final = 1200  # bytes of a picture in a datagram
GROUP: Final = 8  # pieces that one more, the exclusive or of them all, makes good for the loss of one
RATE_MAX: Final = 10_000_000
NAMES_MAX: Final = 300
_ASK, _TOLD, _PIECE = b"DcA1", b"DcT1", b"DcP1"
_ask = struct.Struct(">4sQIB8s")
_told = struct.Struct(">4sQ8s")
_piece = struct.Struct(">4sQIIIIHQIHHH")


class PictureAsk(NamedTuple):
    """Of the console."""

    at_us: int  # its own clock
    rate_bps: int  # with all headers; 0: none now
    camera: int  # counts from 0
    cookie: bytes


class PictureTold(NamedTuple):
    """The answer to an ask: names of the cameras, why this one has no pictures, in words, and which come by WebRTC as well."""

    at_us: int  # of the ask
    cookie: bytes
    names: tuple[str, ...]
    why: str
    live: tuple[str, ...] = ()


class PicturePiece(NamedTuple):
    """A part of a picture, or the exclusive or of a group of them (`at` is then of the group, behind the last one)."""

    at_us: int  # of the last ask
    held_us: int  # since that came
    number: int  # of the datagram, to count losses
    picture: int
    age_us: int  # of the picture, when this was sent
    same_s: int  # since the picture was another one
    taken_ms: int  # since 1970, by the boat's clock
    size: int  # of the picture, bytes
    step: int  # bytes of each piece
    at: int
    camera: int
    data: bytes


def mac_key(secret: bytes) -> bytes:
    return hashlib.sha256(b"delfim camera" + secret).digest()


def signed(key: bytes, body: bytes) -> bytes:
    return body + hmac.digest(key, body, "sha256")[:MAC_BYTES]


def opened(key: bytes, datagram: bytes, kind: bytes, head: int) -> bytes:
    body, mac = datagram[:-MAC_BYTES], datagram[-MAC_BYTES:]
    if (
        len(body) < head
        or not body.startswith(kind)
        or not hmac.compare_digest(mac, hmac.digest(key, body, "sha256")[:MAC_BYTES])
    ):
        raise FormatError("no datagram of a camera with this key")
    return body


def ask_bytes(key: bytes, ask: PictureAsk) -> bytes:
    return signed(key, _ask.pack(_ASK, ask.at_us, ask.rate_bps, ask.camera, ask.cookie))


def read_ask(key: bytes, datagram: bytes) -> PictureAsk:
    """Raises FormatError."""
    body = opened(key, datagram, _ASK, _ask.size)
    if len(body) != _ask.size:
        raise FormatError("an ask of another length")
    at_us, rate, camera, cookie = _ask.unpack(body)[1:]
    return PictureAsk(at_us, min(rate, RATE_MAX), camera, cookie)


def told_bytes(key: bytes, told: PictureTold) -> bytes:
    words = "\n".join((",".join(told.names), told.why, *([",".join(told.live)] if told.live else []))).encode()[:NAMES_MAX]
    return signed(key, _told.pack(_TOLD, told.at_us, told.cookie) + words)


def piece_bytes(key: bytes, piece: PicturePiece) -> bytes:
    numbers = (piece.at_us, piece.held_us, piece.number, piece.picture, piece.age_us, piece.same_s, piece.taken_ms, piece.size)
    return signed(key, _piece.pack(_PIECE, *numbers, piece.step, piece.at, piece.camera) + piece.data)


def read_answer(key: bytes, datagram: bytes) -> PictureTold | PicturePiece:
    """Raises FormatError."""
    if datagram.startswith(_TOLD):
        body = opened(key, datagram, _TOLD, _told.size)
        _, at_us, cookie = _told.unpack_from(body)
        names, why, live, *_ = (*body[_told.size :].decode(errors="replace").split("\n"), "", "")
        return PictureTold(at_us, cookie, _names(names), why, _names(live))
    body = opened(key, datagram, _PIECE, _piece.size)
    piece = PicturePiece._make((*_piece.unpack_from(body)[1:], body[_piece.size :]))
    if not (0 < piece.size <= PICTURE_MAX and 0 < piece.step <= PIECE_MAX and len(piece.data) <= piece.step):
        raise FormatError("a piece of no picture")
    count = -(-piece.size // piece.step)
    if piece.at >= count + -(-count // GROUP) or len(piece.data) != length_of(piece.at, piece.size, piece.step):
        raise FormatError("a piece beyond its picture")
    return piece


def _names(words: str) -> tuple[str, ...]:
    return tuple(filter(None, words.split(",")))


def length_of(at: int, size: int, step: int) -> int:
    """Bytes of the piece at this place."""
    return min(step, size - at * step) if at < -(-size // step) else step


def cut(picture: bytes, step: int) -> list[bytes]:
    """The pieces of a picture, and behind them one for each group of them."""
    pieces = [picture[at : at + step] for at in range(0, len(picture), step)]
    return pieces + [_both(pieces[at : at + GROUP], step) for at in range(0, len(pieces), GROUP)]


def _both(pieces: Sequence[bytes], step: int) -> bytes:
    """The exclusive or of pieces, short ones filled with zeros."""
    found = 0
    for each in pieces:
        found ^= int.from_bytes(each.ljust(step, b"\0"))
    return found.to_bytes(step)


class Joining:
    """One picture that comes in pieces, in any order."""

    def __init__(self, first: PicturePiece) -> None:
        self.newest, self._pieces = first, dict[int, bytes]()
        self._count = -(-first.size // first.step)

    def add(self, piece: PicturePiece) -> bytes | None:
        """The picture, when it is whole. Pieces of another form are left out."""
        if (piece.size, piece.step) != (self.newest.size, self.newest.step):
            return None
        self.newest = piece
        self._pieces[piece.at] = piece.data
        self._mend(piece.at // GROUP if piece.at < self._count else piece.at - self._count)
        if any(at not in self._pieces for at in range(self._count)):
            return None
        return b"".join(self._pieces[at] for at in range(self._count))

    def _mend(self, group: int) -> None:
        """Make the one piece that lacks from the others of its group."""
        ats = [*range(group * GROUP, min((group + 1) * GROUP, self._count)), self._count + group]
        lacking = [at for at in ats if at not in self._pieces]
        if len(lacking) == 1 and lacking[0] < self._count:
            step = self.newest.step
            made = _both([self._pieces[at] for at in ats if at in self._pieces], step)
            self._pieces[lacking[0]] = made[: length_of(lacking[0], self.newest.size, step)]
