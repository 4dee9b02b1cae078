"""Fixtures for all tests, and the rule that continuous integration skips nothing."""

import asyncio
import contextlib
import ctypes
import fcntl
import gc
import importlib
import inspect
import os
import signal
import socket
import struct
from collections.abc import Generator, Iterator
from pathlib import Path

import hypothesis
import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

from tests.guest.harness import Guest, guest, missing

# The same examples in every run, and no stopwatch: a busy machine is no failure.
hypothesis.settings.register_profile("delfim", deadline=None, derandomize=True)
hypothesis.settings.load_profile("delfim")

# Matrices of these tests are small: more threads only wait for each other, and take the processor from the tests beside them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Most of what there is stays, all tests among it: who looks through it as often as by default does so a twelfth of the time.
gc.set_threshold(10_000, 10, 10)

# A shell's job in the background ignores Ctrl-C, and so would all programs that are started here and ended by it.
signal.signal(signal.SIGINT, signal.default_int_handler)


ROOT = Path(__file__).parents[1]
CLONE_NEWNET, SIOCSIFFLAGS, IFF_UP = 0x40000000, 0x8914, 1  # linux/sched.h, linux/sockios.h, linux/if.h


def pytest_configure(config: pytest.Config) -> None:
    """A worker of several has a network of its own, where that is permitted: its ports and its buses are its own."""
    if hasattr(config, "workerinput") and ctypes.CDLL(None).unshare(CLONE_NEWNET) == 0:
        with socket.socket() as any_socket:
            fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sh22x", b"lo", IFF_UP))


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """All workers import all tests, which takes long where nothing is compiled yet: each begins with a share of its own, and
    finds the others' compiled. What fails here fails again where it is told."""
    if worker := getattr(session.config, "workerinput", None):
        asked = [ROOT / each.partition("::")[0] for each in session.config.args]
        files = [each for each in sorted(ROOT.glob("tests/**/test_*.py")) if any(map(each.is_relative_to, asked))]
        for file in files[int(worker["workerid"].removeprefix("gw")) :: worker["workercount"]]:
            with contextlib.suppress(Exception, pytest.skip.Exception):
                importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cuts", type=int, default=3, help="how often the power fails in tests/guest/test_power_cut.py (3)")
    parser.addoption("--frames-per-s", type=int, default=2000, help="on the bus in test_power_cut.py (%(default)s)")
    parser.addoption("--minutes", type=float, default=0.1, help="of the black box on a full bus, in a guest (%(default)s)")
    parser.addoption("--mutations", type=int, default=40, help="of each kind of file, in test_mutated_files.py (%(default)s)")
    parser.addoption(
        "--outages", type=int, default=20, help="of one of two links, in tests/console/test_links.py (%(default)s)"
    )
    parser.addoption("--seeds", type=int, default=100, help="runs of mixed faults in lock step (%(default)s)")


class Rooms(LoadScopeScheduling):
    """Workers share out files, whose fixtures cost; all guests go to one of them, for each guest takes a processor."""

    def _split_scope(self, nodeid: str) -> str:
        return "guests" if nodeid.startswith("tests/guest/") else nodeid.partition("::")[0]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Rooms:
    return Rooms(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Guests begin first, so that nobody waits for them in the end."""
    items.sort(key=lambda item: "guest" not in item.path.parts)


def pytest_runtest_teardown() -> None:
    """A program whose start was tried in this process may have made it urgent, which starves all tests beside the next ones."""
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """A test may be a coroutine: it runs in a loop of its own, or by the fixture `runner`. A fixture that is an asynchronous
    context is entered there."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None

    async def told() -> None:
        async with contextlib.AsyncExitStack() as entered:
            given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters}
            for name, value in given.items():
                if isinstance(value, contextlib.AbstractAsyncContextManager):
                    given[name] = await entered.enter_async_context(value)
            await pyfuncitem.obj(**given)

    run = pyfuncitem.funcargs["runner"].run if "runner" in pyfuncitem.funcargs else asyncio.run
    run(told())
    return True


@pytest.fixture
def mutations(request: pytest.FixtureRequest) -> int:
    """Of the sample of each reader of files."""
    count: int = request.config.getoption("--mutations")
    return count


@pytest.fixture
def seeds(request: pytest.FixtureRequest) -> range:
    """Of the runs of mixed faults."""
    return range(request.config.getoption("--seeds"))


@pytest.fixture
def outages(request: pytest.FixtureRequest) -> int:
    """Of one of two links."""
    count: int = request.config.getoption("--outages")
    return count


def _skip_is_failure(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Under CI a test that does not run has failed; elsewhere a skip with its reason is in order."""
    if os.environ.get("CI") and report.skipped and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.longrepr = f"every test must run in continuous integration, this one did not: {reason}"


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    _skip_is_failure(report)
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    _skip_is_failure(report)
    return report


@pytest.fixture(scope="session")
def can_guest(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guest]:
    """The one guest that all tests share: vcan0 and vcan1 are up; a test leaves it as it found it."""
    if reason := missing():
        pytest.skip(reason)
    with guest(tmp_path_factory.mktemp("guest")) as shared:
        yield shared
