"""Who commands, on the page: said in the bar, taken, offered and accepted from its menu; each word of the gateway is answered.
With a folder on its command line it keeps a picture for docs/operator.md (`make pictures`).
"""

import asyncio
import contextlib
import sys
from pathlib import Path

import pytest

from delfim.console.watch.operators import OperatorsFile, add_operator
from tests.console.scenes import a_minute_at_work, at_work, choose, opened
from tests.console.standin import Message, Standin
from tests.console.test_gateway import opened as real
from tests.kit.page import sailing, shown
from tests.kit.pictures import keeper
from tests.services.browser import Page, browser, shrink, tab

BUTTON = "document.getElementById('bridge')"
DESK = (1200, 640)


def word(n: int, **more: int) -> Message:
    """Ana's page is 1, Rui's 2; Zita may only watch."""
    people = ((1, "Ana", "command"), (2, "Rui", "maintain"), (3, "Zita", "watch"))
    pages = [{"page": page, "name": name, "role": role, "carries": True} for page, name, role in people]
    return {"t": "bridge", "n": n, "you": 1, "holder": 0, "granted": 0, "grant": 0, "offered": 0, "pages": pages, **more}


async def says(page: Page, gateway: Standin, told: Message, words: str) -> None:
    await gateway.tell(told)
    await shown(page, gateway, f"{BUTTON}.textContent === {words!r}")


async def handed(page: Page, gateway: Standin) -> None:
    """Ana takes the command, offers it to Rui, gets it back."""
    await says(page, gateway, word(1), "Nobody commands")
    await page.value(f"{BUTTON}.click()")
    await choose(page, "Take the command")
    await gateway.until(lambda m: m["t"] == "handover" and m["do"] == "take")
    await says(page, gateway, word(2, granted=1, grant=1), "You command")
    await gateway.until(lambda m: m["t"] == "here" and (m["n"], m["grant"]) == (2, 1))
    await says(page, gateway, word(3, holder=1, grant=1), "You command")
    await page.value(f"{BUTTON}.click()")
    await choose(page, "Offer it to Rui")
    assert (await gateway.until(lambda m: m["t"] == "handover" and m["do"] == "offer"))["page"] == 2
    await says(page, gateway, word(4, holder=2, grant=2), "Rui commands")
    await shown(page, gateway, "document.getElementById('said').textContent.includes('You command no longer')")


async def test_the_command_is_taken_offered_and_accepted_and_each_word_is_answered() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        assert await page.value(f"{BUTTON}.hidden"), "a console without operators has nobody to hand over to"
        await handed(page, gateway)
        await says(page, gateway, word(5, holder=2, grant=2, offered=1), "Rui offers you the command")
        await page.value(f"{BUTTON}.click()")
        await choose(page, "Accept the command")
        await gateway.until(lambda m: m["t"] == "handover" and m["do"] == "accept")
        assert [m["n"] for m in gateway.said if m["t"] == "here"] == [1, 2, 3, 4, 5]


async def test_who_may_only_watch_takes_nothing_and_a_phone_says_who_commands() -> None:
    gateway = at_work()
    async with gateway.serving(), tab() as page:
        await opened(page, gateway, width=390, height=780)
        await says(page, gateway, word(1, you=3, holder=1), "Ana commands")
        left, right = await page.value(f"(({{left, right}}) => [left, right])({BUTTON}.getBoundingClientRect())")
        assert 0 <= left < right <= 390
        await says(page, gateway, word(2, you=3), "Nobody commands")
        await page.value(f"{BUTTON}.click()")
        await shown(page, gateway, "document.querySelector('.popup').textContent.includes('your role is to watch')")


@pytest.mark.long
async def test_two_pages_hand_the_command_over_at_the_real_gateway(tmp_path: Path) -> None:
    """Each in a browser of its own, for a browser keeps one operator's key."""
    file = tmp_path / "operators.json"
    keys = [add_operator(file, name, "command") for name in ("Ana", "Rui")]
    async with contextlib.AsyncExitStack() as held:
        sea = await held.enter_async_context(real(tmp_path, operators=OperatorsFile(file), key=keys[0]))
        ana, rui = [await held.enter_async_context(browser(tmp_path / name)) for name in ("ana", "rui")]
        for page, key in ((ana, keys[0]), (rui, keys[1])):
            await page.open(f"{sea.url}?token={key}", width=1200, height=800)
            await page.until(f"{BUTTON}.textContent === 'Nobody commands'")
        await ordered(ana, "Take the command")
        await ana.until(f"{BUTTON}.textContent === 'You command'")
        await rui.until(f"{BUTTON}.textContent === 'Ana commands'")
        await rui.press("k")
        await rui.press(" ")
        await rui.press("h")
        await rui.until("document.getElementById('said').textContent.includes('Ana commands')")
        await ordered(ana, "Offer it to Rui")
        await rui.until(f"{BUTTON}.textContent === 'Ana offers you the command'")
        await ordered(rui, "Accept the command")
        await rui.until(f"{BUTTON}.textContent === 'You command'")
        await ana.until(f"{BUTTON}.textContent === 'Rui commands'")
        assert [page.complaints for page in (ana, rui)] == [[], []]
        await rui.open("about:blank", width=1200, height=800)
        await ana.until(f"{BUTTON}.textContent === 'Nobody commands'")


async def ordered(page: Page, entry: str) -> None:
    """From the menu of who commands."""
    await page.value(f"{BUTTON}.click()")
    await choose(page, entry)


def main(folder: Path) -> None:
    async def keep() -> None:
        picture = keeper(folder, "console")
        async with a_minute_at_work(*DESK) as (page, gateway):
            await says(page, gateway, word(1, holder=1), "You command")
            await page.value(f"{BUTTON}.click()")
            await picture(page, "bridge")

    asyncio.run(keep())
    shrink(folder.glob("console-bridge.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
