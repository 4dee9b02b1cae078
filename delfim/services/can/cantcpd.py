"""cantcpd: CAN over TCP; clients with permission watch the buses, and send (docs/cantcpd.md)."""

import asyncio
import contextlib

from delfim.base.ranges import address
from delfim.canproxy.cantcp.access import Access
from delfim.canproxy.cantcp.server import CanServer
from delfim.canproxy.tables import Cantcpd
from delfim.services.runtime import Runtime


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled. Raises OSError if it cannot listen on an address."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    interfaces = settings.of(Cantcpd).buses or settings.buses
    with contextlib.ExitStack() as links:
        access = Access(settings.of(Cantcpd), settings.can, settings.closed_buses)
        server = CanServer(settings.of(Cantcpd), interfaces, runtime, runtime.clock, settings.can.receive_buffer_bytes, access)
        links.callback(server.close)
        asked = [(listen, server.slcan_connection) for listen in settings.of(Cantcpd).slcan]
        asked += [(listen, server.connection) for listen in settings.of(Cantcpd).listen]
        for listen, connection in asked:
            listening = await loop.create_server(connection, *address(listen))
            links.callback(listening.close)
        port = listening.sockets[0].getsockname()[1]
        links.enter_context(runtime.publishing("cantcpd", server.report))
        while True:
            server.poll(port)
            await asyncio.sleep(1.0)
