"""The keys of Torqeedo motors in a vehicle's file (docs/torqeedo.md)."""

from typing import Annotated, Any

import msgspec

from delfim.base.ranges import BitRate, Device, Interface, Name
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


class TorqlinkPort(Table, frozen=True):
    """The bus of one motor."""

    interface: Interface  # a CAN bus where nobody else commands
    bitrate_bps: BitRate = 250_000  # of a Linux interface, as J1939 has it


class TorqlinkTable(Table, frozen=True):
    """Torqeedo motors with TorqLink, each on a CAN bus of its own: a command has no number of a motor (docs/torqeedo.md)."""

    ports: dict[Name, TorqlinkPort] = msgspec.field(default_factory=dict)  # by the names of the thrusters

    @property
    def lines(self) -> dict[str, Table]:
        """Its buses, by their keys."""
        return {f"torqlink.ports.{name}": port for name, port in self.ports.items()}

    def settled(self, vehicle: Any) -> "TorqlinkTable":
        on = dict[str, str]()
        for row in vehicle.thrusters:
            if row.driver != "torqlink":
                continue
            if row.name not in self.ports:
                raise ValueError(
                    f"torqlink.ports: {row.name} needs a bus: a table [torqlink.ports.{row.name}] with its interface"
                )
            other = on.setdefault(self.ports[row.name].interface, row.name)
            if other != row.name:
                raise ValueError(
                    f"torqlink.ports: {other} and {row.name} have one bus, {self.ports[row.name].interface}: both would obey "
                    "each command"
                )
        return self
