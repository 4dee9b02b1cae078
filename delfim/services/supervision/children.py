"""The programs of the supervisor: starting one with a pipe to beat on, and finding out where a silent one stands."""

import contextlib
import logging
import os
import re
import signal
import time
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Final, Literal, NamedTuple

from delfim.services.supervision.cgroup import Limits

LEAVES: Final = b"l"  # in the pipe in place of the beats: the boat is stopped, and the services end
LAST_WORD: Final = b"e"  # and after all beats: the services have ended, the process ends next
STACKS_SIGNAL: Final[signal.Signals] = getattr(signal, "SIGUSR2", signal.SIGTERM)  # asks for that; Windows runs no children
STACKS_BYTES: Final = 65536  # a pipe holds no more
FRAMES: Final = 3  # of the main thread's stack, in the reason

log = logging.getLogger(__name__)


class Supervised(NamedTuple):
    """A program of the supervisor. The critical one has the dead-man; there is at most one. The others run on processors that
    nobody else wants (SCHED_IDLE): being niced does not make the kernel take a processor from them at once when the critical
    one wakes. A guard, which holds motors, is no less urgent than the critical one: it has the dead-man, too, starts at once,
    and ends last if it is the first of them."""

    name: str
    argv: tuple[str, ...]
    critical: bool = False
    guard: bool = False
    limits: Limits = Limits()


@dataclass(slots=True)
class Child:
    """A program and its state. Times are monotonic unless they say otherwise."""

    program: Supervised
    state: Literal["waiting", "running", "stopped", "failed"] = "waiting"
    pid: int = 0  # 0 while it does not run
    pipe: int = -1  # read end
    start_s: float = 0.0  # when it was started, or will be
    beat_s: float | None = None  # last beat, and later by all the time in which the computer did not let us run since
    is_leaving: bool = False  # it said its last word, and commands nothing more
    pause_s: float = 0.0  # before its last start
    restarts: int = 0
    reason: str = ""  # of its last end or silence, in words
    is_silent: bool = False  # silent, and not critical
    verdict: str = ""  # why it is or was killed by us
    kill_s: float = inf  # when it is killed for its silence
    dead_s: float = inf  # when it should be dead of that
    since_s: float = 0.0  # monotonic, of the last change of state

    @property
    def is_urgent(self) -> bool:
        return self.program.critical or self.program.guard

    def spawn(self) -> None:
        """Start it, with a pipe to beat on. Raises OSError."""
        program = self.program
        self.start_s, self.beat_s, self.is_silent, self.is_leaving = time.monotonic(), None, False, False
        self.verdict, self.kill_s, self.dead_s = "", inf, inf
        self.pipe, beat = os.pipe()
        os.set_blocking(self.pipe, False)
        os.set_inheritable(beat, True)
        argv = (*program.argv, "--beat-fd", str(beat))
        try:
            self.pid = os.posix_spawnp(
                argv[0], argv, os.environ, setsid=True, setsigmask=(), setsigdef=(signal.SIGPIPE, STACKS_SIGNAL)
            )
        finally:
            os.close(beat)
        program.limits.hold(program.name, self.pid)
        if not self.is_urgent:
            try:
                os.sched_setscheduler(self.pid, os.SCHED_IDLE, os.sched_param(0))
            except OSError as error:
                log.warning("%s: SCHED_IDLE: %s; going on without it", program.name, error.strerror)

    def hurry(self) -> None:
        """Let it compete for the processor, if we may decide that: a program with little time to end must get some of it."""
        if not self.is_urgent:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(self.pid, os.SCHED_OTHER, os.sched_param(0))

    def stacks(self) -> str:
        """The calls where its threads stand, as it wrote into its pipe; empty where it did not."""
        try:
            return os.read(self.pipe, STACKS_BYTES).decode(errors="replace").lstrip(".") if self.pipe >= 0 else ""
        except BlockingIOError:
            return ""

    def hang_up(self) -> None:
        if self.pipe >= 0:
            os.close(self.pipe)
            self.pipe = -1


def stood(stacks: str) -> str:
    """The innermost calls of the main thread, in words, from faulthandler's dump of all threads; empty if there is none."""
    _, _, last = stacks.rpartition("hread 0x")
    calls = re.findall(r'File "[^"]*?((?:[^"/]+/)?[^"/]+)", line (\d+) in (\S+)', last)[:FRAMES]
    return "it stood in " + ", called by ".join(f"{name} ({file}:{line})" for file, line, name in calls) if calls else ""


def ended(code: int) -> str:
    """Describe how a program ended, in words, from its exit code; negative: the signal."""
    return f"exit code {code}" if code >= 0 else f"killed by signal {-code} ({signal.strsignal(-code)})"


def process_state(pid: int) -> str:
    """The state of a process as the kernel has it, such as "T (stopped)"."""
    try:
        return next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("State:"))[7:]
    except (OSError, StopIteration):
        return "unknown"
