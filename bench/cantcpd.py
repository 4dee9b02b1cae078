"""cantcpd with clients on a bus that is full: frames lost by each client, and what a client costs.

    python bench/cantcpd.py [--seconds S] [--clients N ...] [--rate FRAMES_PER_S]

One of the clients sleeps when there are more than one: it loses frames, and no other does. Server, bus and readers are
processes of their own; CPU is that of the server, from /proc.
"""

import argparse
import contextlib
import os
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from delfim.base.frames import extended
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.socket import CanAddress

BUS = f"bench{os.getpid() % 100000}"
BURSTS_PER_S = 1000
SETTLE_S = 2.0
ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "delfim"]
FORK = get_context("fork")  # the children are on the same bus


def feed(rate: int, seconds: float, last: Connection) -> None:
    """Numbered frames at this rate, in bursts of a millisecond; tells how many there were."""
    with open_canloop(BUS) as bus:
        number, start_s = 0, time.monotonic()
        while (elapsed_s := time.monotonic() - start_s) < seconds:
            while number < rate * elapsed_s:
                bus.sendto(number.to_bytes(8, "big"), CanAddress(extended(number % 40)))
                number += 1
            time.sleep(1 / BURSTS_PER_S)
    last.send(number)


def read(port: int, clients: int, seconds: float, result: Connection) -> None:
    """Clients that count the frames they get, until nothing has come for a second."""
    selector, counts = selectors.DefaultSelector(), [0] * clients
    for index in range(clients):
        selector.register(connected(port), selectors.EVENT_READ, index)
    result.send("ready")
    while ready := selector.select(SETTLE_S if any(counts) else seconds):
        for key, _ in ready:
            counts[key.data] += os.read(key.fd, 65536).count(b">")
    result.send(counts)


def connected(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port))
    for command in (b"", f"< open {BUS} >".encode(), b"< rawmode >"):
        connection.sendall(command)
        connection.recv(64)
    return connection


@contextlib.contextmanager
def daemon(place: str) -> Iterator[tuple[int, int]]:
    """The service in a process of its own: its process id and port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = [
        f'can.interface="canloop:{BUS}"',
        "can.receive_buffer_bytes=16777216",  # what the machine does beside is no loss of cantcpd's
        'mavlink.listen="127.0.0.1:0"',
        "mavlink.peers=[]",
        f'cantcpd.listen=["127.0.0.1:{port}"]',
        f'runtime.run_directory="{place}"',
    ]
    command = [*COMMAND, "run", str(ROOT / "etc/delfimx.toml"), "--service", "cantcpd"]
    process = subprocess.Popen([*command, *(word for setting in settings for word in ("--set", setting))])
    try:
        while True:
            with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
                break
            time.sleep(0.05)
        yield process.pid, port
    finally:
        process.terminate()
        process.wait()


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(clients: int, rate: int, seconds: float) -> tuple[int, float, list[int]]:
    """Frames sent, share of a core of the server, frames that each client that is awake got."""
    sleepers = 1 if clients > 1 else 0
    with tempfile.TemporaryDirectory() as place, daemon(place) as (pid, port), contextlib.ExitStack() as links:
        for _ in range(sleepers):
            links.enter_context(connected(port))
        ours, theirs = FORK.Pipe()
        reader = FORK.Process(target=read, args=(port, clients - sleepers, seconds, theirs))
        reader.start()
        ours.recv()
        time.sleep(0.2)
        told, tell = FORK.Pipe()
        feeder = FORK.Process(target=feed, args=(rate, seconds, tell))
        began_s, used_s = time.monotonic(), cpu_s(pid)
        feeder.start()
        sent: int = told.recv()
        used_s, took_s = cpu_s(pid) - used_s, time.monotonic() - began_s
        counts: list[int] = ours.recv()
        feeder.join()
        reader.join()
    return sent, used_s / took_s, counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rate", type=int, default=7_700)
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 8])
    asked = parser.parse_args()
    shares: dict[int, float] = {}
    print(f"{'clients':>7} {'frames/s':>8} {'core %':>7} {'us/frame':>8}  lost by those awake")
    for clients in asked.clients:
        sent, share, counts = measure(clients, asked.rate, asked.seconds)
        shares[clients] = share
        rate = sent / asked.seconds
        print(f"{clients:7} {rate:8.0f} {100 * share:7.1f} {1e6 * share / rate:8.1f}  {[sent - count for count in counts]}")
    first, last = min(shares), max(shares)
    if first != last:
        each = (shares[last] - shares[first]) / (last - first)
        print(f"each further client: {100 * each:.2f} % of a core, {1e3 * each / asked.rate * 1e3:.3f} ms for 1,000 frames")


if __name__ == "__main__":
    main()
