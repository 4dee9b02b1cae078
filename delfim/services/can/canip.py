"""canip: UDP datagrams over the bus (docs/canip.md)."""

import asyncio
import contextlib
import os

from delfim.canproxy.canudp import CanIp, open_tun
from delfim.canproxy.opening import open_can
from delfim.canproxy.tables import Canip
from delfim.services.runtime import Runtime


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, bus = runtime.config.of(Canip), runtime.config.can
    tun = open_tun(settings.device, settings.address, settings.mtu)
    with contextlib.ExitStack() as links:
        links.callback(os.close, tun)
        can = links.enter_context(open_can(bus.interface))
        carrier = CanIp(asyncio.get_running_loop(), tun, can, settings, bus.node)
        links.callback(carrier.close)
        links.enter_context(runtime.reading(tun, carrier.on_packets))
        links.enter_context(runtime.publishing("canip", carrier.report))
        await asyncio.Event().wait()
