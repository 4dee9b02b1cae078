"""The rate of pictures on links of many kinds, in lock step: a camera's sender, the console's end, a radio between them."""

import io
import random
from collections import deque
from typing import Any

import pytest
from PIL import Image

from delfim.base.clock import ManualClock
from delfim.console.pictures.picturelink import SILENT_S, HeardPicture, PictureLink
from delfim.console.pictures.snapshot import with_place
from delfim.parts.camera import wire
from delfim.parts.camera.jpegblocks import jpeg_of
from delfim.parts.camera.sending import PictureSender
from tests.parts.camera.test_sending import KEY, Bow

STEP_S = 0.005


class Way:
    """One direction of a radio: a queue before its rate, a delay behind it, losses."""

    def __init__(self, rate_bps: float, loss: float, chance: random.Random) -> None:
        self.rate_bps, self._loss, self._chance = rate_bps, loss, chance
        self._free_s = 0.0
        self._flying = deque[tuple[float, bytes]]()
        self.waited_s = 0.0

    def put(self, data: bytes, now_s: float) -> None:
        free_s = max(self._free_s, now_s) + 8.0 * (len(data) + 28) / self.rate_bps
        self.waited_s = free_s - now_s
        if self.waited_s > 1.0:  # its queue is full
            return
        self._free_s = free_s
        if self._chance.random() >= self._loss:
            self._flying.append((self._free_s + 0.01, data))

    def out(self, now_s: float) -> list[bytes]:
        found = []
        while self._flying and self._flying[0][0] <= now_s:
            found.append(self._flying.popleft()[1])
        return found


class Watching:
    """A console that looks through a radio of that rate."""

    def __init__(self, rate_bps: float, loss: float = 0.0) -> None:
        chance = random.Random(7)
        self.clock, self.camera = ManualClock(100.0), Bow()
        self.down, self.up = Way(rate_bps, loss, chance), Way(rate_bps, loss, chance)
        self.sender = PictureSender(KEY, [self.camera], self.clock, self._send)
        self.link = PictureLink(KEY, lambda data: self.up.put(data, self.clock.monotonic_s()), 100.0)
        self.pictures = list[tuple[float, HeardPicture]]()
        self.waits = list[float]()

    def _send(self, address: Any, data: bytes) -> None:
        self.down.put(data, self.clock.monotonic_s())

    def sail(self, seconds: float, *, others_bps: float = 0.0, hold: bool = False) -> None:
        """So long; `others_bps` go the same way from the boat, ten times a second, as its state does."""
        self.pictures.clear()
        self.waits.clear()
        for step in range(round(seconds / STEP_S)):
            now_s = self.clock.monotonic_s()
            if step % 20 == 0:
                self.camera.take(now_s)
                if others_bps:
                    self.down.put(bytes(round(others_bps / 80)), now_s)
                    self.waits.append(self.down.waited_s)
            for data in self.up.out(now_s):
                self.sender.hear("console", data)
            self.sender.tick()
            for data in self.down.out(now_s):
                if data.startswith(b"Dc"):
                    picture = self.link.hear(data, now_s)
                    if picture is not None:
                        self.pictures.append((now_s, picture))
            self.link.tick(now_s, hold)
            self.clock.advance(STEP_S)


@pytest.mark.parametrize(
    ("rate_bps", "least", "width"),
    [
        (20_000, 0.5, 160),
        pytest.param(64_000, 1.5, 160, marks=pytest.mark.long),
        pytest.param(600_000, 5.0, 320, marks=pytest.mark.long),
        pytest.param(2_500_000, 8.0, 640, marks=pytest.mark.long),
    ],
)
def test_pictures_take_what_a_link_with_losses_leaves_and_the_state_does_not_wait(
    rate_bps: int, least: float, width: int
) -> None:
    watching = Watching(rate_bps, loss=0.05)
    watching.sail(20.0, others_bps=0.2 * rate_bps)
    watching.sail(20.0, others_bps=0.2 * rate_bps)
    assert len(watching.pictures) / 20.0 >= least
    sizes = sorted(picture.width for _, picture in watching.pictures)
    assert sizes[len(sizes) // 2] == width
    waits = sorted(watching.waits)
    own_s = 0.2 * 0.1 + 8 * 330 / rate_bps  # of this message on the link, and one piece before it
    assert waits[len(waits) // 2] <= own_s + 0.08
    assert waits[int(0.95 * len(waits))] <= own_s + 0.3


def test_a_picture_is_never_told_younger_than_it_is() -> None:
    watching = Watching(64_000, loss=0.05)
    watching.sail(20.0)
    assert watching.pictures
    for _, picture in watching.pictures:
        assert picture.taken_s <= picture.taken_ms / 1000 + 0.001  # one clock here: what was told, and what is true
        assert picture.taken_s >= picture.taken_ms / 1000 - 0.7


def test_while_an_order_is_under_way_little_is_asked_for() -> None:
    watching = Watching(1_000_000)
    watching.sail(10.0)
    watching.sail(1.0, hold=True)  # the next ask says so
    watching.sail(5.0, hold=True)
    assert sum(len(picture.jpeg) for _, picture in watching.pictures) < 5 * 8000 / 8


def test_a_link_that_becomes_slow_gets_less_at_once() -> None:
    watching = Watching(1_000_000)
    watching.sail(20.0)
    watching.down.rate_bps = 100_000
    watching.sail(6.0)
    watching.sail(6.0, others_bps=10_000)
    assert max(watching.waits[20:]) < 0.4


def test_why_there_is_no_picture_is_told() -> None:
    clock = ManualClock(100.0)
    link = PictureLink(KEY, lambda data: None, 100.0)
    assert link.why(100.0) == ""
    assert link.why(100.0 + SILENT_S) == "no camera of this boat answers"
    told = wire.PictureTold(0, bytes(8), ("bow",), "ffmpeg is not installed: apt install ffmpeg")
    link.hear(wire.told_bytes(KEY, told), 104.0)
    assert link.why(104.0) == "ffmpeg is not installed: apt install ffmpeg"
    assert link.why(104.0 + SILENT_S + 0.1) == "the boat’s cameras are not heard"
    link.hear(b"anything", clock.monotonic_s())
    assert link.refused == 1


@pytest.mark.parametrize(
    ("place", "shown"),
    [
        ((38.6907, -9.2153), (("N", (38.0, 41.0, 26.52)), ("W", (9.0, 12.0, 55.08)))),
        ((-0.5, 179.9999), (("S", (0.0, 30.0, 0.0)), ("E", (179.0, 59.0, 59.64)))),
    ],
)
def test_a_snapshot_holds_place_and_time(place: tuple[float, float], shown: tuple[Any, Any]) -> None:
    jpeg = with_place(jpeg_of(16, 16, [1, 2, 3, 4]), *place, 1_790_000_000_123, "Lake, bow")
    with Image.open(io.BytesIO(jpeg)) as image:
        image.load()
        exif = image.getexif()
    gps = exif.get_ifd(0x8825)
    found = ((gps[1], tuple(map(float, gps[2]))), (gps[3], tuple(map(float, gps[4]))))
    assert found == shown
    assert (exif[0x010E], exif[0x0132]) == ("Lake, bow", "2026:09:21 14:13:20")


def test_a_snapshot_without_a_place_has_none() -> None:
    with Image.open(io.BytesIO(with_place(jpeg_of(16, 16, [1, 2, 3, 4]), None, None, 0, "Lake"))) as image:
        assert image.getexif().get_ifd(0x8825) == {}
