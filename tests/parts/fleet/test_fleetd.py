"""Boats at an MQTT broker, Debian's mosquitto: frames both ways, last will, retained state, bounds, TLS and passwords."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiomqtt
import pytest

from delfim import config
from delfim.base.clock import ManualClock, SystemClock
from delfim.base.errors import ConfigError, PermanentFailure
from delfim.base.input.keys import new_key
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway.serving import broker_line
from delfim.console.link.mavlink import Key, mavlink
from delfim.parts.fleet.broker import STALE_S, BrokerLine, BrokerPlace
from delfim.parts.fleet.fleetd import FleetMember, serve
from delfim.parts.fleet.table import FleetTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import doors
from delfim.services.suite import services
from delfim.vehicle.report import BoatReport
from tests.console.fakeboat import FakeBoat
from tests.parts.fleet.mosquitto import broker, certified, needs_mosquitto
from tests.parts.gnss.caster import free_port

ROOT = Path(__file__).parents[3]
STATE = BoatReport(
    mode="play", reason="operator", boat="Otter", latitude_deg=38.7, longitude_deg=-9.2, age_s={"navigation": 0.1}
)


def settings(
    port: int, folder: Path, listen: str = "127.0.0.1:14560", orders: str = "127.0.0.1:14555", **table: Any
) -> config.Vehicle:
    return config.Vehicle(
        boat=config.BoatTable(name="Otter", id=3),
        mavlink=Mavlink(key=str(folder / "key"), peers=(listen,), listen=orders),
        fleet=FleetTable(broker=f"mqtt://127.0.0.1:{port}/tagus", listen=listen, **table),
    )


async def until(is_so: Callable[[], object]) -> None:
    async with asyncio.timeout(200):
        while not is_so():
            await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def following(*lines: BrokerLine) -> AsyncIterator[None]:
    """While they are connected."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(line.follow()) for line in lines]
        await until(lambda: not any(line.reason for line in lines))
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()


async def heard(port: int, topic: str, count: int) -> list[tuple[str, bytes, bool]]:
    """The first messages of a topic, as another program hears them, and whether each was retained."""
    async with asyncio.timeout(200), aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe(topic)
        found = []
        async for each in client.messages:
            found.append((str(each.topic), bytes(each.payload), each.retain))  # type: ignore[arg-type]
            if len(found) == count:
                return found
    return found


def line_of(port: int, clock: Any = None, hear: Callable[[str, bytes], None] = lambda *_: None, **more: Any) -> BrokerLine:
    place = BrokerPlace.of(f"mqtt://127.0.0.1:{port}/tagus")
    return BrokerLine(place, place.topic("+", "up"), hear, clock or SystemClock(), **more)


@needs_mosquitto
def test_a_boat_is_found_and_commanded_and_its_state_is_kept_for_who_comes_later(tmp_path: Path) -> None:
    new_key(tmp_path / "key")

    async def main(port: int) -> None:
        loop, clock, answers = asyncio.get_running_loop(), SystemClock(), list[tuple[bool, str]]()
        vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        with vehicle, door:
            vehicle.bind(("127.0.0.1", 0))
            door.bind(("127.0.0.1", 0))
            member = FleetMember(settings(port, tmp_path, orders=f"127.0.0.1:{vehicle.getsockname()[1]}"), door, clock)
            boat = FakeBoat(3, clock, lambda data: vehicle.sendto(data, door.getsockname()), key.secret)  # type: ignore[arg-type]
            loop.add_reader(door, member.on_frames)
            loop.add_reader(vehicle, lambda: boat.hear(vehicle.recv(2048)))
            frames = list[bytes]()

            def hear(topic: str, data: bytes) -> None:
                frames.append(data)
                fleet.receive(("broker", topic.split("/")[1]), data)

            console = line_of(port, hear=hear)
            fleet = Fleet(clock, lambda way, data: console.put(f"tagus/{way[1]}/down", data), lambda _: None, key)
            async with following(member.line, console):
                member.heard(STATE)
                await until(lambda: (boat.tick(), 3 in fleet.boats)[1])
                assert fleet.boats[3].snapshot(clock.monotonic_s())["link"]["kind"] == "broker"
                fleet.command(3, "mode", {"mode": "hold"}, lambda well, why: answers.append((well, why)))
                await until(lambda: answers)
                assert (answers, boat.mode) == ([(True, "")], 5)
                stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                with stranger:
                    stranger.sendto(b"\xfd not the boat", door.getsockname())
                    boat.say(mavlink.MAVLink_statustext_message(6, b"after it", 0, 0))
                    await until(lambda: any(b"after it" in frame for frame in frames))
                    assert not any(b"not the boat" in frame for frame in frames)
                (_, state, is_kept), *_ = await heard(port, "tagus/Otter/state", 1)
                told = json.loads(state)
                assert is_kept
                assert (told["boat"], told["mode"], told["latitude_deg"]) == ("Otter", "play", 38.7)
                assert await heard(port, "tagus/Otter/link", 1) == [("tagus/Otter/link", b"here", True)]
            assert await heard(port, "tagus/Otter/link", 1) == [("tagus/Otter/link", b"ended", True)]
            loop.remove_reader(door)
            loop.remove_reader(vehicle)

    key = Key(tmp_path / "key")
    with broker(tmp_path) as port:
        asyncio.run(main(port))


@needs_mosquitto
def test_a_boat_that_is_gone_is_told_by_its_last_will(tmp_path: Path) -> None:
    async def main(port: int) -> None:
        line = line_of(port, boat="Otter")
        namesake = aiomqtt.Client("127.0.0.1", port, identifier=line._identifier)
        async with following(line), namesake:  # the broker throws the first one out
            assert (await heard(port, "tagus/Otter/link", 1))[0][1] == b"lost"

    with broker(tmp_path) as port:
        asyncio.run(main(port))


@needs_mosquitto
async def test_nothing_is_kept_for_a_broker_that_is_away_but_the_newest_state(tmp_path: Path) -> None:
    """It is killed and started again, twice."""
    port = free_port()
    line, frames = line_of(port, boat="Otter", held=4), list[bytes]()
    listener = line_of(port, hear=lambda topic, data: frames.append(data))
    follow = asyncio.gather(line.follow(), listener.follow())
    await until(lambda: "refused" in line.reason)
    for life in range(2):
        for number in range(20):
            line.put("tagus/Otter/up", b"old %d" % number)
            line.keep("tagus/Otter/state", b"state %d of %d" % (number, life))
        assert line.counts["dropped"] == 20 * (life + 1)
        with broker(tmp_path, port):
            await until(lambda: not line.reason and not listener.reason)
            assert (await heard(port, "tagus/Otter/state", 1))[0][1:] == (b"state 19 of %d" % life, True)
            line.put("tagus/Otter/up", b"new %d" % life)
            await until(lambda life=life: len(frames) > life)
        await until(lambda: line.reason and listener.reason)
    follow.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await follow
    assert frames == [b"new 0", b"new 1"]


@needs_mosquitto
def test_on_a_link_that_is_away_no_more_waits_than_the_bound_and_it_is_told(tmp_path, monkeypatch):
    """The broker stands still: it takes nothing, and its connections stay."""
    monkeypatch.setattr("delfim.parts.fleet.broker.ANSWER_S", 0.5)

    async def main(port: int, pid: int) -> None:
        line, frames = line_of(port, boat="Otter", held=8), list[bytes]()
        async with following(line, line_of(port, hear=lambda topic, data: frames.append(data))):
            os.kill(pid, signal.SIGSTOP)
            while not line.reason:  # the client waits for the kernel to take a frame, and gives the connection up
                line.put("tagus/Otter/up", bytes(2000))
                assert len(line._frames) <= 8
                await asyncio.sleep(0)
            dropped = line.counts["dropped"]
            line.put("tagus/Otter/up", b"old")
            assert line.counts["dropped"] == dropped + 1
            os.kill(pid, signal.SIGCONT)
            await until(lambda: not line.reason)
            line.put("tagus/Otter/up", b"new")
            await until(lambda: b"new" in frames)
            told = await heard(port, "tagus/Otter/link", 1)
            assert told == [("tagus/Otter/link", b"here", True)]

    with broker(tmp_path) as port:
        asyncio.run(main(port, int((tmp_path / f"mosquitto-{port}.pid").read_text())))


async def test_a_line_that_cannot_say_goodbye_is_cancelled_at_once_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = asyncio.Event()

    class Client:
        def __init__(self, *_: object, **__: object) -> None:
            self._client = SimpleNamespace(_sock_recv=None)

        async def __aenter__(self) -> "Client":
            return self

        async def __aexit__(self, *_: object) -> None:
            raise aiomqtt.MqttError("Operation timed out")

        async def subscribe(self, *_: object, **__: object) -> None:
            begun.set()
            await asyncio.Event().wait()

    monkeypatch.setattr(aiomqtt, "Client", Client)
    following = asyncio.create_task(line_of(1).follow())
    await begun.wait()
    following.cancel()
    async with asyncio.timeout(200):
        await asyncio.wait([following])
    assert following.cancelled()


async def test_a_cancellation_that_comes_with_an_answer_is_not_lost() -> None:
    """asyncio.wait_for of Python 3.11, with which the client waits, then gives the answer."""

    class Client:
        async def publish(self, *_: object, **__: object) -> None:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.Event().wait()

    line = line_of(1)
    line.keep("tagus/Otter/state", b"state")
    sending = asyncio.create_task(line._send(Client()))  # type: ignore[arg-type]
    await until(lambda: not line._kept)
    sending.cancel()
    async with asyncio.timeout(200):
        await asyncio.wait([sending])


async def test_a_frame_that_waited_too_long_is_not_sent_and_a_slow_broker_costs_the_oldest() -> None:
    clock, sent = ManualClock(), list[bytes]()
    line = line_of(1, clock, held=3)
    line.reason = ""

    async def publish(topic: str, frame: bytes, qos: int) -> None:
        sent.append(frame)
        if frame == b"last":
            raise aiomqtt.MqttError("enough")

    for number in range(5):
        line.put("t", b"old %d" % number)
    assert line.counts["dropped"] == 2
    clock.advance(STALE_S + 0.1)
    line.put("t", b"new")
    line.put("t", b"last")
    with pytest.raises(aiomqtt.MqttError):
        await line._send(SimpleNamespace(publish=publish))  # type: ignore[arg-type]
    assert sent == [b"new", b"last"]
    assert line.counts["dropped"] == 5


@needs_mosquitto
def test_a_retained_order_is_an_old_one_and_a_huge_one_is_none(tmp_path: Path) -> None:
    async def main(port: int) -> None:
        orders = list[bytes]()
        line = line_of(port, hear=lambda topic, data: orders.append(data))
        async with aiomqtt.Client("127.0.0.1", port) as stranger:
            await stranger.publish("tagus/Otter/up", b"of yesterday", qos=1, retain=True)
            async with following(line):
                await stranger.publish("tagus/Otter/up", bytes(4096), qos=1)
                await stranger.publish("tagus/Otter/up", b"", qos=1)
                await stranger.publish("tagus/Otter/up", b"now", qos=1)
                await until(lambda: orders)
        assert orders == [b"now"]
        assert line.counts["refused"] == 3

    with broker(tmp_path) as port:
        asyncio.run(main(port))


@pytest.mark.parametrize(
    "packet",
    [b"\x30\x80\x80\x80\x7f", b"\x30\x81\x80\x04", b"\x34\x0c\x00\x01x\0\1" + bytes(7)],
    ids=["256 MB", "just too long", "to be asked about"],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho drops a socket that failed, unclosed
async def test_a_broker_that_sends_more_than_anybody_asked_for_is_left_at_once(packet: bytes) -> None:
    """A broker that says yes to everything, and then announces a message: nothing of that is read, or kept."""

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answers = {0x10: b"\x20\2\0\0", 0x82: b"\x90\3\0\1\0" + packet}
        while data := await reader.read(1000):
            writer.write(answers.get(data[0], b""))
        writer.close()

    server = await asyncio.start_server(talk, "127.0.0.1", 0)
    line = line_of(server.sockets[0].getsockname()[1])
    async with server, asyncio.timeout(200), asyncio.TaskGroup() as group:
        following = group.create_task(line.follow())
        await until(lambda: line.counts["connected"] == 2 and line.reason)
        following.cancel()
    assert line.counts["heard"] == line.counts["refused"] == 0


@needs_mosquitto
def test_who_takes_the_name_of_a_boat_does_not_put_it_off(tmp_path: Path) -> None:
    async def main(port: int) -> None:
        line = line_of(port, hear=lambda topic, data: None, boat="Otter")
        async with following(line), aiomqtt.Client("127.0.0.1", port, identifier="delfim-tagus-Otter") as thief:
            await thief.subscribe("tagus/Otter/link")
            async for message in thief.messages:
                assert message.payload == b"here"
                break
            line.put("tagus/Otter/up", b"frame")
            await until(lambda: line.counts["sent"])
            assert line.counts["connected"] == 1

    with broker(tmp_path) as port:
        asyncio.run(main(port))


@needs_mosquitto
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho drops a socket that failed, unclosed
def test_tls_and_a_password(tmp_path: Path) -> None:
    async def main(port: int) -> None:
        place = BrokerPlace.of(f"mqtts://localhost:{port}")
        assert place.topic("Otter", "up") == "delfim/Otter/up"
        files = {"credentials": str(tmp_path / "credentials"), "authorities": str(tmp_path / "cert.pem")}
        async with following(BrokerLine(place, "delfim/+/up", lambda *_: None, SystemClock(), **files)):
            pass
        for left_out, words in (("credentials", "uthori"), ("authorities", "certificate")):
            some = {name: file for name, file in files.items() if name != left_out}
            line = BrokerLine(place, "delfim/+/up", lambda *_: None, SystemClock(), **some)
            task = asyncio.ensure_future(line.follow())
            await until(lambda line=line, words=words: words in line.reason)
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    with broker(tmp_path, settings=certified(tmp_path)) as port:
        asyncio.run(main(port))


@pytest.mark.parametrize("words", ["", "mqtt://", "http://a:1", "mqtt://a", "mqtt://a:99999", "mqtt://a:1/b/c", "mqtt://a:1/#"])
def test_what_is_no_broker_is_refused(words: str) -> None:
    with pytest.raises(ConfigError, match="no broker"):
        BrokerPlace.of(words)


def test_a_console_needs_a_key_and_sends_no_password_in_the_clear(tmp_path: Path) -> None:
    gateway: Any = SimpleNamespace(hear_of=None)
    asked: Any = SimpleNamespace(
        broker="mqtt://example.org:1883", key="", broker_credentials=str(tmp_path / "c"), broker_authorities=""
    )
    with pytest.raises(ConfigError, match="--key"):
        broker_line(gateway, asked)
    asked.key = "k"
    with pytest.raises(ConfigError, match="in the clear"):
        broker_line(gateway, asked)


FLEET = 'broker = "mqtts://example.org:8883/tagus"'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"[fleet]\n{FLEET}", "needs a key"),
        (f'[mavlink]\nkey = "/k"\n[fleet]\n{FLEET}', "mavlink.peers"),
        (f'[mavlink]\nkey = "/k"\npeers = ["127.0.0.1:14560"]\nlisten = "127.0.0.1:0"\n[fleet]\n{FLEET}', "port of its own"),
        ('[fleet]\ncredentials = "/c"', "without a broker"),
        ('[fleet]\nbroker = "mqtt://example.org:1883"\ncredentials = "/c"', "in the clear"),
        (f'[fleet]\n{FLEET}\nlisten = "0.0.0.0:14560"', "of this computer"),
    ],
)
def test_the_file_is_refused_with_a_reason(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "boat.toml").write_text(f'[boat]\nname = "Otter"\n{text}\n')
    with pytest.raises(ConfigError, match=words):
        config.load(tmp_path / "boat.toml")


def loaded_by_delfimx(modules: set[str]) -> set[str]:
    """Those of these modules that the services of DelfimX load."""
    program = (
        "import sys; from delfim import config; from delfim.services import suite; settings = config.load('etc/delfimx.toml');"
        "[row.loaded() for row in suite.services(settings)]; print(*sys.modules)"
    )
    ended = subprocess.run((sys.executable, "-c", program), capture_output=True, text=True, cwd=ROOT, check=True)
    return modules & set(ended.stdout.split())


def test_a_boat_that_has_no_broker_loads_nothing_of_it() -> None:
    assert loaded_by_delfimx({"delfim.services.suite"}), "it tells what is loaded"
    assert loaded_by_delfimx({"aiomqtt", "paho", "delfim.parts.fleet.broker", "delfim.parts.fleet.fleetd"}) == set()


def test_nothing_of_it_runs_unless_the_file_asks_and_then_it_is_a_process_and_a_door(tmp_path: Path) -> None:
    asked, quiet = settings(1883, tmp_path), config.Vehicle(boat=config.BoatTable(name="Otter"))
    assert "fleetd" not in {row.name for row in services(quiet)}
    (row,) = [row for row in services(asked) if row.name == "fleetd"]
    assert row.place == "process"
    assert {door.reach for door in doors(asked, ["fleetd"]) if door.service == "fleetd"} == {"known", "anyone", "here"}
    runtime: Any = SimpleNamespace(config=asked, status={"fleetd": SimpleNamespace(place="runtime")})
    with pytest.raises(PermanentFailure, match="process"):
        asyncio.run(serve(runtime))
