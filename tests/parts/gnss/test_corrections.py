"""Corrections of a real caster, rtklib's str2str, and of the radio, at a receiver's pty: whole, fresh, told when they end."""

import asyncio
import contextlib
import os
import select
import socket
import ssl
import termios
import tty
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import ConfigError, PermanentFailure
from delfim.lines.rtcm import doorstep, framed
from delfim.parts.gnss import corrections
from delfim.parts.gnss.receiverport import WAITING_BYTES, ReceiverPort
from delfim.parts.gnss.table import Corrections
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.services.priority.navigation_loop import Account
from delfim.services.runtime import Runtime
from delfim.services.servicestatus import ServiceStatus
from tests.parts.gnss.caster import Base, casting, free_port, needs_str2str
from tests.services.boat import STATE, served, vehicle, vehicle_file

SECRET = "ana:secret"


def frame(number: int, length: int = 60) -> bytes:
    return framed((number << 4).to_bytes(2, "big") + os.urandom(length))


class Receiver:
    """A receiver's port: what corrections bring is read at its other end. The vehicle has set it up."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self._end, self._port = os.openpty()
        tty.setraw(self._port)
        os.set_blocking(self._end, False)
        name.symlink_to(os.ttyname(self._port))

    def heard(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self._end, 1 << 16)
        return b""

    def close(self) -> None:
        for each in (self._end, self._port):
            os.close(each)


class Rover:
    """The service, its receiver, and a caster that the test feeds."""

    def __init__(self, runtime: Runtime, receiver: Receiver, run_directory: Path) -> None:
        self._runtime, self.receiver, self._doorstep = runtime, receiver, doorstep(str(run_directory))

    @property
    def figures(self) -> dict[str, Any]:
        return dict(self._runtime.board["corrections"]())

    async def until(self, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        async with asyncio.timeout(200):
            while not wanted(figures := self.figures):
                await asyncio.sleep(0.01)
        return figures

    async def receives(self, wanted: bytes, say: Callable[[], object] = lambda: None) -> bytes:
        """What the receiver hears, until this is part of it; `say` is called now and then."""
        found = b""
        async with asyncio.timeout(200):
            while wanted not in (found := found + self.receiver.heard()):
                say()
                await asyncio.sleep(0.01)
        return found

    def radio(self, data: bytes) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.sendto(data, str(self._doorstep))


@contextlib.asynccontextmanager
async def roving(tmp_path: Path, caster: str = "", credentials: str = SECRET, **more: Any) -> AsyncIterator[Rover]:
    receiver, secret = Receiver(tmp_path / "gnss"), tmp_path / "ntrip"
    secret.write_text(credentials)
    secret.chmod(0o600)
    ports = {"gnss": Nmea0183Port(device=str(receiver.name), baud=115_200)}
    table = Corrections(to="gnss", caster=caster, credentials=str(secret) if caster else "", **more)
    settings = vehicle_file(
        tmp_path,
        navigation=config.NavigationTable(sources=("nmea0183",)),
        nmea0183=Nmea0183(ports=ports),
        corrections=table,
    )
    try:
        async with vehicle(settings, STATE | {"fix": 5}), served(settings, corrections.serve, "corrections") as runtime:
            rover = Rover(runtime, receiver, tmp_path)
            await rover.until(lambda figures: "receiver" not in figures["troubles"])
            yield rover
    finally:
        receiver.close()


async def begun(port: int, links: contextlib.ExitStack) -> Base:
    """A caster, beside the loop."""
    return await asyncio.to_thread(links.enter_context, casting(port, SECRET))


@needs_str2str
async def test_bytes_of_a_caster_come_to_the_receiver_also_after_the_caster_was_gone(tmp_path):
    port = free_port()
    async with roving(tmp_path, f"ntrip://127.0.0.1:{port}/BASE") as rover:
        await rover.until(lambda f: f["troubles"]["caster"] == f"127.0.0.1:{port}: Connection refused")
        for _ in range(2):
            with contextlib.ExitStack() as links:
                base = await begun(port, links)
                first, rest = frame(1005, 19), [frame(1077, 400), frame(1087, 300)]
                await rover.receives(first, lambda base=base, first=first: base.say(first))
                base.say(b"noise" + rest[0] + b"\xd3\xff" + rest[1])
                found = await rover.receives(rest[1])
                assert found.replace(first, b"") == b"".join(rest), "whole frames alone"
                assert rover.figures["troubles"] == {}
            await rover.until(lambda f: f["troubles"].get("caster"))
        told = rover.figures
        assert {"1005", "1077", "1087"} == set(told["caster"]["messages"])
        assert told["receiver"]["dropped"] == 0


@needs_str2str
@pytest.mark.parametrize(
    ("mountpoint", "credentials", "words"),
    [("BASE", "ana:wrong", "it refuses user and password"), ("NOWHERE", SECRET, "it has no mountpoint NOWHERE")],
)
async def test_a_refusal_of_the_caster_is_said_in_words(tmp_path, mountpoint, credentials, words):
    with contextlib.ExitStack() as links:
        base = await begun(port := free_port(), links)
        async with roving(tmp_path, f"ntrip://127.0.0.1:{port}/{mountpoint}", credentials) as rover:
            await rover.until(lambda f: f["troubles"] == {"caster": f"127.0.0.1:{port}: {words}"})
            base.say(frame(1005))
            assert rover.receiver.heard() == b""


@pytest.mark.parametrize(
    ("caster", "words"),
    [
        ("ntrip://nowhere.invalid:2101/BASE", "nowhere.invalid:2101: "),
        ("ntrips://127.0.0.1:PORT/BASE", "its certificate is not to be trusted: self-signed certificate"),
    ],
)
async def test_a_caster_that_cannot_be_reached_is_told_in_words(tmp_path, certificate, caster, words):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    server = await asyncio.start_server(lambda reader, writer: writer.close(), "127.0.0.1", 0, ssl=context)
    place = caster.replace("PORT", str(server.sockets[0].getsockname()[1]))
    async with server, roving(tmp_path, place) as rover:
        figures = await rover.until(lambda f: "not connected yet" not in f["troubles"]["caster"])
        assert words in figures["troubles"]["caster"]


async def test_the_caster_is_told_where_the_boat_is(tmp_path):
    """In the head for version 2, and in the stream again and again."""
    heard = bytearray()

    async def caster(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"ICY 200 OK\r\n\r\n")
        while data := await reader.read(4096):
            heard.extend(data)
            writer.write(frame(1005))
        writer.close()

    server = await asyncio.start_server(caster, "127.0.0.1", 0)
    async with server, roving(tmp_path, f"ntrip://127.0.0.1:{server.sockets[0].getsockname()[1]}/VRS", gga_s=0.05) as rover:
        async with asyncio.timeout(200):
            while heard.count(b"$GPGGA,") < 3:
                await asyncio.sleep(0.01)
        assert b",3841.441088,N,00912.917844,W,4,10," in heard
        await rover.until(lambda f: not f["troubles"])


async def test_what_comes_by_radio_is_put_together_and_rests_while_the_caster_sends(tmp_path):
    async def caster(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await sends.wait()
        writer.write(b"ICY 200 OK\r\n" + observed)
        await reader.read()
        writer.close()

    sends, observed, whole = asyncio.Event(), frame(1077), frame(1087, 500)
    server = await asyncio.start_server(caster, "127.0.0.1", 0)
    place = f"ntrip://127.0.0.1:{server.sockets[0].getsockname()[1]}/BASE"
    async with server, roving(tmp_path, place, gga_s=0.0) as rover:
        for at in range(0, len(whole), 180):
            rover.radio(whole[at : at + 180])
        assert await rover.receives(whole) == whole
        sends.set()
        await rover.receives(observed)
        rover.radio(frame(1097))
        figures = await rover.until(lambda f: f["receiver"]["unused"])
        assert figures["radio"]["messages"] == {"1087": 1, "1097": 1}
        assert rover.receiver.heard() == b""


async def test_a_receiver_that_is_pulled_out_and_comes_back_is_served_again(tmp_path):
    async with roving(tmp_path) as rover:
        rover.receiver.name.unlink()
        rover.receiver.close()
        figures = await rover.until(lambda f: "receiver" in f["troubles"])
        assert figures["troubles"]["receiver"].startswith(str(rover.receiver.name))
        rover.receiver = Receiver(rover.receiver.name)
        await rover.until(lambda f: not f["troubles"])
        again = frame(1005)
        rover.radio(again)
        assert await rover.receives(again) == again


async def test_a_shared_port_keeps_its_settings_and_what_came_for_the_vehicle(tmp_path):
    """The vehicle reads it at its own speed; another one that sets it up again would throw away what waits there."""
    receiver = Receiver(tmp_path / "gnss")
    line = os.open(receiver.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    before = termios.tcgetattr(line)
    os.write(receiver._end, b"$GPGGA")
    select.select([line], [], [], 30)
    port = ReceiverPort(str(receiver.name), 9600, shared=True)
    port.look()
    assert port.trouble == ""
    assert termios.tcgetattr(line) == before
    assert os.read(line, 100) == b"$GPGGA"
    port.close()
    os.close(line)
    receiver.close()


@pytest.mark.parametrize(("sources", "is_read"), [(("nmea0183",), True), (("dsor",), False)])
async def test_a_port_that_nobody_reads_is_set_up_at_the_speed_of_its_table(tmp_path, sources, is_read):
    receiver = Receiver(tmp_path / "gnss")
    settings = vehicle_file(
        tmp_path,
        navigation=config.NavigationTable(sources=sources),
        nmea0183=Nmea0183(ports={"gnss": Nmea0183Port(device=str(receiver.name), baud=57_600)}),
        corrections=Corrections(to="gnss", baud=9600),
    )
    port = corrections.receiver_port(settings)
    port.look()
    assert (termios.tcgetattr(receiver._port)[5] == termios.B57600) is not is_read
    port.close()
    receiver.close()


async def test_a_receiver_that_does_not_take_corrections_gets_the_newest_and_holds_up_nobody(tmp_path):
    receiver = Receiver(tmp_path / "gnss")
    port = ReceiverPort(str(receiver.name), 9600, shared=True)
    port.look()
    pieces = [frame(1077, 900) for _ in range(100)]
    for each in pieces:
        port.send(each)
    assert port.dropped > 60
    assert sum(map(len, port._waiting)) <= WAITING_BYTES
    found = b""
    async with asyncio.timeout(200):
        while not found.endswith(pieces[-1]):
            found += receiver.heard()
            await asyncio.sleep(0)
    while found:  # whole pieces, in their order
        first = next(each for each in pieces if found.startswith(each))
        pieces, found = pieces[pieces.index(first) + 1 :], found[len(first) :]
    port.close()
    receiver.close()


async def test_a_connection_to_the_receiver_is_made_anew(tmp_path):
    heard = asyncio.Queue[bytes]()

    async def receiver(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"$GNGGA\r\n" * 1000)  # nobody here reads it
        await heard.put(await reader.read(4096))
        writer.close()

    server = await asyncio.start_server(receiver, "127.0.0.1", 0)
    async with server, asyncio.timeout(200):
        port = ReceiverPort(f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}", 9600, shared=False)
        for _ in range(2):
            while port.trouble:
                port.look()
                await asyncio.sleep(0.01)
            port.send(again := frame(1005))
            assert await heard.get() == again
            while not port.trouble:
                port.look()
                await asyncio.sleep(0.01)
        port.close()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"caster": "ntrip://caster.example:2101/BASE"}, "a caster needs a receiver"),
        ({"to": "gnss", "credentials": "/x"}, "credentials without a caster"),
        ({"to": "gnss", "caster": "http://caster.example/BASE"}, "ntrip://HOST:PORT/MOUNTPOINT"),
        ({"to": "gnss", "caster": "ntrip://caster.example:2101/"}, "ntrip://HOST:PORT/MOUNTPOINT"),
        ({"to": "compass"}, "no serial port or connection of the name compass"),
        ({"to": "heard"}, "no serial port or connection of the name heard"),
        ({"to": "/dev/gnss"}, "/dev/gnss is read by nmea0183.ports.gnss.device already"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path, table, words):
    file = tmp_path / "boat.toml"
    file.write_text(
        """[boat]
name = "x"
[navigation]
sources = ["nmea0183"]
[nmea0183.ports.gnss]
device = "/dev/gnss"
[nmea0183.ports.heard]
device = "udp:127.0.0.1:10110"
"""
    )
    values = [f'corrections.{key}="{value}"' for key, value in table.items()]
    with pytest.raises(ConfigError, match=words):
        config.load(file, values)


async def test_it_does_not_run_beside_navigation(tmp_path):
    runtime = Runtime(vehicle_file(tmp_path, corrections=Corrections(to="/dev/gnss")), SystemClock())
    runtime.status["corrections"] = ServiceStatus("corrections", "runtime", Account("corrections", 0.1), 0, 0.0)
    with pytest.raises(PermanentFailure, match="place = 'process'"):
        await corrections.serve(runtime)
