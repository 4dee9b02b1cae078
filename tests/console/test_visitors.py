"""Strangers at the door of the page: so many connections, and none that asks nothing; whoever asks is served beside them."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from functools import partial

from aiohttp import ClientSession, web

from delfim.console.pages.visitors import OF_ONE, PageVisitor
from delfim.services.access.connection_limits import ConnectionLimits


@contextlib.asynccontextmanager
async def door(limits: ConnectionLimits, idle_s: float) -> AsyncIterator[int]:
    async def told(request: web.BaseRequest) -> web.Response:
        return web.Response(text="the page")

    server = web.Server(told)
    loop = asyncio.get_running_loop()
    listener = await loop.create_server(partial(PageVisitor, server, limits, logging.getLogger(), idle_s), "127.0.0.1", 0)
    try:
        yield int(listener.sockets[0].getsockname()[1])
    finally:
        listener.close()
        await server.shutdown(0.1)


async def test_beyond_its_connections_an_address_gets_none_and_another_is_served() -> None:
    limits = ConnectionLimits(100, 5)
    async with door(limits, 600.0) as port, contextlib.AsyncExitStack() as held:
        for _ in range(20):
            _, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0))
            held.callback(writer.close)
        async with ClientSession() as visitor, visitor.get(f"http://127.0.0.1:{port}/") as answer:
            assert await answer.text() == "the page"
        async with asyncio.timeout(60.0):
            while limits.refused < 15:
                await asyncio.sleep(0)
        assert limits.inside["127.0.0.2"] == 5


async def test_who_asks_nothing_is_gone_in_time_and_who_asked_stays() -> None:
    limits = ConnectionLimits(100, OF_ONE)
    async with door(limits, 0.05) as port, ClientSession() as visitor:
        async with visitor.get(f"http://127.0.0.1:{port}/") as answer:
            assert answer.status == 200
        reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0))
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()
        assert limits.inside["127.0.0.2"] == 0
        assert limits.inside["127.0.0.1"] == 1
