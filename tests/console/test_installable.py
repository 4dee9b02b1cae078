"""The page as an app: Chromium's own judgement, and what is kept of it opens without the gateway, says so, and never stays an
old page at a new gateway. Over HTTPS with a certificate that the browser trusts, as it must be."""

import asyncio
import base64
import contextlib
import hashlib
import json
import re
import shutil
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.tables import decode
from delfim.console import tabletd
from delfim.console.gateway import gateway as gateway_module
from delfim.console.gateway.gateway import PAGE, Gateway
from delfim.console.gateway.serving import serve
from delfim.console.pages import webpush
from delfim.console.pages.installable import MANIFEST, PUBLIC, built
from delfim.console.pages.pushing import KeptPush, PushDesk
from delfim.console.watch.operators import OperatorsFile
from delfim.services.access.certificates import server_tls
from tests.certificates import certificate
from tests.console.pushservice import Browser, PlayedService, ended
from tests.console.scenes import choose
from tests.services.browser import Page, browser

__all__ = ["certificate"]
OFFLINE = "!document.getElementById('offline').hidden"
ONLINE = "window.delfim?.online() === true"


def trusted(pem: Path) -> str:
    """The browser's option by which it trusts this certificate as if an authority had signed it."""
    words = ["openssl", "x509", "-in", str(pem), "-pubkey", "-noout"]
    public = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    der = base64.b64decode("".join(public.splitlines()[1:-1]))
    return f"--ignore-certificate-errors-spki-list={base64.b64encode(hashlib.sha256(der).digest()).decode()}"


@contextlib.asynccontextmanager
async def at_sea(folder: Path, pem: Path, port: int = 0, push: PushDesk | None = None) -> AsyncIterator[tuple[str, Gateway]]:
    """The boat's page, as tabletd serves it, until the end of the block: its address with the token, and the gateway."""
    table = {"listen": "127.0.0.1:0", "boats": "127.0.0.1:14561", "directory": str(folder)}
    told = {"boat": {"name": "test"}, "tablet": table, "mavlink": {"peers": ["127.0.0.1:14561"]}}
    gateway = tabletd.tablet_gateway(decode(told, config.Vehicle, "test.toml"), "", push)
    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    async with ended(gateway.app):
        tls = server_tls(str(pem), "tablet.certificate")
        serving = asyncio.create_task(serve(gateway, ("127.0.0.1", 0), ("127.0.0.1", port), ready.set_result, tls, 0.2))
        try:
            yield await ready, gateway
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)


async def test_chromium_may_install_the_page_and_it_opens_without_its_boat(
    tmp_path: Path, certificate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with browser(tmp_path / "browser", trusted(certificate)) as page:
        async with at_sea(tmp_path / "tablet", certificate) as (url, _):
            port = int(url.split(":")[2].partition("/")[0])
            await page.open(url, width=390, height=780, scale=1.0)
            await page.until(ONLINE)
            await page.value("navigator.serviceWorker.ready.then(() => true)")
            manifest = await page.call("Page.getAppManifest")
            assert manifest["errors"] == []
            assert (await page.call("Page.getInstallabilityErrors"))["installabilityErrors"] == []

        await page.reload()
        await page.until(OFFLINE)
        assert "CONSOLE OFFLINE" in await page.value("document.getElementById('offline').innerText")
        assert await page.value("document.querySelectorAll('.chip').length") == 0, "no state is kept"
        kept = "caches.keys().then(async (names) => (await (await caches.open(names[0])).keys()).map((each) => each.url))"
        paths = {each.partition(f":{port}/")[2].partition("?")[0] for each in await page.value(kept)}
        served = {file.name for file in PAGE.iterdir()} - {"index.html", "LICENSES.txt", "sources.json", "sw.js"}
        assert paths == {"", *served}

        newer = tmp_path / "page"
        shutil.copytree(PAGE, newer)
        mine = built(PAGE)
        for name in ("index.html", "sw.js"):
            (newer / name).write_text((newer / name).read_text().replace(mine, "0123abcd"))
        monkeypatch.setattr(gateway_module, "PAGE", newer)
        async with at_sea(tmp_path / "tablet", certificate, port):
            with contextlib.suppress(AssertionError):  # the page that was kept goes while it is asked
                await page.until(f"{ONLINE} && document.querySelector('script').src.endsWith('?0123abcd')")
            await page.until(f"{ONLINE} && document.querySelector('script').src.endsWith('?0123abcd')")
            await page.until("caches.keys().then((names) => names.join()).then((names) => names === 'delfim-0123abcd')")
        page.complaints.clear()  # of the boat that was not there


GIVES = """navigator.serviceWorker.ready.then((registration) => {
  let its = null;
  registration.pushManager.subscribe = async ({ applicationServerKey }) => {
    window.asked = applicationServerKey;
    return (its = { toJSON: () => (%s), unsubscribe: async () => (its = null) });
  };
  registration.pushManager.getSubscription = async () => its;
  navigator.serviceWorker.getRegistration = async () => registration;
  Notification.requestPermission = async () => "granted";
  return true;
})"""

SHOWN = """new Promise((done) => setTimeout(done, 2000)).then(() => navigator.serviceWorker.ready)
  .then((its) => its.getNotifications()).then((all) => all.map((each) => [each.title, each.body]))"""


@pytest.mark.long
async def test_a_grave_alert_reaches_a_browser_by_its_push_service_and_is_shown(tmp_path: Path, certificate: Path) -> None:
    """All but the Internet's service: what the page gives of it is played, and its message is handed to the browser here."""
    service, its = PlayedService(), Browser()
    subscription = json.dumps({"endpoint": its.at("one").endpoint, "keys": {"p256dh": its.keys.p256dh, "auth": its.keys.auth}})
    async with service.serving(certificate) as trust, browser(tmp_path / "browser", trusted(certificate)) as page:
        (tmp_path / "tablet").mkdir()
        file = tmp_path / "tablet/push.json"
        desk = PushDesk(file, OperatorsFile(None), SystemClock(), "", service, trust)
        async with at_sea(tmp_path / "tablet", certificate, 0, desk) as (url, gateway):
            await page.open(url, width=1200, height=800, scale=1.0)
            origin = url.partition("/?")[0]
            await page.call("Browser.grantPermissions", origin=origin, permissions=["notifications"])
            await page.until(ONLINE)
            await page.value(GIVES % subscription)
            await wake(page)
            async with asyncio.timeout(60.0):
                while not kept(file):
                    await asyncio.sleep(0.02)
            assert len(webpush.decoded(await page.value("window.asked"))) == 65
            assert [each.endpoint for each in kept(file)] == [its.at("one").endpoint]

            gateway.watch.alerts.hear(1, 2, "port propeller blocked: stop")
            async with asyncio.timeout(60.0):
                while not service.heard:
                    await asyncio.sleep(0.02)
            said = its.reads(service.heard[0][2]).decode()
            for _ in range(10):  # who asks while the browser is about to show one makes it forget that
                await deliver(page, origin, said)
                if shown := await page.value(SHOWN):
                    break
            assert shown == [["boat 1: alarm", "port propeller blocked: stop"]]

            await wake(page)
            async with asyncio.timeout(60.0):
                while kept(file):
                    await asyncio.sleep(0.02)


async def wake(page: Page) -> None:
    """*Wake me* in the map's menu."""
    await page.press("w")
    await page.press("Enter")
    await page.until("!document.querySelector('.popup').hidden", 30.0)
    await choose(page, "Screen")
    await choose(page, "Wake me")
    await page.press("Escape")
    await page.press("Escape")


async def deliver(page: Page, origin: str, words: str) -> None:
    """What the browser does with a message of its service."""
    await page.call("ServiceWorker.enable")
    async with asyncio.timeout(60.0):
        while not (told := [each for each in page.registrations if each["scopeURL"].startswith(origin)]):
            await page.value("1")
    await page.call("ServiceWorker.deliverPushMessage", origin=origin, registrationId=told[0]["registrationId"], data=words)


def kept(file: Path) -> list[webpush.PushSubscription]:
    return msgspec.json.decode(file.read_bytes(), type=KeptPush).browsers if file.exists() else []


def test_the_page_names_its_build_and_what_is_public_is_in_it() -> None:
    worker = (PAGE / "sw.js").read_text()
    assert re.fullmatch("[0-9a-f]{8}", built(PAGE))
    assert f'const BUILT = "{built(PAGE)}";' in worker
    assert all((PAGE / each.lstrip("/")).exists() for each in PUBLIC)
    assert f"/{MANIFEST}" in PUBLIC
    assert built(Path("/nowhere")) == ""
