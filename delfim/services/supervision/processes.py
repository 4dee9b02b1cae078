"""The processes of a session, from /proc: ended together, counted together."""

import contextlib
import os
import signal
from collections.abc import Awaitable, Iterator
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

LOOK_S: Final = 0.02  # between two looks whether a session is empty
PASSES: Final = 50  # through a session until nobody is left
PAGE_BYTES: Final = os.sysconf("SC_PAGE_SIZE")
TICKS_PER_S: Final = os.sysconf("SC_CLK_TCK")
T = TypeVar("T")


class Usage(NamedTuple):
    """The use of the computer by all processes of a session."""

    processes: int = 0
    cpu_s: float = 0.0  # of those that live
    memory_bytes: int = 0  # resident


def end(session: int, number: int) -> None:
    """Send a signal to all processes of a session, also in the background, and when the program that began it has ended."""
    for pid in members(session):
        with contextlib.suppress(ProcessLookupError, PermissionError):  # one that has become another user is not ours to end
            os.kill(pid, number)


def kill(session: int) -> None:
    """Kill all processes of a session. They are stopped before: programs that start others for ever would outrun us."""
    for _ in range(PASSES):
        end(session, signal.SIGSTOP)
        end(session, signal.SIGKILL)
        if not members(session):
            return


async def started(start: Awaitable[T]) -> T:
    """The answer of the loop that starts a program. A cancellation waits until the program is there, and comes with the next
    wait: asyncio kills one that it has not yet joined to its pipes, but no other of its session, and waits for it for ever."""
    import asyncio

    starting = asyncio.ensure_future(start)
    try:
        await asyncio.wait({starting})
    except asyncio.CancelledError:
        await asyncio.wait({starting})
        if (us := asyncio.current_task()) is not None:
            us.cancel()
    return starting.result()


async def empty(session: int, within_s: float) -> None:
    """Wait until nobody lives in a session any more, at most so long."""
    import asyncio  # here: the program that samples the computer has no loop, and saves 5 MB

    for _ in range(round(within_s / LOOK_S)):
        if not members(session):
            return
        await asyncio.sleep(LOOK_S)


def members(session: int) -> list[int]:
    """The processes that live in a session."""
    return [pid for pid, sid, _ in _all() if sid == session]


def usage() -> dict[int, Usage]:
    """The use of the computer by each session, by its number."""
    found = dict[int, Usage]()
    for _, sid, fields in _all():
        processes, cpu_s, memory_bytes = found.get(sid, Usage())
        ticks, pages = int(fields[11]) + int(fields[12]), int(fields[21])
        found[sid] = Usage(processes + 1, cpu_s + ticks / TICKS_PER_S, memory_bytes + pages * PAGE_BYTES)
    return found


def threads(user: int) -> int:
    """The number of a user's threads, which is what the kernel's limit of processes counts."""
    count = 0
    for name in os.listdir("/proc"):
        with contextlib.suppress(OSError, ValueError):
            if os.stat(f"/proc/{int(name)}").st_uid == user:
                count += len(os.listdir(f"/proc/{name}/task"))
    return count


def _all() -> Iterator[tuple[int, int, list[str]]]:
    """List (process, session, the fields of proc(5) from the third) of every process that lives."""
    for name in os.listdir("/proc"):
        with contextlib.suppress(OSError, ValueError):  # gone meanwhile, or no process
            fields = Path("/proc", str(int(name)), "stat").read_text().rpartition(")")[2].split()
            if fields[0] != "Z":
                yield int(name), int(fields[3]), fields
