"""cantcpd: CAN over TCP, the socketcand protocol and slcan (thesis 3.3). It watches the buses for any number of clients, and
sends for them.

A bus has one socket for all its clients, open while there are any. A frame becomes text once. Every client has a bounded queue
of its own: frames not taken in time are lost for it alone, oldest first, and counted. No callback takes longer for a slow
client, for one that floods, or for a full bus.

Address and identifier decide who may transmit (the vehicle's file); refused frames are counted and logged, but not answered,
because python-can's reader ends at an answer. Sent frames are on the bus, and so in the black box. The protocol itself:
delfim.canproxy.socketcand; how to connect the usual programs: docs/cantcpd.md.
"""

import asyncio
import logging
from collections.abc import Iterable, Mapping
from typing import Final

from delfim.base.clock import Clock
from delfim.canproxy import socketcand
from delfim.canproxy.cantcp import slcan
from delfim.canproxy.cantcp.access import Access, bus_name
from delfim.canproxy.cantcp.beacon import announce
from delfim.canproxy.cantcp.client import Client, Clients
from delfim.canproxy.cantcp.sharedbus import Readers, SharedBus
from delfim.canproxy.tables import Cantcpd

BEACON_EVERY: Final = 3  # polls

log = logging.getLogger(__name__)


class CanServer:
    """The service: `connection` and `slcan_connection` make the protocol of one connection, `poll` is called once a second."""

    def __init__(
        self,
        settings: Cantcpd,
        interfaces: Iterable[str],
        readers: Readers,
        clock: Clock,
        receive_buffer_bytes: int = 1 << 20,
        access: Access | None = None,
    ) -> None:
        """`access`: None where only the settings decide."""
        self.clients = Clients(settings, access or Access(settings))
        self.buses: Mapping[str, SharedBus] = {
            bus_name(interface): SharedBus(bus_name(interface), interface, readers, clock, receive_buffer_bytes)
            for interface in interfaces
        }
        self._beacon, self._polls = settings.beacon, 0
        self._silent: set[str] = set()  # interfaces where the beacon failed

    def connection(self) -> Client:
        return Client(self.clients, self.buses, socketcand.SocketcandSession(self.buses))

    def slcan_connection(self) -> Client:
        """Make a connection to the first bus: slcan cannot name others."""
        return Client(self.clients, self.buses, slcan.SlcanSession(next(iter(self.buses))))

    def poll(self, port: int) -> None:
        """Reopen buses that failed, close clients that stalled, announce `port` on the LAN."""
        for bus in self.buses.values():
            bus.poll()
        self.clients.poll(asyncio.get_running_loop().time())
        if self._polls % BEACON_EVERY == 0:
            for interface in self._beacon:
                self._announce(interface, port)
        self._polls += 1

    def _announce(self, interface: str, port: int) -> None:
        try:
            announce(interface, port, list(self.buses))
            self._silent.discard(interface)
        except OSError as error:  # down, without address, no LAN
            if interface not in self._silent:
                log.warning("cantcpd: no beacon on %s: %s", interface, error)
            self._silent.add(interface)

    def report(self) -> dict[str, object]:
        """The server's report, JSON-ready: every bus and every client."""
        return {
            "refused": self.clients.refused,
            "buses": {
                bus.name: {
                    "received": bus.received,
                    "transmitted": bus.transmitted,
                    "dropped": bus.dropped,
                    "failure": bus.failure,
                }
                for bus in self.buses.values()
            },
            "clients": {client.name: client.report() for client in self.clients.inside},
            "left": {host: dict(counts) for host, counts in self.clients.left.items()},
        }

    def close(self) -> None:
        """Close every connection and bus."""
        for client in list(self.clients.inside):
            client.abort()
        for bus in self.buses.values():
            bus.close()
