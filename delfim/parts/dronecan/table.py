"""The keys of a DroneCAN bus in a vehicle's file (docs/dronecan.md)."""

from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import BitRate, Degrees, Interface, MicroTesla, Shear, Stretch
from delfim.base.tables import Table

Node = Annotated[int, msgspec.Meta(ge=1, le=127)]
Place = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]


class Rangefinder(Table, frozen=True):
    """A rangefinder that looks over the water: what it sees is a thing that the boat keeps clear of (docs/traffic.md)."""

    node: Node  # that it hangs on
    sensor: Annotated[int, msgspec.Meta(ge=0, le=255)] = 0  # its number there
    angle_deg: Degrees = 0.0  # where it looks, clockwise from the bow
    forward_m: Place = 0.0  # of the boat's place
    starboard_m: Place = 0.0
    least_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.5  # what is nearer is the boat itself, or spray
    most_m: Annotated[float, msgspec.Meta(ge=0.5, le=1000.0)] = 100.0


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
    preferred_sources: tuple[Node, ...] = ()  # sensors' numbers, best first; empty: any
    antennas_deg: Degrees = 0.0  # of two antennas: where the second is, seen from the first, clockwise from the bow
    compass_deg: Degrees = 0.0  # where the arrow of compass and gyro points, clockwise from the bow
    variation_deg: Degrees = 0.0  # of the place, east positive: what is added to a magnetic heading
    hard_iron_ut: tuple[MicroTesla, MicroTesla, MicroTesla] = (0.0, 0.0, 0.0)  # taken off the compass' x, y and z
    soft_iron: tuple[Stretch, Stretch, Stretch, Shear, Shear, Shear] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)  # then: xx yy zz xy xz yz
    rangefinders: Annotated[tuple[Rangefinder, ...], msgspec.Meta(max_length=16)] = ()  # that look over the water

    def __post_init__(self) -> None:
        rows = [(row.node, row.sensor) for row in self.rangefinders]
        for node, sensor in rows:
            if rows.count((node, sensor)) > 1:
                raise ValueError(f"rangefinders: sensor {sensor} of node {node} has two rows")

    def settled(self, vehicle: Any) -> "Dronecan":
        if self.rangefinders and "dronecan" not in vehicle.sensors.names:
            raise ValueError('rangefinders: nobody reads them: name "dronecan" in sensors.names')
        return self
