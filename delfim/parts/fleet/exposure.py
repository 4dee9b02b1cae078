"""Who may do what by the fleet's broker."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.fleet.table import FleetTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import EVERY, Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    if "fleetd" not in running:
        return
    table, key = settings.of(FleetTable), settings.of(Mavlink).key
    yield Entrance("fleetd", table.broker, "known", f"holders of {key}, through the broker", "watch and command the boat")
    where = "the broker knows who may read it" if table.credentials else "anyone who may read at the broker"
    yield Entrance("fleetd", f"{table.broker}, state", "anyone", where, "read where the boat is")
    yield Entrance("fleetd", f"{table.listen} UDP", "here", EVERY, "send bytes to the broker; without the key they say nothing")
