"""Bounds the connections of a page that strangers can reach: so many in all and of one address, and none that asks nothing."""

import asyncio
import logging
from typing import Final

from aiohttp import web

from delfim.services.access.connection_limits import ConnectionLimits

OF_ALL, OF_ONE = 64, 24  # connections: a browser opens six at once and keeps one for each page
IDLE_S: Final = 15.0  # for the first request to arrive


class PageVisitor(web.RequestHandler):
    """aiohttp's connection with limits."""

    __slots__ = ("_address", "_limits", "_wait")

    def __init__(self, server: web.Server, limits: ConnectionLimits, log: logging.Logger, idle_s: float = IDLE_S) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(server, loop=loop, access_log=None, logger=log)  # type: ignore[arg-type]
        self._limits, self._address = limits, ""
        self._wait = loop.call_later(idle_s, self._late)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        address = str((transport.get_extra_info("peername") or ("",))[0])
        if self._limits.enter(address):
            self._address = address
        super().connection_made(transport)
        if not self._address:
            self._late()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self._messages or self._current_request is not None:
            self._wait.cancel()

    def connection_lost(self, exc: BaseException | None) -> None:
        self._wait.cancel()
        if self._address:
            self._limits.leave(self._address)
        super().connection_lost(exc)

    def _late(self) -> None:
        """It asks nothing, or there are too many."""
        if self.transport is not None:
            self.transport.abort()
