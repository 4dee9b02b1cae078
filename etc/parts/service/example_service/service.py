"""The service, in a process of its own: what it publishes is on the boat's page and in `/api/state`."""

import asyncio
import math
from typing import Any

from example_service import TidesTable


async def serve(runtime: Any) -> None:
    """Runs until it is cancelled. What it raises is told, and it is started again after a pause."""
    table, height_m = runtime.config.of(TidesTable), 0.0
    with runtime.publishing("example_service", lambda: {"height_m": round(height_m, 2)}):
        while True:
            height_m = 1.5 + math.sin(runtime.clock.monotonic_s() / 7_000.0)
            await asyncio.sleep(table.period_s)
