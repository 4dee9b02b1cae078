"""The program that grabs: real processes, which end, hang, flood, and say why."""

import os
import select
import shutil
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from delfim.base.clock import ManualClock, SystemClock
from delfim.parts.camera import grabber
from delfim.parts.camera.grabber import Grabber, Picture, command, encoding, sizes
from delfim.parts.camera.jpegblocks import size_of
from delfim.parts.camera.table import CameraTable
from tests.parts.camera.test_pictures import clock_in

TABLE = CameraTable(source="test", rate_hz=30.0)


class Readers:
    """What the runtime does with files that are readable."""

    def __init__(self) -> None:
        self.handlers = dict[int, Callable[[], object]]()

    def reader(self, fd: int, handler: Callable[[], object]) -> None:
        self.handlers[fd] = handler

    def remove_reader(self, fd: int) -> None:
        self.handlers.pop(fd, None)

    def turn(self) -> None:
        """Waits until something is readable, and has it read; a program that closed its pipes is only looked at again."""
        for fd in select.select(list(self.handlers), [], [], 20.0 if self.handlers else 0.01)[0]:
            if fd in self.handlers:
                self.handlers[fd]()


@pytest.fixture
def readers() -> Readers:
    return Readers()


Grab = Callable[..., tuple[Grabber, list[tuple[int, Picture]]]]


@pytest.fixture
def grab(readers: Readers) -> Iterator[Grab]:
    made = list[Grabber]()

    def grab(table: CameraTable = TABLE, clock: ManualClock | None = None) -> tuple[Grabber, list[tuple[int, Picture]]]:
        took = list[tuple[int, Picture]]()
        made.append(Grabber("bow", table, clock or SystemClock(), readers, lambda level, each: took.append((level, each))))
        return made[-1], took

    yield grab
    for each in made:
        each.close()
    assert not readers.handlers


def told(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """That program in place of ffmpeg: `fd` are its pipes."""

    def words(table: CameraTable, fds: list[int]) -> list[str]:
        return [sys.executable, "-c", f"import os, signal, sys\nfd = {fds}\n{program}"]

    monkeypatch.setattr(grabber, "command", words)


def until(readers: Readers, its: Grabber, done: Callable[[], object]) -> None:
    while not done():
        readers.turn()
        its.tick()


def test_pictures_come_in_three_sizes_and_hold_the_time(readers: Readers, grab: Grab) -> None:
    its, took = grab()
    its.tick()
    until(readers, its, lambda: {0, 1, 2} <= {level for level, _ in took})
    for level, picture in took:
        assert size_of(picture.jpeg) == sizes(TABLE)[level]
        assert 0 <= picture.taken_ms % (1 << 40) - clock_in(picture.jpeg) < 60_000
    assert its.report()["why"] == ""


def test_the_last_word_of_a_program_that_ends_is_the_reason(
    readers: Readers, grab: Grab, monkeypatch: pytest.MonkeyPatch
) -> None:
    told(monkeypatch, "sys.stderr.write('trying\\nConnection refused\\n')")
    its, _ = grab()
    its.tick()
    until(readers, its, lambda: its.why != "starting")
    assert its.why == "Connection refused"
    assert its.report()["starts"] == 1


def test_it_is_started_again_after_pauses_that_grow(grab: Grab, monkeypatch: pytest.MonkeyPatch) -> None:
    told(monkeypatch, "signal.pause()")
    clock = ManualClock(0.0)
    its, _ = grab(clock=clock)
    begun = list[float]()
    before = 0
    for _ in range(1000):
        its.tick()
        if its.starts > before:
            before = its.starts
            begun.append(clock.monotonic_s())
        clock.advance(0.1)
    gaps = [round(later - one) for one, later in pairwise(begun)]
    assert gaps == [21, 22, 25, 30]  # 20 s without a picture, and the pause
    assert its.why == "no picture for 20 s"


FLOODING = """
from delfim.parts.camera.played import PlayedPictures, mpjpeg
data = mpjpeg(PlayedPictures(64, 64).picture(1))
while True:
    os.write(fd[0], data)
"""


def test_one_that_floods_is_ended(readers: Readers, grab: Grab, monkeypatch: pytest.MonkeyPatch) -> None:
    told(monkeypatch, FLOODING)
    clock = ManualClock(0.0)
    its, took = grab(clock=clock)
    its.tick()
    until(readers, its, lambda: its.why and its.why != "starting")
    assert its.why == "more than 130 pictures a second"
    assert len(took) <= 131


def test_one_that_writes_something_else_is_ended(readers: Readers, grab: Grab, monkeypatch: pytest.MonkeyPatch) -> None:
    told(monkeypatch, "os.write(fd[0], b'x' * 60000)\nsignal.pause()")
    its, took = grab()
    its.tick()
    until(readers, its, lambda: its.why != "starting")
    assert (its.why, took) == ("it writes no pictures", [])


def test_without_ffmpeg_it_says_what_to_install(grab: Grab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    its, _ = grab(CameraTable(source="/dev/video0"))
    its.tick()
    assert its.why == "ffmpeg is not installed: apt install ffmpeg"


def test_the_password_is_in_the_programs_words_and_in_no_others(
    tmp_path: Path, readers: Readers, grab: Grab, monkeypatch: pytest.MonkeyPatch
) -> None:
    login = tmp_path / "login"
    login.write_text("ana:secret\n")
    login.chmod(0o600)
    table = CameraTable(source="rtsp://10.0.0.5/main", credentials=str(login))
    monkeypatch.setattr(shutil, "which", lambda name: "/bin/ffmpeg")
    assert "rtsp://ana:secret@10.0.0.5/main" in command(table, (3, 4, 5))
    told(monkeypatch, "sys.stderr.write('rtsp://ana:secret@10.0.0.5/main: 401, secret\\n')")
    its, _ = grab(table)
    its.tick()
    until(readers, its, lambda: its.why != "starting")
    assert its.why == "rtsp://...@10.0.0.5/main: 401, ..."


def test_ffmpeg_writes_the_first_picture_of_each_period_at_once(
    tmp_path: Path, readers: Readers, grab: Grab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None waits for another one: a picture that did would be a period older, with each thread that encodes one more."""
    table, line = CameraTable(source="/dev/video0", rate_hz=10.0), tmp_path / "frames"
    os.mkfifo(line)

    def words(table: CameraTable, fds: list[int]) -> list[str]:
        frames = ["-f", "rawvideo", "-pix_fmt", "yuv420p", "-s", f"{table.width_px}x{table.height_px}", "-framerate", "30"]
        return ["ffmpeg", "-nostdin", "-loglevel", "error", *frames, "-i", str(line), *encoding(table, fds)]

    monkeypatch.setattr(grabber, "command", words)
    its, took = grab(table)
    its.tick()
    with line.open("wb") as feed:
        feed.write(bytes(table.width_px * table.height_px * 3 // 2 * 10))  # at 30 a second: the first, 4th, 7th, 10th
        feed.flush()
        until(readers, its, lambda: len(took) == 4 * len(sizes(table)))
    assert {(level, size_of(each.jpeg)) for level, each in took} == set(enumerate(sizes(table)))
