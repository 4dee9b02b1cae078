"""The keys of Torqeedo motors in a vehicle's file (docs/torqeedo.md)."""

from typing import Annotated, Any

import msgspec

from delfim.base.ranges import Device, Name
from delfim.base.tables import Table

BAUD = 19_200  # of every TQ bus


class TorqeedoPort(Table, frozen=True):
    """The line of one motor."""

    device: Device  # its serial port of RS-485, or where that is to be had over the network


class TorqeedoTable(Table, frozen=True):
    """Torqeedo motors with TQ bus, each on a line of its own (docs/torqeedo.md)."""

    power_percent: Annotated[int, msgspec.Meta(ge=1, le=100)] = 100  # of its power that a motor may take
    ports: dict[Name, TorqeedoPort] = msgspec.field(default_factory=dict)  # by the names of the thrusters

    @property
    def lines(self) -> dict[str, Table]:
        """Its lines, by their keys."""
        return {f"torqeedo.ports.{name}": port for name, port in self.ports.items()}

    def settled(self, vehicle: Any) -> "TorqeedoTable":
        for row in vehicle.thrusters:
            if row.driver == "torqeedo" and row.name not in self.ports:
                raise ValueError(
                    f"torqeedo.ports: {row.name} needs a line: a table [torqeedo.ports.{row.name}] with its device"
                )
        return self
