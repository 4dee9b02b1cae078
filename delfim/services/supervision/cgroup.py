"""Memory and processor limits of a program, by the kernel's control groups (cgroup v2). Standard library only.

If there are none (another kernel, no rights), the program runs without limits, and one line in the log says so.
"""

import contextlib
import functools
import logging
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path("/sys/fs/cgroup")
OURS: Final = "delfim"  # the group of our groups
PERIOD_US: Final = 100_000

log = logging.getLogger(__name__)


class Limits(NamedTuple):
    """The limits of a program together with all that it starts. 0: no limit."""

    memory_bytes: int = 0
    cpu: float = 0.0  # processors, 0.5 is half of one
    is_asked: bool = True  # by somebody who wants to know where they are not kept

    def hold(self, name: str, pid: int, root: Path = ROOT) -> bool:
        """Put a process under these limits. Never raises; returns whether the kernel keeps them."""
        if not (self.memory_bytes or self.cpu):
            return True
        group = root / OURS / name
        wanted = " ".join(f"+{each}" for each, limit in (("memory", self.memory_bytes), ("cpu", self.cpu)) if limit)
        try:
            if not (root / "cgroup.controllers").exists():
                raise FileNotFoundError(2, "no control groups here", str(root))
            with contextlib.suppress(OSError):
                group.rmdir()  # with the limits of another file
            group.mkdir(parents=True, exist_ok=True)
            for above in (root, root / OURS):
                (above / "cgroup.subtree_control").write_text(wanted)
            if self.memory_bytes:
                (group / "memory.max").write_text(str(self.memory_bytes))
                (group / "memory.oom.group").write_text("1")
            if self.cpu:
                (group / "cpu.max").write_text(f"{round(self.cpu * PERIOD_US)} {PERIOD_US}")
            (group / "cgroup.procs").write_text(str(pid))
        except OSError as error:
            if self.is_asked:
                _warn_once(f"{error.filename or group}: {error.strerror}")
            return False
        return True

    def end(self, name: str, root: Path = ROOT) -> None:
        """Kill all processes under these limits, those too that left their session."""
        with contextlib.suppress(OSError):  # no such group, or a kernel older than 5.14
            (root / OURS / name / "cgroup.kill").write_text("1")

    def exceeded(self, name: str, root: Path = ROOT) -> str:
        """The reason, in words, why the kernel ended the program since the last call; empty if it did not."""
        if not self.memory_bytes:
            return ""
        group = root / OURS / name
        try:
            events = dict(line.split() for line in (group / "memory.events").read_text().splitlines())
        except (OSError, ValueError):
            return ""
        with contextlib.suppress(OSError):
            group.rmdir()  # and its counts with it
        if not int(events.get("oom_kill", 0)):
            return ""
        return f"killed by the kernel: it needed more than its {self.memory_bytes >> 20} MB"


@functools.cache
def _warn_once(why: str) -> None:
    log.warning("memory and processor limits: %s; going on without them", why)
