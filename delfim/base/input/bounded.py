"""The bounds of a process that reads what came from outside: it sets them itself, before it reads."""

import sys
from collections.abc import Callable
from typing import Any, Final

import msgspec

from delfim.base.errors import DelfimError, in_words

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


def printed(read: Callable[[str], dict[str, Any]], path: str, memory_bytes: int, cpu_s: int) -> int:
    """The whole of a process that reads a file: it prints what is in it as JSON, or `{"refused": WORDS}`."""
    bounded(memory_bytes, cpu_s)
    try:
        told = read(path)
    except MemoryError:
        told = {"refused": f"{path}: it takes too much memory: simplify it"}
    except (DelfimError, OSError) as error:
        told = {"refused": in_words(error)}
    sys.stdout.buffer.write(msgspec.json.encode(told))
    return 0
