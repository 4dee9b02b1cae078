"""Who may see the pictures of the boat's cameras."""

from collections.abc import Collection, Iterator

from delfim import config
from delfim.parts.camera.table import LIVE_PORTS, PORTS, STREAMS
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import EVERY, Entrance


def entrances(settings: config.Vehicle, running: Collection[str]) -> Iterator[Entrance]:
    if "camerad" not in running:
        return
    link, names = settings.of(Mavlink), ", ".join(settings.table("camera"))
    film = [name for name, table in settings.table("camera").items() if table.webrtc]
    first = LIVE_PORTS + STREAMS * settings.boat.id
    port, may = PORTS + settings.boat.id, f"see the pictures of {names}"
    if link.key:
        host = link.listen.rpartition(":")[0]
        yield Entrance("camerad", f"{host}:{port}", "known", f"holders of {link.key}", may)
        if film:
            place, who = f"{host}:{first}-{first + STREAMS - 1}", f"who was let in at {port}, as long as they look"
            yield Entrance("camerad", place, "known", who, f"see the pictures of {', '.join(film)}, by WebRTC")
    else:
        yield Entrance("camerad", f"127.0.0.1:{port}", "here", f"{EVERY}, for there is no key", may)
