"""The event loop of a process that has no navigation window: uvloop's, or asyncio's where uvloop is not installed.

The runtime has a loop of its own, because only that one serves navigation first (docs/decisions/0004-uvloop.md).
"""

import asyncio
import logging


def new_event_loop() -> asyncio.AbstractEventLoop:
    """A loop for `asyncio.Runner`. Without uvloop, as on Windows, one line in the log says so."""
    try:
        import uvloop
    except ImportError:
        logging.getLogger(__name__).info("uvloop is not installed; asyncio's own loop serves this process")
        return asyncio.new_event_loop()
    loop: asyncio.AbstractEventLoop = uvloop.new_event_loop()
    return loop
