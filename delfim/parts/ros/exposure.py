"""Who may do what by ROS 2."""

from collections.abc import Collection, Iterator
from typing import Final

from delfim import config
from delfim.parts.ros.table import RosTable
from delfim.services.access.exposure import STEER, Entrance

SEE: Final = "lead it aside by what it tells to see"


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    table = settings.of(RosTable)
    if "rosd" in running:
        may = "; ".join(("read the boat's state", *[SEE] * table.obstacles, *[STEER] * table.commands))
        yield Entrance("rosd", table.router, "anyone", "anyone who reaches this Zenoh router", may)
