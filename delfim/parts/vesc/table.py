"""The keys of VESC motor controllers in a vehicle's file (docs/vesc.md)."""

from typing import Annotated, Literal

import msgspec

from delfim.base.ranges import BitRate, Interface
from delfim.base.tables import Table


class Vesc(Table, frozen=True):
    """VESC motor controllers, on a bus where nobody else speaks (docs/vesc.md)."""

    interface: Interface = "can1"  # the bus of the controllers
    bitrate_bps: BitRate = 500_000  # of a Linux interface, as the controllers have it by default
    command: Literal["rpm", "duty", "current"] = "rpm"  # what they are told; rpm: full command is rpm_max of the row
    duty_max: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.95  # at full command: part of the battery's voltage
    current_max_a: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 20.0  # at full command, in the motor
    pole_pairs: Annotated[int, msgspec.Meta(ge=1, le=100)] = 7  # of the motors: half of their magnets
