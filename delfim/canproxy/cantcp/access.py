"""Access to the buses by TCP: which addresses may watch and transmit, and which identifiers are barred (the vehicle's file)."""

import ipaddress
import re
from collections.abc import Collection, Iterable
from typing import Final

from delfim import config
from delfim.base.frames import CAN_IDE, extended, identifier, standard
from delfim.canproxy.dsor.messages import Node, time_frame
from delfim.canproxy.dsor.protocol import SOURCE_AT
from delfim.canproxy.tables import Cantcpd

_OWN: Final = frozenset(Node) - {Node.BROADCAST}


class Networks:
    """Networks of the vehicle's file; `host in networks` tests the address of a peer, as a socket has it."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = [ipaddress.ip_network(network) for network in networks]

    def __contains__(self, host: str) -> bool:
        address = _address(host)
        return any(address in network for network in self._networks)


class Access:
    """The networks that may watch and transmit, the barred identifiers, and those that only the boat's nodes may send."""

    def __init__(self, settings: Cantcpd, can: config.Can | None = None, closed: Collection[str] = ()) -> None:
        """`can`: the bus of the boat's nodes. `closed`: the interfaces where only devices may send."""
        self._can, self._closed = can, closed
        self._watch, self._transmit = Networks(settings.watch), Networks(settings.transmit)
        self._barred = [_range(text) for text in settings.barred]

    def may_watch(self, host: str) -> bool:
        return host in self._watch

    def may_transmit(self, host: str) -> bool:
        return host in self._transmit

    def refusal(self, host: str, interface: str, arb: int) -> str:
        """The reason, in words, why a client there may not send this on this bus; empty: it may."""
        if not self.may_transmit(host):
            return "its network may only watch (cantcpd.transmit)"
        if interface in self._closed:
            return "only devices speak on this bus: they command motors, or tell the boat where it is"
        if self.is_barred(arb):
            return f"{identifier(arb):X} is barred"
        return f"{identifier(arb):X} is for the boat's own nodes alone" if self._poses(interface, arb) else ""

    def _poses(self, interface: str, arb: int) -> bool:
        """Whether this frame is the time, or comes from a node of the boat: by such messages it sails."""
        if self._can is None or interface != self._can.interface:
            return False
        return arb >> SOURCE_AT & 0x7F in _OWN if arb & CAN_IDE else arb == time_frame(self._can.vehicle)

    def is_barred(self, arb: int) -> bool:
        return any(low <= arb <= high and not (arb ^ low) & CAN_IDE for low, high in self._barred)


def _range(text: str) -> tuple[int, int]:
    """Parse "040", "040-043" or "00000040-00000043" to the first and last arbitration field."""
    low, _, high = text.partition("-")
    arb = extended if len(low) == 8 else standard
    return arb(int(low, 16)), arb(int(high or low, 16))


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    address = ipaddress.ip_address(host.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def bus_name(interface: str) -> str:
    """The name by which clients open an interface: the part after its last colon, 16 characters at most."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", interface.rpartition(":")[2])[:16]
