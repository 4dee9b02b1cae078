"""Strict priority, on the real loop with real sockets: what runs between a readable navigation frame and its handler."""

import asyncio
import random
import select
import selectors
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from math import inf

import pytest

from delfim.base.clock import Clock, ManualClock, SystemClock
from delfim.services.priority.navigation_loop import (
    ACCOUNT,
    Account,
    NavigationFirst,
    NavigationLoop,
    NavigationSelector,
)
from delfim.services.priority.window import NavigationWindow


class Navigation:
    """A navigation socket, and for each frame how many callbacks began between its sending and its handling."""

    def __init__(self) -> None:
        self.receiver, self._sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.receiver.setblocking(False)
        self.began = 0  # callbacks of the loop
        self.others: list[int] = []
        self._sent_at: int | None = None

    def send(self) -> None:
        """Now readable, unless a frame already is."""
        if self._sent_at is None:
            self._sent_at = self.began
            self._sender.send(b"frame")

    def handle(self) -> bool:
        """Called in a window without a frame, too."""
        try:
            assert self.receiver.recv(16) == b"frame"
        except BlockingIOError:
            return False
        assert self._sent_at is not None
        self.others.append(self.began - self._sent_at)
        self._sent_at = None
        return True

    def close(self) -> None:
        self.receiver.close()
        self._sender.close()


@pytest.fixture
def navigation(monkeypatch: pytest.MonkeyPatch) -> Iterator[Navigation]:
    """Counts every callback that the loop runs, of whatever kind."""
    navigation, run = Navigation(), asyncio.Handle._run

    def counted(handle: asyncio.Handle) -> None:
        navigation.began += 1
        run(handle)

    monkeypatch.setattr(asyncio.Handle, "_run", counted)
    yield navigation
    navigation.close()


@pytest.fixture
def window() -> NavigationWindow:
    return NavigationWindow(0.0006, 0.0)


def loop_with(window: NavigationWindow, clock: Clock | None = None) -> asyncio.Runner:
    return asyncio.Runner(loop_factory=lambda: NavigationLoop(window, clock or SystemClock(), Account("loop", 1.0)))


def first(handler: Callable[[], bool], fd: int) -> list[Exception]:
    """Register a navigation handler with the running loop; what it raises ends in the list."""
    loop, failures = asyncio.get_running_loop(), list[Exception]()
    assert isinstance(loop, NavigationLoop)
    loop.add_navigation(fd, handler, failures.append)
    return failures


class Echo(asyncio.Protocol):
    """Sends back what comes; two of them never stop."""

    def __init__(self, ran: Callable[[str], None]) -> None:
        self._ran = ran

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._ran("protocol")
        self._transport.write(data)


async def flood(ran: Callable[[str], None], enough: Callable[[], bool]) -> None:
    """Work of every kind that asyncio knows, always more of it than gets done, until it is enough."""
    loop = asyncio.get_running_loop()

    async def task() -> None:
        while not enough():
            ran("task")
            await asyncio.sleep(0)

    def soon() -> None:
        ran("soon")
        if not enough():
            loop.call_soon(soon)

    def timer() -> None:
        ran("timer")
        if not enough():
            loop.call_later(0.0001, timer)

    async def worker() -> None:
        while not enough():
            await loop.run_in_executor(None, abs, -1)
            ran("worker")

    transports = []
    for _ in range(3):
        loop.call_soon(soon)
        timer()
        for end in socket.socketpair():
            transport, _ = await loop.create_connection(lambda: Echo(ran), sock=end)
            transports.append(transport)
        transport.write(b"ping")
    await asyncio.gather(*(task() for _ in range(20)), worker(), worker())
    for transport in transports:
        transport.close()


def test_nothing_runs_between_a_frame_and_its_handler(navigation: Navigation, window: NavigationWindow) -> None:
    """Frames come while callbacks of every kind run; the one under way is the only one."""
    kinds, chance = Counter[str](), random.Random(1)

    def ran(kind: str) -> None:
        kinds[kind] += 1
        if chance.random() < 0.1:
            navigation.send()

    async def main() -> None:
        first(navigation.handle, navigation.receiver.fileno())
        await asyncio.wait_for(flood(ran, lambda: len(navigation.others) >= 1000), 20)

    with loop_with(window) as runner:
        runner.run(main())
    assert set(kinds) == {"task", "soon", "timer", "protocol", "worker"}
    assert max(navigation.others) == 0


class Interrupting(SystemClock):
    """The loop reads the clock at every step that it makes between two callbacks, so that is when frames come, too."""

    def __init__(self, navigation: Navigation) -> None:
        self._navigation, self._chance = navigation, random.Random(1)

    def monotonic_s(self) -> float:
        if self._chance.random() < 0.1:
            self._navigation.send()
        return time.monotonic()


def test_one_callback_at_most_when_a_frame_comes_at_any_step_of_the_loop(navigation, window):
    async def main() -> None:
        first(navigation.handle, navigation.receiver.fileno())
        await asyncio.wait_for(flood(lambda kind: None, lambda: len(navigation.others) >= 1000), 20)

    with loop_with(window, Interrupting(navigation)) as runner:
        runner.run(main())
    assert max(navigation.others) == 1


class Scripted(SystemClock):
    """Time passes by being read; every 10 ms of it a frame comes."""

    def __init__(self, navigation: Navigation) -> None:
        self._navigation, self.now_s, self._due_s = navigation, 100.0, 100.0

    def monotonic_s(self) -> float:
        self.now_s += 2e-5
        if self.now_s >= self._due_s:
            self._navigation.send()
            self._due_s += 0.01
        return self.now_s


def test_no_callback_runs_when_the_frame_comes_inside_its_window(navigation: Navigation) -> None:
    window, running_at_opening = NavigationWindow(0.0006, 0.2), []
    open_window = window.open

    def opened(now_s: float) -> float:
        running_at_opening.append(navigation.began)
        return open_window(now_s)

    window.open = opened  # type: ignore[method-assign]
    running_at_arrival: list[int] = []

    def handle() -> bool:
        complete = navigation.handle()
        if complete:
            running_at_arrival.append(navigation.began)
        return complete

    async def main() -> None:
        first(handle, navigation.receiver.fileno())
        await asyncio.wait_for(flood(lambda kind: None, lambda: len(navigation.others) >= 100), 20)

    with loop_with(window, Scripted(navigation)) as runner:
        runner.run(main())
    assert window.hits >= 94
    assert window.misses == window.late == 0
    assert running_at_arrival[5:99] == running_at_opening[:94]


@pytest.mark.parametrize(
    ("timer_s", "selected_s", "polled_s"),
    [
        (None, 0.0045, 0.0),  # no timer: until the window opens
        (0.0100, 0.0045, 0.0),
        (0.0042, 0.0042, 0.0),  # epoll_wait would make 5 ms of it, and be late for the window
        (0.0020, None, 0.0020),  # is over in time, whatever it makes of it
    ],
)
def test_no_timer_lets_the_loop_sleep_into_its_window(monkeypatch, timer_s, selected_s, polled_s):
    window, selected, polled = NavigationWindow(0.0006, 0.1), list[float](), list[float | None]()
    selector = NavigationSelector(NavigationFirst(window, ManualClock(), Account("loop", 1.0)))
    monkeypatch.setattr(select, "select", lambda _r, _w, _x, timeout: selected.append(timeout))
    monkeypatch.setattr(selectors.EpollSelector, "select", lambda _, timeout: polled.append(timeout) or [])
    window.opens_s = ManualClock().monotonic_s() + 0.0045
    with closing(selector):
        assert selector.select(timer_s) == []
    assert selected == pytest.approx([] if selected_s is None else [selected_s])
    assert polled == [polled_s]


class Passing(ManualClock):
    """Time passes by being read, and by waiting."""

    def monotonic_s(self) -> float:
        self.advance(1e-5)
        return super().monotonic_s()


def test_the_loop_wakes_for_a_window_and_holds_it_for_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else to do and nothing comes: the window is opened in time, and closed."""
    clock, window = Passing(100.0), NavigationWindow(0.002, 0.5)
    monkeypatch.setattr(select, "select", lambda _r, _w, _x, timeout: clock.advance(timeout))
    monkeypatch.setattr(selectors.EpollSelector, "select", lambda _, timeout: [clock.advance(timeout)][1:])

    async def main(fd: int) -> None:
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "time", clock.monotonic_s)
        first(lambda: False, fd)
        now_s = clock.monotonic_s()
        for i in range(-10, 0):
            window.arrived(fd, now_s + 0.02 * i + 0.01)
        await asyncio.sleep(0.1)

    receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with receiver, sender, loop_with(window, clock) as runner:
        runner.run(main(receiver.fileno()))
        monkeypatch.undo()
    assert (window.hits, window.misses, window.late) == (0, 3, 0)
    assert window.opens_s == inf
    assert window.spent_s == pytest.approx(3 * 2 * 0.002, abs=3 * 1e-4)  # opened before the message was due


class Practice:
    """A rehearsal that notes what is asked of it."""

    def __init__(self, step: Callable[[], None]) -> None:
        self._step, self.steps = step, list[str]()

    def whole(self) -> None:
        self.steps.append("whole")
        self._step()

    def part(self) -> None:
        self.steps.append("part")
        self._step()


@pytest.mark.parametrize("raises", ["", "whole", "part"])
def test_the_path_is_rehearsed_in_windows_alone_and_never_again_once_that_raised(navigation: Navigation, raises: str) -> None:
    window, is_open = NavigationWindow(0.0006, 0.2), set[bool]()

    def step() -> None:
        is_open.add(window.is_open)
        if rehearsal.steps[-1] == raises:
            raise ValueError("defect")

    rehearsal = Practice(step)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, NavigationLoop)
        loop.set_rehearsal(rehearsal)
        first(navigation.handle, navigation.receiver.fileno())
        await asyncio.wait_for(flood(lambda kind: None, lambda: len(navigation.others) >= 50), 20)

    with loop_with(window, Scripted(navigation)) as runner:
        runner.run(main())
    assert is_open == {True}
    if raises:
        assert (rehearsal.steps.count(raises), rehearsal.steps[-1]) == (1, raises)
    else:
        assert 0 < rehearsal.steps.count("whole") <= window.hits + window.misses + window.late + 1
        assert rehearsal.steps.count("part") > window.hits


def test_a_rehearsal_that_would_not_be_over_in_time_is_left_out_and_one_interruption_is_forgotten() -> None:
    clock = ManualClock()
    first = NavigationFirst(NavigationWindow(0.0006, 0.2), clock, Account("loop", 1.0))
    lengths_s = [0.00015, 0.5, *[0.00009] * 100]
    first.rehearsal = rehearsal = Practice(lambda: clock.advance(lengths_s[len(rehearsal.steps) - 1]))

    def window() -> int:
        """Rehearsals in a window of which the message is due 0.6 ms after it opened."""
        count, now_s = len(rehearsal.steps), clock.monotonic_s()
        first._rehearse(now_s + 0.0006, now_s)
        return len(rehearsal.steps) - count

    with closing(first):
        assert window() == 1
        assert window() == 1, "interrupted for half a second"
        assert window() == 0, "so none was begun"
        assert any(window() for _ in range(20))
        assert window() == 1


@pytest.mark.parametrize("step", [1, 4])
def test_a_message_that_came_during_a_rehearsal_is_not_taken_for_a_later_one(monkeypatch, navigation, step):
    """Else the next windows would open later, and their messages come during rehearsals, too. And no service pays for it."""
    clock, window, fd = ManualClock(), NavigationWindow(0.0006, 0.2), navigation.receiver.fileno()
    account = Account("vehicle", 1.0)
    first = NavigationFirst(window, clock, account)
    for i in range(10):
        window.arrived(fd, 0.01 * i)
    arrived, arrived_s, begun_s = window.arrived, list[float](), list[float]()
    monkeypatch.setattr(window, "arrived", lambda source, at_s: (arrived_s.append(at_s), arrived(source, at_s)))

    def practise() -> None:
        begun_s.append(clock.monotonic_s())
        clock.advance(0.00005)
        if len(begun_s) == step:
            navigation.send()

    with closing(first):
        first.add(fd, navigation.handle, print)
        first.rehearsal = Practice(practise)
        clock.advance(0.0995)
        first.resume()
    assert arrived_s == [begun_s[step - 1]]
    assert len(begun_s) == step, "none more when the message is there"
    assert account.busy_s == 0.0


def test_a_computer_that_slept_in_a_window_has_windows_again() -> None:
    window = NavigationWindow(0.0006, 0.1)
    for i in range(10):
        window.arrived(1, 0.1 * i)
    window.open(window.opens_s)
    window.close(window.opens_s, 3600.0)
    for i in range(10):
        window.arrived(1, 3600.2 + 0.1 * i)
    now_s = window.opens_s
    assert window.open(now_s) > now_s


def test_nobody_starves_while_navigation_is_always_readable(navigation: Navigation, window: NavigationWindow) -> None:
    """Every frame that is handled brings the next one: others still get a turn each, in turn."""
    turns = Counter[str]()
    ends = [socket.socketpair() for _ in range(3)]

    def handle() -> bool:
        navigation.handle()
        navigation.send()
        return True

    async def main() -> list[int]:
        loop = asyncio.get_running_loop()
        first(handle, navigation.receiver.fileno())
        navigation.send()

        def turn(name: str) -> None:
            turns[name] += 1

        def chain(name: str) -> None:
            turn(name)
            loop.call_soon(chain, name)

        for i, (near, far) in enumerate(ends):
            far.send(b"always readable")
            loop.add_reader(near, turn, f"reader {i}")
            chain(f"chain {i}")
        while min(turns.values()) < 500 or len(turns) < 6:
            await asyncio.sleep(0)
        for near, _ in ends:
            loop.remove_reader(near)
        return list(turns.values())

    with loop_with(window) as runner:
        counts = runner.run(asyncio.wait_for(main(), 20))
    for near, far in ends:
        near.close()
        far.close()
    assert max(counts) <= min(counts) + 2
    assert len(navigation.others) >= sum(counts)


def test_two_sources_are_both_first(window: NavigationWindow) -> None:
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
    order: list[str] = []

    def handler(end: socket.socket, name: str) -> Callable[[], bool]:
        def handle() -> bool:
            end.recv(16)
            order.append(name)
            return True

        return handle

    async def main() -> None:
        loop = asyncio.get_running_loop()
        for i, (near, _) in enumerate(pairs):
            first(handler(near, f"navigation {i}"), near.fileno())
        loop.call_soon(order.append, "other")
        loop.call_soon(order.append, "other")
        for _, far in pairs:
            far.send(b"frame")
        await asyncio.sleep(0.01)

    with loop_with(window) as runner:
        runner.run(main())
    for near, far in pairs:
        near.close()
        far.close()
    assert sorted(order[:2]) == ["navigation 0", "navigation 1"]
    assert order[2:] == ["other", "other"]


def test_a_handler_that_raises_is_removed_and_told(window: NavigationWindow) -> None:
    receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def handle() -> bool:
        raise ValueError("defect")

    async def main() -> list[Exception]:
        failures = first(handle, receiver.fileno())
        sender.send(b"frame")
        await asyncio.sleep(0.02)
        return failures

    with receiver, sender, loop_with(window) as runner:
        failures = runner.run(main())
    assert [str(failure) for failure in failures] == ["defect"]


def test_a_handler_may_remove_the_other_one(window: NavigationWindow) -> None:
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
    called: list[int] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, NavigationLoop)

        def handler(this: int) -> Callable[[], bool]:
            def handle() -> bool:
                called.append(this)
                for near, _ in pairs:
                    loop.remove_navigation(near.fileno())
                return False

            return handle

        for i, (near, far) in enumerate(pairs):
            first(handler(i), near.fileno())
            far.send(b"frame")
        await asyncio.sleep(0.01)

    with loop_with(window) as runner:
        runner.run(main())
    for near, far in pairs:
        near.close()
        far.close()
    assert len(called) == 1


def test_removing_a_socket_that_is_closed_already_is_in_order(window: NavigationWindow) -> None:
    receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, NavigationLoop)
        fd = receiver.fileno()
        first(lambda: False, fd)
        receiver.close()
        loop.remove_navigation(fd)
        loop.remove_navigation(fd)

    with sender, loop_with(window) as runner:
        runner.run(main())


def test_the_time_of_a_callback_is_charged_to_who_registered_it(window: NavigationWindow) -> None:
    """Readers, timers, tasks and navigation handlers, each on the account of the context they come from."""
    clock, budget_s = ManualClock(), 0.002
    costs_s = {"reader": 0.003, "timer": 0.001, "task": 0.004, "navigation": 0.005, "idle": 0.0}
    accounts = {name: Account(name, budget_s) for name in costs_s}
    pairs = {name: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for name in ("reader", "navigation")}
    done = set[str]()

    def work(name: str) -> bool:
        if name in pairs:
            pairs[name][0].recv(16)
        clock.advance(costs_s[name])
        done.add(name)
        return True

    async def task() -> None:
        ACCOUNT.set(accounts["task"])
        await asyncio.sleep(0)
        work("task")

    async def main() -> None:
        loop = asyncio.get_running_loop()
        ACCOUNT.set(accounts["reader"])
        loop.add_reader(pairs["reader"][0], work, "reader")
        ACCOUNT.set(accounts["timer"])
        loop.call_later(0.001, work, "timer")
        ACCOUNT.set(accounts["navigation"])
        first(lambda: ACCOUNT.get() is accounts["navigation"] and work("navigation"), pairs["navigation"][0].fileno())
        ACCOUNT.set(accounts["idle"])
        for _, far in pairs.values():
            far.send(b"frame")
        await task()
        while len(done) < 4:
            await asyncio.sleep(0.001)
        loop.remove_reader(pairs["reader"][0])

    with loop_with(window, clock) as runner:
        runner.run(main())
    for pair in pairs.values():
        for end in pair:
            end.close()
    assert {name: account.longest_s for name, account in accounts.items()} == pytest.approx(costs_s)
    assert {name: account.busy_s for name, account in accounts.items()} == pytest.approx(costs_s), "waiting costs nothing"
    assert {name: account.over_budget for name, account in accounts.items()} == {
        name: int(cost_s > budget_s) for name, cost_s in costs_s.items()
    }
