"""The exposure of a boat by its vehicle's file: what listens where, who is admitted, and what one can do there.

`delfim check --sea` prints them. A door has a fault where somebody beyond this computer could move the boat or write to it
without a key or a password.
"""

from collections.abc import Collection, Iterator, Sequence
from ipaddress import ip_network
from typing import Final, Literal, NamedTuple

from delfim import config
from delfim.base import parts
from delfim.base.ranges import is_loopback
from delfim.canproxy.tables import Canip, Cantcpd
from delfim.services.tables import Ftpd, GuestTable, Httpd, Slipd, Sshd, Tablet
from delfim.simulator.tables import Simulation

EVERY: Final = "every program of this computer"


class Entrance(NamedTuple):
    """One listener. `reach`: open to anyone who gets there, to those who are known, or to this computer alone."""

    service: str
    place: str  # ADDRESS:PORT, a serial line, a file
    reach: Literal["anyone", "known", "here"]
    who: str
    may: str
    fault: str = ""  # why the boat must not go to sea like this; empty: it may


def doors(settings: config.Vehicle, running: Collection[str]) -> list[Entrance]:
    """List all listeners of a boat, those that anyone may use first. `running`: the services that its file enables."""
    found = [*_console(settings)]
    for part in parts.OWN.values():
        if part.exposure:
            found += parts.load(part, part.exposure)(settings, running)
    found += _guest(settings)
    for name, of_service in SERVICES.items():
        if name in running:
            found += of_service(settings)
    order = ("anyone", "known", "here")
    return sorted(found, key=lambda door: order.index(door.reach))


def _console(settings: config.Vehicle) -> Iterator[Entrance]:
    here = "programs of this computer that may open the file"
    fault = "simulation.faults lets `delfim fault` break the boat's log and links" if settings.of(Simulation).faults else ""
    yield Entrance("vehicle", settings.console.socket, "here", here, "command the boat", fault)


def unheard(settings: config.Vehicle) -> str:
    """The reason why no console on another computer can reach the boat; "": one can."""
    reasons = settings.facts("unheard")
    return "" if "" in reasons else next(iter(reasons), "nothing aboard listens to consoles")


STEER: Final = "be the guest computer, which steers in mode grex"


def _guest(settings: config.Vehicle) -> Iterator[Entrance]:
    table, may = settings.of(GuestTable), STEER
    if table.enabled and table.key:
        who = f"holders of {table.key} in {listed(table.networks)}"
        yield Entrance("guest", table.listen, "known", who, may)
    elif table.enabled:
        yield Entrance("guest", table.listen, "here", f"{EVERY}, for there is no key", may)


def _cantcpd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Cantcpd)
    for listen in (*table.listen, *table.slcan):
        watching, sending = beyond(table.watch), beyond(table.transmit)
        if is_loopback(listen) or not watching:
            may = "read the buses and send frames" if table.transmit else "read the buses"
            yield Entrance("cantcpd", listen, "here", EVERY, may)
            continue
        fault = f"cantcpd.transmit: anyone in {listed(sending)} may send frames, which move the boat" if sending else ""
        may = "read the buses and send frames" if sending else "read the buses"
        yield Entrance("cantcpd", listen, "anyone", f"anyone in {listed(watching)}", may, fault)


def _httpd(settings: config.Vehicle) -> Iterator[Entrance]:
    yield _open("httpd", settings.of(Httpd).listen, "read the boat's page and its logs")


def _tabletd(settings: config.Vehicle) -> Iterator[Entrance]:
    table = settings.of(Tablet)
    in_clear = not table.certificate and not is_loopback(table.listen)
    fault = "tabletd: whoever hears the token commands the boat; name a certificate (tablet.certificate)" if in_clear else ""
    who, is_here = f"holders of the token or of an operator's key in {table.directory}", is_loopback(table.listen)
    how = "" if is_here else ", in the clear" if in_clear else ", over TLS"
    yield Entrance("tabletd", table.listen, "here" if is_here else "known", f"{who}{how}", "watch and command the boat", fault)


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


SERVICES = {
    "httpd": _httpd,
    "tabletd": _tabletd,
    "cantcpd": _cantcpd,
    "slipd": _slipd,
    "canip": _canip,
    "ftpd": _ftpd,
    "sshd": _sshd,
}


def _open(service: str, listen: str, may: str) -> Entrance:
    if is_loopback(listen):
        return Entrance(service, listen, "here", EVERY, may)
    return Entrance(service, listen, "anyone", "anyone who reaches this address", may)


def beyond(networks: Sequence[str]) -> list[str]:
    """Those that reach beyond this computer."""
    return [each for each in networks if not ip_network(each).is_loopback]


def listed(networks: Sequence[str]) -> str:
    """Networks in words."""
    return ", ".join(networks) or "no network"
