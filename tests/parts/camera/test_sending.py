"""What a camera sends to whom, and how fast."""

from typing import Any

import pytest

from delfim.base.clock import ManualClock
from delfim.parts.camera import wire
from delfim.parts.camera.grabber import Picture
from delfim.parts.camera.played import PlayedPictures
from delfim.parts.camera.sending import LEASE_S, PictureSender

KEY = wire.mac_key(b"1" * 32)
SIZES = ((640, 360), (320, 176), (160, 88))
HERE = ("127.0.0.1", 5000)


class Bow:
    name, same_since_s, why = "bow", 0.0, ""

    def __init__(self) -> None:
        self.latest: list[Picture | None] = [None, None, None]

    def take(self, now_s: float) -> None:
        self.latest = [Picture(PlayedPictures(*size).picture(int(now_s * 1000)), now_s, int(now_s * 1000)) for size in SIZES]


class Watched:
    """A sender whose console asks each half second."""

    def __init__(self) -> None:
        self.clock, self.camera = ManualClock(100.0), Bow()
        self.sent = list[tuple[float, Any, bytes]]()
        self.sender = PictureSender(KEY, [self.camera], self.clock, self._send)
        self.cookie = bytes(8)

    def _send(self, address: Any, data: bytes) -> None:
        self.sent.append((self.clock.monotonic_s(), address, data))

    def ask(self, rate_bps: int, address: Any = HERE, **more: Any) -> wire.PictureTold:
        ask = wire.PictureAsk(round(self.clock.monotonic_s() * 1e6), rate_bps, 0, self.cookie)._replace(**more)
        self.sender.hear(address, wire.ask_bytes(KEY, ask))
        told = wire.read_answer(KEY, self.sent[-1][2])
        assert isinstance(told, wire.PictureTold)
        self.cookie = told.cookie
        return told

    def sail(self, seconds: float, rate_bps: int) -> list[wire.PicturePiece]:
        """Ask at that rate for so long; the pieces that came."""
        self.ask(rate_bps)
        self.sent.clear()
        for step in range(round(seconds * 200)):
            if step % 100 == 0:
                self.ask(rate_bps)
            if step % 20 == 0:
                self.camera.take(self.clock.monotonic_s())
            self.sender.tick()
            self.clock.advance(0.005)
        answers = [wire.read_answer(KEY, data) for _, _, data in self.sent]
        return [each for each in answers if isinstance(each, wire.PicturePiece)]


@pytest.mark.parametrize(
    ("rate_bps", "width", "pictures"),
    [(20_000, 160, 10), (64_000, 160, 35), (300_000, 320, 50), (2_000_000, 640, 90)],
)
def test_the_rate_is_kept_and_carries_the_largest_size_that_it_can(rate_bps: int, width: int, pictures: int) -> None:
    watched = Watched()
    pieces = watched.sail(10.0, rate_bps)
    bits = sum(8 * (len(data) + 28) for _, _, data in watched.sent)
    assert 0.9 * min(rate_bps, 1_000_000) <= bits / 10.0 <= 1.05 * rate_bps + 2000
    joined = {piece.picture: wire.Joining(piece) for piece in pieces}
    whole = [found for piece in pieces if (found := joined[piece.picture].add(piece)) is not None]
    assert len(dict.fromkeys(whole)) >= pictures
    assert {wire_width(each) for each in whole[1:]} == {width}


def wire_width(picture: bytes) -> int:
    from delfim.parts.camera.jpegblocks import size_of

    return size_of(picture)[0]


def test_pieces_never_leave_in_a_burst() -> None:
    watched = Watched()
    watched.sail(5.0, 300_000)
    by_time = dict[float, int]()
    for at_s, _, data in watched.sent:
        by_time[at_s] = by_time.get(at_s, 0) + 8 * (len(data) + 28)
    assert max(by_time.values()) <= 300_000 * 0.08


def test_a_piece_tells_the_age_of_its_picture() -> None:
    watched = Watched()
    pieces = watched.sail(3.0, 20_000)
    taken = {piece.taken_ms for piece in pieces if piece.picture == pieces[-1].picture}
    assert len(taken) == 1
    sent_s = watched.sent[-1][0] if watched.sent[-1][2].startswith(b"DcP1") else None
    last = pieces[-1]
    assert sent_s is None or round(sent_s - last.age_us * 1e-6, 2) == round(last.taken_ms / 1000, 2)


def test_nobody_gets_pictures_who_is_not_at_the_address_that_asks() -> None:
    """An ask that was overheard, and is sent again with another address on it, brings one short answer."""
    watched = Watched()
    watched.sail(1.0, 300_000)
    watched.sent.clear()
    ask = wire.PictureAsk(1, 300_000, 0, watched.cookie)
    watched.sender.hear(("10.0.0.9", 1), wire.ask_bytes(KEY, ask))
    for _ in range(100):
        watched.camera.take(watched.clock.monotonic_s())
        watched.sender.tick()
        watched.clock.advance(0.005)
    stray = [data for _, address, data in watched.sent if address != HERE]
    assert len(stray) == 1
    assert len(stray[0]) < 2 * len(wire.ask_bytes(KEY, ask))


def test_an_older_ask_changes_nothing() -> None:
    watched = Watched()
    watched.sail(1.0, 20_000)
    watched.ask(2_000_000, at_us=1)
    watched.sent.clear()
    for step in range(100):
        if step % 20 == 0:
            watched.camera.take(watched.clock.monotonic_s())
        watched.sender.tick()
        watched.clock.advance(0.005)
    assert sum(8 * len(data) for _, _, data in watched.sent) < 15_000


def test_after_the_last_ask_nothing_more_is_sent() -> None:
    watched = Watched()
    watched.sail(1.0, 64_000)
    watched.clock.advance(LEASE_S + 0.1)
    watched.sender.tick()
    assert not watched.sender.is_watched


def test_a_rate_of_zero_is_none_and_a_wrong_key_is_counted() -> None:
    watched = Watched()
    assert watched.sail(1.0, 0) == []
    watched.sender.hear(HERE, b"anything")
    assert watched.sender.refused == 1
    assert watched.ask(1000, camera=7).why == "there is no such camera"


def test_four_consoles_may_look() -> None:
    watched = Watched()
    for port in range(6):
        address = ("127.0.0.1", port)
        watched.ask(64_000, address)
        watched.ask(64_000, address)
    watched.sent.clear()
    watched.camera.take(100.0)
    watched.sender.tick()
    assert len({address for _, address, _ in watched.sent}) == 4
