"""The chart of the scenario with a headland, and how it was made: python -m tests.vehicle.headland"""

import math
from pathlib import Path
from typing import Final

from delfim.base import geodesy
from tests.vehicle.charted import Shoal, chart

FILE: Final = Path(__file__).parents[2] / "etc/scenarios/headland.clearance"
AT: Final = geodesy.origin(math.radians(38.690696), math.radians(-9.215310))  # where the simulated boat lies
LAND: Final[list[Shoal]] = [(60.0, east, 12.0) for east in range(-300, 1, 10)]  # from the western edge on
BAR: Final[list[Shoal]] = [(60.0, east, 12.0) for east in range(10, 61, 10)]  # before it, open as "0-2 m"


def headland() -> bytes:
    return chart(AT, [*LAND, *BAR], opened=LAND, draught_m=0.6)


if __name__ == "__main__":
    FILE.write_bytes(headland())
