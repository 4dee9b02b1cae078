"""The event loop of a process that has no navigation window: uvloop's, or asyncio's where there is no uvloop, as on Windows.

The runtime has a loop of its own, because only that one serves navigation first (docs/decisions/0004-uvloop.md).
"""

import asyncio
import logging


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Make a loop for `asyncio.Runner`. Without uvloop, one line in the log says so, and the loop uses select(2): Windows' own
    stops hearing UDP for good once a datagram found nobody at its port, as when a boat was switched off."""
    try:
        import uvloop
    except ImportError:
        logging.getLogger(__name__).info("uvloop is not installed; asyncio's own loop serves this process")
        return asyncio.SelectorEventLoop()
    loop: asyncio.AbstractEventLoop = uvloop.new_event_loop()
    return loop
