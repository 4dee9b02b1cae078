"""The guest computer's door over real TCP on loopback: who is let in, and that a refused visitor changes nothing."""

import asyncio
import contextlib
import json
import re
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import msgspec
import pytest

from delfim.base import tables
from delfim.base.errors import ConfigError
from delfim.base.input.keys import new_key, read_key
from delfim.parts.ros.rossteering import GuestLine
from delfim.services.access import guest_listener
from delfim.services.access.guest_listener import GuestListener
from delfim.services.tables import GuestTable
from delfim.simulator.guest import Zigzag, guest
from delfim.vehicle.grex import proof

HOME = "127.0.0.1"
REFERENCE = b'{"heading_deg": 90, "speed_mps": 1.0}\n'


class Link:
    """One connection to the door."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def challenge(self) -> str:
        return str(json.loads(await self.reader.readline())["challenge"])

    def say(self, line: bytes) -> None:
        self.writer.write(line)

    async def is_shut(self) -> bool:
        try:
            return await self.reader.read() == b""
        except ConnectionError:
            return True


Opened = Callable[..., Awaitable[Link]]


@contextlib.asynccontextmanager
async def at_the_door(boat, table: GuestTable) -> AsyncIterator[tuple[Opened, GuestListener, int]]:
    door = GuestListener(table, boat.guest, boat.state, boat.clock)
    server = await asyncio.get_running_loop().create_server(door.visitor, HOME, 0)
    port, links = server.sockets[0].getsockname()[1], []

    async def opened(host: str = HOME) -> Link:
        links.append(Link(*await asyncio.open_connection(HOME, port, local_addr=(host, 0))))
        return links[-1]

    try:
        async with asyncio.timeout(30):
            yield opened, door, port
    finally:
        for link in links:
            link.writer.close()
        server.close()
        door.close()


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0)


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    new_key(tmp_path / "guest.key")
    return tmp_path / "guest.key"


@pytest.fixture
def locked(key_file: Path) -> GuestTable:
    return GuestTable(enabled=True, key=str(key_file))


async def test_the_holder_of_the_key_is_the_guest(boat, locked):
    key = read_key(locked.key)
    async with at_the_door(boat, locked) as (opened, door, _port):
        link = await opened()
        answer = json.dumps({"proof": proof(key, await link.challenge())}).encode() + b"\n"
        link.say(answer + REFERENCE)  # the set point may come with the proof
        await until(lambda: boat.state.setpoint.guest_heading_rad is not None)
        boat.navigate()
        assert json.loads(await link.reader.readline())["mode"] == "idle"
        assert not door.waiting


@pytest.mark.parametrize(
    "answer",
    [
        b'{"proof": "' + b"0" * 64 + b'"}',
        b'{"proof": "\xc3\xa9"}',
        b'{"proof": 1}',
        b"[]",
        b"",
        REFERENCE.strip(),
        b"\xff",
        b"x" * 300,
    ],
)
async def test_who_has_no_key_is_shut_out_and_moves_nothing(boat, locked, answer, caplog):
    async with at_the_door(boat, locked) as (opened, _door, _port):
        link = await opened()
        challenge = await link.challenge()
        link.say(answer + b"\n" + REFERENCE)
        assert await link.is_shut()
        assert (len(challenge), boat.state.setpoint.guest_heading_rad) == (32, None)
        assert not boat.guest.is_connected
    assert boat.state.counts["guest_refused"] == 1
    assert "guest: 127.0.0.1 refused: " in caplog.text


async def test_a_proof_is_good_for_one_connection(boat, locked):
    key = read_key(locked.key)
    async with at_the_door(boat, locked) as (opened, _door, _port):
        first, second = await opened(), await opened()
        heard = json.dumps({"proof": proof(key, await first.challenge())}).encode() + b"\n"
        await second.challenge()
        second.say(heard)
        assert await second.is_shut()


async def test_a_stranger_neither_replaces_the_guest_nor_hears_the_boat(boat, locked):
    key = read_key(locked.key)
    async with at_the_door(boat, locked) as (opened, _door, _port):
        link = await opened()
        link.say(json.dumps({"proof": proof(key, await link.challenge())}).encode() + b"\n")
        await until(lambda: boat.guest.is_connected)
        stranger = await opened()
        await stranger.challenge()
        boat.navigate()
        assert json.loads(await link.reader.readline())["mode"] == "idle"
        stranger.say(b"let me in\n")
        assert await stranger.is_shut()
        assert boat.guest.is_connected


async def test_who_does_not_answer_has_five_seconds_and_four_places_an_address(boat, locked, monkeypatch):
    monkeypatch.setattr(guest_listener, "ANSWER_S", 0.2)
    async with at_the_door(boat, locked) as (opened, door, _port):
        slow = [await opened() for _ in range(4)]
        for link in slow:
            await link.challenge()
        assert await (await opened()).is_shut(), "one too many of this address"
        others = [await opened("127.0.0.2") for _ in range(4)]
        for link in others:
            await link.challenge()
        assert await (await opened("127.0.0.3")).is_shut(), "one too many altogether"
        for link in (*slow, *others):
            assert await link.is_shut()
        assert not door.waiting
        assert await (await opened()).challenge()


async def test_a_network_that_is_not_named_is_shut_out_with_the_key_and_without(boat, key_file):
    for key in ("", str(key_file)):
        table = GuestTable(enabled=True, key=key, networks=("127.0.0.2",))
        async with at_the_door(boat, table) as (opened, _door, _port):
            assert await (await opened()).is_shut()
            assert not boat.guest.is_connected
    assert boat.state.counts["guest_refused"] == 2


async def test_delfims_own_guest_proves_its_key(boat, locked):
    async with at_the_door(boat, locked) as (_opened, _door, port):
        running = asyncio.create_task(guest(HOME, port, Zigzag(course_deg=90.0), key=read_key(locked.key)))
        try:
            await until(lambda: boat.guest.is_connected)
            boat.navigate()
            await until(lambda: boat.state.setpoint.guest_heading_rad is not None)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def test_the_guest_of_the_document_is_let_in(boat, locked, key_file):
    program = re.findall(r"```python\n(.*?)```", Path("docs/guest.md").read_text(), re.DOTALL)[-1]
    async with at_the_door(boat, locked) as (_opened, _door, port):
        text = program.replace("192.168.1.10", HOME).replace("4747", str(port))
        words = (sys.executable, "-c", text)
        process = await asyncio.create_subprocess_exec(*words, cwd=key_file.parent, stderr=subprocess.DEVNULL)
        try:
            await until(lambda: boat.guest.is_connected)
            while boat.state.setpoint.guest_heading_rad is None:
                boat.navigate()
                await asyncio.sleep(0)
        finally:
            process.kill()
            await process.wait()


@pytest.mark.parametrize(
    ("table", "is_refused"),
    [
        ({"enabled": True, "listen": "192.168.1.10:4747"}, True),
        ({"enabled": True, "listen": "0.0.0.0:4747"}, True),
        ({"enabled": True, "listen": "boat:4747"}, True),
        ({"enabled": True, "listen": "192.168.1.10:4747", "key": "/log/keys/guest.key"}, False),
        ({"enabled": True, "listen": "localhost:4747"}, False),
        ({"enabled": False, "listen": "192.168.1.10:4747"}, False),
    ],
)
def test_beyond_this_computer_the_file_must_name_a_key(table, is_refused):
    if is_refused:
        with pytest.raises(ConfigError, match="needs a key"):
            tables.decode(table, GuestTable, "boat.toml")
    else:
        assert msgspec.structs.asdict(tables.decode(table, GuestTable, "boat.toml"))["listen"] == table["listen"]


async def test_steering_from_ros_that_the_door_refuses_says_where_the_reason_is(boat, locked):
    async with at_the_door(boat, msgspec.structs.replace(locked, networks=("10.0.0.0/8",))) as (_opened, _door, port):
        line = GuestLine(msgspec.structs.replace(locked, listen=f"{HOME}:{port}"))
        following = asyncio.create_task(line.follow())
        await until(lambda: line.reason != "not connected yet")
        following.cancel()
        assert line.reason == "the vehicle closed the connection: its log says why"
