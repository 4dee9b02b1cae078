"""The keys of an Iridium modem in a vehicle's file (docs/iridium.md)."""

from typing import Annotated, Any

import msgspec

from delfim.base.ranges import Baud, address
from delfim.base.tables import Table, text


class IridiumTable(Table, frozen=True):
    """An Iridium SBD modem (9602, 9603, RockBLOCK): reports, and home, hold, stop and a position back (docs/iridium.md)."""

    device: Annotated[str, text("((/|tcp:|unix:)[^ ]+)?", "/DEVICE, tcp:ADDRESS:PORT, unix:PATH, or empty")] = ""  # "": none
    baud: Baud = 19_200  # of that line
    every_s: Annotated[float, msgspec.Meta(ge=60.0, le=86_400.0)] = 600.0  # from one report to the next, and look for orders
    order_age_s: Annotated[float, msgspec.Meta(ge=60.0, le=86_400.0)] = 3600.0  # an order that is older on arrival is refused

    def settled(self, vehicle: Any) -> "IridiumTable":
        if not self.device:
            return self
        link = vehicle.mavlink
        if not (link.enabled and link.key):
            raise ValueError("iridium.device: anybody may write to a modem: mavlink needs a key; delfim console --keygen FILE")
        if address(link.listen)[1] == 0:
            raise ValueError("iridium.device: orders must find the boat: mavlink.listen needs a port of its own, as 14555")
        return self

    @property
    def files(self) -> dict[str, str]:
        """Devices of this computer, by their keys."""
        return {"iridium.device": self.device} if self.device.startswith("/") else {}
