"""The keys of front seats in a vehicle's file (docs/front-seat.md)."""

from typing import Annotated, Literal

import msgspec

from delfim.base.ranges import Baud, Device
from delfim.base.tables import Table


class OtterTable(Table, frozen=True):
    """The front seat of an Otter of Maritime Robotics (docs/front-seat.md)."""

    device: Device = "tcp:192.168.53.2:2009"  # the boat's own computer
    baud: Baud = 115_200  # of a serial port


class HeronTable(Table, frozen=True):
    """The front seat of a Heron of Clearpath, or of a boat that speaks as it does (docs/front-seat.md)."""

    device: Device = "tcp:192.168.1.100:29500"  # the boat's own computer
    baud: Baud = 115_200  # of a serial port


class MavlinkFrontSeat(Table, frozen=True):
    """A board with ArduRover or PX4 (docs/front-seat.md): its motors, its position and heading, or both by one line."""

    device: Device = "tcp:127.0.0.1:5760"  # the board, or a router of its messages
    baud: Baud = 115_200  # of a serial port
    autopilot: Literal["ardupilot", "px4"] = "ardupilot"  # what runs on it; they read the throttle in two ways
    board: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1  # its SYSID_THISMAV, or MAV_SYS_ID
    system: Annotated[int, msgspec.Meta(ge=1, le=255)] = 255  # the number that we have there: SYSID_MYGCS of ArduRover
    battery: bool = False  # its battery is the boat's, with the charge that it tells: its BATT_CAPACITY must be right
