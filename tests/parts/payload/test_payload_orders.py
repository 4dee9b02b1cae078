"""Payload programs with rights, through the real confined processes and the real command socket to a real boat in lock step."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.base.ranges import PayloadRight
from delfim.parts.payload import payload, payloadorders
from delfim.parts.payload.payloadorders import OrderLine
from delfim.parts.payload.table import PayloadTable
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.orders import payloadlines
from delfim.vehicle.plans.mission import Mission, Waypoint, canonical
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import NoLog
from tests.services.boat import served, vehicle_file

SAYS_SO = """say() { echo '{"command": "alive"}'; }; say
while read line; do case "$line" in
*utc_ns*'"helmsman":"%s"'*) %s;; *utc_ns*) say;; *'"ok":false'*) echo "$line" >&2;;
esac; done"""
TELLS = """while read line; do case "$line" in *'"ok":false'*) echo "$line" >&2;; esac; done"""
LIES = (
    '{"command": "heading", "heading_deg": NaN}',
    '{"command": "goto", "latitude_deg": 38.6907, "longitude_deg": -9.2153}',
    '{"command": "heading", "heading_deg": 90, "speed_mps": 99}',
    '{"command": "stop"}',
    '{"command": "ordered", "payload": "steers", "order": {"command": "pause"}}',
)
STEERS = """say; echo '{"command": "heading", "heading_deg": 90, "speed_mps": 1}'"""
FLOODS = """while :; do echo '{"command": "heading", "heading_deg": 180}'; done"""
MAY = ("heading", "hold")


class Sea:
    """A boat, its command socket, and the service with the programs."""

    def __init__(self, settings: config.Vehicle) -> None:
        self.run = Lockstep(settings, 1, lambda clock: NoLog())
        self.state, loop = self.run.state, asyncio.get_running_loop()
        self.reviews = Reviews(self.run.vehicle, self.obey, loop)
        self.commands = CommandServer(self.obey, self.reviews, lambda: in_json(self.run.vehicle.report()), 8)
        self.told: Callable[[], dict[str, Any]] = dict
        self.clock, self.next_s = loop.time, 0.0

    def obey(self, command: console.Commands, operator: str = "local") -> str | None:
        refused = self.run.vehicle.on_command(command, operator)
        self.reviews.hear(command, operator)
        return refused

    async def until(self, condition: Callable[[], object], pace_s: float = 0.2) -> None:
        """Sail on, no faster than the programs can follow: on a busy machine they run last. 0: as fast as the boat can."""
        async with asyncio.timeout(200):
            while not condition():
                if self.clock() >= self.next_s:
                    self.next_s = self.clock() + pace_s
                    self.run.cycle()
                    if pace_s:  # otherwise their pipes would be full
                        self.commands.publish()
                await asyncio.sleep(0.01 if pace_s else 0)

    async def give(self, name: str) -> None:
        """As soon as it is heard."""
        await self.until(lambda: self.obey(console.Entrust(name)) is None)


@contextlib.asynccontextmanager
async def carried(tmp_path: Path, may: tuple[PayloadRight, ...] = MAY, **programs: str) -> AsyncIterator[Sea]:
    tables = {name: PayloadTable(command=("/bin/sh", "-c", words), may=may) for name, words in programs.items()}
    settings = vehicle_file(tmp_path, payload=tables, supervisor=config.SupervisorTable(backoff_s=0.01, backoff_max_s=0.1))
    sea = Sea(settings)
    server = await asyncio.get_running_loop().create_unix_server(sea.commands.connection, settings.console.socket)
    try:
        async with served(settings, payload.serve, "payload") as runtime:
            sea.told = runtime.board["payload"]
            yield sea
    finally:
        sea.commands.close()
        server.close()


def test_a_program_steers_and_one_that_dies_hangs_floods_or_lies_costs_itself_alone(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(payloadlines, "ORDERS", (1e6, 1_000_000))  # the boat's clock runs faster than that of the budgets

    async def test() -> None:
        lies = "; ".join(f"echo '{line}'" for line in LIES)
        programs = {
            "steers": SAYS_SO % ("steers", STEERS),
            "dies": SAYS_SO % ("dies", "exit 100"),
            "hangs": SAYS_SO % ("hangs", "sleep 1000"),
            "floods": SAYS_SO % ("floods", FLOODS),
            "lies": f"{lies}; {TELLS}",
        }
        async with carried(tmp_path, **programs) as sea:
            state = sea.state
            await sea.until(lambda: state.cycles > 20, 0)
            await sea.give("steers")
            await sea.until(lambda: state.mode is Mode.HEADING)
            assert (state.helmsman, state.reason) == ("steers", "payload steers")
            for name in ("dies", "hangs"):
                await sea.give(name)
                told = sea.told()["lines"][name]["told"]
                await sea.until(lambda name=name, told=told: sea.told()["lines"][name]["told"] > told + 1)
                await sea.until(lambda: not state.helmsman, 0)
                assert state.mode is Mode.HOLD
                assert state.relieved.startswith(f"failsafe: no word from payload {name} for 5.")
            await sea.give("floods")
            await sea.until(lambda: sea.told()["lines"]["floods"]["dropped"] > 1000 and state.mode is Mode.HEADING)
            assert state.helmsman == "floods", "it has the right, and the boat"
            assert sea.obey(console.SetMode("hold")) is None
            cycles = state.cycles
            await sea.until(lambda: state.cycles > cycles + 10, 0)
            assert (state.mode, state.helmsman) == (Mode.HOLD, "")
            await sea.until(lambda: sea.told()["lines"]["lies"]["denied"] >= len(LIES) and "ordered is for" in caplog.text)

    with caplog.at_level(logging.INFO):
        asyncio.run(test())
    for why in (
        "command not understood: it is not JSON",
        "goto is not among the rights of lies, which has heading, hold",
        "command not understood: speed_mps must be 0.0 to 30.0",
        "stop is for operators alone",
        "ordered is for operators alone",
    ):
        assert 'payload: lies: {"event":"answer"' in caplog.text
        assert f'"ok":false,"reason":"refused: {why}"' in caplog.text


SAMPLES = """while read line; do case "$line" in
*'"event":"sample"'*'"try":1'*) echo '{"command": "sampled", "number": 1, "ok": false, "reason": "the pump is blocked"}';;
*'"event":"sample"'*) echo '{"command": "sampled", "number": 2, "reason": "500 ml"}';;
esac; done"""


async def test_a_program_takes_a_sample_at_a_station_at_the_second_try(tmp_path: Path) -> None:
    here = Waypoint(latitude_deg=38.6907, longitude_deg=-9.2153, hold_s=60.0, tries=2)
    mission = Mission(version=1, name="Samples", waypoint=(here, Waypoint(latitude_deg=38.6910, longitude_deg=-9.2153)))
    async with carried(tmp_path, ("samples",), sampler=SAMPLES) as sea:
        await sea.until(lambda: sea.state.cycles > 20, 0)
        assert sea.obey(console.LoadMission(canonical(mission))) is None
        await sea.until(lambda: sea.told()["lines"]["sampler"]["told"] > 0)
        assert sea.obey(console.Play()) is None
        await sea.until(lambda: sea.state.sample.number == 2)
        await sea.until(lambda: sea.run.vehicle.helm.memory.leg == 1)
        lines = sea.told()["lines"]["sampler"]
        assert (lines["ordered"], lines["denied"]) == (2, 0)
        assert [words for words in sea.run.noted if words.startswith("station")] == [
            "station: waypoint 1: sample 1 is asked for, try 1 of 2",
            "station: waypoint 1: payload sampler: the pump is blocked",
            "station: waypoint 1: sample 2 is asked for, try 2 of 2",
            "station: waypoint 1: payload sampler has sample 2: 500 ml",
        ]
        assert sea.state.mode is Mode.PLAY


async def test_orders_wait_for_the_vehicle_a_moment_and_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A vehicle that is not there, one that answers nonsense, and orders that are too old or too many."""
    monkeypatch.setattr(payloadorders, "AGAIN_S", 0.0)
    path, clock, answers, heard = str(tmp_path / "command"), ManualClock(), list[str | None](), list[bytes]()
    line = OrderLine(path, clock)
    task = asyncio.create_task(line.follow())
    line.order("one", console.Pause(), answers.append)
    await _until(lambda: answers)
    assert "the vehicle does not answer" in str(answers.pop())

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.closing(writer):
            while heard_now := await reader.readline():
                heard.append(heard_now)
                writer.write(b"nonsense\n" if len(heard) == 1 else b'{"ok": true, "reason": "", "state": {}}\n')

    server = await asyncio.start_unix_server(answer, path)
    line.order("one", console.Pause(), answers.append)
    await _until(lambda: answers)
    assert answers.pop() == "refused: the vehicle did not answer"
    for _ in range(payloadorders.WAITING + 1):
        line.order("one", console.Pause(), answers.append)
    assert answers == ["refused: 8 orders wait for the vehicle already"]
    line.order("two", console.Pause(), answers.append)
    clock.advance(payloadorders.WAIT_S + 0.1)
    line.order("two", console.Alive(), answers.append)
    await _until(lambda: len(answers) == 11)
    assert answers[1:] == ["refused: it waited 2.1 s for the vehicle"] * 9 + [None]
    assert heard[-1] == b'{"command":"ordered","payload":"two","order":{"command":"alive"}}\n'
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    server.close()
    await server.wait_closed()
    await asyncio.sleep(0.01)  # the end of the connection is heard


async def _until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(200):
        while not condition():
            await asyncio.sleep(0)
