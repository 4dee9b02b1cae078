"""What a browser needs to keep the page as an app (W3C manifest): the manifest and its icons, which have no secret, and the
build by which a page that was kept from before is known."""

import re
from pathlib import Path
from typing import Final

from aiohttp import web

MANIFEST: Final = "manifest.webmanifest"
PUBLIC: Final = frozenset({f"/{MANIFEST}", "/icon-192.png", "/icon-512.png"})  # browsers ask for these without a cookie


def built(page: Path) -> str:
    """Of which build the page in this folder is; empty: there is none, or it does not say so. Raises OSError."""
    index = page / "index.html"
    found = re.search(r"console\.js\?([0-9a-f]{8})", index.read_text(encoding="utf-8")) if index.exists() else None
    return found[1] if found else ""


def manifest_route(app: web.Application, page: Path) -> None:
    """Serves the manifest with its type, which Python knows from 3.14 on."""

    async def manifest(request: web.Request) -> web.FileResponse:
        return web.FileResponse(page / MANIFEST, headers={"Content-Type": "application/manifest+json"})

    app.router.add_get(f"/{MANIFEST}", manifest)
