"""The runtime with real services, signals and pipes. What changes a whole process runs in one of its own."""

import asyncio
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from itertools import pairwise
from pathlib import Path

import pytest

from delfim import config
from delfim.base.clock import Clock, ManualClock, SystemClock
from delfim.base.errors import BusError, PermanentFailure
from delfim.services import runtime as module
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.supervision.children import LAST_WORD, LEAVES
from delfim.services.supervision.supervisor import EXIT_PERMANENT

SETTINGS = config.Vehicle(
    boat=config.BoatTable(name="Test"), supervisor=config.SupervisorTable(deadman_s=0.4, backoff_s=0.01, backoff_max_s=0.04)
)
Start = Callable[[Runtime], Awaitable[None]]


def ran(*services: LoadedService, beat_fd: int = -1, clock: Clock | None = None) -> tuple[Runtime, int]:
    """The runtime after it ended, and its exit code."""
    runtime = Runtime(SETTINGS, clock or SystemClock(), beat_fd=beat_fd, alone=True)
    return runtime, runtime.main(services)


def in_a_process(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A program that may spoil its process, with the names of this file."""
    preamble = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); from test_runtime import *\n"
    command = [sys.executable, "-c", preamble + program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)


async def forever(runtime: Runtime) -> None:
    await asyncio.Event().wait()


async def stopper(runtime: Runtime) -> None:
    """A service that ends the test once the others have had their time."""
    await asyncio.sleep(0.1)
    runtime.stop("test over")


def test_a_service_is_called_at_its_period_and_starts_again_when_a_call_fails() -> None:
    ticks = list[int]()

    async def ticking(runtime: Runtime) -> None:
        ended = asyncio.Event()

        def tick() -> None:
            ticks.append(runtime.status["ticking"].restarts)
            if len(ticks) == 3:
                raise ValueError("a defect")
            if len(ticks) == 6:
                ended.set()

        with runtime.ticking(0.001, tick):
            await ended.wait()
        ticks.append(-1)

    runtime, _ = ran(LoadedService("ticking", ticking))
    assert ticks == [0, 0, 0, 1, 1, 1, -1], "a tick that failed is the last of its block, and none comes after the end of one"
    assert runtime.status["ticking"].reason == "finished"


def test_it_ends_when_all_services_have() -> None:
    async def brief(runtime: Runtime) -> None:
        await asyncio.sleep(0)

    runtime, code = ran(LoadedService("one", brief), LoadedService("two", brief))
    assert code == 0
    assert {(name, status.state, status.reason) for name, status in runtime.status.items()} == {
        ("one", "stopped", "finished"),
        ("two", "stopped", "finished"),
    }


def test_a_service_that_raises_is_started_again_after_growing_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    starts: list[str] = []
    pauses: list[float] = []
    sleep = asyncio.sleep

    async def sleeping(pause_s: float) -> None:
        pauses.append(pause_s)
        await sleep(0)

    async def failing(runtime: Runtime) -> None:
        starts.append("failing")
        if len(starts) == 5:
            return
        raise BusError("bus-off")

    monkeypatch.setattr(asyncio, "sleep", sleeping)
    runtime, _ = ran(LoadedService("failing", failing))
    assert pauses == [0.01, 0.02, 0.04, 0.04]
    assert runtime.status["failing"].restarts == 4


def test_what_fails_again_and_again_is_told_once_and_when_it_goes(caplog, monkeypatch):
    monkeypatch.setattr(module, "SETTLE_S", 0.0)
    caplog.set_level("INFO")
    ends = [BusError("there is no interface can0"), *[BusError("can0 is down")] * 9, *[KeyError("heading")] * 3, None]

    async def failing(runtime: Runtime) -> None:
        if (end := ends.pop(0)) is not None:
            raise end
        await asyncio.sleep(0.01)

    ran(LoadedService("can", failing))
    assert [record.getMessage() for record in caplog.records if record.getMessage().startswith("can: ")] == [
        "can: there is no interface can0; retried within 0.04 s",
        "can: can0 is down; retried within 0.04 s",
        "can: defect in the program",
        "can: KeyError: 'heading'; retried within 0.04 s",
        "can: runs again",
    ]


def test_the_reason_of_a_failure_is_kept_in_words(caplog: pytest.LogCaptureFixture) -> None:
    async def failing(runtime: Runtime) -> None:
        raise BusError("can0: bus-off")

    async def defective(runtime: Runtime) -> None:
        raise KeyError("heading")

    reasons: list[str] = []

    async def looking(runtime: Runtime) -> None:
        await asyncio.sleep(0.05)
        reasons.extend(status.reason for status in runtime.status.values())
        runtime.stop("test over")

    ran(LoadedService("failing", failing), LoadedService("defective", defective), LoadedService("looking", looking))
    assert reasons == ["can0: bus-off", "KeyError: 'heading'", ""]
    with_traceback = {record.message for record in caplog.records if record.exc_info}
    assert with_traceback == {"defective: defect in the program"}


def test_a_permanent_failure_is_final_and_others_go_on() -> None:
    starts: list[str] = []

    async def hopeless(runtime: Runtime) -> None:
        starts.append("hopeless")
        raise PermanentFailure("no such device")

    async def well(runtime: Runtime) -> None:
        await asyncio.sleep(0.05)

    runtime, code = ran(LoadedService("hopeless", hopeless), LoadedService("well", well))
    assert starts == ["hopeless"]
    assert (runtime.status["hopeless"].state, runtime.status["hopeless"].reason) == ("failed", "no such device")
    assert runtime.status["well"].state == "stopped"
    assert code == EXIT_PERMANENT


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_the_services_one_after_the_other_the_last_row_first(number: signal.Signals) -> None:
    order: list[str] = []

    def noting(name: str) -> Start:
        async def start(runtime: Runtime) -> None:
            try:
                await forever(runtime)
            finally:
                await asyncio.sleep(0.01)  # its end takes time, and the next one waits for it
                order.append(name)

        return start

    async def killer(runtime: Runtime) -> None:
        await asyncio.sleep(0.01)
        os.kill(os.getpid(), number)
        await forever(runtime)

    runtime, code = ran(
        *(LoadedService(name, noting(name)) for name in ("log", "httpd", "vehicle")), LoadedService("killer", killer)
    )
    assert order == ["vehicle", "httpd", "log"]
    assert code == 0
    assert {(status.state, status.reason) for status in runtime.status.values()} == {("stopped", number.name)}


def test_a_service_waiting_for_its_next_start_stops_at_once() -> None:
    async def failing(runtime: Runtime) -> None:
        raise BusError("bus-off")

    runtime, _ = ran(LoadedService("failing", failing), LoadedService("stopper", stopper))
    assert runtime.status["failing"].state == "stopped"


def test_a_service_that_raises_while_it_stops_is_not_started_again() -> None:
    starts: list[str] = []

    async def untidy(runtime: Runtime) -> None:
        starts.append("untidy")
        try:
            await forever(runtime)
        finally:
            raise BusError("cannot close")

    runtime, _ = ran(LoadedService("untidy", untidy), LoadedService("stopper", stopper))
    assert starts == ["untidy"]
    assert runtime.status["untidy"].state == "stopped"


REFUSING = """
async def refusing(runtime):
    while True:
        try:
            await forever(runtime)
        except asyncio.CancelledError:
            pass
async def noting(runtime):
    try:
        await forever(runtime)
    finally:
        print("stopped", flush=True)
module.STOP_S = 0.1
ran(LoadedService("log", noting), LoadedService("refusing", refusing), LoadedService("stopper", stopper))
"""


def test_a_service_that_refuses_to_end_does_not_keep_the_process() -> None:
    end = in_a_process(REFUSING)
    assert (end.returncode, end.stdout) == (1, "stopped\n")
    assert "refusing did not end in 0.1 s" in end.stderr


@pytest.mark.parametrize("until", [Runtime.reading, Runtime.navigating])
def test_a_callback_that_raises_fails_its_service(until: Callable[..., contextlib.AbstractContextManager[None]]) -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    starts: list[str] = []

    async def service(runtime: Runtime) -> None:
        starts.append(runtime.status["service"].reason)
        if len(starts) == 2:
            return

        def handler() -> bool:
            raise BusError("gone")

        with until(runtime, near.fileno(), handler):
            far.send(b"frame")
            await forever(runtime)

    async def well(runtime: Runtime) -> None:
        await asyncio.sleep(0.05)
        starts.append("well is well")

    with near, far:
        _, code = ran(LoadedService("service", service), LoadedService("well", well))
    assert starts == ["", "gone", "well is well"]
    assert code == 0


def test_readers_and_navigation_are_called_until_they_are_removed() -> None:
    calls: list[str] = []
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]

    async def service(runtime: Runtime) -> None:
        def handler(i: int) -> Callable[[], bool]:
            def handle() -> bool:
                calls.append(pairs[i][0].recv(16).decode())
                return True

            return handle

        with contextlib.ExitStack() as links:
            links.enter_context(runtime.navigating(pairs[0][0].fileno(), handler(0)))
            links.enter_context(runtime.reading(pairs[1][0].fileno(), handler(1)))
            for _ in range(2):
                pairs[1][1].send(b"other")
                pairs[0][1].send(b"navigation")
                await asyncio.sleep(0.01)
                links.close()

    ran(LoadedService("service", service))
    for pair in pairs:
        for end in pair:
            end.close()
    assert calls == ["navigation", "other"]


def test_a_reader_with_a_pause_is_not_called_more_often_and_not_after_its_removal() -> None:
    calls_s: list[float] = []
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    async def service(runtime: Runtime) -> None:
        theirs.send(b"never read")
        runtime.reader(ours.fileno(), lambda: calls_s.append(time.monotonic()), 0.01)
        while len(calls_s) < 5:
            await asyncio.sleep(0.001)
        runtime.remove_reader(ours.fileno())
        await asyncio.sleep(0.03)

    ran(LoadedService("service", service))
    for end in (ours, theirs):
        end.close()
    assert len(calls_s) == 5
    assert min(later_s - earlier_s for earlier_s, later_s in pairwise(calls_s)) >= 0.009


def test_every_callback_is_charged_to_its_service_from_when_it_has_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """The connections that a server of a service accepts are the service's, too. What starting costs does not count."""
    monkeypatch.setattr(module, "SETTLE_S", 0.02)

    clock, worked = ManualClock(), asyncio.Event()

    class Slow(asyncio.Protocol):
        def data_received(self, data: bytes) -> None:
            clock.advance(0.005)
            worked.set()

    async def serving(runtime: Runtime) -> None:
        clock.advance(0.05)
        server = await asyncio.get_running_loop().create_server(Slow, "127.0.0.1", 0)
        async with server:
            while runtime.status["serving"].state != "running":
                await asyncio.sleep(0.005)
            with socket.create_connection(server.sockets[0].getsockname()) as client:
                client.send(b"work")
                await worked.wait()

    async def idle(runtime: Runtime) -> None:
        await worked.wait()

    runtime, _ = ran(LoadedService("serving", serving), LoadedService("idle", idle), clock=clock)
    serving_account, idle_account = runtime.status["serving"].account, runtime.status["idle"].account
    assert (serving_account.longest_s, serving_account.over_budget) == (pytest.approx(0.005), 1)
    assert idle_account.busy_s == 0.0
    report = runtime.report()
    assert json.loads(json.dumps(report)) == report


def test_it_beats_at_least_every_tenth_of_a_second_and_says_when_nobody_listens() -> None:
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    beats: list[int] = []

    async def listening(runtime: Runtime) -> None:
        for _ in range(4):
            await asyncio.sleep(module.BEAT_S)
            beats.append(len(os.read(reader, 100)))
        os.close(reader)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(forever(runtime), 10.0)
        runtime.stop("it was not told")

    runtime, code = ran(LoadedService("listening", listening), beat_fd=writer)
    os.close(writer)
    assert all(1 <= n <= 3 for n in beats)
    assert (code, runtime.status["listening"].reason) == (0, "the supervisor is gone")


def test_the_first_beat_comes_when_the_libraries_of_the_start_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a slow computer reading them keeps the loop from turning for longer than a dead-man waits."""
    os.mkfifo(tmp_path / "gate")
    (tmp_path / "library_of_this_test.py").write_text(f"open({str(tmp_path / 'gate')!r}).close()")
    monkeypatch.syspath_prepend(tmp_path)
    reader, writer = os.pipe()
    beats: list[int] = []

    async def reading(runtime: Runtime) -> None:
        library = runtime.load("library_of_this_test")
        await asyncio.sleep(3 * module.BEAT_S)
        beats.append(len(select.select([reader], [], [], 0)[0]))
        assert runtime.is_starting()
        (tmp_path / "gate").write_text("")
        await library
        while not select.select([reader], [], [], 0)[0]:
            await asyncio.sleep(0.01)
        beats.append(runtime.is_starting())
        runtime.stop("test over")

    _, code = ran(LoadedService("reading", reading), beat_fd=writer)
    os.close(reader)
    os.close(writer)
    assert (beats, code) == ([0, False], 0)


IN_REAL_TIME = """
said = []
module.real_time = said.append
sys.path.insert(0, sys.argv[1])
gate = Path(sys.argv[1]) / "gate"
async def reading(runtime):
    library = runtime.load("library_of_this_test")
    await asyncio.sleep(3 * module.BEAT_S)
    print(said)
    gate.write_text("")
    await library
    while not said:
        await asyncio.sleep(0.01)
    print(said)
    runtime.stop("test over")
sys.exit(Runtime(SETTINGS, SystemClock()).main([LoadedService("reading", reading)]))
"""


def test_it_is_in_real_time_when_the_libraries_of_the_start_are_read(tmp_path: Path) -> None:
    """On one slow processor the threads that read them would never get it."""
    os.mkfifo(tmp_path / "gate")
    (tmp_path / "library_of_this_test.py").write_text(f"open({str(tmp_path / 'gate')!r}).close()")
    end = in_a_process(IN_REAL_TIME, str(tmp_path))
    assert (end.returncode, end.stdout) == (0, "[]\n[10]\n"), end.stderr


def test_a_full_pipe_does_not_disturb() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    while select.select([], [writer], [], 0)[1]:
        os.write(writer, bytes(4096))
    runtime, code = ran(LoadedService("waiting", forever), LoadedService("stopper", stopper), beat_fd=writer)
    os.close(reader)
    os.close(writer)
    assert (code, runtime.status["waiting"].reason) == (0, "test over")


def test_the_supervisor_hears_that_the_services_have_ended_before_the_threads_have() -> None:
    """They may keep the process for longer than a dead-man waits."""
    reader, writer = os.pipe()
    said = b""

    def until_the_last_word() -> None:
        nonlocal said
        while LAST_WORD not in said and len(said) < 100:
            said += os.read(reader, 100)

    async def working(runtime: Runtime) -> None:
        asyncio.get_running_loop().run_in_executor(None, until_the_last_word)
        await forever(runtime)

    _, code = ran(LoadedService("working", working), LoadedService("stopper", stopper), beat_fd=writer)
    os.close(reader)
    os.close(writer)
    assert (code, said.strip(b".")) == (0, LAST_WORD)


def test_from_when_the_boat_is_stopped_the_supervisor_hears_that_the_program_leaves() -> None:
    """What comes after, logs above all, may hold the loop for longer than a dead-man waits."""
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    said = list[bytes]()

    async def sailing(runtime: Runtime) -> None:
        runtime.leaves()  # not yet: nobody ends the program
        try:
            await forever(runtime)
        finally:
            said.append(os.read(reader, 1000))
            runtime.leaves()
            assert not runtime.ends_in_order(), "a test is no signal"
            runtime._beat()
            said.append(os.read(reader, 1000))

    ran(LoadedService("sailing", sailing), LoadedService("stopper", stopper), beat_fd=writer)
    os.close(reader)
    os.close(writer)
    assert (set(said[0]), said[1]) == ({ord(".")}, 2 * LEAVES)


def test_the_last_deadman_event_is_shown(tmp_path: Path) -> None:
    event = {"reason": "beat stopped for 1.0 s: dead-man", "at_s": 1500.0}
    (tmp_path / "supervisor.json").write_text(json.dumps({"deadman": event}))
    reader, writer = os.pipe()
    settings = config.Vehicle(boat=config.BoatTable(name="Test"), runtime=config.RuntimeTable(run_directory=str(tmp_path)))
    assert Runtime(settings, SystemClock(), beat_fd=writer).report()["deadman"] == event
    (tmp_path / "supervisor.json").write_text("{")
    assert Runtime(settings, SystemClock(), beat_fd=writer).report()["deadman"] == {}
    os.close(reader)
    os.close(writer)


UNPRIVILEGED = """
import resource
if os.geteuid() == 0:
    os.setuid(65534)
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
settings = config.RuntimeTable(nice=-5, fifo_priority=10, cpus=(1023,), mlockall=True)
async def brief(runtime):
    print("well")
vehicle = config.Vehicle(boat=config.BoatTable(name="Test"), runtime=settings)
sys.exit(Runtime(vehicle, SystemClock()).main([LoadedService("brief", brief)]))
"""


def test_what_is_not_permitted_costs_one_warning_each() -> None:
    end = in_a_process(UNPRIVILEGED)
    assert (end.returncode, end.stdout) == (0, "well\n"), end.stderr
    warnings = [line.split(": ")[0] for line in end.stderr.splitlines() if "going on without" in line]
    assert warnings == ["runtime.nice = -5", "runtime.cpus = [1023]", "runtime.mlockall", "runtime.fifo_priority = 10"]


COLLECTING = """
import gc
async def littering(runtime):
    print(json.dumps([gc.isenabled(), gc.get_freeze_count() > 10000]))
    for i in range(20):
        for _ in range(2000):
            loop = []
            loop.append(loop)
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.25)
    print(json.dumps([runtime.report()["loop"]["collections"] >= 1, gc.get_count()[0] < 5000]))
Runtime(SETTINGS, SystemClock()).main([LoadedService("littering", littering)])
"""


def test_garbage_is_collected_by_the_loop_and_not_by_the_interpreter() -> None:
    end = in_a_process(COLLECTING)
    assert end.stdout == "[false, true]\n[true, true]\n", end.stderr
