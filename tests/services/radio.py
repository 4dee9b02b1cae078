"""A relay that breaks off as a bad radio does; FTP's data connections pass it, too."""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator
from typing import Final

PASSIVE: Final = re.compile(rb"^227 .*\((?:\d+,){4}(\d+),(\d+)\)")


class Radio:
    """Each connection breaks off after `breaks_after` bytes of the server; `breaks` counts them."""

    def __init__(self, breaks_after: int) -> None:
        self.breaks_after, self.breaks = breaks_after, 0
        self._servers: list[asyncio.Server] = []
        self._writers: list[asyncio.StreamWriter] = []

    async def relay(self, port: int) -> int:
        """The port that leads there."""

        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            there_reader, there = await asyncio.open_connection("127.0.0.1", port)
            self._writers += writer, there
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pour(reader, there, 1 << 40))
                group.create_task(self._pour(there_reader, writer, self.breaks_after))

        server = await asyncio.start_server(connected, "127.0.0.1", 0)
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _pour(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, left: int) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(min(left, 1 << 14)):
                if told := PASSIVE.match(data):
                    port = await self.relay(int(told[1]) * 256 + int(told[2]))
                    data = f"227 here (127,0,0,1,{port // 256},{port % 256})\r\n".encode()
                writer.write(data)
                await writer.drain()
                left -= len(data)
                if left <= 0:
                    self.breaks += 1
                    for each in self._writers:
                        each.transport.abort()
                    self._writers.clear()
                    return
            writer.close()

    async def close(self) -> None:
        for server in self._servers:
            server.close()
        for writer in self._writers:
            writer.transport.abort()
        await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def radio(port: int, breaks_after: int) -> AsyncIterator[tuple[Radio, int]]:
    """(it, the port on this side)."""
    link = Radio(breaks_after)
    try:
        yield link, await link.relay(port)
    finally:
        await link.close()
