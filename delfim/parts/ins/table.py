"""The keys of an inertial navigation system in a vehicle's file (docs/ins.md)."""

from typing import Annotated, Literal

import msgspec

from delfim.base.ranges import Baud, Device
from delfim.base.tables import Table


class InsTable(Table, frozen=True):
    """An inertial navigation system with a receiver, source `ins`: position, velocity, attitude and how sure it is of them."""

    device: Device = "/dev/ttyUSB0"  # its serial port, or where that is to be had over the network
    baud: Baud = 115_200  # of a serial port
    speaks: Literal["vectornav", "xsens", "sbg", "anpp"] = "vectornav"  # VectorNav; MTData2; sbgECom; Advanced Navigation
    position_max_m: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 10.0  # where it is less sure, position is unknown
    heading_max_deg: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] = 5.0  # where it is less sure, heading is unknown
