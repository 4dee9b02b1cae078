"""The keys of the boat's topics for ROS 2 in a vehicle's file (docs/ros2.md)."""

from ipaddress import ip_address, ip_network
from typing import Annotated, Any

import msgspec

from delfim.base.ranges import (
    PORT,
    is_loopback,
)
from delfim.base.tables import Table, text

ZenohRouter = Annotated[str, text(rf"((tcp|tls)/([^ :/]+|\[[0-9A-Fa-f:]+\]):{PORT})?", "tcp/HOST:PORT, tls/HOST:PORT or empty")]


class RosTable(Table, frozen=True):
    """The boat's topics for ROS 2, over a Zenoh router as rmw_zenoh has it (docs/ros2.md)."""

    router: ZenohRouter = ""  # where it is, as tcp/127.0.0.1:7447; "": no topics
    domain: Annotated[int, msgspec.Meta(ge=0, le=232)] = 0  # ROS_DOMAIN_ID of the others
    namespace: Annotated[str, text("([a-z][a-z0-9_]{0,31})?", "small letters, digits or _, or empty")] = ""  # "": boat.name
    commands: bool = False  # Twist and goal of ROS steer in mode grex, as the guest; the router on this computer only
    obstacles: bool = False  # what /BOAT/scan sees are things to keep clear of, told as the guest; likewise

    @property
    def is_guest(self) -> bool:
        """Whether it is the guest computer."""
        return self.commands or self.obstacles

    def __post_init__(self) -> None:
        if self.is_guest and not (self.router and is_loopback(self.router.partition("/")[2])):
            what = "commands" if self.commands else "obstacles"
            raise ValueError(f"{what}: whoever reaches the router could steer: it must be one of this computer")

    def settled(self, vehicle: Any) -> "RosTable":
        here, networks = (ip_address("127.0.0.1"), ip_address("::1")), list(map(ip_network, vehicle.guest.networks))
        what = "ros.commands: it steers" if self.commands else "ros.obstacles: it speaks"
        if self.is_guest and not vehicle.guest.enabled:
            raise ValueError(f"{what} as the guest: guest.enabled must be true")
        if self.is_guest and not any(each in network for each in here for network in networks):
            raise ValueError(f"{what} as the guest: guest.networks must have 127.0.0.0/8, where it comes from")
        if self.obstacles and "guest" not in vehicle.traffic.hears:
            raise ValueError('ros.obstacles: nobody hears them: "guest" in traffic.hears')
        return self
