"""Who may do what by satellite."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.iridium.table import IridiumTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    if "iridiumd" in running:
        place, who = settings.of(IridiumTable).device, f"holders of {settings.of(Mavlink).key}"
        yield Entrance("iridiumd", place, "known", who, "stop the boat, send it home, to a position, or have it hold")
