"""A ship that a real boat hears on its NMEA 2000 bus and gives way to, as the operator sees it at the real console."""

import asyncio
import os
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from delfim.logging.reading import read_events
from delfim.vehicle.operator.link import Link
from tests.console.chain import afloat
from tests.console.test_first_voyage import PATIENCE_S, console
from tests.services.browser import tab

MEET = (
    'sensors.names=["sysstat", "nmea2000"]',
    f'nmea2000.interface="canloop:traffic-{os.getpid()}"',
    "simulation.heading_deg=0.0",
    'simulation.traffic.heard="perfect"',
    'simulation.traffic.vessel=[{name="MARIA", transponder="A", length_m=30.0, beam_m=6.0, north_m=420.0, course_deg=180.0, '
    'speed_mps=2.5}, {name="TEJO", transponder="B", east_m=900.0, course_deg=0.0, speed_mps=3.0}]',
)
TEXT = "document.querySelector('#traffic').textContent"


def names(state: dict[str, Any]) -> set[str]:
    return {each["name"] for each in (state["traffic"] or {"targets": ()})["targets"]}


def logged(folder: Path) -> set[str]:
    """Their names in the last list of the state log's sidecar."""
    events = [event for file in (folder / "1" / "log").glob("*/state/*.meta.jsonl") for event in read_events(file)]
    seen = [event["value"] for event in events if event["event"] == "vessels"]
    return {each["name"] for each in seen[-1]} if seen else set()


async def met(folder: Path) -> None:
    async with console(folder) as (_, _, port, url), tab() as page:
        await page.open(url, width=1300, height=800, scale=1.0)
        with afloat(folder / "1", 1, port, MEET) as boat:
            await boat.until(lambda state: names(state) == {"MARIA", "TEJO"})
            await page.until("delfim.vessels().length === 2", PATIENCE_S)
            await page.until(f"/AIS: 2 targets, last report [0-9]+ s ago. Sees only who transmits./.test({TEXT})", PATIENCE_S)
            with Link(boat.place / "command") as link:
                await boat.until(lambda state: link.ask("alive") and all(check["ok"] for check in state["checks"]))
                link.ask("course", course_deg=0.0, speed_mps=1.5)
                state = await boat.until(lambda state: link.ask("alive") and state["traffic"]["order"])
                words = state["traffic"]["order"]["words"]
                assert words.startswith("giving way to MARIA, head-on, port to port")
                await page.until(f"{TEXT}.includes('giving way to MARIA, head-on, port to port')", PATIENCE_S)
                await page.until(
                    "delfim.vessels().some(([name, gravity]) => name === 'MARIA' && gravity !== 'none')", PATIENCE_S
                )
                await boat.until(lambda state: link.ask("alive") and logged(folder) == {"MARIA", "TEJO"})
                link.ask("stop")
            async with aiohttp.ClientSession() as session, session.get(url.split("?")[0] + "api/boats") as answer:
                assert answer.status == 403, "not for everybody"


@pytest.mark.long
def test_the_operator_sees_the_ship_and_what_the_boat_does_for_it(tmp_path: Path) -> None:
    asyncio.run(met(tmp_path))
