"""An order of a laboratory's part on a real boat, without a change of the program: from the page's menu, by MAVLink, and from a
terminal; what its device then says is in the log, in an export and in a replay.
"""

import asyncio
import csv
import os
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.parts.mavlink.codec import wire
from tests.console.chain import Sea, operating, ordered
from tests.console.scenes import choose
from tests.parts.laboratory import ROOT, installed
from tests.parts.test_afloat import command

NUMBER = 31010  # MAV_CMD_USER_1
OTHER = 199  # another console
CONTROL = 32100


class Sailed(NamedTuple):
    log: Path
    path: str  # of the program with the part
    out: list[float]  # rope, after each of the ways


@pytest.fixture(scope="module")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Sailed:
    """The winch was ordered in all ways, under way, and the boats are in harbour again."""
    folder = tmp_path_factory.mktemp("added-command")
    installed(folder / "laboratory", "order")
    path = f"{folder}/laboratory:{ROOT}"
    winch = ('parts.example_order="1.0"', 'sensors.names=["sysstat", "example_order"]', "example_order.pays_out_below_mps=9.0")
    more = (*winch, f'example_order.interface="canloop:winch-{os.getpid()}"')

    async def voyage() -> list[float]:
        async with operating(folder, *more, env=os.environ | {"PYTHONPATH": path}) as sea:
            out = await _ordered(sea, path)
            await sea.nothing_amiss()
            return out

    return Sailed(folder / "1/log", path, asyncio.run(voyage()))


async def _ordered(sea: Sea, path: str) -> list[float]:
    page, boat = await sea.at_rest(1)
    await page.press("h")
    out = []

    async def paid_out(rope_m: float) -> None:
        state = await boat.until(lambda state: state["measured"].get("rope_m") == rope_m)
        out.append(state["measured"]["rope_m"])
        assert state["mode"] == "heading"
        await boat.sails_on(3)

    title = "[...document.querySelectorAll('.item .title')].find(each => each.textContent.startsWith('Pay out'))"
    while not await page.value(f"Boolean({title})"):  # the boat has not told its orders yet
        await page.press("Escape")
        await page.press("Enter")
        await choose(page, "More")
    await page.value(f"{title}.click()")
    await page.press("ArrowRight")  # from 5 m
    await page.press("Enter")
    await paid_out(6.0)
    console = wire.Sender(OTHER, 190, None, lambda: 0)
    sea.radios[0].say(console.pack(ordered(1, CONTROL, 0.0, 1.0)) + console.pack(ordered(1, NUMBER, 7.0, 1.0)))
    await paid_out(7.0)
    told = await boat.delfim("drive", "order", "pay_out", "rope_m=8", "rate_mps=1", env=os.environ | {"PYTHONPATH": path})
    assert told.startswith("heading "), told
    await paid_out(8.0)
    return out


@pytest.mark.long
def test_the_order_comes_from_the_page_by_mavlink_and_from_a_terminal(sailed: Sailed) -> None:
    assert sailed.out == [6.0, 7.0, 8.0]


@pytest.mark.long
def test_what_came_of_it_is_in_the_log_in_its_export_and_in_a_replay(sailed: Sailed, tmp_path: Path) -> None:
    file = tmp_path / "state.csv"
    command("log", "export", "csv", "--output", str(file), str(sailed.log), path=str(ROOT))
    with file.open() as lines:
        assert max(float(row["rope_m [m]"] or 0.0) for row in csv.DictReader(lines)) == 8.0
    repeated = command("log", "replay", str(sailed.log), path=sailed.path)
    assert "all the same, bit by bit" in repeated.stdout, repeated.stdout + repeated.stderr
