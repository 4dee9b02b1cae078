"""Who may speak on lines of NMEA 0183 over the network, on which this computer listens."""

from collections.abc import Collection, Iterator
from ipaddress import ip_network

from delfim import config
from delfim.base.ranges import is_loopback
from delfim.parts.nmea0183.table import Nmea0183
from delfim.services.access.exposure import EVERY, STEER, Entrance, beyond, listed


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    table = settings.of(Nmea0183)
    others = beyond(table.senders)
    for key, device in settings.outside("device").items():
        if not device.startswith(("udp:", "tcp-listen:")):
            continue
        may = STEER if key == "nmea0183.guest.device" else "tell the boat where it is"
        kind, _, place = device.partition(":")
        place = f"{place} UDP" if kind == "udp" else place
        if is_loopback(place.removesuffix(" UDP")) or not others:
            yield Entrance("vehicle", place, "here", EVERY, may)
            continue
        many = [each for each in others if ip_network(each).num_addresses > 1]
        fault = f"nmea0183.senders: anyone in {listed(many)} may {may}, by {key}; name single addresses" if many else ""
        yield Entrance("vehicle", place, "anyone", f"anyone with an address in {listed(others)}", may, fault)
