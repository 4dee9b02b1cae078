"""What loads a runtime in the benchmark: services that do the work of those of the suite, and the clients that use them.

Two monitors read every frame of the bus, somebody downloads a log, somebody polls the statistics page twenty times a second,
and somebody runs a program every second. The services are rows like those of `delfim.suite`, so that every competitor hosts
the same ones; the clients run in a niced process of their own: `python -m delfim.bench.load`.
"""

import asyncio
import contextlib
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Final, NamedTuple

from delfim.canproxy.socket import ANYTHING, open_can
from delfim.services.runtime import Runtime, Service

BACKLOG_BYTES: Final = 1 << 16  # a monitor that is further behind misses frames
FRAMES_A_CALL: Final = 16
BLOCK: Final = bytes(range(256)) * 64  # 16 KiB of a log
POLL_HZ: Final = 20.0
DOWNLOAD_BYTES_PER_S: Final = 2e6
PROGRAM: Final = ("/bin/echo", "done")

Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Ports(NamedTuple):
    """Where the services listen, on loopback."""

    monitors: int
    download: int
    statistics: int
    commands: int


def rows(ports: Ports) -> list[Service]:
    """The services, one row each."""

    async def monitors(runtime: Runtime) -> None:
        await _monitors(runtime, ports.monitors)

    async def download(runtime: Runtime) -> None:
        await _serve(_download, ports.download)

    async def statistics(runtime: Runtime) -> None:
        await _serve(lambda reader, writer: _statistics(runtime, reader, writer), ports.statistics)

    async def commands(runtime: Runtime) -> None:
        await _serve(_command, ports.commands)

    return [Service(start.__name__, start) for start in (monitors, download, statistics, commands)]


async def _serve(handler: Handler, port: int) -> None:
    async def quiet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            await handler(reader, writer)
        writer.close()

    async with await asyncio.start_server(quiet, "127.0.0.1", port) as server:
        await server.serve_forever()


async def _monitors(runtime: Runtime, port: int) -> None:
    """Frames of the bus as text, to whoever is connected."""
    writers = set[asyncio.StreamWriter]()
    with open_can(runtime.config.can.interface) as bus:
        bus.setblocking(False)
        bus.bind(ANYTHING)

        def on_readable() -> None:
            lines = list[str]()
            while len(lines) < FRAMES_A_CALL and (frame := bus.receive()) is not None:
                seconds, rest_ns = divmod(frame.t_ns, 1_000_000_000)
                lines.append(f"< frame {frame.identifier:X} {seconds}.{rest_ns // 1000:06d} {frame.data.hex()} >")
            text = "".join(lines).encode()
            for writer in writers:
                if writer.transport.get_write_buffer_size() < BACKLOG_BYTES:
                    writer.write(text)

        async def attend(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writers.add(writer)
            try:
                await reader.read()
            finally:
                writers.discard(writer)

        runtime.reader(bus.fileno(), on_readable)
        try:
            await _serve(attend, port)
        finally:
            runtime.remove_reader(bus.fileno())


async def _download(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while True:
        writer.write(BLOCK)
        await writer.drain()


async def _statistics(runtime: Runtime, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while True:
        await reader.readuntil(b"\r\n\r\n")
        page = json.dumps({"load": os.getloadavg(), "times": os.times(), **runtime.report()}, default=str).encode()
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(page) + page)
        await writer.drain()


async def _command(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while await reader.readline():
        child = await asyncio.create_subprocess_exec(*PROGRAM, stdout=asyncio.subprocess.PIPE)
        output, _ = await child.communicate()
        writer.write(output)
        await writer.drain()


class Clients:
    """All clients of one competitor, each in a thread, until `stop`; `counts` says what they got."""

    def __init__(self, ports: Ports) -> None:
        self.counts = {"monitor_bytes": 0, "pages": 0, "download_bytes": 0, "commands": 0}
        self._ended = threading.Event()
        asked = (
            (self._monitor, ports.monitors),
            (self._monitor, ports.monitors),
            (self._poll, ports.statistics),
            (self._download, ports.download),
            (self._run, ports.commands),
        )
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
        with contextlib.suppress(OSError):
            use(link)

    def _monitor(self, link: socket.socket) -> None:
        while data := link.recv(1 << 16):
            self.counts["monitor_bytes"] += len(data)

    def _poll(self, link: socket.socket) -> None:
        while not self._ended.wait(1.0 / POLL_HZ):
            link.sendall(b"GET / HTTP/1.1\r\nHost: boat\r\n\r\n")
            if not link.recv(1 << 16):
                return
            self.counts["pages"] += 1

    def _download(self, link: socket.socket) -> None:
        started_s = time.monotonic()
        while data := link.recv(1 << 16):
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


def main() -> int:
    """A line of four ports starts the clients and is answered with "on", an empty line stops them and is answered with their
    counts as JSON; the end of the input ends."""
    os.nice(10)
    clients: Clients | None = None
    for line in sys.stdin:
        if line.strip():
            clients = Clients(Ports(*map(int, line.split())))
            print("on", flush=True)
        elif clients is not None:
            print(json.dumps(clients.stop()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
