"""A browser engine for the tests: headless Chromium over its DevTools socket, as little of it as is needed."""

import asyncio
import atexit
import base64
import contextlib
import functools
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import AsyncIterator, Iterable
from pathlib import Path
from typing import Any

import aiohttp
from PIL import Image

from tests.kit.processes import ENDS_WITH_US

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
START_S = 60.0
WORDS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-port=0", "--no-first-run")
FORGETS = "--disable-back-forward-cache"  # a page that was left is gone, and with it its process's work
NOWHERE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"  # no network but this machine's
MODIFIERS = {"Alt": 1, "Control": 2, "Meta": 4, "Shift": 8}
VIRTUAL_KEYS = {
    "Tab": 9,
    "Enter": 13,
    "Escape": 27,
    " ": 32,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "F1": 112,
    "F6": 117,
    "+": 187,
    "-": 189,
}


class Page:
    """One tab."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, group: int) -> None:
        self._socket, self._group = socket, group
        self._numbers = itertools.count(1)
        self._front = ""  # the tab that hides this one
        self.complaints: list[str] = []  # of the page's console: errors, what the policy refused; a test ends with none
        self.calls_in_vain = False  # its gateway was killed: it may complain that it cannot reach it, also later
        self.requests: list[str] = []  # addresses, once the domain Network is enabled
        self.registrations: list[dict[str, Any]] = []  # of workers, once the domain ServiceWorker is enabled
        self.origins: set[str] = set()  # that were opened

    async def call(self, method: str, **words: Any) -> dict[str, Any]:
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": words})
        while (told := await self._heard()).get("id") != number:
            pass
        assert "error" not in told, told
        return told["result"]

    async def _heard(self) -> dict[str, Any]:
        """The next answer or event."""
        told: dict[str, Any] = json.loads(await self._socket.receive_str())
        method = told.get("method")
        if method in ("Runtime.exceptionThrown", "Log.entryAdded"):
            self.complaints.append(json.dumps(told["params"]))
        if method in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            self.requests.append(told["params"].get("url") or told["params"]["request"]["url"])
        if method == "ServiceWorker.workerRegistrationUpdated":
            self.registrations += told["params"]["registrations"]
        if method == "Page.javascriptDialogOpening":  # leave the page? Yes.
            answer = {"method": "Page.handleJavaScriptDialog", "params": {"accept": True}}
            await self._socket.send_json({"id": next(self._numbers), **answer})
        return told

    async def nothing_amiss(self) -> None:
        """The page had nothing to complain of."""
        await self.value("document.title")  # what it said before is heard by then
        amiss = [each for each in self.complaints if not (self.calls_in_vain and "/ws" in each)]
        assert not amiss, amiss

    def sleep(self) -> None:
        """All of the browser stands still, as on a laptop that was closed."""
        os.killpg(self._group, signal.SIGSTOP)

    def wake(self) -> None:
        os.killpg(self._group, signal.SIGCONT)

    def kill(self) -> None:
        """All of the browser is gone, without a word."""
        os.killpg(self._group, signal.SIGKILL)

    async def hide(self) -> None:
        """Another tab comes to the front."""
        self._front = (await self.call("Target.createTarget", url="about:blank"))["targetId"]
        await self.until("document.hidden")

    async def show(self) -> None:
        """The other tab is closed."""
        await self.call("Page.bringToFront")
        await self.call("Target.closeTarget", targetId=self._front)
        await self.until("!document.hidden")

    async def open(
        self, url: str, *, width: int, height: int, scale: float = 2.0, dark: bool = False, script: bool = True
    ) -> None:
        await self.call("Runtime.enable")
        await self.call("Log.enable")
        await self.call("Page.enable")
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=width < 600
        )
        await self.call("Emulation.setScriptExecutionDisabled", value=not script)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        await self.call("Emulation.setEmulatedMedia", features=features)
        self.origins.add("/".join(url.split("/")[:3]))
        await self.call("Page.navigate", url=url)
        await self.until("document.readyState === 'complete'")

    async def reload(self) -> None:
        """Nothing is asked meanwhile: a page that goes does not always answer."""
        await self.call("Page.reload")
        while (await self._heard()).get("method") != "Page.loadEventFired":
            pass

    async def value(self, expression: str) -> Any:
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        return answer["result"].get("value")

    async def until(self, expression: str, timeout_s: float = 200.0) -> None:
        """Wait until an expression is true in the page."""
        try:
            async with asyncio.timeout(timeout_s):
                while not await self.value(expression):
                    await asyncio.sleep(0.05)
        except TimeoutError:
            left = expression.rpartition(" === ")[0]
            was = f"; at last it was {await self.value(f'String({left})')!r}" if left else ""
            words = await self.value("document.body?.innerText.slice(0, 1000)")
            raise AssertionError(f"it never was so: {expression}{was}; the page says {words!r}") from None

    async def press(self, key: str, modifiers: tuple[str, ...] = ()) -> None:
        """A key, as KeyboardEvent.key calls it, down and up again."""
        words: dict[str, Any] = {"key": key, "code": _code(key), "modifiers": sum(MODIFIERS[each] for each in modifiers)}
        words["windowsVirtualKeyCode"] = VIRTUAL_KEYS.get(key, ord(key.upper()[0]))
        await self.call("Input.dispatchKeyEvent", type="rawKeyDown", **words)
        await self.call("Input.dispatchKeyEvent", type="keyUp", **words)

    async def mouse(self, *points: tuple[float, float]) -> None:
        """Press the button at the first point, drag along the others, let go at the last."""
        await self.pointer("mouseMoved", points[0], 0)
        await self.pointer("mousePressed", points[0], 1)
        for point in points[1:]:
            await self.pointer("mouseMoved", point, 1)
        await self.pointer("mouseReleased", points[-1], 0)

    async def point(self, x: float, y: float) -> None:
        await self.pointer("mouseMoved", (x, y), 0)

    async def pointer(self, kind: str, point: tuple[float, float], buttons: int) -> None:
        """`kind` is mouseMoved, mousePressed or mouseReleased."""
        words = {"x": point[0], "y": point[1], "buttons": buttons, "clickCount": 0 if kind == "mouseMoved" else 1}
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        await self.call("Input.dispatchMouseEvent", type=kind, button=button, **words)

    async def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """`kind` is Start, Move or End."""
        await self.call("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=[{"x": x, "y": y} for x, y in points])

    async def picture(self, height: int | None = None) -> bytes:
        """The whole page, or its top, as PNG."""
        size = (await self.call("Page.getLayoutMetrics"))["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": height or size["height"], "scale": 1}
        taken = await self.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)
        return base64.b64decode(taken["data"])


def _code(key: str) -> str:
    if len(key) > 1:
        return key
    return {" ": "Space", "+": "Equal", "-": "Minus"}.get(key) or (f"Digit{key}" if key.isdigit() else f"Key{key.upper()}")


@contextlib.asynccontextmanager
async def browser(folder: Path, *more: str) -> AsyncIterator[Page]:
    """A tab of a fresh browser whose files are in `folder`."""
    assert PROGRAM is not None
    child = await asyncio.create_subprocess_exec(
        PROGRAM,
        *WORDS,
        *more,
        f"--user-data-dir={folder}",
        "about:blank",
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        port = await _port(folder / "DevToolsActivePort")
        async with aiohttp.ClientSession() as session:
            async with session.get(f"http://127.0.0.1:{port}/json") as answer:
                tab = next(each for each in await answer.json() if each["type"] == "page")
            async with session.ws_connect(tab["webSocketDebuggerUrl"], max_msg_size=0) as socket:
                page = Page(socket, child.pid)
                yield page
                await page.nothing_amiss()
    finally:
        with contextlib.suppress(ProcessLookupError):
            child.send_signal(signal.SIGTERM)
        await child.wait()


@contextlib.asynccontextmanager
async def tab() -> AsyncIterator[Page]:
    """A tab of a browser that all tests of this process share: its start takes a processor for two seconds. It has no
    network but this machine's, and keeps nothing for the next test, which gets it again: a tab's own process takes half as
    long as the page in it. Who fails leaves none, and who kills the browser gets another one the next time."""
    child, folder = _shared()
    if child.poll() is not None:
        _shared.cache_clear()
        child, folder = _shared()
    async with aiohttp.ClientSession() as session:
        address = await _address(session, child, await _port(folder / "DevToolsActivePort"))
        async with session.ws_connect(address, max_msg_size=0) as socket:
            page = Page(socket, child.pid)
            passed = False
            try:
                await page.call("Page.bringToFront")
                yield page
                if child.poll() is None:
                    await page.nothing_amiss()
                    passed = True
            finally:
                if child.poll() is None:
                    await _left(page)
                    if passed:
                        _IDLE.append((child, address))
                    else:
                        await page.call("Target.closeTarget", targetId=address.rpartition("/")[2])


_IDLE: list[tuple[subprocess.Popen[bytes], str]] = []  # tabs, each of a browser that may be gone since


async def _address(session: aiohttp.ClientSession, child: subprocess.Popen[bytes], port: int) -> str:
    """Of a tab that nobody has."""
    while _IDLE:
        whose, address = _IDLE.pop()
        if whose is child:
            return address
    async with session.put(f"http://127.0.0.1:{port}/json/new?about:blank") as answer:
        return str((await answer.json())["webSocketDebuggerUrl"])


async def _left(page: Page) -> None:
    """The tab, and what the browser keeps, as if nothing had been opened."""
    await page.value("window.name = ''")
    await page.call("Page.navigate", url="about:blank")  # a page that lives on keeps what it likes anew
    await page.until("location.href === 'about:blank' && document.readyState === 'complete'")
    await page.call("Page.resetNavigationHistory")
    await page.call("Network.clearBrowserCookies")
    for origin in page.origins:
        await page.call("Storage.clearDataForOrigin", origin=origin, storageTypes="all")


@functools.cache
def _shared() -> tuple[subprocess.Popen[bytes], Path]:
    """The browser, and the folder of its files; it ends with this process."""
    assert PROGRAM is not None
    folder = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
    words = [*ENDS_WITH_US, PROGRAM, *WORDS, NOWHERE, FORGETS, f"--user-data-dir={folder.name}", "about:blank"]
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    def end() -> None:
        child.terminate()
        child.wait()
        folder.cleanup()

    atexit.register(end)
    return child, Path(folder.name)


async def _port(file: Path) -> int:
    async with asyncio.timeout(START_S):
        while not (text := _read(file)):
            await asyncio.sleep(0.05)
    return int(text.splitlines()[0])


def _read(file: Path) -> str:
    return file.read_text() if file.exists() else ""


def shrink(pictures: Iterable[Path]) -> None:
    """Give them palettes: a third of the bytes, for pictures of lines and words. It takes seconds, in which a page that this
    program serves hears nothing: do it afterwards."""
    for file in pictures:
        whole = Image.open(file).convert("RGB")
        whole.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(file, "png", optimize=True)
