"""The command `delfim` with one more service, `bad`, which misbehaves in the way that the file named first says, as soon as
it says so. What it does is real, and so is everything around it."""

import asyncio
import os
import select
import sys
import time
from pathlib import Path

from delfim.__main__ import main
from delfim.services import suite
from delfim.services.runtime import Runtime

HOW = Path(sys.argv.pop(1))
LEAK_BYTES = 1 << 20  # a second
CALLBACK_S = 0.0004  # within the budget of a good one


def how() -> str:
    return HOW.read_text() if HOW.exists() else ""


async def bad(runtime: Runtime) -> None:
    while not how():
        await asyncio.sleep(0.02)
    match how():
        case "crashes":
            raise RuntimeError("it crashes")
        case "leaks":
            hoard = []
            while True:
                hoard.append(b"x" * (LEAK_BYTES // 10))
                await asyncio.sleep(0.1)
        case "blocks":
            os.unlink(HOW)  # once
            select.select([], [], [], 10.0)  # as a call does that somebody forgot
            await asyncio.Event().wait()
        case "eats":
            while True:
                until_s = time.monotonic() + CALLBACK_S
                while time.monotonic() < until_s:
                    pass
                await asyncio.sleep(0)


suite.SERVICES = (suite.Service("bad", "__main__:bad"), *suite.SERVICES)
if sys.argv[1] == "supervise":
    file, *rest = sys.argv[2:]
    sys.exit(suite.supervise(file, rest[1::2], (sys.executable, __file__, str(HOW))))
sys.exit(main())
