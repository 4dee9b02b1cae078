"""Who may do what by ROS 2."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.ros.table import RosTable
from delfim.services.access.exposure import STEER, Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    table = settings.of(RosTable)
    if "rosd" in running:
        may = f"read the boat's state; {STEER}" if table.commands else "read the boat's state"
        yield Entrance("rosd", table.router, "anyone", "anyone who reaches this Zenoh router", may)
