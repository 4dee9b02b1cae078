"""A serial port at any rate and in either form, by the settings that the kernel then has; and bytes through it."""

import array
import fcntl
import os
import re
import select
import termios
from types import SimpleNamespace

import pytest

from delfim.base.clock import ManualClock
from delfim.base.errors import DelfimError
from delfim.base.input.ratelimit import PIECE_BYTES, Allowance
from delfim.lines import serialline
from delfim.lines.serialline import SerialLine, open_port


@pytest.fixture
def terminal():
    """Both ends of a pseudo-terminal: the far end, and the name of the near one."""
    far, near = os.openpty()
    yield far, os.ttyname(near)
    os.close(far)
    os.close(near)


def rates(port: int) -> tuple[int, int]:
    settings = array.array("I", bytes(44))
    fcntl.ioctl(port, serialline.TCGETS2, settings)
    return settings[9], settings[10]


@pytest.mark.parametrize("baud", [4800, 57_600, 100_000, 416_666, 420_000])
def test_a_port_runs_at_the_rate_that_was_asked_for(terminal, baud):
    far, near = terminal
    port = open_port(near, baud, ignores_modem=True)
    assert rates(port) == (baud, baud)
    os.write(far, b"hear\x00\xff")
    assert os.read(port, 100) == b"hear\x00\xff"
    os.close(port)


def test_a_port_with_parity_and_two_stop_bits(terminal, monkeypatch):
    """A pseudo-terminal has no parity and drops that bit, so the settings are looked at on their way to the kernel."""
    asked = []
    set_all = termios.tcsetattr

    def setting(port, when, settings):
        asked.append(settings[2])
        set_all(port, when, settings)

    monkeypatch.setattr(termios, "tcsetattr", setting)
    os.close(open_port(terminal[1], 100_000, ignores_modem=True, form="8E2"))
    os.close(open_port(terminal[1], 100_000, ignores_modem=True))
    both = termios.PARENB | termios.CSTOPB
    assert [settings & both for settings in asked] == [both, 0]


def test_a_rate_that_the_port_cannot_make_is_refused_in_words(terminal, monkeypatch):
    monkeypatch.setattr(serialline, "_set_rate", lambda port, baud: 93_750)
    with pytest.raises(DelfimError, match=r"does not run at 100000 baud; the nearest rate that it can make is 93750"):
        open_port(terminal[1], 100_000, ignores_modem=True)


def test_a_line_of_an_odd_rate_is_read(terminal):
    far, near = terminal
    line = SerialLine(near, 420_000, SimpleNamespace(time_ns=lambda: 7))
    os.write(far, b"frame")
    assert line.read() == b"frame"
    line.close()


def test_a_port_that_floods_is_read_in_pieces_and_stays_open(terminal):
    far, near = terminal
    clock = ManualClock()
    line = SerialLine(near, 4800, clock, allowance=Allowance(4000, clock.monotonic_s))
    os.write(far, b"$GPHDT,1.0,T\r\n" * 200)
    taken = list[int]()
    while sum(taken) + line.allowance.bytes < 2800:
        assert select.select([line], [], [], 60.0)[0]
        taken.append(len(line.read()))
    assert max(taken) == PIECE_BYTES
    assert 1000 <= sum(taken) < 1000 + PIECE_BYTES
    assert line.trouble == ""
    clock.advance(1.0)
    assert line.rebind()
    assert re.fullmatch("more than it may say: 1[0-9]{2} sentences dropped, 1,[0-9]{3} bytes", line.trouble)
    os.write(far, b"$GPHDT,2.0,T\r\n$GPHDT,3.0,T\r\n")
    assert select.select([line], [], [], 60.0)[0]
    assert line.read().endswith(b"$GPHDT,3.0,T\r\n")
    line.rebind()
    line.rebind()
    assert line.trouble == ""
    line.close()
