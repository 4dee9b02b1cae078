"""The keys of the fleet's broker in a vehicle's file (docs/fleets.md)."""

from typing import Annotated, Any

import msgspec

from delfim.base.ranges import PORT, Listen, address, is_loopback
from delfim.base.tables import Table, text

FleetBroker = Annotated[
    str,
    text(
        rf"(mqtts?://([A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\]):{PORT}(/[A-Za-z0-9_-]{{1,40}})?)?",
        "mqtts://HOST:PORT or mqtts://HOST:PORT/FLEET, or mqtt, or empty",
    ),
]


class FleetTable(Table, frozen=True):
    """An MQTT broker, at which consoles hear the boat and whoever may read it finds its state (docs/fleets.md)."""

    broker: FleetBroker = ""  # where it is, and the fleet's name (delfim); mqtts is over TLS; "": none
    credentials: str = ""  # file with USER:PASSWORD in one line, mode 0600; "": the broker asks for none
    authorities: str = ""  # PEM file of who signs the broker's certificate; "": those that the system trusts
    listen: Listen = "127.0.0.1:14560"  # the boat's frames come here: an address of this computer, one of mavlink.peers too
    period_s: Annotated[float, msgspec.Meta(ge=0.2, le=3600.0)] = 1.0  # the retained state is renewed so often

    def __post_init__(self) -> None:
        if (self.credentials or self.authorities) and not self.broker:
            raise ValueError("credentials or authorities without a broker: write broker = ...")
        plain = self.broker.removeprefix("mqtt://").partition("/")[0] if self.broker.startswith("mqtt://") else ""
        if plain and self.credentials and not is_loopback(plain):
            raise ValueError("the password would go over the network in the clear: write mqtts in place of mqtt")
        if not is_loopback(self.listen):
            raise ValueError("listen: an address of this computer, as 127.0.0.1:14560")

    def settled(self, vehicle: Any) -> "FleetTable":
        if not self.broker:
            return self
        link = vehicle.mavlink
        if not (link.enabled and link.key):
            raise ValueError(
                "fleet.broker: anybody may speak there: mavlink needs a key; delfim console --keygen FILE makes one"
            )
        if self.listen not in link.peers:
            raise ValueError(f'fleet.broker: the boat must tell its frames there: add "{self.listen}" to mavlink.peers')
        if address(link.listen)[1] == 0:
            raise ValueError("fleet.broker: orders must find the boat: mavlink.listen needs a port of its own, as 14555")
        return self

    @property
    def unheard(self) -> str:
        """Why no console can reach the boat by a broker; "": one can."""
        return "" if self.broker else "fleet.broker is empty"
