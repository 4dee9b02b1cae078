"""The tab that all tests of a process get one after the other: the next one finds it as a new one would be."""

import contextlib
from collections.abc import AsyncIterator

import pytest
from aiohttp import web

from tests.services.browser import PROGRAM, Page, tab

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")

PAGE = """<!doctype html><link rel=icon href=data:><body style="margin: 0; height: 900px"><script>
window.seen = [];
for (const kind of ["pointermove", "mouseover", "pointerdown", "keydown", "pointerup"])
  window.addEventListener(kind, (event) => seen.push(kind), true);
</script>"""
FOUND = """[
  innerWidth, localStorage.length, sessionStorage.length, document.cookie, window.name, history.length, document.hidden,
  window.injected ?? null, navigator.userActivation.hasBeenActive, document.querySelector(":hover") === null,
  "ontouchstart" in window, matchMedia("(prefers-color-scheme: dark)").matches, location.hash, seen.join(),
]"""
NEW = [800, 0, 0, "", "", 2, False, None, False, True, False, False, "", ""]
USED = "localStorage.a = 1, sessionStorage.b = 1, document.cookie = 'c=1', window.name = 'd', location.hash = 'e'"


@contextlib.asynccontextmanager
async def site() -> AsyncIterator[str]:
    async def index(_: web.Request) -> web.Response:
        return web.Response(text=PAGE, content_type="text/html")

    app = web.Application()
    app.add_routes([web.get("/", index)])
    runner = web.AppRunner(app)
    await runner.setup()
    try:
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        yield f"http://127.0.0.1:{runner.addresses[0][1]}/"
    finally:
        await runner.cleanup()


async def name(page: Page) -> str:
    return str((await page.call("Target.getTargetInfo"))["targetInfo"]["targetId"])


async def used(page: Page, url: str) -> None:
    """In all ways that a browser remembers, a button held down, and on the dark side."""
    await page.call("Page.addScriptToEvaluateOnNewDocument", source="window.injected = 1")
    await page.call("Emulation.setTouchEmulationEnabled", enabled=True)
    await page.open(url, width=500, height=400, dark=True)
    await page.value(USED)
    await page.press("a")
    await page.pointer("mousePressed", (200.0, 200.0), 1)
    await page.until("seen.includes('pointerdown')")


async def test_a_tab_comes_back_as_a_new_one() -> None:
    async with site() as url:
        async with tab() as page:
            await used(page, url)
            was, first = await page.value(FOUND), await name(page)
            assert [n for n, each in enumerate(NEW) if each == was[n]] == [6], (
                "each of them was used but that it was not hidden"
            )
        async with tab() as page:
            assert await name(page) == first
            await page.open(url, width=800, height=600)
            assert await page.value(FOUND) == NEW
            async with tab() as other:
                assert await name(other) != first, "two at once are two"
                await other.open(url, width=800, height=600)


async def test_who_fails_leaves_no_tab() -> None:
    async with site() as url:
        with contextlib.suppress(ZeroDivisionError):
            async with tab() as page:
                await page.open(url, width=800, height=600)
                failed = await name(page)
                raise ZeroDivisionError
        async with tab() as page:
            assert await name(page) != failed
