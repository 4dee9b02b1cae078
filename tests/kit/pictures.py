"""Pictures of the page, kept by the tests that operate it."""

import base64
from collections.abc import Awaitable, Callable
from pathlib import Path

from tests.services.browser import Page

SETTLED_MS = 900  # until tiles, forms and messages stand still


def keeper(folder: Path, name: str, *steps: str) -> Callable[[Page, str], Awaitable[None]]:
    """Keeps what the window shows as `NAME-STEP.png`, at these steps, or at all."""

    async def keep(page: Page, step: str) -> None:
        if steps and step not in steps:
            return
        await page.value(f"new Promise(done => setTimeout(done, {SETTLED_MS}))")
        taken = await page.call("Page.captureScreenshot", format="png")
        (folder / f"{name}-{step}.png").write_bytes(base64.b64decode(taken["data"]))

    return keep
