"""payload: runs the outside programs of the vehicle's file (thesis 2.8, figure 2-7): navigation in, values out.

A service in a process of its own, so that no pipe of theirs burdens the runtime: it watches the vehicle over the command
socket as a console does. A program that does not read loses lines, one that floods is slowed down and its lines are dropped
and counted, one that ends is started again after a pause. Each is confined by `delfim.services.supervision.confine`. What it
orders goes to the vehicle, which decides. How to write one: docs/payloads.md.
"""

import asyncio
import contextlib
import fcntl
import logging
import os
import signal
import sys
from functools import partial
from typing import Any, Final, cast

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import FormatError, PermanentFailure, in_words, one_line
from delfim.logging.liblog import event_line
from delfim.logging.nodelog import line as log_line
from delfim.logging.openlog import open_log
from delfim.parts.payload.payloadorders import OrderLine
from delfim.parts.payload.table import PayloadTable
from delfim.services.report_feed import watch
from delfim.services.runtime import Runtime
from delfim.services.supervision import processes
from delfim.services.supervision.cgroup import ROOT, Limits
from delfim.services.supervision.children import ended
from delfim.services.supervision.confine import ALONE, NETWORK
from delfim.services.supervision.supervisor import EXIT_PERMANENT
from delfim.vehicle.orders.payloadlines import (
    LINE_BYTES,
    ORDER_BYTES,
    VALUES,
    BoundedLines,
    OrderBudget,
    Value,
    answered,
    lines,
    ordered,
    values,
    word_of,
)
from delfim.vehicle.report import BoatReport

LOOK_S: Final = 2.0  # between two looks at the programs' processes
END_S: Final = 0.3  # from SIGTERM to SIGKILL, and for its last words; the runtime waits a second for a service
PAUSE_S: Final = 0.1  # a program that says much is not heard for so long
MUCH_BYTES: Final = 4096  # in one piece
REPORTS: Final = 50.0, 100  # lines of values a second in the long run, and at once
SAID: Final = 5.0, 20  # the same of lines of standard error
PIPE_BYTES: Final = 4096  # that wait for a program: some seconds of navigation
SAID_CHARACTERS: Final = 200  # of one line in the log

log = logging.getLogger(__name__)


async def _within(seconds: float, event: asyncio.Event) -> None:
    """Wait for something, at most so long."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()


class Payload(asyncio.SubprocessProtocol):
    """One program with its process, its lines, its figures."""

    def __init__(self, name: str, table: PayloadTable, settings: config.Vehicle, clock: Clock, orders: OrderLine) -> None:
        self.name, self._table, self._pauses, self._clock = name, table, settings.supervisor, clock
        self._group, self._limits = f"payload-{name}", Limits(table.memory_max_mb << 20, table.cpu_max)
        self._feed = -1  # its standard input
        self._log = open_log(settings.log, self._group, ".jsonl", "zwrite", clock)
        self._transport: asyncio.SubprocessTransport | None = None
        self._ended, self._silent = asyncio.Event(), asyncio.Event()  # the process; both of its pipes
        self._over, self._wanted = asyncio.Event(), asyncio.Event()  # it ended, or shall; no operator has stopped it
        self._wanted.set()
        self._pipes = 0
        self._reports = BoundedLines(*REPORTS, ORDER_BYTES if table.may else LINE_BYTES)
        self._said = BoundedLines(*SAID)
        self._orders, self._budget, self._dropped = orders, OrderBudget(), 0  # lines that it was told of
        self._last_words = ""
        self._usage, self._cpu = processes.Usage(), 0.0
        self.state, self.reason, self.since_s = "starting", "", clock.monotonic_s()
        self.restarts = self.told = self.unread = self.refused = self.reported = self.ordered = self.denied = 0
        self.values = dict[str, tuple[Value, float]]()  # the newest of each name, and when it came

    # The life of the process.

    async def run(self) -> None:
        """Start the program again and again, with growing pauses, until it must not be or the service is cancelled."""
        self._log.note(event_line(self._clock, "start", command=self._table.command[0]))
        pause_s = self._pauses.backoff_s
        while True:
            if not self._wanted.is_set():
                self._change("stopped", "")
                self._log.note(event_line(self._clock, "stopped", reason="by the operator"))
                await self._wanted.wait()
            began_s, before = self._clock.monotonic_s(), self.reason
            code, reason = await self._once()
            if not self._wanted.is_set():
                continue
            lived_s = self._clock.monotonic_s() - began_s
            again = code != EXIT_PERMANENT
            self._change("waiting" if again else "failed", f"{reason}: {self._last_words}" if self._last_words else reason)
            if self.reason != before or not again:
                log.error("payload: %s: %s%s", self.name, self.reason, "" if again else "; not started again")
            self._log.note(event_line(self._clock, "end", reason=self.reason))
            if not again:
                return
            pause_s = self._pauses.backoff_s if lived_s > self._pauses.backoff_max_s else pause_s
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, self._pauses.backoff_max_s)
            self.restarts += 1

    async def _once(self) -> tuple[int, str]:
        """Run the program once; returns its exit code, and how it ended in words."""
        table, loop = self._table, asyncio.get_running_loop()
        limits = tuple(map(str, (table.memory_max_mb, table.cpu_max, table.processes_max)))
        limits = (*limits, NETWORK if table.network else ALONE)
        words = (sys.executable, "-m", "delfim.services.supervision.confine", self._group, table.user, *limits, *table.command)
        self._ended.clear()
        self._over.clear()
        self._silent.clear()
        self._pipes, self._last_words = 2, ""
        self._limits.end(self._group)
        stdin, feed = os.pipe()
        try:
            start = loop.subprocess_exec(lambda: self, *words, stdin=stdin, start_new_session=True)
            transport, _ = await processes.started(start)
        except OSError as error:
            os.close(feed)
            return 127, in_words(error)
        finally:
            os.close(stdin)
        pid, self._feed = transport.get_pid(), feed
        os.set_blocking(feed, False)
        fcntl.fcntl(feed, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._change("running", self.reason)
        with contextlib.ExitStack() as last:
            last.callback(transport.close)
            last.callback(self._kill, pid)
            try:
                await self._over.wait()
            finally:
                self._transport, self._feed = None, -1
                os.close(feed)
                processes.end(pid, signal.SIGTERM)
                await processes.empty(pid, END_S)
                self._kill(pid)
                await _within(END_S, self._ended)  # the loop has to hear of it before it ends itself
            await _within(END_S, self._silent)  # its last words may still be in the pipe
        code = transport.get_returncode()
        if code is None or not self._wanted.is_set():
            return 0, ""
        return code, self._limits.exceeded(self._group) or ended(code)

    def _kill(self, session: int) -> None:
        processes.kill(session)
        self._limits.end(self._group)

    def _change(self, state: str, reason: str) -> None:
        self.state, self.reason, self.since_s = state, reason, self._clock.monotonic_s()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.SubprocessTransport, transport)

    def pipe_connection_lost(self, fd: int, exc: Exception | None) -> None:
        self._pipes -= 1
        if self._pipes == 0:
            self._silent.set()

    def process_exited(self) -> None:
        self._ended.set()
        self._over.set()

    def rest(self, rests: bool) -> None:
        """An operator has stopped it, or not."""
        if rests:
            self._wanted.clear()
            self._over.set()
        else:
            self._wanted.set()

    # Its lines.

    def tell(self, line: bytes) -> None:
        """Send the program a line, unless too many wait for it already."""
        if self._feed < 0:
            return
        try:
            os.write(self._feed, line)  # whole or not at all: it is shorter than PIPE_BUF
            self.told += 1
        except OSError:  # full, or closed at its end
            self.unread += 1

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        now_s = self._clock.monotonic_s()
        if fd == 1:
            for line in self._reports.feed(data, now_s):
                self._hear(line, now_s)
            if self._table.may and self._reports.dropped > self._dropped:
                dropped, self._dropped = self._reports.dropped - self._dropped, self._reports.dropped
                self.tell(answered("", f"refused: {dropped} lines dropped: more than {REPORTS[0]:.0f} a second"))
        else:
            for line in self._said.feed(data, now_s):
                self._last_words = one_line(line.decode(errors="replace"))[:SAID_CHARACTERS]
                log.info("payload: %s: %s", self.name, self._last_words)
        if len(data) >= MUCH_BYTES and self._transport is not None:
            pipe = cast(asyncio.ReadTransport, self._transport.get_pipe_transport(fd))
            pipe.pause_reading()
            asyncio.get_running_loop().call_later(PAUSE_S, _resume, pipe)

    def _hear(self, line: bytes, now_s: float) -> None:
        """Take a line of values, or an order, which is logged as it came and answered."""
        word = word_of(line)
        if word is None:
            self._report(line, now_s)
            return
        self._log.put(log_line(self._clock.time_ns(), line))
        answer = partial(self._answer, word)
        try:
            if not self._table.may:
                raise FormatError(f"{self.name} has no rights: its table says what it may")
            command = ordered(line)
        except FormatError as error:
            answer(f"refused: {error}")
            return
        if why := self._budget.exceeded(command, now_s):
            answer(f"refused: {why}")
        else:
            self._orders.order(self.name, command, answer)

    def _answer(self, word: str, refused: str | None) -> None:
        self.ordered += refused is None
        self.denied += refused is not None
        self.tell(answered(word, refused))

    def _report(self, line: bytes, now_s: float) -> None:
        """Take a line of values: it is logged as it came, the newest of each name kept."""
        found = values(line)
        if found is None or len(self.values.keys() | found.keys()) > VALUES:
            self.refused += 1
            return
        self.reported += 1
        self.values |= {name: (value, now_s) for name, value in found.items()}
        self._log.put(log_line(self._clock.time_ns(), line))

    # Its figures.

    def look(self, usage: dict[int, processes.Usage], elapsed_s: float) -> None:
        """Update the figures; called every LOOK_S with what all sessions of the computer use."""
        self._log.poll()
        now = usage.get(self._transport.get_pid(), processes.Usage()) if self._transport is not None else processes.Usage()
        self._cpu, self._usage = max(now.cpu_s - self._usage.cpu_s, 0.0) / elapsed_s, now

    def process(self) -> dict[str, object]:
        """The process, as a row of the page."""
        return {
            "state": self.state,
            "restarts": self.restarts,
            "cpu_percent": round(100 * self._cpu, 1),
            "memory_mb": round(self._usage.memory_bytes / 1e6, 1),
        }

    def lines(self) -> dict[str, object]:
        """Counts of the lines that were sent, not read, and reported; of those dropped or refused; of orders by their
        answers."""
        return {
            "told": self.told,
            "unread": self.unread,
            "reported": self.reported,
            "dropped": self._reports.dropped + self._said.dropped,
            "refused": self.refused,
            "ordered": self.ordered,
            "denied": self.denied,
        }

    def trouble(self, now_s: float) -> str:
        """The reason, in words, why somebody should look at it; also for a while after it was started again."""
        if self.reason and (self.state != "running" or now_s - self.since_s < self._pauses.backoff_max_s):
            return f"{self.state}: {self.reason}"
        return "" if self._log.status().writable else f"its log is not written: {self._log.status().reason}"

    def close(self) -> None:
        self._log.note(event_line(self._clock, "end"))
        self._log.close()


def _resume(pipe: asyncio.ReadTransport) -> None:
    if not pipe.is_closing():
        pipe.resume_reading()


class Payloads:
    """All programs, and the vehicle's state that they receive."""

    def __init__(self, runtime: Runtime) -> None:
        settings, self._clock = runtime.config, runtime.clock
        self._socket = settings.console.socket
        self.orders = OrderLine(self._socket, self._clock)
        self.programs = [
            Payload(name, table, settings, self._clock, self.orders) for name, table in settings.table("payload").items()
        ]
        self._before: BoatReport | None = None
        self._trouble = "the vehicle has not answered yet"

    async def watch(self) -> None:
        """Send the programs what the vehicle publishes."""
        await watch(self._socket, self._heard, self._failed)

    def _failed(self, why: str) -> None:
        self._trouble = why

    def _heard(self, now: BoatReport) -> None:
        self._trouble = ""
        for program in self.programs:
            program.rest(program.name in now.resting)
        for line in lines(now, self._before):
            for program in self.programs:
                program.tell(line)
        self._before = now

    async def look(self) -> None:
        """Keep the figures and the logs of the programs."""
        at_s = self._clock.monotonic_s()
        while True:
            await asyncio.sleep(LOOK_S)
            now_s, usage = self._clock.monotonic_s(), processes.usage()
            for program in self.programs:
                program.look(usage, max(now_s - at_s, 1e-3))
            at_s = now_s

    def figures(self) -> dict[str, Any]:
        now_s = self._clock.monotonic_s()
        troubles = {each.name: words for each in self.programs if (words := each.trouble(now_s))}
        shown = {
            f"{each.name} {name}": {"value": value, "age_s": round(now_s - at_s, 1)}
            for each in self.programs
            for name, (value, at_s) in each.values.items()
        }
        return {
            "troubles": troubles | ({"navigation": self._trouble} if self._trouble else {}),
            "last_ends": {each.name: each.reason for each in self.programs if each.reason},
            "programs": {each.name: each.process() for each in self.programs},
            "lines": {each.name: each.lines() for each in self.programs},
            "values": shown,
        }


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    status = runtime.status.get("payload")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("payload: the vehicle does not start programs; write services.payload.place = 'process'")
    if os.getuid():
        log.warning("payload: only root can run programs as another user; they run as this one")
    if not (ROOT / "cgroup.controllers").exists():
        log.warning("payload: no control groups at %s: memory is limited for each process alone, cpu_max is not kept", ROOT)
    payloads = Payloads(runtime)
    with contextlib.ExitStack() as links:
        for program in payloads.programs:
            links.callback(program.close)
        links.enter_context(runtime.publishing("payload", payloads.figures))
        async with asyncio.TaskGroup() as group:
            group.create_task(payloads.watch())
            if any(table.may for table in runtime.config.table("payload").values()):
                group.create_task(payloads.orders.follow())
            group.create_task(payloads.look())
            for program in payloads.programs:
                group.create_task(program.run())
