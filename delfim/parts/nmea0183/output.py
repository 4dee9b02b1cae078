"""Sends navigation to other instruments, as NMEA 0183 sentences on serial lines and by UDP (docs/nmea0183.md).

A few tens of microseconds each time, between navigation and in its turn; nothing here waits.
"""

import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import Protocol

from delfim import config
from delfim.base.clock import Clock
from delfim.base.ranges import address
from delfim.lines.nmea0183.speaking import SPEAKERS
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Out
from delfim.vehicle.links import ReadableLine
from delfim.vehicle.state import State


class Outgoing(Protocol):
    """The output of sentences: a serial line, or `Datagrams`."""

    def write(self, data: bytes) -> bool: ...  # False when not all was taken


class Datagrams:
    """Datagrams to one address, which may be a LAN's broadcast address."""

    def __init__(self, place: str) -> None:
        self._to = address(place)
        family = socket.AF_INET6 if ":" in self._to[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self.close = self._socket.close

    def write(self, data: bytes) -> bool:
        with contextlib.suppress(OSError):
            return self._socket.sendto(data, self._to) == len(data)
        return False


class Teller:
    """The output of one table [nmea0183.out.NAME]. Call `tell` every `period_s`."""

    def __init__(self, table: Nmea0183Out, to: Outgoing, stale_s: float, state: State, clock: Clock) -> None:
        self.period_s = 1.0 / table.rate_hz
        self._speakers = [SPEAKERS[name] for name in table.sentences]
        self._to, self._stale_s, self._state, self._clock = to, stale_s, state, clock
        self._told = self._silent = self._lost = 0

    def tell(self) -> None:
        """Send the sentences; nothing while navigation is silent or knows nothing."""
        n, age_s = self._state.navigation, self._clock.monotonic_s() - self._state.navigation_s
        data = b"" if n is None or age_s > self._stale_s else b"".join(speak(n) for speak in self._speakers)
        if not data:
            self._silent += 1
        elif self._to.write(data):
            self._told += 1
        else:
            self._lost += 1

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: how often sentences were sent, navigation was unknown, and the output took nothing."""
        return {"told": self._told, "unknown": self._silent, "lost": self._lost}


def tellers(
    settings: config.Vehicle,
    line: Callable[[str, int], ReadableLine],
    links: contextlib.ExitStack,
    state: State,
    clock: Clock,
) -> Iterator[tuple[str, Teller]]:
    """The outputs of the vehicle's file, by name. `links` closes what is opened here. Raises DelfimError."""
    for name, table in settings.of(Nmea0183).out.items():
        to: Outgoing
        if table.to.startswith("udp:"):
            to = datagrams = Datagrams(table.to.removeprefix("udp:"))
            links.callback(datagrams.close)
        else:
            to = line(table.to, table.baud)
        yield name, Teller(table, to, settings.navigation.stale_s, state, clock)
