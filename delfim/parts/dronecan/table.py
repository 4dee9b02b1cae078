"""The keys of a DroneCAN bus in a vehicle's file (docs/dronecan.md)."""

from typing import Annotated, Literal

import msgspec

from delfim.base.ranges import BitRate, Degrees, Interface, MicroTesla, Shear, Stretch
from delfim.base.tables import Table


class Dronecan(Table, frozen=True):
    """Motor controllers, servos and sensors on a DroneCAN bus (docs/dronecan.md). A thruster's address is the index of its
    controller (ESC_INDEX), that of what turns it the number of its actuator."""

    interface: Interface = "can1"  # the bus of motors and sensors
    bitrate_bps: BitRate = 1_000_000  # of a Linux interface, as DroneCAN has it
    node: Annotated[int, msgspec.Meta(ge=1, le=125)] = 10  # number of this computer; no device may have it
    rate_hz: Annotated[float, msgspec.Meta(ge=10.0, le=100.0)] = 20.0  # commands a second; most controllers stop after 0.2 s
    command: Literal["raw", "rpm"] = "raw"  # a part of full power, or revolutions: rpm_max of a thruster at full command
    steer: Literal["unitless", "position"] = "unitless"  # servos get a part of angle_max_deg, -1 to 1, or the angle in rad
    numbers: bool = True  # give devices that have no number one
    preferred_sources: tuple[Annotated[int, msgspec.Meta(ge=1, le=127)], ...] = ()  # sensors' numbers, best first; empty: any
    antennas_deg: Degrees = 0.0  # of two antennas: where the second is, seen from the first, clockwise from the bow
    compass_deg: Degrees = 0.0  # where the arrow of compass and gyro points, clockwise from the bow
    variation_deg: Degrees = 0.0  # of the place, east positive: what is added to a magnetic heading
    hard_iron_ut: tuple[MicroTesla, MicroTesla, MicroTesla] = (0.0, 0.0, 0.0)  # taken off the compass' x, y and z
    soft_iron: tuple[Stretch, Stretch, Stretch, Shear, Shear, Shear] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)  # then: xx yy zz xy xz yz
