"""The kernel's clock and the battery clock: who keeps it, who may set it, and what is written where. The clock itself is set in
guests alone."""

import logging
import struct
from pathlib import Path

import pytest

from delfim.base.clock import MADE_NS
from delfim.services.clock import kernel
from delfim.services.clock.kernel import (
    KernelClock,
    Timex,
    battery_ns,
    keeper,
    left_alone,
    set_from_battery,
    write_battery,
)

DAY_NS = 86_400_000_000_000
NOW_NS = MADE_NS + 40 * DAY_NS + 3_723_600_000_000  # 2026-02-10 01:02:03.6


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    """A computer on which a program may set the clock and nobody else does."""
    folder = tmp_path / "proc"
    for pid, name in (("1", "delfim"), ("7", "sshd")):
        (folder / pid).mkdir(parents=True)
        (folder / pid / "comm").write_text(name + "\n")
    (folder / "self").mkdir()
    (folder / "self/status").write_text("Name:\tdelfim\nCapPrm:\t0\nCapEff:\t000001ffffffffff\n")
    return folder


def test_the_clock_is_set_where_nothing_speaks_against_it(proc):
    assert left_alone("auto", ("can0", "can1"), proc) == ""


@pytest.mark.parametrize(
    ("mode", "buses", "words"),
    [
        ("never", ("can0",), 'not set: clock.set = "never"'),
        ("auto", ("canloop:can0",), "not set: the bus is simulated"),
        ("auto", ("can0", "vcan1"), "not set: the bus is simulated"),
    ],
)
def test_it_is_left_alone_in_simulation_and_where_the_file_says_so(proc, mode, buses, words):
    assert left_alone(mode, buses, proc) == words


@pytest.mark.parametrize("name", ["chronyd", "ntpd", "systemd-timesyn"])
def test_it_is_left_to_another_keeper(proc, name):
    (proc / "7/comm").write_text(name + "\n")
    assert left_alone("auto", ("can0",), proc) == f"kept by {name}"
    assert keeper(proc) == name


@pytest.mark.parametrize("capabilities", ["CapEff:\t00000000a80425fb\n", ""])  # as in a container; a /proc without it
def test_it_is_left_alone_without_the_privilege(proc, capabilities):
    (proc / "self/status").write_text(f"Name:\tdelfim\n{capabilities}")
    assert left_alone("auto", ("can0",), proc) == "not set: this program may not (CAP_SYS_TIME)"


@pytest.mark.parametrize(
    ("timex", "disciplined"),
    [
        (Timex(status=0x40), False),
        (Timex(status=0x00), True),  # synchronised by somebody
        (Timex(status=0x41), True),  # a phase-locked loop is running, if not yet synchronised
        (Timex(status=0x40, freq=-1_234_567), True),  # chrony without rtcsync
    ],
)
def test_who_tunes_the_kernels_clock_keeps_it(monkeypatch, timex, disciplined):
    clock = KernelClock()
    monkeypatch.setattr(clock, "read", lambda: timex)
    assert clock.disciplined() is disciplined


def test_the_kernel_is_asked_and_not_changed():
    found = KernelClock().read()
    assert found.modes == 0


@pytest.fixture
def sysfs(tmp_path: Path) -> Path:
    (tmp_path / "sys/class/rtc/rtc0").mkdir(parents=True)
    return tmp_path / "sys"


def test_the_battery_clock_is_read(sysfs):
    assert battery_ns(sysfs) is None
    (sysfs / "class/rtc/rtc0/since_epoch").write_text("1770000000\n")
    assert battery_ns(sysfs) == 1_770_000_000_000_000_000


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch, proc: Path):
    """A board: its clock, its battery clock, and what was set."""

    class Board:
        time_ns, battery_ns, alone = 5_000_000_000, NOW_NS, ""

        def __init__(self) -> None:
            self.set: list[int] = []
            self.written: list[tuple[int, bytes]] = []

    found = Board()
    monkeypatch.setattr(kernel.time, "time_ns", lambda: found.time_ns)
    monkeypatch.setattr(kernel.time, "clock_settime_ns", lambda which, ns: found.set.append(ns))
    monkeypatch.setattr(kernel, "battery_ns", lambda: found.battery_ns)
    monkeypatch.setattr(kernel, "left_alone", lambda mode, buses: found.alone)
    monkeypatch.setattr(KernelClock, "disciplined", lambda self: False)
    monkeypatch.setattr(kernel.fcntl, "ioctl", lambda fd, request, words: found.written.append((request, words)))
    return found


def test_before_the_programs_a_clock_that_was_never_set_takes_the_battery_clocks_time(board, caplog):
    caplog.set_level(logging.INFO)
    set_from_battery("auto", ("can0",))
    assert board.set == [NOW_NS]
    assert [each.message for each in caplog.records] == ["clock: set by the battery clock to 2026-02-10 01:02:03 UTC"]


def test_an_empty_battery_gives_no_time(board, caplog):
    board.battery_ns = 946_684_800_000_000_000
    set_from_battery("auto", ("can0",))
    assert board.set == []
    assert "2000-01-01 00:00:00 UTC, before this program was made: it is not taken" in caplog.records[0].message
    board.battery_ns = None
    set_from_battery("auto", ("can0",))
    assert board.set == []


def test_a_clock_that_is_set_or_not_ours_is_left(board):
    board.time_ns = NOW_NS + 5 * DAY_NS
    set_from_battery("auto", ("can0",))
    board.time_ns, board.alone = 0, "kept by chronyd"
    set_from_battery("auto", ("can0",))
    assert board.set == []


def test_at_the_end_the_battery_clock_gets_the_time(board, tmp_path):
    board.time_ns = NOW_NS
    rtc = tmp_path / "rtc0"
    write_battery("auto", ("can0",), rtc)
    assert board.written == [], "there is none"
    rtc.touch()
    write_battery("auto", ("can0",), rtc)
    # struct rtc_time: second, minute, hour, day, month from 0, year from 1900
    assert board.written == [(0x4024700A, struct.pack("9i", 4, 2, 1, 10, 1, 126, 0, 0, 0))]


@pytest.mark.parametrize(("time_ns", "alone"), [(5_000_000_000, ""), (NOW_NS, "kept by ntpd")])
def test_a_battery_clock_does_not_get_1970_and_not_anothers_time(board, tmp_path, time_ns, alone):
    board.time_ns, board.alone = time_ns, alone
    (tmp_path / "rtc0").touch()
    write_battery("auto", ("can0",), tmp_path / "rtc0")
    assert board.written == []


def test_a_battery_clock_that_fails_costs_a_line(board, tmp_path, monkeypatch, caplog):
    def refuse(*_: object) -> None:
        raise OSError(22, "Invalid argument")

    board.time_ns = NOW_NS
    monkeypatch.setattr(kernel.fcntl, "ioctl", refuse)
    (tmp_path / "rtc0").touch()
    write_battery("auto", ("can0",), tmp_path / "rtc0")
    assert [each.message for each in caplog.records] == [f"clock: {tmp_path}/rtc0: Invalid argument"]
