"""The command `delfim` with one more service in the runtime: it hangs when the process gets SIGUSR1, in the way that the file
named in --hang says. For tests of the dead-man: hanging is real, and so is everything around it."""

import asyncio
import ctypes
import resource
import signal
import sys
from pathlib import Path

from delfim.__main__ import main
from delfim.services import suite
from delfim.services.runtime import Runtime
from delfim.services.supervision import supervisor

HANG = Path(sys.argv.pop(1))


def hang() -> None:
    match HANG.read_text():
        case "python":
            while True:
                pass
        case "interpreter lock":
            ctypes.PyDLL(None).sleep(60)  # a C function that keeps the lock
        case "memory":
            resource.setrlimit(resource.RLIMIT_AS, (400 << 20, 400 << 20))
            hoard = []
            while True:
                try:  # in this frame, where the test looks for it
                    hoard.append(bytearray(1 << 20))
                except MemoryError:  # and on it goes, as a program does that swallows it
                    continue


async def sleeper(runtime: Runtime) -> None:
    """Hangs the loop's own thread, as a bad service would."""
    asked = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, asked.set)
    await asked.wait()
    hang()


suite.SERVICES = (suite.Service("sleeper", "__main__:sleeper"), *suite.SERVICES)
if sys.argv[1] == "supervise":
    vars(supervisor)["STACKS_S"] = 3.0  # a busy machine does not give it the processor sooner; the stop does not wait for it
    file, *rest = sys.argv[2:]
    sys.exit(suite.supervise(file, rest[1::2], (sys.executable, __file__, str(HANG))))
sys.exit(main())
