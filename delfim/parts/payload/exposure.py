"""What a payload program may order: no door, and others who may steer all the same."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.services.access.exposure import Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    for name, table in settings.table("payload").items():
        if table.may and "payload" in running:
            may = f"order: {', '.join(table.may)}"
            yield Entrance("payload", table.command[0], "here", f"payload {name}, when an operator gave it the boat", may)
