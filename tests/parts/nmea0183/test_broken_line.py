"""A serial line of sensors that floods, falls silent, speaks at another rate, is pulled out and comes back as another device:
told in words, and heard again.
"""

import os
import re
import select
import tty
from pathlib import Path

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.input.ratelimit import Allowance
from delfim.lines.nmea0183.framing import framed
from delfim.lines.serialline import SerialLine
from delfim.parts.nmea0183.source import GARBLED_S, Nmea0183Navigation, opened
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.vehicle.links import Links

FLOOD_BYTES = 20_000


class Plugged:
    """A device under a name that stays, as those of /dev/serial/by-id."""

    def __init__(self, name: Path) -> None:
        self._name = name
        self.end, self._port = os.openpty()
        tty.setraw(self._port)
        name.symlink_to(os.ttyname(self._port))

    def pull(self) -> None:
        self._name.unlink()
        os.close(self._port)
        os.close(self.end)


class Boat:
    """The source on a real line, and its clock."""

    def __init__(self, device: Path) -> None:
        self.clock = ManualClock(monotonic_s=1000.0)
        self.got = self.said = 0  # bytes
        self.line = SerialLine(
            str(device), 4800, self.clock, self._count, True, allowance=Allowance(FLOOD_BYTES, self.clock.monotonic_s)
        )
        self.line.rebind()
        settings = config.Vehicle(
            boat=config.BoatTable(name="tried"),
            navigation=config.NavigationTable(sources=("nmea0183",)),
            nmea0183=Nmea0183(ports={"gnss": Nmea0183Port(device=str(device))}),
        )
        self.source: Nmea0183Navigation = opened(
            settings, Links(lambda *_: pytest.fail("no bus"), lambda *_: self.line), {}, lambda *_: None
        )

    def _count(self, t_ns: int, data: bytes) -> None:
        self.got += len(data)

    def hear(self, device: Plugged, say: bytes) -> None:
        """All that the device says now, as the loop reads it."""
        self.said += os.write(device.end, say)
        while self.got + self.line.allowance.bytes < self.said:
            assert select.select([self.source.input], [], [], 60.0)[0]
            self.source.read(self.clock.monotonic_s())

    def hears(self, seconds: int, device: Plugged, say: bytes) -> bool:
        """Whether positions came while the device said this each second."""
        before = self.source.heard_s
        for _ in range(seconds):
            self.hear(device, say)
            self.words()
            self.clock.advance(1.0)
        return self.source.heard_s > before

    def words(self) -> str:
        """Of the port, as the statistics page and `delfim sensors` have them."""
        ports = self.source.report(self.clock.monotonic_s())["ports"]
        assert isinstance(ports, dict)
        return str(ports["gnss"]["garbled"] or self.line.trouble)


def fixes(count: int) -> bytes:
    rows = (f"GPRMC,1200{each:02d}.00,A,3841.44{each:02d},N,00912.9180,W,2.0,90.0,221126,,,A" for each in range(count))
    return b"".join(map(framed, rows))


def test_each_is_told_in_words_and_heard_again(tmp_path):
    device = Plugged(tmp_path / "gnss")
    boat = Boat(tmp_path / "gnss")
    assert boat.hears(3, device, fixes(10))
    assert boat.words() == ""

    while boat.line.allowance.bytes < FLOOD_BYTES:  # it floods
        boat.hear(device, fixes(10))
    assert boat.line.rebind()
    assert re.fullmatch("more than it may say: [0-9]{3} sentences dropped, 2[0-9],[0-9]{3} bytes", boat.words())
    assert boat.hears(3, device, fixes(10))
    boat.line.rebind()
    boat.line.rebind()
    assert boat.words() == ""

    boat.clock.advance(10.0)  # it is silent: that is a trouble of navigation, and none of the line
    assert boat.words() == ""

    nonsense = bytes(range(128, 160)) + b"\n"  # at another rate
    assert not boat.hears(int(GARBLED_S) + 2, device, nonsense)
    assert boat.words() == "bytes but no sentence for 5 s: is the baud rate still that of the file?"
    assert boat.hears(3, device, fixes(10))
    assert boat.words() == ""

    device.pull()
    boat.source.read(boat.clock.monotonic_s())
    assert boat.words() in ("Input/output error", "hung up")
    assert not boat.line.rebind()
    assert boat.words() == "No such file or directory"
    others = Plugged(tmp_path / "other")  # takes the number that was free
    device = Plugged(tmp_path / "gnss")
    assert boat.line.rebind()
    assert boat.hears(3, device, fixes(10))
    assert boat.words() == ""
    boat.line.close()
    for each in (others, device):
        each.pull()
