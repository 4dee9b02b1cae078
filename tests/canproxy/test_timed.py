"""The time frame: who sends it when, and how late."""

import asyncio
import ctypes
import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import MADE_NS, ManualClock, SystemClock
from delfim.base.errors import BusError
from delfim.base.frames import Frame, standard
from delfim.canproxy import timekeeping
from delfim.canproxy.dsor.messages import TIME, TIME_FRAME, time_frame
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.canproxy.timekeeping import REDUNDANT_DELAY_S, SecondTimer, Timekeeper, TimeService

ROOT = Path(__file__).parents[2]
BUS = "canloop:timed"
S = 1_000_000_000


def frame(utc_ns: int) -> Frame:
    return Frame(TIME_FRAME, TIME.pack(utc_ns))


# Who sends


def test_the_master_says_the_time_each_second() -> None:
    keeper, clock = Timekeeper("master", 2.5, 0.0), ManualClock()
    sent = []
    for _ in range(3):
        sent.append(keeper.tick(clock.monotonic_s(), clock.time_ns()))
        clock.advance(1.0001)
    start = ManualClock().time_ns()
    assert sent == [frame(start), frame(start + 1_000_100_000), frame(start + 2_000_200_000)]
    assert keeper.report()["late_s"] == {"p50": 0.0001, "p99": 0.0002, "worst": 0.0002}


def test_each_vehicle_has_a_time_frame_of_its_own() -> None:
    keeper = Timekeeper("redundant", 2.5, 0.0, time_frame(0xD0))
    keeper.hear(frame(0), 0.5)
    assert keeper.report()["heard"] == 0, "another vehicle's"
    keeper.hear(Frame(standard(0x0D0), TIME.pack(0)), 0.5)
    assert keeper.report()["heard"] == 1
    assert keeper.tick(4.01, 4 * S + 10_000_000) == Frame(standard(0x0D0), TIME.pack(4 * S + 10_000_000))


def test_a_master_does_not_yield() -> None:
    keeper = Timekeeper("master", 2.5, 0.0)
    keeper.hear(frame(0), 0.1)
    assert keeper.tick(1.0, S) == frame(S)
    assert keeper.report()["heard"] == 1


def redundant(heard: list[bool], takeover_s: float = 2.5) -> list[bool]:
    """Whether it speaks in each second, given whether the master did, at its start."""
    keeper, spoke = Timekeeper("redundant", takeover_s, 0.0), []
    for second, master in enumerate(heard):
        if master:
            keeper.hear(frame(second * S), float(second))
        now_s = second + REDUNDANT_DELAY_S
        spoke.append(keeper.tick(now_s, round(now_s * 1e9)) is not None)
    return spoke


def test_the_redundant_one_takes_over_and_yields() -> None:
    master = [True, True, False, False, False, False, True, True, False, True]
    assert redundant(master) == [False, False, False, False, True, True, False, False, False, False]


def test_alone_it_waits_as_long_before_it_speaks() -> None:
    assert redundant([False] * 5) == [False, False, False, True, True]
    assert redundant([False] * 8, takeover_s=5.5) == [False] * 6 + [True] * 2


@given(st.lists(st.booleans(), max_size=40), st.floats(1.1, 10.0))
def test_it_never_speaks_in_a_second_in_which_the_master_does_nor_is_silent_for_long(master, takeover_s):
    spoke = redundant(master, takeover_s)
    assert not any(a and b for a, b in zip(master, spoke, strict=True))
    silent = 0
    for a, b in zip(master, spoke, strict=True):
        silent = 0 if a or b else silent + 1
        assert silent <= takeover_s + 1


def test_takeovers_are_counted() -> None:
    keeper = Timekeeper("redundant", 2.5, 0.0)
    for now_s in (3.0, 4.0):
        assert keeper.tick(now_s, S + 10_000_000)
    assert not keeper.tick(2.0, S + 510_000_000)  # and nothing is sent in the middle of a second
    keeper.hear(frame(0), 5.0)
    assert not keeper.tick(5.01, S)
    assert keeper.report() == {
        "mode": "redundant",
        "speaking": False,
        "sent": 2,
        "heard": 1,
        "takeovers": 1,
        "late_s": {"p50": 0.0, "p99": 0.0, "worst": 0.0},
    }


@pytest.mark.parametrize(
    "other", [Frame(standard(0x0C1), bytes(8)), Frame(TIME_FRAME, bytes(7)), Frame(standard(0x0C0, remote=True), bytes(8))]
)
def test_other_frames_are_no_master(other: Frame) -> None:
    keeper = Timekeeper("redundant", 2.5, 0.0)
    keeper.hear(other, 2.0)
    assert keeper.tick(3.0, S + 10_000_000) is not None
    assert keeper.report()["heard"] == 0


def test_jitter_is_that_of_the_last_ten_minutes() -> None:
    keeper = Timekeeper("master", 2.5, 0.0)
    for i in range(700):
        keeper.tick(float(i), i * S + (1000 if i < 100 else 2000))
    assert keeper.report()["late_s"] == {"p50": 2e-6, "p99": 2e-6, "worst": 2e-6}


# When: the timer


class Timerfd:
    """The kernel's side of a SecondTimer: what it was set to, and what reading gives."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.set: list[tuple[int, ...]] = []
        self.result: bytes | int = bytes(8)
        monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: self)
        monkeypatch.setattr(timekeeping.os, "read", self._read)

    def timerfd_create(self, clock: int, flags: int) -> int:
        assert (clock, flags) == (0, os.O_NONBLOCK | os.O_CLOEXEC)
        return 99

    def timerfd_settime(self, fd: int, flags: int, times: bytes, _: None) -> int:
        assert (fd, flags) == (99, 3)
        self.set.append(memoryview(times).cast("l").tolist())  # type: ignore[arg-type]
        return 0

    def _read(self, fd: int, length: int) -> bytes:
        assert (fd, length) == (99, 8)
        if isinstance(self.result, int):
            raise OSError(self.result, os.strerror(self.result))
        return self.result


@pytest.mark.parametrize(
    ("delay_s", "utc_ns", "first"),
    [
        (0.0, 7 * S, (8, 0)),
        (0.0, 7 * S + 1, (8, 0)),
        (0.0, 8 * S - 1, (8, 0)),
        (0.01, 7 * S + 1, (7, 10_000_000)),
        (0.01, 7 * S + 10_000_000, (8, 10_000_000)),
    ],
)
def test_the_timer_is_set_to_the_next_second(monkeypatch, delay_s, utc_ns, first):
    kernel = Timerfd(monkeypatch)
    SecondTimer(delay_s, utc_ns)
    assert kernel.set == [[1, 0, *first]]


def test_a_stepped_clock_sets_the_timer_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Timerfd(monkeypatch)
    timer = SecondTimer(0.0, 7 * S)
    assert timer.passed(8 * S)
    kernel.result = errno.ECANCELED
    assert not timer.passed(3 * S + 5)
    assert kernel.set[-1] == [1, 0, 4, 0]
    kernel.result = errno.EAGAIN
    assert not timer.passed(4 * S)
    assert len(kernel.set) == 2


def test_a_system_without_such_timers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    with pytest.raises(BusError, match="no timerfd"):
        SecondTimer(0.0, 0)


# Together


class Ticking:
    """A timer whose seconds begin when the test says so."""

    def passed(self, utc_ns: int) -> bool:
        return True


@pytest.fixture
def buses() -> Iterator[tuple[CanSocket, CanSocket]]:
    """The service's socket and another node's, which hears everything."""
    with open_can(BUS) as service, open_can(BUS) as other:
        service.setblocking(False)
        for each in (service, other):
            each.bind(CanAddress(TIME_FRAME))
        other.settimeout(200.0)
        yield service, other


def service(mode: Literal["master", "redundant"], can: CanSocket, clock: ManualClock) -> TimeService:
    return TimeService(Timekeeper(mode, 2.5, clock.monotonic_s()), Ticking(), can, clock)  # type: ignore[arg-type]


def test_frames_that_waited_count_before_the_second(buses: tuple[CanSocket, CanSocket]) -> None:
    """A program that stood still for five seconds must not take over from a master that it did not listen to."""
    can, other = buses
    clock = ManualClock(time_ns=MADE_NS)
    quiet = service("redundant", can, clock)
    clock.advance(5.0)
    other.sendmsg(frame(0))
    quiet.on_second()
    assert quiet.report()["sent"] == 0
    clock.advance(3.01)
    quiet.on_second()
    assert other.recvmsg()[:2] == (TIME_FRAME, TIME.pack(clock.time_ns()))
    assert quiet.report()["speaking"] is True
    other.sendmsg(frame(0))
    quiet.on_frames()
    assert quiet.report()["speaking"] is False


def test_a_bus_that_fails_is_counted_and_taken_up(buses: tuple[CanSocket, CanSocket], monkeypatch: pytest.MonkeyPatch) -> None:
    can, other = buses
    clock, rebound = ManualClock(time_ns=MADE_NS), []

    def fail(*_: object) -> None:
        raise BusError("gone")

    with monkeypatch.context() as broken:
        broken.setattr(can, "sendmsg", fail)
        broken.setattr(can, "receive", fail)
        broken.setattr(can, "rebind", lambda: rebound.append(1))
        master = service("master", can, clock)
        master.on_second()
    assert master.report()["failures"] == 2
    assert rebound == [1]
    clock.advance(1.0)
    master.on_second()
    assert other.recvmsg().data == TIME.pack(clock.time_ns())


def test_a_clock_that_was_never_set_is_not_sent(buses: tuple[CanSocket, CanSocket]) -> None:
    can, other = buses
    clock = ManualClock(time_ns=MADE_NS - S)
    master = service("master", can, clock)
    master.on_second()
    clock.advance(1.0)
    master.on_second()
    assert master.report()["sent"] == 1
    assert other.recvmsg().data == TIME.pack(MADE_NS)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(200):
        while not condition():
            await asyncio.sleep(0.001)


def test_in_a_real_loop_the_frame_comes_at_the_start_of_a_second(buses: tuple[CanSocket, CanSocket]) -> None:
    can, other = buses
    clock = SystemClock()

    async def main() -> TimeService:
        timer = SecondTimer(0.0, clock.time_ns())
        master, loop = TimeService(Timekeeper("master", 2.5, 0.0), timer, can, clock), asyncio.get_running_loop()
        loop.add_reader(timer.fileno(), master.on_second)
        await until(lambda: master.report()["sent"] == 2)
        loop.remove_reader(timer.fileno())
        timer.close()
        return master

    master = asyncio.run(main())
    first, second = (other.recvmsg() for _ in range(2))
    for each in (first, second):
        says = TIME.unpack(each.data)[0]
        assert says % S < S // 4
        assert abs(each.t_ns - says) < S // 4
    assert TIME.unpack(second.data)[0] // S == TIME.unpack(first.data)[0] // S + 1
    assert "worst" in master.report()["late_s"]  # type: ignore[operator]


@pytest.mark.parametrize("mode", ["master", "redundant"])
def test_the_service_runs_in_a_process_of_its_own(buses: tuple[CanSocket, CanSocket], tmp_path: Path, mode: str) -> None:
    _, other = buses
    overrides = (
        f'can.interface="{BUS}"',
        f'timed.mode="{mode}"',
        "timed.takeover_s=1.1",
        f'runtime.run_directory="{tmp_path}"',
    )
    words = [word for override in overrides for word in ("--set", override)]
    command = [sys.executable, "-m", "delfim", "run", "etc/delfimx.toml", "--service", "timed", *words]
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE) as program:
        other.settimeout(200.0)
        try:
            assert TIME.unpack(other.recvmsg().data)[0] % S < S // 4
            if mode == "redundant":
                other.sendmsg(frame(0))  # the master is back
                other.settimeout(1.0)
                with pytest.raises(TimeoutError):
                    other.recvmsg()
        finally:
            program.send_signal(signal.SIGTERM)
            errors = program.communicate(timeout=200)[1].decode()
    assert program.returncode == 0, errors
    assert ("sends it now" in errors, "stops sending" in errors) == (mode == "redundant", mode == "redundant")


def test_report_is_json() -> None:
    keeper = Timekeeper("master", 2.5, 0.0)
    assert json.loads(json.dumps(keeper.report()))["late_s"] == {}
