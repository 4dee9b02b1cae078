"""Who may do what by MAVLink."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import EVERY, Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    table = settings.of(Mavlink)
    if table.enabled and table.key:
        for place in (f"{table.listen} UDP", *([table.serial] if table.serial else [])):
            yield Entrance("mavlink", place, "known", f"holders of {table.key}", "watch and command the boat")
    elif table.enabled:
        yield Entrance("mavlink", f"{table.listen} UDP", "here", f"{EVERY}, for there is no key", "command the boat")
