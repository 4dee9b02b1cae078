"""canzlogd: the black box, every frame of every bus (docs/log-format.md)."""

import asyncio
import contextlib
from functools import partial

from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, bus_state
from delfim.logging.blackbox import FRAMES_A_CALL, BlackBox
from delfim.services.runtime import Runtime

GATHER_S = 0.005  # frames wait this long for others before they go into the black box; the kernel has already stamped them


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    room = settings.can.receive_buffer_bytes
    with contextlib.ExitStack() as links:
        opened = (open_can(name, receive_buffer_bytes=room, error_frames=True, batch=FRAMES_A_CALL) for name in settings.buses)
        sockets = [links.enter_context(each) for each in opened]
        box = BlackBox(sockets, settings.log, runtime.clock, bus_state)
        links.callback(box.close)
        links.enter_context(runtime.publishing("canzlogd", box.figures))
        for each in sockets:
            each.bind(ANYTHING)
            each.setblocking(False)
            links.enter_context(runtime.reading(each.fileno(), partial(box.on_readable, each), GATHER_S))
        while True:
            await asyncio.sleep(1.0)
            box.poll()
