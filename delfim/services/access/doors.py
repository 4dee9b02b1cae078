"""The doors of a boat, as its vehicle's file opens them: what listens where, who is let in, and what one can do there.

`delfim check --sea` prints them. A door has a fault where somebody beyond this computer could move the boat or write to it
without a key or a password.
"""

from collections.abc import Collection, Iterator, Sequence
from ipaddress import ip_network
from typing import Final, Literal, NamedTuple

from delfim import config
from delfim.base.ranges import is_loopback
from delfim.canproxy.tables import Canip, Cantcpd
from delfim.services.tables import Ftpd, Httpd, Slipd, Sshd
from delfim.simulator.tables import Simulation

EVERY: Final = "every program of this computer"


class Entrance(NamedTuple):
    """One door. `reach`: open to anyone who gets there, to those who are known, or to this computer alone."""

    service: str
    place: str  # ADDRESS:PORT, a serial line, a file
    reach: Literal["anyone", "known", "here"]
    who: str
    may: str
    fault: str = ""  # why the boat must not go to sea like this; empty: it may


def doors(settings: config.Vehicle, running: Collection[str]) -> list[Entrance]:
    """All doors of a boat, those that anyone may use first. `running`: the services that its file enables."""
    found = [*_console(settings), *_guest(settings), *_instruments(settings)]
    for name, of_service in SERVICES.items():
        if name in running:
            found += of_service(settings)
    order = ("anyone", "known", "here")
    return sorted(found, key=lambda door: order.index(door.reach))


def _console(settings: config.Vehicle) -> Iterator[Entrance]:
    here = "programs of this computer that may open the file"
    fault = "simulation.faults lets `delfim fault` break the boat's log and links" if settings.of(Simulation).faults else ""
    yield Entrance("vehicle", settings.console.socket, "here", here, "command the boat", fault)
    mavlink = settings.table("mavlink")
    if mavlink.enabled and mavlink.key:
        for place in (f"{mavlink.listen} UDP", *([mavlink.serial] if mavlink.serial else [])):
            yield Entrance("mavlink", place, "known", f"holders of {mavlink.key}", "watch and command the boat")
    elif mavlink.enabled:
        yield Entrance(
            "mavlink",
            f"{mavlink.listen} UDP",
            "here",
            f"{EVERY}, for there is no key",
            "command the boat",
        )


def unheard(settings: config.Vehicle) -> str:
    """Why no console on another computer can reach the boat; "": one can."""
    mavlink = settings.table("mavlink")
    if not mavlink.enabled:
        return "mavlink.enabled is false"
    if not mavlink.key:
        return "mavlink.key is empty, and without a key only this computer is heard"
    if is_loopback(mavlink.listen) and not (mavlink.serial or settings.table("fleet").broker):
        return f"mavlink.listen is {mavlink.listen}, which only this computer reaches"
    return ""


_STEER: Final = "be the guest computer, which steers in mode grex"


def _guest(settings: config.Vehicle) -> Iterator[Entrance]:
    table, may = settings.guest, _STEER
    if table.enabled and table.key:
        who = f"holders of {table.key} in {_networks(table.networks)}"
        yield Entrance("guest", table.listen, "known", who, may)
    elif table.enabled:
        yield Entrance("guest", table.listen, "here", f"{EVERY}, for there is no key", may)


def _instruments(settings: config.Vehicle) -> Iterator[Entrance]:
    """Lines of NMEA 0183 over the network, on which this computer listens."""
    table = settings.table("nmea0183")
    beyond = _beyond(table.senders)
    for key, device in settings.outside("device").items():
        if not device.startswith(("udp:", "tcp-listen:")):
            continue
        may = _STEER if key == "nmea0183.guest.device" else "tell the boat where it is"
        kind, _, place = device.partition(":")
        place = f"{place} UDP" if kind == "udp" else place
        if is_loopback(place.removesuffix(" UDP")) or not beyond:
            yield Entrance("vehicle", place, "here", EVERY, may)
            continue
        many = [each for each in beyond if ip_network(each).num_addresses > 1]
        fault = f"nmea0183.senders: anyone in {_networks(many)} may {may}, by {key}; name single addresses" if many else ""
        yield Entrance("vehicle", place, "anyone", f"anyone with an address in {_networks(beyond)}", may, fault)


def _cantcpd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Cantcpd)
    for listen in (*table.listen, *table.slcan):
        watching, sending = _beyond(table.watch), _beyond(table.transmit)
        if is_loopback(listen) or not watching:
            may = "read the buses and send frames" if table.transmit else "read the buses"
            yield Entrance("cantcpd", listen, "here", EVERY, may)
            continue
        fault = f"cantcpd.transmit: anyone in {_networks(sending)} may send frames, which move the boat" if sending else ""
        may = "read the buses and send frames" if sending else "read the buses"
        yield Entrance("cantcpd", listen, "anyone", f"anyone in {_networks(watching)}", may, fault)


def _httpd(settings: config.Vehicle) -> Iterator[Entrance]:
    yield _open("httpd", settings.of(Httpd).listen, "read the boat's page and its logs")


def _slipd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Slipd)
    place = f"{table.device}, {table.address}"
    yield Entrance("slipd", place, "anyone", "anyone with such a radio on its frequency", "reach the doors of this list")


def _canip(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Canip)
    yield Entrance(
        "canip", f"{table.device}, {table.address}", "anyone", "nodes of the bus", "reach the UDP doors of this list"
    )


def _ftpd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Ftpd)
    writers = [name for name, user in table.users.items() if user.upload]
    may = f"read {table.root}" + (f"; upload: {', '.join(writers)}" if writers else "")
    how = "by password, over TLS" if table.certificate else "by password, in the clear"
    in_clear = not table.certificate and not is_loopback(table.listen)
    fault = "ftpd: whoever hears a password may upload; name a certificate (ftpd.certificate)" if in_clear and writers else ""
    yield Entrance("ftpd", table.listen, "known", f"{', '.join(table.users)}, {how}", may, fault)


def _sshd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Sshd)
    may = f"run programs as {table.user or 'the user that started Delfim'}, read and write files"
    yield Entrance("sshd", table.listen, "known", f"{', '.join(table.users)}, by key", may)


def _fleetd(settings: config.Vehicle) -> Iterator[Entrance]:
    table, key = settings.table("fleet"), settings.table("mavlink").key
    yield Entrance("fleetd", table.broker, "known", f"holders of {key}, through the broker", "watch and command the boat")
    where = "the broker knows who may read it" if table.credentials else "anyone who may read at the broker"
    yield Entrance("fleetd", f"{table.broker}, state", "anyone", where, "read where the boat is")
    yield Entrance("fleetd", f"{table.listen} UDP", "here", EVERY, "send bytes to the broker; without the key they say nothing")


def _rosd(settings: config.Vehicle) -> Iterator[Entrance]:
    may = f"read the boat's state; {_STEER}" if settings.table("ros").commands else "read the boat's state"
    yield Entrance("rosd", settings.table("ros").router, "anyone", "anyone who reaches this Zenoh router", may)


def _payload(settings: config.Vehicle) -> Iterator[Entrance]:
    """No door, and others who may steer all the same."""
    for name, table in settings.table("payload").items():
        if table.may:
            may = f"order: {', '.join(table.may)}"
            yield Entrance("payload", table.command[0], "here", f"payload {name}, when an operator gave it the boat", may)


SERVICES = {
    "rosd": _rosd,
    "fleetd": _fleetd,
    "httpd": _httpd,
    "cantcpd": _cantcpd,
    "slipd": _slipd,
    "canip": _canip,
    "ftpd": _ftpd,
    "sshd": _sshd,
    "payload": _payload,
}


def _open(service: str, listen: str, may: str) -> Entrance:
    if is_loopback(listen):
        return Entrance(service, listen, "here", EVERY, may)
    return Entrance(service, listen, "anyone", "anyone who reaches this address", may)


def _beyond(networks: Sequence[str]) -> list[str]:
    """Those that reach beyond this computer."""
    return [each for each in networks if not ip_network(each).is_loopback]


def _networks(networks: Sequence[str]) -> str:
    return ", ".join(networks) or "no network"
