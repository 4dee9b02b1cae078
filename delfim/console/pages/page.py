"""One browser at the gateway."""

import asyncio
from contextlib import suppress
from typing import Any, Final

import msgspec
from aiohttp import web

from delfim.console.pages.admission import OPERATOR

BACKLOG_BYTES: Final = 1 << 20  # a page that is so far behind misses older states
DROPPED: Final = {"boats": BACKLOG_BYTES, "vessels": BACKLOG_BYTES, "progress": BACKLOG_BYTES, "picture": BACKLOG_BYTES >> 4}
QUEUE_MAX: Final = 1000  # messages to one of them


def encoded(message: Any) -> str:
    """JSON, with null for numbers that are not finite: browsers take no others."""
    return msgspec.json.encode(message).decode()


class Page:
    """One browser. One that is behind misses pictures first, then states, and never answers."""

    def __init__(self, link: web.WebSocketResponse, request: web.Request, number: int) -> None:
        self._link, self._request, self.number = link, request, number
        self.operator = request.get(OPERATOR)
        self.queue: asyncio.Queue[str | None] = asyncio.Queue(maxsize=QUEUE_MAX + 1)  # None: the end

    @property
    def who(self) -> str:
        return self.operator.name if self.operator else f"page {self.number} at {self._request.remote}"

    def tell(self, message: dict[str, Any]) -> None:
        transport = self._request.transport
        waits = BACKLOG_BYTES if transport is None else transport.get_write_buffer_size()
        if self.queue.qsize() >= QUEUE_MAX or waits >= DROPPED.get(message["t"], waits + 1):
            return
        self.queue.put_nowait(encoded(message))

    def end(self) -> None:
        self.queue.put_nowait(None)

    async def write(self) -> None:
        """Sends until the connection ends."""
        with suppress(ConnectionError):
            while (text := await self.queue.get()) is not None:
                await self._link.send_str(text)
        await self._link.close()
