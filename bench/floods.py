"""Who floods the boat's doors: `python -m bench.floods KIND PORT`, PORT being that of ftpd.

Frames with a forged signature for the MAVLink port; connections to cantcpd that say nothing, from many addresses; clients that
open a bus there and leave; commands to cantcpd that mean nothing, or are barred; connections to ftpd, as many as it takes; and
lines that the runtime's own loop has to log; and a line of sensors that floods, falls silent, speaks at another rate, is pulled
out and comes back as another device. The same seed sends the same. Within the benchmark itself runs a payload program that
floods.
"""

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from itertools import count
from pathlib import Path
from random import Random
from typing import Final

from bench.critical_path import running, until
from bench.fuzz import SYSTEM
from bench.load import IDLE, Ports
from delfim.base.errors import DelfimError
from delfim.lines.nmea0183.framing import framed
from delfim.parts.mavlink.codec.wire import dialect

BURST_S: Final = 0.002
BURST: Final = 100  # at once, at most
HELD: Final = 64  # connections of which the oldest is closed for a new one
TIMEOUT_S: Final = 0.5
LINE_STEPS: Final = 2000  # a second of each: floods, is silent, speaks at another rate, is unplugged
SENTENCES: Final = 80 * framed("GPGGA,120000.00,3841.4420,N,00912.9180,W,4,12,0.7,0.0,M,,M,,")
NONSENSE: Final = (
    "< send 040 2 11 22 >",
    "< send 123 9 >",
    "< nonsense >",
    "< filter >",
    "<" * 300,
    "\xff\0 >",
)


def _forged(random: Random, ports: Ports, _: str, __: int) -> Generator[None, None, None]:
    """Orders to drive, to stop and to take over, as if the console that commands had signed them."""
    kinds = (dialect.MAVLINK_MSG_ID_MANUAL_CONTROL, dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_HEARTBEAT)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", ports.mavlink))
        while True:
            kind, payload = random.choice(kinds), random.randbytes(33)
            header = bytes([len(payload), 1, 0, random.randrange(256), SYSTEM, 190]) + kind.to_bytes(3, "little")
            crc = dialect.x25crc(header + payload + bytes([dialect.mavlink_map[kind].crc_extra])).crc.to_bytes(2, "little")
            link.send(b"\xfd" + header + payload + crc + b"\1" + random.randbytes(12))
            yield


def _connections(random: Random, port: int) -> Generator[None, None, None]:
    held = deque[socket.socket]()
    try:
        while True:
            while len(held) >= HELD:
                held.popleft().close()
            address = f"127.0.{random.randrange(256)}.{random.randrange(2, 255)}"
            held.append(socket.create_connection(("127.0.0.1", port), TIMEOUT_S, (address, 0)))
            yield
    finally:
        for link in held:
            link.close()


def _silent(random: Random, ports: Ports, _: str, __: int) -> Generator[None, None, None]:
    return _connections(random, ports.cantcpd)


def _visitors(random: Random, _: Ports, __: str, ftpd: int) -> Generator[None, None, None]:
    return _connections(random, ftpd)


def _visits(random: Random, ports: Ports, bus: str, _: int) -> Generator[None, None, None]:
    while True:
        with socket.create_connection(("127.0.0.1", ports.cantcpd), TIMEOUT_S) as link:
            link.sendall(f"< open {bus} >< rawmode >".encode())
            while b"ok" not in link.recv(1 << 10):
                pass
        yield


def _nonsense(random: Random, ports: Ports, bus: str, _: int) -> Generator[None, None, None]:
    with socket.create_connection(("127.0.0.1", ports.cantcpd), TIMEOUT_S) as link:
        link.sendall(f"< open {bus} >".encode())
        link.setblocking(False)
        while True:
            with contextlib.suppress(BlockingIOError):
                link.send(random.choice(NONSENSE).encode("latin-1"))
                link.recv(1 << 16)
            yield


def _words(_: Random, ports: Ports, __: str, ___: int) -> Generator[None, None, None]:
    with socket.create_connection(("127.0.0.1", ports.commands), TIMEOUT_S) as link:
        for number in count():
            link.sendall(f"log {number}\n".encode())
            yield


def sensor_line(benchmark: int) -> Path:
    """The name under which the boat has its line of sensors; of the benchmark with this process id."""
    return Path(tempfile.gettempdir(), f"delfim-bench-line-{benchmark}")


def _line(random: Random, _: Ports, __: str, ___: int) -> Generator[None, None, None]:
    name, handles = sensor_line(os.getppid()), list[int]()
    try:
        for number in count():
            phase = number // LINE_STEPS % 4
            if phase == 3 and handles:
                _unplug(name, handles)
            elif phase != 3 and not handles:
                handles[:] = os.openpty()
                tty.setraw(handles[1])
                os.set_blocking(handles[0], False)
                name.symlink_to(os.ttyname(handles[1]))
            with contextlib.suppress(BlockingIOError):  # the boat has closed it
                if phase == 0:
                    os.write(handles[0], SENTENCES)
                elif phase == 2:
                    os.write(handles[0], random.randbytes(40))
            yield
    finally:
        _unplug(name, handles)


def _unplug(name: Path, handles: list[int]) -> None:
    name.unlink(missing_ok=True)
    for each in handles:
        os.close(each)
    handles.clear()


Kind = Callable[[Random, Ports, str, int], Generator[None, None, None]]
KINDS: Final[dict[str, tuple[Kind, float]]] = {  # and how many a second
    "forged frames": (_forged, 3500.0),
    "silent connections to cantcpd": (_silent, 300.0),
    "short visits to cantcpd": (_visits, 300.0),
    "nonsense to cantcpd": (_nonsense, 5000.0),
    "connections to ftpd": (_visitors, 300.0),
    "lines for the system log": (_words, 1000.0),
    "a broken line of sensors": (_line, 2000.0),
}


PAYLOAD: Final = "a payload that floods"
SHOUTS: Final = ("/bin/sh", "-c", """while :; do echo '{"x": 1}'; echo noise >&2; done""")


@contextlib.contextmanager
def payload(asked: Sequence[str], file: str, place: Path) -> Iterator[list[int]]:
    """A program that says as much as it can, carried as the supervisor has it done; afterwards the list holds how many lines
    were dropped. `place` has the vehicle's command socket in its folder "delfim"."""
    own, dropped = place / "payload", list[int]()
    figures = own / "service-payload.json"
    figures.unlink(missing_ok=True)  # of the turn before: its program would seem to shout while this one still starts
    settings = [*asked, f"payload.shouts.command={json.dumps(SHOUTS)}", f'console.socket="{place}/delfim/command"']
    settings += [f'runtime.run_directory="{own}"', f'log.directory="{own}"']
    words = [word for each in settings for word in ("--set", each)]
    beat, told = os.pipe()
    command = [*IDLE, sys.executable, "-m", "delfim", "run", file, "--service", "payload", "--beat-fd", str(told), *words]

    def lines() -> int:
        """Raises OSError, ValueError, KeyError while it has said nothing."""
        return int(json.loads(figures.read_text())["figures"]["lines"]["shouts"]["dropped"])

    def shouting() -> None:
        with contextlib.suppress(ValueError, KeyError, FileNotFoundError):
            if lines():
                return
        raise DelfimError("nothing was shouted yet")

    with running(command, pass_fds=(told,), stderr=subprocess.DEVNULL):
        try:
            until(shouting, PAYLOAD)
            before = lines()
            yield dropped
            dropped.append(lines() - before)
        finally:
            os.close(told)
            os.close(beat)


def main() -> int:
    """A line of ports (bench.load) starts and is answered with "on", an empty line stops and is answered with how many
    were sent, and how many failed, as JSON; the end of the input ends."""
    kind, rate_hz = KINDS[sys.argv[1]]
    random = Random(1)
    while line := sys.stdin.readline():
        *numbers, bus, _ = line.split()
        asked = random, Ports(*map(int, numbers)), bus, int(sys.argv[2])
        flood, sent, failed, began_s = kind(*asked), 0, 0, time.monotonic()
        print("on", flush=True)
        while not select.select([sys.stdin], [], [], BURST_S)[0]:
            for _ in range(min(int((time.monotonic() - began_s) * rate_hz) - sent - failed, BURST)):
                try:
                    next(flood)
                    sent += 1
                except OSError:  # hung up on, or not let in: that is what it is for
                    failed += 1
                    flood = kind(*asked)
        flood.close()
        sys.stdin.readline()
        print(json.dumps({"sent": sent, "failed": failed}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
