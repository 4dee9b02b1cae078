"""Who may see the pictures of the boat's cameras."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.camera.table import PORTS
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import EVERY, Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    if "camerad" not in running:
        return
    link, names = settings.of(Mavlink), ", ".join(settings.table("camera"))
    port, may = PORTS + settings.boat.id, f"see the pictures of {names}"
    if link.key:
        host = link.listen.rpartition(":")[0]
        yield Entrance("camerad", f"{host}:{port}", "known", f"holders of {link.key}", may)
    else:
        yield Entrance("camerad", f"127.0.0.1:{port}", "here", f"{EVERY}, for there is no key", may)
