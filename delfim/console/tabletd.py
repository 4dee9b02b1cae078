"""tabletd: the console's page, served by the boat itself, so that a tablet alone operates it (docs/tablet.md).

A process of its own. To the vehicle it is one more console on MAVLink, at an address of this computer, with the boat's key.
Its heartbeat, by which the boat knows that somebody is there, goes only while a page is heard: a tablet out of reach is a
console that is silent, and `failsafe.console_silent` says what the boat does.
"""

from pathlib import Path
from typing import Final

from delfim import config
from delfim.base.clock import WakefulClock
from delfim.base.errors import ConfigError, PermanentFailure
from delfim.base.ranges import address
from delfim.console.gateway.gateway import Gateway
from delfim.console.gateway.serving import serve as serve_pages
from delfim.console.link.mavlink import Key
from delfim.console.pages.admission import kept_token
from delfim.console.pages.pushing import PushDesk
from delfim.console.watch.operators import OperatorsFile
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.certificates import server_tls
from delfim.services.runtime import Runtime
from delfim.services.tables import Tablet

END_S: Final = 0.2  # for open pages, when the service ends: they find it again by themselves


def tablet_gateway(settings: config.Vehicle, file: str, push: PushDesk | None = None) -> Gateway:
    """The gateway of this boat, whose vehicle's file is there. `push`: another desk than its own. Raises ConfigError and
    OSError."""
    table, key = settings.of(Tablet), settings.of(Mavlink).key
    place = Path(table.directory)
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    (place / "sessions").mkdir(exist_ok=True)
    operators, clock = OperatorsFile(place / "operators.json"), WakefulClock()
    gateway = Gateway(
        clock,
        place / "missions",
        Key(Path(key), stamps=place / "mavlink.stamps") if key else None,
        kept_token(place / "token"),
        Path(file) if file else None,
        charts=place / "charts",
        trials=place / "adopt",
        operators=operators,
        sessions=place / "sessions",
        frames=False,
    )
    gateway.attended_only(table.silent_s)
    gateway.wakes(push or PushDesk(place / "push.json", operators, clock, table.contact))
    return gateway


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, status = runtime.config, runtime.status.get("tabletd")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("tabletd: it writes files, for which the runtime has no time; write place = 'process'")
    table = settings.of(Tablet)
    try:
        gateway = tablet_gateway(settings, runtime.file)
        with runtime.publishing("tabletd", gateway.report):
            tls = server_tls(table.certificate, "tablet.certificate")
            await serve_pages(gateway, address(table.boats), address(table.listen), lambda url: None, tls, END_S)
    except ConfigError as error:
        raise PermanentFailure(f"tablet: {error}") from None
