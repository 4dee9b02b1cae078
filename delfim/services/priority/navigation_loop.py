"""Strict priority for navigation in an asyncio loop (thesis 2.7, 3.4), by two mechanisms.

Navigation first: `NavigationLoop` looks at the navigation sockets between any two callbacks of any kind (readers,
tasks, timers, protocols, completions of workers). From the moment a frame is readable, at most one other callback runs
before its handler does. For all others the loop stays what it is: first come, first served, nobody starves.

Navigation window: navigation is periodic. `NavigationWindow` (`window.py`) learns when the next message is due;
shortly before, the loop runs nothing else and polls without sleeping until the message is there or the window ends. No callback
is under way then.

Between two callbacks is also where their time is measured: `Account` holds the cost of each service. Linux only (epoll). Why
it is made like this, with figures: docs/decisions/0001-navigation-first.md.
"""

import asyncio
import logging
import select
import selectors
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from contextvars import Context, ContextVar, copy_context
from dataclasses import dataclass
from math import inf
from typing import Any, Final, Protocol

from delfim.base.clock import Clock
from delfim.services.priority.window import NavigationWindow

EPOLL_TICK_S: Final = 0.001


@dataclass(slots=True)
class Account:
    """The cost of one service's callbacks. Times are wall time: the loop's waiting, not the processor's work."""

    name: str
    budget_s: float  # of one callback
    busy_s: float = 0.0
    longest_s: float = 0.0
    over_budget: int = 0  # callbacks that took longer than the budget

    def charge(self, spent_s: float) -> None:
        self.busy_s += spent_s
        if spent_s > self.longest_s:
            self.longest_s = spent_s
        if spent_s > self.budget_s:
            self.over_budget += 1

    def reset(self) -> None:
        self.busy_s, self.longest_s, self.over_budget = 0.0, 0.0, 0


# A callback or task is charged to the context in which it was registered, and so is all that comes of it.
ACCOUNT: Final[ContextVar[Account]] = ContextVar("ACCOUNT")


def speaker() -> str:
    """The name of the service whose callback this is; empty for none."""
    account = ACCOUNT.get(None)
    return account.name if account else ""


class Practice(Protocol):
    """The critical path without effect, to warm the caches. It must not raise."""

    def whole(self) -> None: ...  # when a window opens, where it is over before the message is due
    def part(self) -> None: ...  # between two looks of a window that waits: a message waits for it, so it takes microseconds


class NavigationSelector(selectors.EpollSelector):
    """Sleeps as the loop's selector does, but wakes in time for the window, and serves navigation before it returns."""

    def __init__(self, first: "NavigationFirst") -> None:
        super().__init__()
        self._first = first
        self.register(first.fileno(), selectors.EVENT_READ)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        first = self._first
        now_s = first.rest()
        if timeout is None or timeout > 0.0:
            until_s, asked_s = first.window.opens_s - now_s, inf if timeout is None else timeout
            if until_s < asked_s + EPOLL_TICK_S:  # epoll_wait, which rounds up to ms, would sleep into it
                select.select([self.fileno()], [], [], max(min(until_s, asked_s), 0.0))
                timeout = 0.0
        events = super().select(timeout)
        first.resume()
        return [event for event in events if event[0].data is not None] if events else events

    def close(self) -> None:
        super().close()
        self._first.close()


class NavigationFirst:
    """The work between two callbacks: the one before is charged, navigation is served, the window is kept."""

    def __init__(self, window: NavigationWindow, clock: Clock, account: Account) -> None:
        self.window = window
        self._clock_s = clock.monotonic_s
        self._epoll = select.epoll()
        self._poll = self._epoll.poll
        self._handlers: dict[int, tuple[Context, Callable[[], bool], Account, Callable[[Exception], None]]] = {}
        self._own = self._payer = account
        self._since_s = self._clock_s()
        self._is_fresh = False  # navigation was looked at, and nothing ran since
        self.rehearsal: Practice | None = None
        self._rehearsal_s = 0.0  # time left to the message when another one begins
        self._practised_s = self._since_s  # when the last practice was over, which is the window's time and no service's

    def fileno(self) -> int:
        """The descriptor that is readable while a navigation socket is."""
        return self._epoll.fileno()

    def add(self, fd: int, handler: Callable[[], bool], failed: Callable[[Exception], None]) -> None:
        self._epoll.register(fd, select.EPOLLIN)
        context = copy_context()
        self._handlers[fd] = context, handler, context.get(ACCOUNT, self._own), failed

    def remove(self, fd: int) -> None:
        if self._handlers.pop(fd, None):
            with suppress(OSError):  # closed already
                self._epoll.unregister(fd)
            self.window.forget(fd)

    def close(self) -> None:
        self._epoll.close()

    def between(self, context: Context) -> None:
        """Do the work before a callback of this context. The hot path of the loop: a few hundred nanoseconds."""
        now_s = self._clock_s()
        self._payer.charge(now_s - self._since_s)
        if self._is_fresh:
            self._is_fresh = False
        else:
            ready = self._poll(0.0, 4)
            if ready or now_s >= self.window.opens_s:
                now_s = self._serve(ready, now_s)
        self._payer = context.get(ACCOUNT, self._own)
        self._since_s = now_s

    def rest(self) -> float:
        """Do the work before the loop polls. Returns the time."""
        now_s = self._clock_s()
        self._payer.charge(now_s - self._since_s)
        return now_s

    def resume(self) -> None:
        """Do the work after the loop has polled. Handling the results goes to its own account."""
        now_s = self._clock_s()
        ready = self._poll(0.0, 4)
        if ready or now_s >= self.window.opens_s:
            now_s = self._serve(ready, now_s)
        self._is_fresh = True
        self._payer = self._own
        self._since_s = now_s

    def _serve(self, ready: Iterable[tuple[int, int]], now_s: float) -> float:
        for fd, _ in ready:
            now_s = self._handle(fd, now_s)
        window = self.window
        if now_s >= window.opens_s:
            opened_s, until_s = now_s, window.open(now_s)
            now_s = self._rehearse(min(window.due_s, until_s), now_s)
            awaited = window.awaited
            while window.is_open and now_s < until_s:  # the handler looks itself: so all of its way stays warm
                now_s = self._handle(awaited, now_s)
                if window.is_open:
                    for fd, _ in self._poll(0.0, 4):
                        now_s = self._handle(fd, now_s)
                if window.is_open and self.rehearsal is not None:
                    self._practise(self.rehearsal.part)
            window.close(opened_s, now_s)
        return now_s

    def _rehearse(self, until_s: float, now_s: float) -> float:
        """Rehearse the whole path once, unless it may not be over in time or the message is there. Returns when that was last
        known not to be so: a message that came meanwhile did not come later than it was due, and the next window must not open
        later for it."""
        if self.rehearsal is None or self._poll(0.0, 1):
            return now_s
        if now_s + self._rehearsal_s > until_s:
            self._rehearsal_s *= 0.5  # an interrupted one must not be the measure for ever
            return now_s
        self._practise(self.rehearsal.whole)
        self._rehearsal_s = 2.0 * (self._practised_s - now_s)
        return now_s

    def _practise(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception:  # a defect that must cost no more than warm caches: rehearsals end here
            self.rehearsal = None
            logging.getLogger(__name__).exception("rehearsal of the critical path")
        self._practised_s = self._clock_s()

    def _handle(self, fd: int, at_s: float) -> float:
        """Call the handler of a readable socket; `at_s` is when it was seen. Returns the time."""
        if fd not in self._handlers:  # the handler before this one removed it
            return self._clock_s()
        context, handler, account, failed = self._handlers[fd]
        try:
            if context.run(handler):
                self.window.arrived(fd, at_s)
        except Exception as error:  # a defect of the service: it is restarted, the loop goes on
            self.remove(fd)
            failed(error)
        now_s = self._clock_s()
        account.charge(now_s - max(at_s, self._practised_s))
        return now_s


class _Ready(deque[asyncio.Handle]):
    """The callbacks that are ready to run. Every single one leaves through here."""

    def __init__(self, handles: Iterable[asyncio.Handle], between: Callable[[Context], None]) -> None:
        super().__init__(handles)
        self._between = between

    def popleft(self) -> asyncio.Handle:
        handle = super().popleft()
        self._between(handle._context)  # type: ignore[attr-defined]
        return handle


class NavigationLoop(asyncio.SelectorEventLoop):
    """An asyncio loop with one difference: navigation first.

    It rests on two details of CPython's asyncio that no public interface offers: `_ready.popleft()` hands out each callback,
    and a handle has its `_context`. tests/services/test_priority.py fails in a version in which that is not so.
    """

    _ready: Any

    def __init__(self, window: NavigationWindow, clock: Clock, account: Account) -> None:
        self._first = NavigationFirst(window, clock, account)
        super().__init__(NavigationSelector(self._first))
        self._ready = _Ready(self._ready, self._first.between)

    def add_navigation(self, fd: int, handler: Callable[[], bool], failed: Callable[[Exception], None]) -> None:
        """Call `handler` whenever `fd` is readable, before anything else, in the context of now. It drains the socket and
        returns True where that completed a message. When it raises, `fd` is removed and `failed` called. Raises OSError for
        a descriptor that epoll cannot watch."""
        self._first.add(fd, handler, failed)

    def set_rehearsal(self, rehearsal: Practice | None) -> None:
        """Set the rehearsal that keeps the caches warm for navigation."""
        self._first.rehearsal = rehearsal

    def remove_navigation(self, fd: int) -> None:
        """Remove a navigation socket; nothing happens where `fd` was not added."""
        self._first.remove(fd)
