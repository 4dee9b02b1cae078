"""router: DSOR messages between the nodes of several buses (docs/dsor.md)."""

import asyncio
import contextlib
from functools import partial

from delfim.canproxy.dsor.routing import Router
from delfim.canproxy.opening import open_can
from delfim.canproxy.tables import Routing
from delfim.services.runtime import Runtime

POLL_S = 1.0


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    interfaces = (settings.can.interface, *(bus.interface for bus in settings.of(Routing).buses.values()))
    room = settings.can.receive_buffer_bytes
    with contextlib.ExitStack() as links:
        sockets = {name: links.enter_context(open_can(name, receive_buffer_bytes=room)) for name in interfaces}
        router = Router(settings.of(Routing), settings.can.interface, sockets, runtime.clock)
        for name, can in sockets.items():
            links.enter_context(runtime.reading(can.fileno(), partial(router.on_readable, name)))
        links.enter_context(runtime.publishing("router", router.report))
        while True:
            await asyncio.sleep(POLL_S)
            router.poll()
