"""Access to the buses by TCP: which addresses may watch and transmit, and which identifiers are barred (the vehicle's file)."""

import ipaddress
from collections.abc import Iterable

from delfim import config
from delfim.frames import CAN_IDE, extended, standard


class Networks:
    """Networks of the vehicle's file; `host in networks` for the address of a peer, as a socket tells it."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = [ipaddress.ip_network(network) for network in networks]

    def __contains__(self, host: str) -> bool:
        address = _address(host)
        return any(address in network for network in self._networks)


class Access:
    """The networks that may watch and transmit, and the barred identifiers."""

    def __init__(self, settings: config.Cantcpd) -> None:
        self._watch, self._transmit = Networks(settings.watch), Networks(settings.transmit)
        self._barred = [_range(text) for text in settings.barred]

    def may_watch(self, host: str) -> bool:
        return host in self._watch

    def may_transmit(self, host: str) -> bool:
        return host in self._transmit

    def is_barred(self, arb: int) -> bool:
        return any(low <= arb <= high and not (arb ^ low) & CAN_IDE for low, high in self._barred)


def _range(text: str) -> tuple[int, int]:
    """First and last arbitration field of "040", "040-043" or "00000040-00000043"."""
    low, _, high = text.partition("-")
    arb = extended if len(low) == 8 else standard
    return arb(int(low, 16)), arb(int(high or low, 16))


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    address = ipaddress.ip_address(host.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address
