"""What loads the suite in the benchmark: clients of its services, and one service that stands for sshd.

Two monitors read every frame of the bus from cantcpd, somebody downloads a log from httpd, somebody polls its page twenty
times a second, and somebody runs a program every second. The program is run by a row of the benchmark's own, because sshd has a
process to itself, where it would not be in anybody's way. The same row logs a line for each "log ..." that it is sent. The
clients run in an idle process, and on one processor, as all that other computers do: `python -m bench.load`.
"""

import asyncio
import contextlib
import http.client
import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final, NamedTuple

from delfim.services.runtime import LoadedService, Runtime

LOG: Final = "20100101/bench/120000.log"  # what is downloaded, in the log directory
LOG_BYTES: Final = 1 << 30  # more than a slice takes of it; the file has holes only
POLL_HZ: Final = 20.0
DOWNLOAD_BYTES_PER_S: Final = 2e6
PROGRAM: Final = ("/bin/echo", "done")
ELSEWHERE: Final = ("taskset", "-c", str(max(os.sched_getaffinity(0))))  # other computers' work is not scattered over this one
IDLE: Final = ("chrt", "--idle", "0")
ASHORE: Final = (*ELSEWHERE, *IDLE)  # a client's work is another computer's, and has time

log = logging.getLogger("delfim.bench")
Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Ports(NamedTuple):
    """Where the services listen, on loopback."""

    cantcpd: int
    httpd: int
    commands: int
    mavlink: int


def prepare(directory: Path) -> None:
    """Put the log that is downloaded into the log directory."""
    path = directory / LOG
    path.parent.mkdir(parents=True)
    with path.open("wb") as file:
        file.truncate(LOG_BYTES)


def rows(ports: Ports) -> list[LoadedService]:
    """What is served beside the suite's own services."""

    async def commands(runtime: Runtime) -> None:
        await _serve(_command, ports.commands)

    return [LoadedService("commands", commands)]


async def _serve(handler: Handler, port: int) -> None:
    async def quiet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            await handler(reader, writer)
        writer.close()

    async with await asyncio.start_server(quiet, "127.0.0.1", port) as server:
        await server.serve_forever()


async def _command(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while line := await reader.readline():
        if line.startswith(b"log "):
            log.info("as long as a line of the system log usually is: %s", line)
            continue
        child = await asyncio.create_subprocess_exec(*PROGRAM, stdout=asyncio.subprocess.PIPE)
        output, _ = await child.communicate()
        writer.write(output)
        await writer.drain()


class Clients:
    """All clients of one competitor, each in a thread, until `stop`; `counts` says what they got. `bus` as cantcpd names it.

    With `watchers` there are only so many, of the bus, and the last of them falls asleep.
    """

    def __init__(self, ports: Ports, bus: str, watchers: int = 0) -> None:
        self.counts = {"monitor_bytes": 0, "pages": 0, "download_bytes": 0, "commands": 0}
        self._ended, self._bus = threading.Event(), bus
        asked = [
            (self._monitor, ports.cantcpd),
            (self._monitor, ports.cantcpd),
            (self._poll, ports.httpd),
            (self._download, ports.httpd),
            (self._run, ports.commands),
        ]
        if watchers:
            asked = [(self._monitor, ports.cantcpd)] * (watchers - 1) + [(self._sleep, ports.cantcpd)]
        self._links = [socket.create_connection(("127.0.0.1", port), timeout=10.0) for _, port in asked]
        self._threads = [
            threading.Thread(target=self._until_ended, args=(use, link), daemon=True)
            for (use, _), link in zip(asked, self._links, strict=True)
        ]
        for thread in self._threads:
            thread.start()

    def stop(self) -> dict[str, int]:
        self._ended.set()
        for link in self._links:
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for link in self._links:
            link.close()
        return self.counts

    def _until_ended(self, use: Callable[[socket.socket], None], link: socket.socket) -> None:
        with contextlib.suppress(OSError, http.client.HTTPException):
            use(link)

    def _monitor(self, link: socket.socket) -> None:
        link.sendall(f"< open {self._bus} >< rawmode >".encode())
        while data := link.recv(1 << 16):
            self.counts["monitor_bytes"] += len(data)

    def _sleep(self, link: socket.socket) -> None:
        link.sendall(f"< open {self._bus} >< rawmode >".encode())
        self._ended.wait()

    def _poll(self, link: socket.socket) -> None:
        while not self._ended.wait(1.0 / POLL_HZ):
            _got(link, "/").read()
            self.counts["pages"] += 1

    def _download(self, link: socket.socket) -> None:
        started_s, file = time.monotonic(), _got(link, f"/logs/{LOG}")
        while data := file.read(1 << 16):
            self.counts["download_bytes"] += len(data)
            early_s = self.counts["download_bytes"] / DOWNLOAD_BYTES_PER_S - (time.monotonic() - started_s)
            if early_s > 0 and self._ended.wait(early_s):
                return

    def _run(self, link: socket.socket) -> None:
        while True:
            link.sendall(b"run\n")
            if not link.recv(1 << 16):
                return
            self.counts["commands"] += 1
            if self._ended.wait(1.0):
                return


def _got(link: socket.socket, path: str) -> http.client.HTTPResponse:
    """The answer to a GET on a connection that stays open. Raises OSError, HTTPException."""
    link.sendall(f"GET {path} HTTP/1.1\r\nHost: boat\r\n\r\n".encode())
    answer = http.client.HTTPResponse(link)
    answer.begin()
    if answer.status != http.client.OK:
        raise http.client.HTTPException(f"{path}: {answer.status}")
    return answer


def main() -> int:
    """A line of ports, the bus and the number of watchers (0: clients of all kinds) starts them and is answered with "on", an
    empty line stops them and is answered with their counts as JSON; the end of the input ends."""
    clients: Clients | None = None
    for line in sys.stdin:
        if line.strip():
            *ports, bus, watchers = line.split()
            clients = Clients(Ports(*map(int, ports)), bus, int(watchers))
            print("on", flush=True)
        elif clients is not None:
            print(json.dumps(clients.stop()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
