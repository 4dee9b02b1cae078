"""The bounds of a process that reads what came from outside: it sets them itself, before it reads."""

import sys
from typing import Final

NICE: Final = 10  # behind all who have no time to wait


def bounded(memory_bytes: int, cpu_s: int | None = None) -> None:
    """From now on the process takes so much memory at most, of addresses, libraries included: more is MemoryError. After so
    much time of a processor it is killed; None: it waits for more to read, and who asked ends it. On Windows, where the console
    alone runs, there are no such bounds: who asked ends it there."""
    if sys.platform != "win32":
        import os
        import resource

        os.nice(NICE)
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        if cpu_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
