"""The keys of an NMEA 2000 bus in a vehicle's file (docs/nmea2000.md)."""

from typing import Annotated, Literal, get_args

import msgspec

from delfim.base.ranges import BitRate, Interface
from delfim.base.tables import Table, text

ToldName = Literal[  # rows in delfim/parts/nmea2000/nmea2000rows.py
    "position", "course", "heading", "turn", "attitude", "rudder", "engine", "battery", "route", "alerts"
]
IsoName = Annotated[str, text("[0-9A-Fa-f]{16}", "a NAME of 16 hexadecimal digits in quotes")]
BatteryInstances = Annotated[tuple[Annotated[int, msgspec.Meta(ge=0, le=252)], ...], msgspec.Meta(max_length=2)]


class Nmea2000(Table, frozen=True):
    """A bus of off-the-shelf sensors. Of several that send the same value, the first in `preferred_sources` is used. With
    `send` the boat is a device there, which tells others what it knows."""

    interface: Interface = "can1"  # the bus of the sensors
    bitrate_bps: BitRate = 250_000  # of a Linux interface, as NMEA 2000 has it
    preferred_sources: tuple[Annotated[int, msgspec.Meta(ge=0, le=251)] | IsoName, ...] = ()  # best first; empty: any
    variation_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = 0.0  # used while the bus sends none
    batteries: BatteryInstances = ()  # instances of the starboard or only battery, and of the port one; empty: not read
    send: Annotated[tuple[ToldName, ...], msgspec.Meta(max_length=len(get_args(ToldName)))] = ()  # to the other devices
    unique_number: Annotated[int, msgspec.Meta(ge=0, le=0x1FFFFF)] = 0  # of this device; 0: made of the boat's name

    @property
    def joins(self) -> bool:
        """Whether the boat takes part in the bus: it tells others something, or asks them for their NAMEs."""
        return bool(self.send) or any(isinstance(each, str) for each in self.preferred_sources)
