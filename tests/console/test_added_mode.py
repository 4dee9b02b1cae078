"""A mode of a laboratory's part on a real boat: entered from the page's list, from
`delfim drive` and by MAVLink; refused without navigation; and what the failsafe does in it is its key in the vehicle's file.

Page, gateway and `delfim drive` are those of the project, to which nothing was added: what they know of it the boat has told.
"""

import asyncio
import contextlib
import os
from collections.abc import Iterator

import pytest

from delfim.parts.mavlink.codec import wire
from tests.console.chain import PATIENCE_S, Boat, Sea, afternoon, ordered, shown_mode, watched
from tests.console.scenes import choose
from tests.parts.laboratory import ROOT, installed
from tests.services.browser import Page

SAYS_SO = 'while read l; do echo {\\"command\\": \\"alive\\"}; done'
WATCHES = f"""payload.watches={{command=["/bin/sh", "-c", '{SAYS_SO}'], may=["hold"]}}"""
NUMBER = 120
OTHER = 199  # another console
SET_MODE, CONTROL = 176, 32100


@pytest.fixture(scope="module")
def afloat(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[asyncio.Runner, Sea]]:
    folder = tmp_path_factory.mktemp("added-mode")
    installed(folder / "laboratory", "mode")
    values = ('parts.example_mode="1.0"', 'failsafe.console_silent.weave="hold"', WATCHES)
    env = os.environ | {"PYTHONPATH": f"{folder}/laboratory:{ROOT}"}
    with afternoon(folder, *values, count=1, env=env) as both:
        yield both


@pytest.fixture
def sea(runner: asyncio.Runner, afloat: tuple[asyncio.Runner, Sea]) -> contextlib.AbstractAsyncContextManager[Sea]:
    return watched(afloat[1])


async def from_the_page(page: Page) -> None:
    await page.press("Enter")
    await choose(page, "Weave")


async def weaves(boat: Boat) -> None:
    await boat.until(lambda state: state["mode"] == "weave" and state["reference"]["heading_deg"] is not None and state["run"])


async def test_it_is_in_the_pages_list_and_entered_from_there(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await boat.until(lambda state: all(each["ok"] for each in state["checks"]))  # before, the page would ask
    await from_the_page(page)
    await weaves(boat)
    await shown_mode(page, 1, "weave")


async def test_a_payload_program_is_a_mode_of_its_name_there_and_any_key_takes_the_boat_back(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await boat.until(lambda state: "payload watches" in state["age_s"])
    await page.press("Enter")
    await choose(page, "Payload watches")
    await boat.until(lambda state: (state["helmsman"], state["mode"]) == ("watches", "hold"))
    await shown_mode(page, 1, "payload watches")
    await page.press("B")
    await boat.until(lambda state: not state["helmsman"])
    await shown_mode(page, 1, "hold")


@pytest.mark.long
async def test_it_is_entered_from_the_command_line(sea: Sea) -> None:
    _page, boat = await sea.at_rest(1)
    assert "weave" in await boat.delfim("drive", "weave")
    await weaves(boat)
    refused = await boat.delfim("drive", "fly")
    assert "no command 'fly'; no mode 'fly': there are manual, " in refused
    assert "weave" in refused


async def test_it_is_entered_by_mavlink(sea: Sea) -> None:
    _page, boat = await sea.at_rest(1)
    console = wire.Sender(OTHER, 190, None, lambda: 0)

    sea.radios[0].say(console.pack(ordered(1, CONTROL, 0.0, 1.0)) + console.pack(ordered(1, SET_MODE, 1.0, float(NUMBER))))
    await weaves(boat)
    assert (await asyncio.to_thread(boat.state))["operator"] == f"console {OTHER}"
    sea.radios[0].say(console.pack(ordered(1, CONTROL, 0.0, 0.0)))  # whoever asks next commands


@pytest.mark.long
async def test_without_navigation_it_is_refused_with_the_reason(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await boat.delfim("fault", "navigation_silent")
    await boat.until(lambda state: not all(check["ok"] for check in state["checks"] if check["name"] == "navigation"))
    await from_the_page(page)
    words = "weave refused: navigation silent for "
    await page.until(f"document.getElementById('messages').textContent.includes('{words}')", PATIENCE_S)
    await boat.delfim("fault", "end")
    assert boat.state()["mode"] == "idle"


@pytest.mark.long
async def test_the_failsafe_does_in_it_what_its_key_says(sea: Sea) -> None:
    page, boat = await sea.at_rest(1)
    await boat.until(lambda state: all(check["ok"] for check in state["checks"]))
    await from_the_page(page)
    await weaves(boat)
    sea.radios[0].cut()
    state = await boat.until(lambda state: state["mode"] == "hold")
    sea.radios[0].mend()
    assert state["reason"].startswith("console silent for "), "the other modes' answer is home"
