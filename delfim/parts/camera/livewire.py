"""What consoles and a boat's cameras say to each other of WebRTC, in the datagrams of wire.py, signed as those.

A page's offer and the boat's answer are no SDP here, but the few values that change in one: nobody aboard reads SDP from
outside. An offer is said again twice a second with the rate that it may have; so nothing needs to be sent again, and who says
nothing for some seconds has ended it.
"""

import re
import struct
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.parts.camera import wire

PRINT_BYTES: Final = 32  # SHA-256 of a certificate
WORDS_MAX: Final = 200
WAITS, ANSWERED, ENDED = range(3)
OFFER: Final = b"DcL1"
_ANSWER: Final = b"DcR1"
_offer = struct.Struct(">4sQIH8sIB32s")
_answer = struct.Struct(">4sQIBQHI32s")
_login = re.compile(rb"[A-Za-z0-9+/]{4,32}\n[A-Za-z0-9+/]{22,64}")  # of ICE, RFC 8839


class LiveOffer(NamedTuple):
    """Of a page: it wants the camera by WebRTC."""

    at_us: int  # the console's own clock
    rate_bps: int  # with all headers; 0: it ends
    camera: int  # counts from 0
    cookie: bytes
    stream: int  # drawn by the console: another one is another connection
    payload: int  # number of VP8 at the page
    certificate: bytes  # its SHA-256
    user: str  # of ICE
    password: str


class LiveAnswer(NamedTuple):
    """Of the boat."""

    at_us: int  # of the offer
    stream: int
    state: int
    sent: int  # bytes of the stream until now, with all headers
    port: int
    ssrc: int
    certificate: bytes
    user: str
    password: str
    why: str  # when it has ended, in words


def offer_bytes(key: bytes, offer: LiveOffer) -> bytes:
    body = _offer.pack(OFFER, *offer[:7]) + f"{offer.user}\n{offer.password}".encode()
    return wire.signed(key, body)


def read_offer(key: bytes, datagram: bytes) -> LiveOffer:
    """Raises FormatError."""
    body = wire.opened(key, datagram, OFFER, _offer.size)
    at_us, rate, camera, cookie, stream, payload, certificate = _offer.unpack_from(body)[1:]
    user, password = _read_login(body[_offer.size :])
    if payload > 127:
        raise FormatError("a number of a codec beyond 127")
    return LiveOffer(at_us, min(rate, wire.RATE_MAX), camera, cookie, stream, payload, certificate, user, password)


def answer_bytes(key: bytes, answer: LiveAnswer) -> bytes:
    words = answer.why if answer.state == ENDED else f"{answer.user}\n{answer.password}" if answer.state == ANSWERED else ""
    return wire.signed(key, _answer.pack(_ANSWER, *answer[:7]) + words.encode()[:WORDS_MAX])


def read_answer(key: bytes, datagram: bytes) -> LiveAnswer:
    """Raises FormatError."""
    body = wire.opened(key, datagram, _ANSWER, _answer.size)
    values, words = _answer.unpack_from(body)[1:], body[_answer.size :]
    state = values[2]
    if state == ANSWERED:
        return LiveAnswer._make((*values, *_read_login(words), ""))
    if state not in (WAITS, ENDED):
        raise FormatError(f"no state of a stream: {state}")
    return LiveAnswer._make((*values, "", "", words.decode(errors="replace")[:WORDS_MAX]))


def is_answer(datagram: bytes) -> bool:
    return datagram.startswith(_ANSWER)


def _read_login(data: bytes) -> tuple[str, str]:
    if not _login.fullmatch(data):
        raise FormatError("no name and password of ICE")
    user, _, password = data.decode().partition("\n")
    return user, password
