"""While the runtime comes up nobody watches over it: the vehicle says so, and stays in idle."""

import asyncio
import os
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import DelfimError
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.vehicle import serve
from delfim.vehicle.operator.link import Link


async def until(link: Link, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The vehicle's state once it is so."""
    while not is_so(state := await asyncio.to_thread(link.ask, "state")):
        await asyncio.sleep(0.01)
    return state


def computer(state: dict[str, Any]) -> dict[str, Any]:
    return next(line for line in state["checks"] if line["name"] == "computer")


def test_the_vehicle_says_that_the_computer_is_starting_until_it_is_watched_over(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "gate")
    (tmp_path / "slow_library_of_this_test.py").write_text(f"open({str(tmp_path / 'gate')!r}).close()")
    monkeypatch.syspath_prepend(tmp_path)
    reader, writer = os.pipe()
    said: list[dict[str, Any]] = []
    settings = config.Vehicle(
        boat=config.BoatTable(name="Test"),
        can=config.Can(interface=f"canloop:{tmp_path.name[:24]}"),
        console=config.Console(socket=str(tmp_path / "command")),
        log=config.LogTable(directory=str(tmp_path / "log"), free_bytes_min=0),
        runtime=config.RuntimeTable(run_directory=str(tmp_path)),
    )

    async def asked(library: asyncio.Future[ModuleType]) -> None:
        while not (tmp_path / "command").exists():
            await asyncio.sleep(0.01)
        with Link(tmp_path / "command") as link:
            said.append(computer(await until(link, lambda state: True)))
            with pytest.raises(DelfimError, match="heading refused: the program is still starting"):
                await asyncio.to_thread(link.ask, "heading", heading_deg=0.0)
            (tmp_path / "gate").write_text("")
            await library
            said.append(computer(await until(link, lambda state: computer(state)["ok"])))

    async def reading(runtime: Runtime) -> None:
        """Whatever fails ends the test: a thread that reads a library cannot be ended otherwise."""
        library = runtime.load("slow_library_of_this_test")
        try:
            await asked(library)
        finally:
            runtime.stop("test over")
            if not library.done():
                os.close(os.open(tmp_path / "gate", os.O_RDWR))

    services = [LoadedService("vehicle", serve), LoadedService("reading", reading)]
    assert Runtime(settings, SystemClock(), beat_fd=writer, alone=True).main(services) == 0
    os.close(reader)
    os.close(writer)
    assert [line["ok"] for line in said] == [False, True]
