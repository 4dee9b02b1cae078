"""What the page's box says of a trial, told by a stand-in for the gateway."""

import asyncio
import contextlib

from tests.console.sheet import trial
from tests.console.standin import Standin
from tests.kit.page import gateway, page, shown
from tests.services.browser import Page

__all__ = ["gateway", "page"]
BOX = "document.querySelector('#adopt').textContent"


def test_what_to_do_with_the_file_is_said_when_the_trial_is_over(
    gateway: Standin, page: contextlib.AbstractAsyncContextManager[Page]
) -> None:
    """The motors are written first, minutes before the hull: who goes then to start the boat again loses the rest."""

    async def scenario() -> None:
        async with page as its:
            told = trial() | {"file": "boat.toml", "is_written": True, "question": ""}
            await gateway.tell(told | {"lines": ["the motors are written"]})
            await shown(its, gateway, f"{BOX}.includes('the motors are written')")
            assert not await its.value(f"{BOX}.includes('start her program again')")
            await gateway.tell(told | {"is_running": False, "end": "done"})
            await shown(its, gateway, f"{BOX}.includes('start her program again')")

    asyncio.run(scenario())
