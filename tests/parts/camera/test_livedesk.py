"""Cameras by WebRTC, as camerad has them: who may look, at what rate, and what becomes of the program that shows them."""

import os
import selectors
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from delfim.base.clock import ManualClock
from delfim.parts.camera import livedesk, livewire, wire
from delfim.parts.camera.grabber import Picture
from delfim.parts.camera.livedesk import LiveDesk, ShownStream
from delfim.parts.camera.sending import LEASE_S, PictureSender
from delfim.parts.camera.table import CameraTable
from tests.parts.camera.film import aiortc
from tests.parts.camera.test_sending import KEY, Bow

__all__ = ["aiortc"]
HERE = ("127.0.0.1", 5000)
OFFER = livewire.LiveOffer(1, 1_000_000, 0, bytes(8), 7, 96, bytes(range(32)), "abcd", "p" * 24)


class Shown(Bow):
    table = CameraTable(source="test", webrtc=True)


class Watched:
    """The descriptors that a desk watches."""

    def __init__(self) -> None:
        self._there = selectors.DefaultSelector()

    def reader(self, fd: int, handler: Callable[[], object]) -> None:
        self._there.register(fd, selectors.EVENT_READ, handler)

    def remove_reader(self, fd: int) -> None:
        if fd in self._there.get_map():
            self._there.unregister(fd)

    def turn(self, for_s: float) -> None:
        for key, _ in self._there.select(for_s):
            key.data()


class Desk:
    """A desk with one camera."""

    def __init__(self, module: str = "aiortc") -> None:
        self.clock, self.camera, self.watched = ManualClock(100.0), Shown(), Watched()
        self.desk = LiveDesk("127.0.0.1", 240, [self.camera], self.clock, self.watched, module)

    def ask(self, stream: int = 7, rate_bps: int = 1_000_000, **more: Any) -> livewire.LiveAnswer:
        self.clock.advance(1e-3)
        at_us = round(self.clock.monotonic_s() * 1e6)
        return self.desk.ask(HERE, OFFER._replace(stream=stream, rate_bps=rate_bps, at_us=at_us, **more))

    def until(self, done: Callable[[livewire.LiveAnswer], object], step_s: float = 0.0, **more: Any) -> livewire.LiveAnswer:
        """Ask on until the answer is so; each turn takes so long by the desk's clock."""
        for _ in range(6000):
            answer = self.ask(**more)
            if done(answer):
                return answer
            self.watched.turn(0.02)
            self.clock.advance(step_s)
            self.desk.tick()
        raise AssertionError(f"it never was so: {answer}")

    @property
    def child(self) -> int:
        assert self.desk._child is not None
        return self.desk._child.pid


@pytest.fixture
def it(aiortc: None) -> Iterator[Desk]:
    made = Desk()
    yield made
    made.desk.close()


def test_without_the_library_nothing_is_offered_and_pictures_go_as_before() -> None:
    it = Desk(module="no_such_library")
    sent = list[bytes]()
    sender = PictureSender(KEY, [it.camera], it.clock, lambda _, data: sent.append(data), it.desk)
    sender.hear(HERE, wire.ask_bytes(KEY, wire.PictureAsk(1, 20_000, 0, bytes(8))))
    told = wire.read_answer(KEY, sent[-1])
    assert isinstance(told, wire.PictureTold)
    assert told == wire.PictureTold(1, told.cookie, ("bow",), "", ())
    assert it.desk.report() == {"why": "aiortc is not installed: pip install 'delfim[webrtc]'", "streams": 0}
    assert it.ask().why == "aiortc is not installed: pip install 'delfim[webrtc]'"


def test_a_camera_that_does_not_ask_for_it_is_not_shown() -> None:
    it = Desk(module="json")
    it.camera.table = CameraTable(source="test")
    it.desk = LiveDesk("127.0.0.1", 240, [it.camera], it.clock, it.watched, "json")
    assert it.desk.names == ()
    assert it.desk.report()["why"] == ""
    assert it.ask().why == "this camera is not shown by WebRTC"
    assert it.ask(camera=9).why == "this camera is not shown by WebRTC"


def test_an_offer_without_the_key_or_the_cookie_of_its_address_hears_nothing() -> None:
    it = Desk(module="json")
    asked = list[Any]()
    it.desk.ask = lambda address, offer: (
        asked.append(address)
        or livewire.LiveAnswer(  # type: ignore[method-assign, func-returns-value]
            1, 7, livewire.WAITS, 0, 0, 0, bytes(32), "", "", ""
        )
    )
    sent = list[bytes]()
    sender = PictureSender(KEY, [it.camera], it.clock, lambda _, data: sent.append(data), it.desk)
    sender.hear(HERE, wire.ask_bytes(KEY, wire.PictureAsk(1, 20_000, 0, bytes(8))))
    told = wire.read_answer(KEY, sent.pop())
    sender.hear(HERE, livewire.offer_bytes(wire.mac_key(b"another"), OFFER._replace(cookie=told.cookie)))  # type: ignore[union-attr]
    assert sender.refused == 1
    sender.hear(HERE, livewire.offer_bytes(KEY, OFFER))
    sender.hear(("127.0.0.1", 5001), livewire.offer_bytes(KEY, OFFER._replace(cookie=told.cookie)))  # type: ignore[union-attr]
    assert (sent, asked) == ([], [])
    sender.hear(HERE, livewire.offer_bytes(KEY, OFFER._replace(cookie=told.cookie)))  # type: ignore[union-attr]
    assert asked == [HERE]
    assert livewire.read_answer(KEY, sent[0]).stream == 7


def test_the_rate_goes_down_at_once_and_up_in_steps() -> None:
    stream = ShownStream(1, OFFER, 0.0)

    def told(rate_bps: int, now_s: float) -> int:
        stream.offer = stream.offer._replace(rate_bps=rate_bps)
        return stream.next_bps(now_s)

    assert told(1_000_000, 0.0) == 700_000
    assert told(8_000, 0.5) == 0, "an order is under way"
    assert told(1_000_000, 1.0) == 700_000, "and it goes on as before"
    assert told(2_000_000, 2.0) == 700_000
    assert told(2_000_000, 5.0) == 1_200_000
    assert told(400_000, 5.5) == 200_000
    assert told(240_000, 6.0) == 0


@pytest.mark.long
def test_two_are_answered_and_a_third_is_told_why_not(it: Desk) -> None:
    first, second = (it.until(lambda answer: answer.state == livewire.ANSWERED, stream=stream) for stream in (7, 8))
    assert {first.port, second.port} == {15380, 15381}
    assert first.password != second.password
    third = it.ask(stream=9)
    assert (third.state, third.why) == (livewire.ENDED, "2 look at it already")
    assert it.ask(stream=8, rate_bps=0).why == "the page has ended it"
    assert it.ask(stream=9).state == livewire.WAITS


@pytest.mark.long
def test_who_says_nothing_is_forgotten_and_the_program_ends_when_nobody_looks(it: Desk) -> None:
    it.until(lambda answer: answer.state == livewire.ANSWERED)
    child = it.child
    it.clock.advance(LEASE_S + 0.1)
    it.desk.tick()
    assert it.desk.report()["streams"] == 0
    it.clock.advance(livedesk.IDLE_S + 0.1)
    it.desk.tick()
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


@pytest.mark.long
def test_a_page_that_never_comes_is_told(it: Desk) -> None:
    answer = it.until(lambda answer: answer.state == livewire.ENDED)
    assert answer.why == "the page does not reach the boat by UDP"


@pytest.mark.long
def test_a_program_that_ends_is_told_and_started_again_after_a_pause(it: Desk) -> None:
    it.until(lambda answer: answer.state == livewire.ANSWERED)
    os.kill(it.child, signal.SIGKILL)
    answer = it.until(lambda answer: answer.state == livewire.ENDED)
    assert answer.why == "the program for WebRTC ended with code -9"
    assert it.ask(stream=8).why == "the program for WebRTC has just ended"
    it.clock.advance(livedesk.AGAIN_S + 0.1)
    it.until(lambda answer: answer.state == livewire.ANSWERED, stream=10)


@pytest.mark.long
def test_a_program_that_hangs_is_ended_and_nobody_waits_for_it(it: Desk) -> None:
    it.until(lambda answer: answer.state == livewire.ANSWERED)
    os.kill(it.child, signal.SIGSTOP)

    def full(answer: livewire.LiveAnswer) -> bool:
        for _ in range(20):
            it.clock.advance(0.01)
            now_s = it.clock.monotonic_s()
            it.camera.latest = [Picture(b"\xff" * 90_000, now_s, 1)] * 3
            it.desk.tick()
        return answer.state == livewire.ENDED

    assert it.until(full).why == "the program for WebRTC takes nothing"


def test_the_same_picture_again_and_again_is_told_with_each(monkeypatch: pytest.MonkeyPatch) -> None:
    it = Desk(module="json")
    it.camera.latest = [Picture(b"same", 107.0, 5)] * 3
    it.clock.advance(9.0)
    told = list[Any]()
    monkeypatch.setattr(it.desk, "_tell", lambda order: told.append(order) or True)
    it.desk._show(0, 1_000_000, it.clock.monotonic_s())
    assert (told[0].same_s, told[0].taken_s, told[0].jpeg) == (109.0, 107.0, b"same")
