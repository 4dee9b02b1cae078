"""One competitor of the benchmark as a process: the vehicle on one kind of event loop, with or without the services beside it.

python -m bench.competitor KIND FILE PORTS [--set KEY=VALUE]...

delfim      the product: its runtime, its rows, and the rows of the load
empty       the same, whose guidance, control and allocation take no time: the last command goes out again
apart       the product's runtime with the vehicle alone
services    the other half of "apart" and of the C program: all rows but the vehicle, niced
asyncio     the rows of "delfim" on a plain asyncio loop: no priority, no window
uvloop      the same on uvloop
"""

import argparse
import asyncio
import contextlib
import gc
import importlib
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from bench.load import Ports, rows
from delfim import config
from delfim.base.clock import Clock, SystemClock
from delfim.base.modes import Mode
from delfim.logging import systemlog
from delfim.services import suite
from delfim.services.priority.navigation_loop import Practice, speaker
from delfim.services.runtime import LoadedService, Runtime
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import Actuation, Wanted

KINDS: Final = ("delfim", "empty", "apart", "services", "asyncio", "uvloop")
SERVICES_NICE: Final = 10


class PlainRuntime(Runtime):
    """What a service sees of the runtime, on whatever loop runs: each reader is just a reader."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        super().__init__(settings, clock, alone=True)

    @contextlib.contextmanager
    def navigating(self, fd: int, handler: Callable[[], bool]) -> Iterator[None]:
        self.reader(fd, handler)
        try:
            yield
        finally:
            self.remove_reader(fd)

    def reader(self, fd: int, handler: Callable[[], object], pause_s: float = 0.0) -> None:
        asyncio.get_running_loop().add_reader(fd, handler)

    def remove_reader(self, fd: int) -> None:
        asyncio.get_running_loop().remove_reader(fd)

    @contextlib.contextmanager
    def ticking(self, period_s: float, handler: Callable[[], object]) -> Iterator[None]:
        async def tick() -> None:
            while True:
                await asyncio.sleep(period_s)
                handler()

        ticks = asyncio.ensure_future(tick())
        try:
            yield
        finally:
            ticks.cancel()

    def rehearsal(self, rehearsal: Practice | None) -> None:
        """There is no window in which it could be done."""

    def report(self) -> dict[str, Any]:
        return {"services": {}}

    async def run(self, services: Sequence[LoadedService]) -> None:
        """All rows until SIGTERM. A row that fails ends the run: a benchmark does not go on without its load."""
        ended = asyncio.Event()
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
        gc.collect()
        gc.freeze()
        gc.disable()  # as the product's runtime does; a run is short
        everything = asyncio.gather(*(row.start(self) for row in services))
        everything.add_done_callback(lambda _: ended.set())
        await ended.wait()
        everything.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await everything


def emptied() -> None:
    """From now on the boat's heading mode computes nothing after its first step: what is left is to read and to send."""
    control, send, kept = Helm.control, Propulsion.send, list[Wanted]()

    def same(helm: Helm, now_s: float) -> Wanted:
        if helm.state.mode is not Mode.HEADING:
            return control(helm, now_s)
        if not kept:
            kept.append(control(helm, now_s))
        return kept[0]

    def again(propulsion: Propulsion, wanted: Wanted, now_s: float) -> Actuation:
        is_same = bool(kept) and wanted is kept[0] and propulsion.sent_s > 0.0
        return propulsion.again(now_s) if is_same else send(propulsion, wanted, now_s)

    setattr(Helm, "control", same)  # noqa: B010
    setattr(Propulsion, "send", again)  # noqa: B010


def new_loop(kind: str) -> asyncio.AbstractEventLoop:
    loop: asyncio.AbstractEventLoop = importlib.import_module("uvloop" if kind == "uvloop" else "asyncio").new_event_loop()
    return loop


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("file")
    parser.add_argument("ports", help="four, with commas")
    parser.add_argument("--set", action="append", default=[])
    asked = parser.parse_args(arguments)
    settings = config.load(asked.file, asked.set)
    systemlog.begin(settings.runtime.run_directory, "runtime", {}, speaker)
    inside = [row for row in suite.services(settings) if row.place == "runtime"]
    suites = {row.name: LoadedService(row.name, row.loaded(), row.budget_s) for row in inside}
    boat = suites.pop("vehicle")
    others = [*suites.values(), *rows(Ports(*map(int, asked.ports.split(","))))]
    services = {"apart": [boat], "services": others}.get(asked.kind, [*others, boat])
    if asked.kind == "empty":
        emptied()
    if asked.kind in ("delfim", "empty", "apart"):
        return Runtime(settings, SystemClock()).main(services)
    if asked.kind == "services":
        os.nice(SERVICES_NICE)
    with asyncio.Runner(loop_factory=lambda: new_loop(asked.kind)) as runner:
        runner.run(PlainRuntime(settings, SystemClock()).run(services))
    return 0


if __name__ == "__main__":
    sys.exit(main())
