"""The boat serves its console's page itself, and a phone that knows the boat's address alone operates it: the real boat with
all its programs, the page in Chromium, and the wireless network between them, which goes."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.console.chain import PATIENCE_S, Boat, _unused, afloat, select, shown_mode
from tests.services.browser import Page, tab

SILENT_S = 2.0  # failsafe.console_silent.after_s of the boat here


class Wireless:
    """The network between the phone and the boat. Cut, it carries nothing, and nobody is told: that is how it goes."""

    def __init__(self, port: int) -> None:
        self._port, self._through = port, asyncio.Event()
        self._through.set()
        self._pipes = set[asyncio.Task[None]]()

    async def open(self) -> None:
        """The boat is at the same port of ::1: it answers to its own names alone."""
        self._server = await asyncio.start_server(self._meet, "127.0.0.1", self._port)

    def cut(self) -> None:
        self._through.clear()

    def mend(self) -> None:
        self._through.set()

    async def close(self) -> None:
        self._through.set()
        self._server.close()
        for each in [*self._pipes]:
            each.cancel()
        await asyncio.gather(*self._pipes, return_exceptions=True)
        await asyncio.sleep(0)  # their ends are closed by now

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await self._through.wait()
        try:
            to, back = await asyncio.open_connection("::1", self._port)
        except OSError:
            writer.close()
            return
        for source, sink in ((reader, back), (to, writer)):
            task = asyncio.create_task(self._carry(source, sink))
            self._pipes.add(task)
            task.add_done_callback(self._pipes.discard)

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        try:
            while data := await source.read(1 << 16):
                await self._through.wait()
                sink.write(data)
                await sink.drain()
        except ConnectionError:
            pass
        finally:
            sink.close()


@contextlib.asynccontextmanager
async def boat_with_page(folder: Path) -> AsyncIterator[tuple[Boat, Wireless, str]]:
    """A boat that serves the page, and the address of that as the phone knows it."""
    frames, port = _unused(socket.SOCK_DGRAM), _unused(socket.SOCK_STREAM)
    more = (
        f'tablet.listen="[::1]:{port}"',
        f'tablet.boats="127.0.0.1:{frames}"',
        f'tablet.directory="{folder}/tablet"',
        f"failsafe.console_silent.after_s={SILENT_S}",
    )
    wireless = Wireless(port)
    with afloat(folder / "1", 1, frames, more) as boat:
        await boat.until(lambda state: state["age_s"]["navigation"] is not None and (folder / "tablet/token").exists())
        await wireless.open()
        try:
            yield boat, wireless, f"http://127.0.0.1:{port}/"
        finally:
            await wireless.close()


async def enters(page: Page, url: str, token: str) -> None:
    """Who knows the address alone finds a locked page, and a field for the token there."""
    await page.open(url, width=390, height=780, scale=1.0)
    await page.value(f"document.querySelector('input').value = {token!r}; document.querySelector('button').click()")
    await page.until("window.delfim !== undefined && document.querySelectorAll('.chip, .strip').length > 0", PATIENCE_S)


@pytest.mark.long
async def test_a_phone_alone_operates_the_boat_and_its_network_is_the_boats_link(tmp_path: Path) -> None:
    async with boat_with_page(tmp_path) as (boat, wireless, url), tab() as page:
        await enters(page, url, (tmp_path / "tablet/token").read_text().strip())
        await page.until("document.body.innerText.includes('boat1')", PATIENCE_S)
        await select(page, 1)
        await boat.until(lambda state: all(check["ok"] or check["name"] == "link" for check in state["checks"]))
        await page.press("h")
        await boat.until(lambda state: state["mode"] == "heading")
        await shown_mode(page, 1, "heading")
        state = boat.state()
        assert state["operator"].startswith("console ")

        wireless.cut()
        gone = await boat.until(lambda state: state["mode"] != "heading")
        assert "console silent" in gone["reason"], gone
        await page.until("!document.getElementById('offline').hidden", PATIENCE_S)

        wireless.mend()
        await page.until("document.getElementById('offline').hidden", PATIENCE_S)
        await page.press(" ")
        await boat.until(lambda state: state["mode"] == "idle")
        await shown_mode(page, 1, "idle")
        page.complaints.clear()  # of the connection that was lost
