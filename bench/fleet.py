"""Boats at an MQTT broker (docs/fleets.md): what a fleet costs broker and console, and how old its news is when it arrives.

Three processes: mosquitto, all boats, the console. Each boat has a connection of its own with a last will, and sends its
position, signed, and its state, retained, once a second. One console hears 199 of them; the 200th is of another fleet. The age
is from the signature's time stamp to the moment when the console has taken the frame.
"""

import argparse
import asyncio
import contextlib
import multiprocessing
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim.base.clock import SystemClock
from delfim.base.errors import DelfimError
from delfim.base.input.keys import read_key
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway.serving import BROKER_FRAMES
from delfim.console.link.mavlink import Key, keygen
from delfim.parts.fleet.broker import STATE, UP, BrokerLine, BrokerPlace
from delfim.parts.fleet.fleetd import retained_state
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import EPOCH_NS, PER_S, Signing
from delfim.vehicle.report import BoatReport

SIZES: Final = 10, 200  # boats
FLEET: Final = 199  # boats of one key at most: the numbers below those of consoles
SECONDS: Final = 12.0
SETTLE_S: Final = 4.0
TICK_S: Final = 0.05
TICKS: Final = os.sysconf("SC_CLK_TCK")


def run(asked: argparse.Namespace) -> int:
    """Prints a line for each of SIZES. Takes less than a minute."""
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
    if program is None:
        raise DelfimError("mosquitto is not installed: apt-get install mosquitto")
    seconds = asked.seconds or (5.0 if asked.quick else SECONDS)
    for boats in SIZES:
        with tempfile.TemporaryDirectory() as folder, _broker(program, Path(folder)) as (port, pid):
            keygen(Path(folder) / "key")
            started = multiprocessing.get_context("spawn")
            fleet = started.Process(target=_sail, args=(boats, port, f"{folder}/key"), daemon=True)
            fleet.start()
            try:
                print(asyncio.run(_measure(boats, port, pid, Path(folder) / "key", seconds)), flush=True)
            finally:
                fleet.terminate()
                fleet.join(10)
    return 0


@contextlib.contextmanager
def _broker(program: str, folder: Path) -> Iterator[tuple[int, int]]:
    with socket.socket() as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        port: int = any_socket.getsockname()[1]
    file = folder / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nlog_type error\nset_tcp_nodelay true\n")
    broker = subprocess.Popen((program, "-c", str(file)))
    try:
        yield port, broker.pid
    finally:
        broker.terminate()
        broker.wait(10)


def _sail(boats: int, port: int, key: str) -> None:
    """All boats, in a process of their own, until it is ended."""
    asyncio.run(_voyages(boats, port, read_key(key)))


async def _voyages(boats: int, port: int, key: bytes) -> None:
    async with asyncio.TaskGroup() as group:
        for number in range(1, boats + 1):
            fleet, system = ("bench", number) if number <= FLEET else ("other", number - FLEET)
            place, clock = BrokerPlace.of(f"mqtt://127.0.0.1:{port}/{fleet}"), SystemClock()
            line = BrokerLine(place, place.topic(f"boat{number}", "down"), _ignore, clock, boat=f"boat{number}")
            group.create_task(line.follow())
            group.create_task(_voyage(number, system, boats, line, key))


def _ignore(topic: str, frame: bytes) -> None:
    """What the console says: its heartbeats and questions."""


async def _voyage(number: int, system: int, boats: int, line: BrokerLine, key: bytes) -> None:
    """One boat: evenly among the others of its second."""
    dialect, clock, name = wire.dialect, SystemClock(), f"boat{number}"
    sender = wire.Sender(system, dialect.MAV_COMP_ID_AUTOPILOT1, key, Signing(key, clock).stamp)
    state = BoatReport(
        mode="play", reason="operator", boat=name, latitude_deg=38.7, longitude_deg=-9.2, age_s={"navigation": 0.1}
    )
    await asyncio.sleep(number / boats)
    while True:
        beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, 0, 209, 4, dialect.MAV_STATE_ACTIVE, 3)
        line.put(line.place.topic(name, UP), sender.pack(beat) + sender.pack(_short(number)))
        line.keep(line.place.topic(name, STATE), msgspec.json.encode(retained_state(state, clock.time_ns())))
        await asyncio.sleep(1.0)


def _short(number: int) -> Any:
    """HIGH_LATENCY2: all in one."""
    dialect = wire.dialect
    place = 386_900_000 + number, -92_150_000
    return dialect.MAVLink_high_latency2_message(0, dialect.MAV_TYPE_SURFACE_BOAT, 0, 4, *place, *(0,) * 21)


async def _measure(boats: int, port: int, pid: int, key: Path, seconds: float) -> str:
    clock, ages_ms = SystemClock(), list[float]()
    place = BrokerPlace.of(f"mqtt://127.0.0.1:{port}/bench")
    line = BrokerLine(place, place.topic("+", UP), lambda topic, data: take(topic, data), clock, held=BROKER_FRAMES)
    fleet = Fleet(clock, lambda way, data: line.put(place.topic(way[1], "down"), data), _told, Key(key))

    def take(topic: str, data: bytes) -> None:
        fleet.receive(("broker", topic.split("/")[1]), data)
        stamp = int.from_bytes(data[-12:-6], "little")
        ages_ms.append((time.time_ns() - EPOCH_NS) / 1e6 - stamp * 1e3 / PER_S)

    async def watch() -> str:
        until_s = time.monotonic() + 3 * SETTLE_S
        while len(fleet.boats) < min(boats, FLEET) and time.monotonic() < until_s:
            await tick()
        until_s = time.monotonic() + SETTLE_S
        while time.monotonic() < until_s:
            await tick()
        ages_ms.clear()
        mine_s, its_s, began_s = time.process_time(), _cpu_s(pid), time.monotonic()
        while time.monotonic() < began_s + seconds:
            await tick()
        for_s = time.monotonic() - began_s
        cpu, broker = (time.process_time() - mine_s) / for_s, (_cpu_s(pid) - its_s) / for_s
        if not ages_ms:
            raise DelfimError(f"nothing was heard of {boats} boats within {for_s:.1f} s")
        ages_ms.sort()
        parts = [ages_ms[min(int(len(ages_ms) * part), len(ages_ms) - 1)] for part in (0.5, 0.99, 1.0)]
        return (
            f"{boats:4d} boats, {len(fleet.boats)} at the console, {len(ages_ms) / for_s:5.1f} frames/s: "
            f"broker {100 * broker:4.1f} %, {_memory_mb(pid):.1f} MB; "
            f"console {100 * cpu:4.1f} %, {_memory_mb(os.getpid()):.1f} MB; "
            f"age p50 {parts[0]:.1f} ms, p99 {parts[1]:.1f} ms, worst {parts[2]:.1f} ms; dropped {line.counts['dropped']}"
        )

    async def tick() -> None:
        await asyncio.sleep(TICK_S)
        fleet.tick()

    follow = asyncio.ensure_future(line.follow())
    try:
        return await watch()
    finally:
        follow.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await follow


def _told(message: dict[str, Any]) -> None:
    """No page is open."""


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _memory_mb(pid: int) -> float:
    rows = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(row for row in rows if row.startswith("VmRSS")).split()[1]) / 1024
