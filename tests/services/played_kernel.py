"""A kernel that is played, for the supervisor: processes, pipes and signals, on a clock that waiting alone moves."""

import heapq
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, count, repeat
from math import inf
from signal import SIGCHLD, SIGKILL, SIGTERM, Signals

from delfim.services.supervision.children import STACKS_SIGNAL

FIRST_S = 100.0  # on its clock
LOOKS = 30_000  # at the clock, in the longest story
DUMP = (
    b'.Thread 0x01 (most recent call first):\n\nThread 0x02 (most recent call first):\n  File "/srv/loop.py", line 34 in turn\n'
)


@dataclass
class Played:
    """One life of a program. Times are seconds since its start."""

    first_s: float = 0.5  # its first beat; inf: none
    silent_s: float = inf  # from then on it does not beat
    again_s: float = inf  # and from then on it does
    word: bytes = b"."  # of its beats from `says_s` on
    says_s: float = 0.0
    ends_s: float = inf
    status: int = 0  # of its end, as the kernel tells it
    term_s: float = 0.2  # so long it takes to end in order; inf: it is deaf
    stands: bytes = DUMP  # what it writes when it is asked, and ends; empty: it goes on
    kill_s: float = 0.0  # so long the kernel takes to end it


@dataclass
class Process:
    name: str
    pid: int
    fd: int  # reading end of its pipe
    life: Played
    is_alive: bool = True


class Kernel:
    """In the place of os, select, signal and time. `told`: what happened, and when since the beginning."""

    WNOHANG, SCHED_IDLE, SCHED_OTHER, environ, Signals = os.WNOHANG, os.SCHED_IDLE, os.SCHED_OTHER, os.environ, Signals
    SIGCHLD, SIGKILL, SIGTERM = SIGCHLD, SIGKILL, SIGTERM
    waitstatus_to_exitcode, sched_param = staticmethod(os.waitstatus_to_exitcode), os.sched_param
    EVERY_S = 0.1  # programs beat so often

    def __init__(self, **lives: Iterable[Played]) -> None:
        self.now_s, self._order, self._looks = FIRST_S, count(), 0
        self._lives = defaultdict(
            lambda: repeat(Played()), {name: chain(each, repeat(Played())) for name, each in lives.items()}
        )
        self._never_block = set[int]()
        self._due = list[tuple[float, int, Callable[[], object]]]()
        self._fds, self._pids = chain(range(20, 24), count()), count(100)  # the first program's pipe is file 0
        self._waiting, self._writers, self._datagrams = dict[int, bytes](), set[int](), set[int]()  # by reading end
        self.dead, self._handlers, self._woken = list[tuple[int, int]](), dict[int, Callable[[int, object], object]](), -1
        self.processes, self.closed = list[Process](), list[int]()
        self.idle, self.hurried = list[str](), list[str]()  # programs that run when nobody else does, and no longer
        self._idlers = set[int]()
        self.told, self.waits_s, self.reads = list[tuple[float, str]](), list[float](), list[int]()

    def say(self, what: str) -> None:
        self.told.append((round(self.now_s - FIRST_S, 3), what))

    def at(self, s: float, what: Callable[[], object]) -> None:
        if s < inf:
            heapq.heappush(self._due, (FIRST_S + s, next(self._order), what))

    def _in(self, s: float, what: Callable[[], object]) -> None:
        self.at(self.now_s - FIRST_S + s, what)

    def monotonic(self) -> float:
        self._looks += 1
        assert self._looks < LOOKS, "it turns without end"
        return self.now_s

    # Pipes.

    def pipe(self) -> tuple[int, int]:
        read, write = next(self._fds), next(self._fds)
        self._waiting[read] = b""
        self._writers.add(read)
        return read, write

    def set_blocking(self, fd: int, blocking: bool) -> None:
        assert not blocking
        self._never_block.add(fd)

    def set_inheritable(self, fd: int, inheritable: bool) -> None:
        assert inheritable

    def close(self, fd: int) -> None:
        self.closed.append(fd)

    def write(self, fd: int, data: bytes) -> None:
        self._waiting[fd] += data

    def ask(self, fd: int, text: bytes) -> None:
        """A datagram: what does not fit into one reading is lost."""
        self._waiting[fd] = text
        self._datagrams.add(fd)

    def hang_up(self, process: Process) -> None:
        """It closes its pipe, and goes on."""
        self._writers.discard(process.fd)

    def strays(self, number: int) -> None:
        """Processes of others that ended, and that nobody waits for."""
        self.dead += [(9000 + each, 0) for each in range(number)]
        self.deliver(SIGCHLD)

    def stand_still(self, seconds: float) -> None:
        self.now_s += seconds

    def read(self, fd: int, size: int) -> bytes:
        self.reads.append(size)
        data = self._waiting[fd]
        if not data and fd in self._writers:
            raise BlockingIOError
        self._waiting[fd] = b"" if fd in self._datagrams else data[size:]
        return data[:size]

    def select(
        self, read: Sequence[int], write: Sequence[int], error: Sequence[int], wait_s: float
    ) -> tuple[list[int], list[int], list[int]]:
        assert wait_s >= 0.0
        self.waits_s.append(wait_s)
        until_s = self.now_s + wait_s
        while not (found := [fd for fd in read if self._waiting[fd] or fd not in self._writers]):
            if not self._due or self._due[0][0] > until_s:
                self.now_s = until_s
                break
            at_s, _, what = heapq.heappop(self._due)
            self.now_s = max(self.now_s, at_s)
            what()
        return found, [], []

    # Signals.

    def set_wakeup_fd(self, fd: int, *, warn_on_full_buffer: bool) -> None:
        assert not warn_on_full_buffer
        assert fd in self._never_block
        self._woken = fd - 1

    def signal(self, number: int, handler: Callable[[int, object], object]) -> None:
        self._handlers[number] = handler

    def deliver(self, number: int) -> None:
        self.write(self._woken, b"s")
        self._handlers[number](number, None)

    # Processes.

    def posix_spawnp(self, path: str, argv: Sequence[str], environ: object, **how: object) -> int:
        if path == "absent":
            raise FileNotFoundError(2, "No such file or directory")
        assert how["setsid"]
        process = Process(path, next(self._pids), int(argv[-1]) - 1, next(self._lives[path]))
        self.processes.append(process)
        life = process.life
        self._in(life.first_s, lambda: self._beat(process, life.first_s))
        self._in(life.ends_s, lambda: self.end(process, life.status))
        return process.pid

    def _beat(self, process: Process, age_s: float) -> None:
        life = process.life
        if not process.is_alive:
            return
        if age_s < life.silent_s or age_s >= life.again_s:
            self.write(process.fd, life.word if age_s >= life.says_s else b".")
        self._in(self.EVERY_S, lambda: self._beat(process, age_s + self.EVERY_S))

    def end(self, process: Process, status: int) -> None:
        if process.is_alive:
            process.is_alive = False
            self._writers.discard(process.fd)
            self.dead.append((process.pid, status))
            self.deliver(SIGCHLD)

    def kill(self, pid: int, number: int) -> None:
        process = next(each for each in self.processes if each.pid == pid)
        self.say(f"{process.name} {'asked' if number == STACKS_SIGNAL else 'term'}")
        assert number in (STACKS_SIGNAL, SIGTERM)
        if number == SIGTERM:
            self._in(process.life.term_s, lambda: self.end(process, 0))
        elif process.life.stands:
            self.write(process.fd, process.life.stands)
            self.end(process, STACKS_SIGNAL)

    def killpg(self, pid: int, number: int) -> None:
        assert number == SIGKILL
        process = next(each for each in self.processes if each.pid == pid)
        self.say(f"{process.name} killed")
        if not process.is_alive:
            raise ProcessLookupError
        self._in(process.life.kill_s, lambda: self.end(process, SIGKILL))

    def waitpid(self, pid: int, how: int) -> tuple[int, int]:
        self.monotonic()
        assert (pid, how) == (-1, os.WNOHANG)
        if self.dead:
            return self.dead.pop(0)
        if any(each.is_alive for each in self.processes):
            return 0, 0
        raise ChildProcessError

    def sched_setscheduler(self, pid: int, policy: int, parameters: object) -> None:
        name = next(each.name for each in self.processes if each.pid == pid)
        assert policy == (os.SCHED_OTHER if pid in self._idlers else os.SCHED_IDLE), "idle as it starts, and not as it ends"
        self._idlers.add(pid)
        (self.idle if policy == os.SCHED_IDLE else self.hurried).append(name)
