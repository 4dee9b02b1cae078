"""The runtime: one process, one loop, navigation first; the vehicle and the services as cooperative tasks of it.

A service is a name and a coroutine function that runs until it is cancelled. If it returns, it has finished; if it raises,
it is restarted after a pause, but after PermanentFailure it stays down; the reason is kept and shown.
Services start in the order given and are stopped one after the other in reverse order.
How to add a service, and what the figures of `report` mean: docs/runtime.md.
"""

import asyncio
import gc
import importlib
import json
import logging
import os
import signal
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import copy_context
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, PermanentFailure, in_words
from delfim.services.priority.garbage import Collector
from delfim.services.priority.navigation_loop import ACCOUNT, Account, NavigationLoop, Practice
from delfim.services.priority.window import NavigationWindow
from delfim.services.servicestatus import ServiceStatus, Stage, status_file
from delfim.services.supervision.children import LAST_WORD, LEAVES
from delfim.services.supervision.privileges import real_time, requested, set_privileges
from delfim.services.supervision.supervisor import EXIT_PERMANENT
from delfim.services.supervision.supervisorfile import last_deadman

BEAT_S: Final = 0.1  # the longest time between two beats of a healthy loop
SETTLE_S: Final = 1.0  # a service is starting for this long; the cost of its callbacks counts afterwards
STOP_S: Final = 1.0  # time for a service to end after its cancellation
SIGNALS: Final = {each.name: each for each in (signal.SIGTERM, signal.SIGINT)}  # by which the program is told to end
TELL_S: Final = 1.0  # a process of its own reports its service this often

log = logging.getLogger(__name__)


class LoadedService(NamedTuple):
    """A service to run."""

    name: str
    start: Callable[["Runtime"], Awaitable[None]]  # runs until cancelled
    budget_s: float | None = None  # of one callback; None: the vehicle's file says it


class Runtime:
    """The loop and its services. One per process.

    beat_fd: pipe to the supervisor, -1 for none; a byte goes into it every BEAT_S while the loop turns, and when its other
    end is gone the runtime stops in order: a boat without dead-man must not sail.
    alone: this process carries one service outside the runtime; it has no windows and no real-time settings.
    new_loop: makes a loop that knows nothing of navigation, for a process alone. It keeps no accounts of callbacks: there
    they wait for nobody but each other. None: a loop that serves navigation first.
    """

    def __init__(
        self,
        settings: config.Vehicle,
        clock: Clock,
        file: str = "",
        *,
        beat_fd: int = -1,
        alone: bool = False,
        new_loop: Callable[[], asyncio.AbstractEventLoop] | None = None,
    ) -> None:
        self.config, self.clock, self.file = settings, clock, file  # the vehicle's
        self.status: dict[str, ServiceStatus] = {}
        self.board: dict[str, Callable[[], dict[str, object]]] = {}  # JSON-ready figures of services, by their names
        limits = settings.runtime
        self.window = NavigationWindow(limits.window_guard_s, 0.0 if alone or not limits.window else limits.window_share_max)
        self._account = Account("runtime", limits.callback_budget_s)  # the loop's own callbacks
        self._place = "process" if alone else "runtime"
        self._beat_fd = beat_fd
        self._beat_s = min(BEAT_S, settings.supervisor.deadman_s / 4)
        self._loads, self._is_up, self._word = 0, False, b"."  # libraries being read; whether it has ever beaten, and how
        self._loop: asyncio.AbstractEventLoop
        self._first: NavigationLoop  # the same loop, where it serves navigation first
        self._plain_loop = new_loop
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._pauses: dict[int, asyncio.TimerHandle] = {}  # of readers
        self._stop_reason, self._stopping = "", asyncio.Event()
        self._collector = Collector(self.window, clock)
        self._deadman: dict[str, object] = {}
        if beat_fd >= 0:
            os.set_inheritable(beat_fd, False)
            os.set_blocking(beat_fd, False)
            self._deadman = last_deadman(Path(limits.run_directory) / "supervisor.json")

    # For services.

    @contextmanager
    def navigating(self, fd: int, handler: Callable[[], bool]) -> Iterator[None]:
        """Call `handler` strictly first whenever `fd` is readable, until the end of the block. It drains the socket and returns
        True where that completed a navigation message. Time and failure are the calling service's."""
        self._first.add_navigation(fd, handler, self._failed())
        try:
            yield
        finally:
            self._first.remove_navigation(fd)

    def rehearsal(self, rehearsal: Practice | None) -> None:
        """Set the rehearsal that keeps the caches warm for navigation: the critical path without effect."""
        self._first.set_rehearsal(rehearsal)

    def reader(self, fd: int, handler: Callable[[], object], pause_s: float = 0.0) -> None:
        """Call `handler` in its turn whenever `fd` is readable, at most once each `pause_s`: waking up for every frame of a
        busy bus costs more than the frames. Time and failure as in `navigating`."""
        failed = self._failed()

        def guarded() -> None:
            try:
                handler()
            except Exception as error:  # a defect of the service: it is restarted, the loop goes on
                self._loop.remove_reader(fd)
                failed(error)
            else:
                if pause_s:
                    self._loop.remove_reader(fd)
                    self._pauses[fd] = self._loop.call_later(pause_s, watch)

        def watch() -> None:
            self._pauses.pop(fd, None)
            self._loop.add_reader(fd, guarded)

        watch()

    def remove_reader(self, fd: int) -> None:
        if pause := self._pauses.pop(fd, None):
            pause.cancel()
        self._loop.remove_reader(fd)

    @contextmanager
    def reading(self, fd: int, handler: Callable[[], object], pause_s: float = 0.0) -> Iterator[None]:
        """Call `handler` as `reader` does, until the end of the block."""
        self.reader(fd, handler, pause_s)
        try:
            yield
        finally:
            self.remove_reader(fd)

    @contextmanager
    def ticking(self, period_s: float, handler: Callable[[], object]) -> Iterator[None]:
        """Call `handler` so often, between navigation and in its turn, until the end of the block; a late tick is not made up
        for. Time and failure as in `navigating`."""
        failed = self._failed()
        due: asyncio.TimerHandle

        def tick() -> None:
            nonlocal due
            due = self._loop.call_at(max(due.when() + period_s, self._loop.time()), tick)
            try:
                handler()
            except Exception as error:  # a defect of the service: it is restarted, the loop goes on
                due.cancel()
                failed(error)

        due = self._loop.call_later(period_s, tick)
        try:
            yield
        finally:
            due.cancel()

    @contextmanager
    def publishing(self, name: str, report: Callable[[], dict[str, object]]) -> Iterator[None]:
        """Publish a service's figures, JSON-ready, on the board until the end of the block."""
        self.board[name] = report
        try:
            yield
        finally:
            del self.board[name]

    def load(self, module: str) -> asyncio.Future[ModuleType]:
        """Load a large library beside the loop while the boat comes up: it costs the path some milliseconds, once. Its objects
        stay for good, so that no collection looks at them. A service's libraries for its first step are read before the first
        beat: a slow computer may take its time for it. Raises ImportError."""
        loading = asyncio.get_running_loop().run_in_executor(None, importlib.import_module, module)
        loading.add_done_callback(self._loaded)
        self._loads += 1
        return loading

    def is_starting(self) -> bool:
        """Whether a dead-man still waits for the first beat: nothing may turn a propeller yet."""
        return self._beat_fd >= 0 and not self._is_up

    def _loaded(self, _: object) -> None:
        self._loads -= 1
        if not gc.isenabled():
            gc.freeze()

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: services, navigation window, the loop's own callbacks, the dead-man's last event, the time
        since boot."""
        now_s = self.clock.monotonic_s()
        return {
            "figures_s": round(now_s, 3),
            "services": {name: status.report(now_s) | self._shown(name) for name, status in self.status.items()},
            "window": self.window.report(),
            "loop": {
                "busy_s": round(self._account.busy_s, 3),
                "longest_callback_s": round(self._account.longest_s, 6),
                **self._collector.report(),
                "tasks": len(asyncio.all_tasks(self._loop)) if self._tasks else 0,
            },
            "deadman": self._deadman,
        }

    def _shown(self, name: str) -> dict[str, object]:
        return {"figures": self.board[name]()} if name in self.board else {}

    def stop(self, reason: str) -> None:
        """End in order: every service, the last of the table first."""
        if not self._stop_reason:
            log.log(logging.WARNING if self._place == "runtime" else logging.INFO, "%s: stopping: %s", self._place, reason)
            self._stop_reason = reason
            self._stopping.set()

    def ends_in_order(self) -> bool:
        """Whether the program was asked to end, and the supervisor lives to do so: whoever ends all that a dead supervisor
        started sends the same signal."""
        try:
            return self._stop_reason in SIGNALS and (self._beat_fd < 0 or os.write(self._beat_fd, self._word) > 0)
        except BlockingIOError:
            return True
        except BrokenPipeError:
            return False

    def leaves(self) -> None:
        """Note that the boat is stopped at the end of the program, and nothing here commands it any more. Logs may take their
        time."""
        if self._stop_reason:
            self._word = LEAVES
            self._say(LEAVES)

    # The life of the process.

    def main(self, services: Sequence[LoadedService]) -> int:
        """Run until SIGTERM, SIGINT, the end of the supervisor or of all services. Returns the exit code: EXIT_PERMANENT where
        a service must not be started again, otherwise 0."""
        if self._place == "runtime":
            set_privileges(self.config.runtime)
            gc.collect()
            gc.freeze()
            gc.disable()
        with asyncio.Runner(loop_factory=self._new_loop) as runner:
            runner.run(self.run(services))
        failed = any(status.state == "failed" for status in self.status.values())
        return EXIT_PERMANENT if failed else 0

    async def run(self, services: Sequence[LoadedService]) -> None:
        """All of `main` that happens in the loop."""
        budget_s = self.config.runtime.callback_budget_s
        for row in services:
            account = Account(row.name, budget_s if row.budget_s is None else row.budget_s)
            self.status[row.name] = ServiceStatus(row.name, self._place, account, os.getpid(), self.clock.monotonic_s())
        for number in SIGNALS.values():
            self._loop.add_signal_handler(number, self.stop, number.name)
        async with asyncio.TaskGroup() as group:
            for row in services:
                context = copy_context()
                context.run(ACCOUNT.set, self.status[row.name].account)
                self._tasks[row.name] = group.create_task(self._serve(row), name=row.name, context=context)
                self._tasks[row.name].add_done_callback(self._ended)
            self._loop.call_soon(self._beat)  # after the first step of every service
            self._collector.tick()
            if self._place == "process" and self._beat_fd >= 0:
                place = Path(self.config.runtime.run_directory)
                self._tell({name: status_file(place / f"service-{name}.json") for name in self.status})
            await self._stopping.wait()
            stuck = [row.name for row in reversed(services) if not await self._end(row.name)]
            if stuck:  # the group would wait for ever
                log.critical("runtime: %s did not end in %g s and held up the rest", ", ".join(stuck), STOP_S)
                logging.shutdown()
                os._exit(1)
        self._say(LAST_WORD)
        self._beat_fd = -1

    def _new_loop(self) -> asyncio.AbstractEventLoop:
        if self._plain_loop is not None:
            self._loop = self._plain_loop()
        else:
            self._loop = self._first = NavigationLoop(self.window, self.clock, self._account)
        return self._loop

    async def _serve(self, row: LoadedService) -> None:
        """Run one service, restarted when it fails, until it is stopped."""
        status, limits = self.status[row.name], self.config.supervisor
        pause_s = limits.backoff_s
        began_s = self.clock.monotonic_s()
        while await self._attempt(row, status):
            if self.clock.monotonic_s() - began_s > limits.backoff_max_s:
                pause_s = limits.backoff_s
            if status.told != status.reason:  # and not each time that nothing has changed
                log.error("%s: %s; retried within %g s", row.name, status.reason, limits.backoff_max_s)
                status.told = status.reason
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, limits.backoff_max_s)
            status.restarts += 1
            began_s = self.clock.monotonic_s()

    async def _attempt(self, row: LoadedService, status: ServiceStatus) -> bool:
        """Run a service once. Returns whether there is to be another run."""
        status.failure = None
        self._change(status, "starting", status.reason)
        settled = self._loop.call_later(SETTLE_S, self._settled, status)
        try:
            await row.start(self)
            self._change(status, "stopped", "finished")
            return False
        except asyncio.CancelledError:
            if status.failure is None or self._stop_reason:
                raise
            while self._tasks[row.name].uncancel():
                pass
            error = status.failure
        except Exception as raised:
            error = raised
        finally:
            settled.cancel()
        reason = in_words(error)
        if not isinstance(error, DelfimError | OSError) and reason != status.told:
            log.error("%s: defect in the program", row.name, exc_info=error)
        if isinstance(error, PermanentFailure):
            log.error("%s: %s; not started again", row.name, reason)
            self._change(status, "failed", reason)
            return False
        self._change(status, "waiting", reason)
        return not self._stop_reason

    def _change(self, status: ServiceStatus, state: Stage, reason: str) -> None:
        status.state, status.reason, status.since_s = state, reason, self.clock.monotonic_s()

    def _settled(self, status: ServiceStatus) -> None:
        self._change(status, "running", status.reason)
        status.account.reset()
        log.info("%s: %s", status.name, "runs again" if status.told else "runs")
        status.told = ""

    def _failed(self) -> Callable[[Exception], None]:
        """The handler of exceptions in callbacks of the calling service. Raises LookupError outside a service."""
        name = ACCOUNT.get().name

        def failed(error: Exception) -> None:
            self.status[name].failure = error
            self._tasks[name].cancel()

        return failed

    async def _end(self, name: str) -> bool:
        """Stop one service. Returns whether it ended."""
        task, status = self._tasks[name], self.status[name]
        task.cancel()
        ended, _ = await asyncio.wait([task], timeout=STOP_S)
        if ended and status.state not in ("failed", "stopped"):
            log.info("%s: ended", name)
            self._change(status, "stopped", self._stop_reason)
        return bool(ended)

    def _ended(self, _: asyncio.Task[None]) -> None:
        if all(task.done() for task in self._tasks.values()):
            self.stop("all services have ended")

    # The loop's own work.

    def _be_real_time(self) -> None:
        """Become real time, not earlier: on a slow computer with one processor the threads that read the libraries would never
        get it."""
        priority = self.config.runtime.fifo_priority
        if priority and self._place == "runtime":
            requested(f"fifo_priority = {priority}", lambda: real_time(priority))

    def _beat(self) -> None:
        """Send the supervisor a beat: the loop turns. Before the first one the supervisor is patient, and that is when
        libraries are read."""
        self._loop.call_later(self._beat_s, self._beat)
        if not self._is_up:
            if self._loads:
                return
            self._is_up = True
            self._be_real_time()
        self._say(self._word)

    def _say(self, word: bytes) -> None:
        try:
            if self._beat_fd >= 0:
                os.write(self._beat_fd, word)
        except BlockingIOError:
            pass  # the supervisor is slow, not dead
        except OSError:
            self.stop("the supervisor is gone")

    def _tell(self, files: dict[str, int]) -> None:
        """Report the services: the page is in another process. The files were opened before the process changed its user."""
        self._loop.call_later(TELL_S, self._tell, files)
        for name, status in self.status.items():
            if files[name] >= 0:
                told = status.report(self.clock.monotonic_s()) | self._shown(name) | {"tasks": len(asyncio.all_tasks())}
                told["busy_s"] = round(time.process_time(), 3)
                os.ftruncate(files[name], os.pwrite(files[name], json.dumps(told).encode(), 0))
