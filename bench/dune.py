"""DUNE in `python -m bench peers`: its Otter in its own simulator, sent ahead by a datagram, measured by its own log.

DUNE is found by its `dune` in PATH, as it is built from source, or installed. It is one process of many tasks that pass
messages to each other; its protocol is IMC (https://www.lsts.pt/docs/imc/), in which datagrams and log are written alike: a
header, fields, a checksum, all little endian.
"""

import contextlib
import math
import os
import shutil
import signal
import socket
import struct
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from bench.critical_path import family, free_ports, running, until
from bench.turn import Turn, spent
from delfim.base.errors import DelfimError

HEADER: Final = struct.Struct("<HHHdHBHB")  # sync, message, bytes of its fields, s since 1970, from and to
SYNC: Final = 0xFE54
CHECKSUM: Final = struct.Struct("<H")
THRUST, STATE, GOTO, ORDER = 301, 350, 450, 501  # SetThrusterActuation, EstimatedState, Goto, VehicleCommand
OURS, ANYBODY = 0x4001, 0xFFFF  # a console; whoever receives it
SPEED_MPS: Final = 1.5
AHEAD_DEG: Final = (41.195, -8.7062)  # a kilometre north of where its simulator begins
SERVICE: Final = "now in 'SERVICE' mode"


class Logged(NamedTuple):
    """One message of the log."""

    number: int
    at_s: float  # since 1970
    fields: bytes


def dune(place: Path) -> Iterator["Dune"]:
    """DUNE's Otter; nothing where it is not built. Raises DelfimError."""
    if (found := shutil.which("dune")) is not None:
        program = Path(found).resolve()
        yield Dune(program, _settings_of(program), place)


def _settings_of(program: Path) -> Path:
    """The folder of its vehicles' files: of an installed program beside it, else of the sources. Raises DelfimError."""
    folders = [program.parents[1] / "etc"]
    with contextlib.suppress(OSError):
        lines = (program.parent / "CMakeCache.txt").read_text().splitlines()
        sources = [line.partition("=")[2] for line in lines if line.startswith("CMAKE_HOME_DIRECTORY:")]
        folders += [Path(each) / "etc" for each in sources]
    if (known := next((each for each in folders if (each / "otter.ini").is_file()), None)) is None:
        raise DelfimError(f"{program} has no otter.ini, in none of {', '.join(map(str, folders))}")
    return known


class Dune:
    """The vehicle that its authors call `otter`, in simulation, as its file has it: navigation ten times a second."""

    label = "DUNE, its Otter at 10 Hz"

    def __init__(self, program: Path, settings: Path, place: Path) -> None:
        self._program, self._settings, self._place = program, settings, place

    def turn(self, seconds: float) -> Turn:
        with tempfile.TemporaryDirectory(dir=self._place) as name:
            place = Path(name)
            (port,) = free_ports(1)
            command = self._laid_out(place, port)
            began_s = time.time()
            with (place / "said").open("w") as said, running(command, stdout=said, stderr=said) as program:
                first_s = _under_way(place, port)
                since_s = time.time()
                processor, memory_bytes = spent(lambda: family(program.pid), seconds)
                program.send_signal(signal.SIGKILL)
                program.wait()
            latency_us = latencies_us(each for each in logged(place) if each.at_s >= since_s)
        # All of it is one process: nothing is left that could tell the motors to stop.
        return Turn(first_s - began_s, processor, memory_bytes, None, latency_us)

    def _laid_out(self, place: Path, port: int) -> list[str]:
        """Lay out a folder that is this turn's alone, for it logs where its program is. Returns the command."""
        (place / "bin").mkdir()
        (place / "etc").mkdir()
        shutil.copy(self._program, place / "bin/dune")
        link = f"[Transports.UDP]\nLocal Port = {port}\nIgnore Filter = true\n"  # else it obeys nobody who was not announced
        log = "[Transports.Logging]\nLSF Compression Method = none\n"
        file = os.path.relpath(self._settings / "otter.ini", place / "etc")
        (place / "etc/peers.ini").write_text(f"[Require {file}]\n\n{link}\n{log}")
        return [str(place / "bin/dune"), "-d", str(place / "etc"), "-c", "peers", "-p", "Simulation"]


def _under_way(place: Path, port: int) -> float:
    """Send the boat ahead as soon as it is in service: what it is told before that, it forgets. Returns when its log has the
    first order of thrust after it, s. Raises DelfimError."""
    until(lambda: _found(SERVICE in (place / "said").read_text(), place), "its service mode")
    sent_s = time.time()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.sendto(order(sent_s), ("127.0.0.1", port))

    def ordered_s() -> float | None:
        thrusts = (each for each in logged(place) if each.number == THRUST and each.at_s >= sent_s)
        return next((each.at_s for each in thrusts if struct.unpack_from("<Bf", each.fields)[1] > 0.0), None)

    at_s: float = until(lambda: _found(ordered_s(), place), "an order of thrust")
    return at_s


def _found(what: object, place: Path) -> object:
    """Return what was found. Raises DelfimError with what DUNE said last where that is nothing yet."""
    if not what:
        raise DelfimError(f"not yet: {(place / 'said').read_text()[-500:]}")
    return what


def order(at_s: float) -> bytes:
    """Return the datagram that sends the boat ahead: VehicleCommand, with a maneuver Goto within it."""
    latitude_rad, longitude_rad = map(math.radians, AHEAD_DEG)
    goto = struct.pack("<HHddfBfBdddH", GOTO, 0, latitude_rad, longitude_rad, 0.0, 1, SPEED_MPS, 0, 0.0, 0.0, 0.0, 0)
    fields = struct.pack("<BHB", 0, 1, 0) + goto + struct.pack("<HH", 0, 0)
    told = HEADER.pack(SYNC, ORDER, len(fields), at_s, OURS, 0xFF, ANYBODY, 0xFF) + fields
    return told + CHECKSUM.pack(checksum(told))


def checksum(data: bytes) -> int:
    """Return the CRC-16 of polynomial 0x8005, each byte's lowest bit first."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


def logged(place: Path) -> Iterator[Logged]:
    """Return the messages of all logs below a folder; a last one that is cut is left out."""
    for file in sorted(place.rglob("Data.lsf")):
        data, at = file.read_bytes(), 0
        while at + HEADER.size <= len(data):
            _, number, size, at_s, *_ = HEADER.unpack_from(data, at)
            end = at + HEADER.size + size + CHECKSUM.size
            if end > len(data):
                break
            yield Logged(number, at_s, data[at + HEADER.size : end - CHECKSUM.size])
            at = end


def latencies_us(messages: Iterable[Logged]) -> list[float]:
    """Return how long each EstimatedState took to become the order to the second motor, ascending, µs. What came to no order
    before the next one is left out. The log has messages as they were written, which is not the order of their stamps."""
    found, state_s, orders = list[float](), math.inf, 0
    for each in sorted(messages, key=lambda each: each.at_s):
        if each.number == STATE:
            state_s, orders = each.at_s, 0
        elif each.number == THRUST:
            orders += 1
            if orders == 2 and state_s < math.inf:
                found.append((each.at_s - state_s) * 1e6)
    return sorted(found)
