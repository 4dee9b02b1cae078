"""A serial port at any rate and in either form, by the settings that the kernel then has; and bytes through it."""

import array
import fcntl
import os
import termios
from types import SimpleNamespace

import pytest

from delfim import serialline
from delfim.errors import DelfimError
from delfim.serialline import SerialLine, open_port


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


def test_a_port_that_floods_is_closed_until_the_next_look(terminal):
    far, near = terminal
    line = SerialLine(near, 4800, SimpleNamespace(time_ns=lambda: 1), flood_bytes=1000)
    while not line.trouble:
        os.write(far, bytes(100))
        line.read()
    assert line.trouble == "floods: more than 1000 bytes a second"
    assert line.read() == b""
    assert line.rebind()
    os.write(far, b"quiet")
    assert line.read().endswith(b"quiet")
    line.close()
