"""The keys of a Ping echo sounder in a vehicle's file (docs/sounders.md)."""

from typing import Annotated

import msgspec

from delfim.base.ranges import Baud, Device
from delfim.base.tables import Table


class PingTable(Table, frozen=True):
    """An echo sounder that speaks Blue Robotics' Ping protocol, sensor `ping` (docs/sounders.md)."""

    device: Device = "/dev/ttyUSB0"  # its serial port, or where that is to be had over the network
    baud: Baud = 115_200  # of a serial port
    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=50.0)] = 10.0  # of its pings; deep water takes longer
    sound_mps: Annotated[float, msgspec.Meta(ge=1000.0, le=2000.0)] | None = None  # speed of sound to tell it; absent: its own
