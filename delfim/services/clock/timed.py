"""timed: the time frame at the start of each second (thesis 5.3.3, docs/timed.md)."""

import asyncio
import contextlib

from delfim.canproxy.dsor.messages import time_frame
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress
from delfim.canproxy.timekeeping import SecondTimer, Timekeeper, TimeService
from delfim.services.runtime import Runtime
from delfim.services.tables import Timed


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, clock, can_settings = runtime.config.of(Timed), runtime.clock, runtime.config.can
    assert settings.mode != "off"
    frame = time_frame(can_settings.vehicle)
    keeper = Timekeeper(settings.mode, settings.takeover_s, clock.monotonic_s(), frame)
    with contextlib.ExitStack() as links:
        can = links.enter_context(open_bound(can_settings, can_settings.interface, (CanAddress(frame),)))
        timer = SecondTimer(keeper.delay_s, clock.time_ns())
        links.callback(timer.close)
        service = TimeService(keeper, timer, can, clock)
        links.enter_context(runtime.reading(can.fileno(), service.on_frames))
        links.enter_context(runtime.reading(timer.fileno(), service.on_second))
        links.enter_context(runtime.publishing("timed", service.report))
        await asyncio.Event().wait()
