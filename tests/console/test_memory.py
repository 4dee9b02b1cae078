"""What a long day leaves behind: nothing that grows. Ten boats to the thirtieth hour, as fast as it goes (`pytest -s`)."""

import asyncio
import gc
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from delfim.base.clock import ManualClock
from delfim.console.boats.boat import TRACK_MAX
from delfim.console.gateway.gateway import Gateway
from delfim.console.gateway.watchlog import KEPT_MAX, WatchLine
from delfim.console.link.mavlink import mavlink
from tests.console.scenes import caught_up, fleet, opened, show, survey
from tests.console.standin import Message, Standin
from tests.services.browser import Page, browser

pytestmark = pytest.mark.long

HOUR_S = 3600


class Day:
    """Ten boats that speak once a minute, are steered by hand and commanded, and say something new each time. Ten minutes
    bring each another address, an hour another mission. That they do not speak ten times a second leaves no less behind: tracks
    have a point a second at most, and are full from the beginning, as after ten hours; all else is what was said last.
    """

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock(100.0)
        self.gateway = Gateway(self.clock, folder)
        self._codecs = [mavlink.MAVLink(None, number, 1) for number in range(1, 11)]
        self._port = 20_000

    def begin(self) -> None:
        self._say(_heartbeat())
        for number in range(KEPT_MAX):  # the log of the watch is full after some hours
            self.gateway.watch.log.put(WatchLine(100.0 + number, 1, "Boat", "", "notice", f"said before: {number}"))
        for boat in self.gateway.fleet.boats.values():
            boat.track.extend((100.0 + second, 38.69 + second / 1e7, -9.21 - second / 1e7) for second in range(TRACK_MAX))

    def hours(self, count: int) -> None:
        for _ in range(count):
            for number in self.gateway.fleet.boats:
                self.gateway.fleet.put(number, survey() | {"name": f"from {self.clock.monotonic_s():.0f} s on"})
            for second in range(0, HOUR_S, 60):
                self._port += 10 if second % 600 == 0 else 0
                self._speak(second)
                for _ in range(120):
                    self.clock.advance(0.5)
                    self.gateway.tick()

    def _speak(self, second: int) -> None:
        fleet, number_of_input = self.gateway.fleet, round(self.clock.monotonic_s())
        self._say(
            _heartbeat(),
            mavlink.MAVLink_global_position_int_message(0, 386_900_000 + second, -92_150_000, 0, 0, 100, 50, 0, 9000),
            mavlink.MAVLink_raw_rpm_message(0, 300.0 + second % 7),
            mavlink.MAVLink_sys_status_message(0, 0, 0, 100, 48_000, -1, 80, 0, 0, 0, 0, 0, 0),
            mavlink.MAVLink_statustext_message(6, f"not said before: {second}".encode(), second + 1, 0),
            mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_RESULT_DENIED),
        )
        for number in fleet.boats:
            fleet.input(number, number_of_input, 10.0, 10.0)
            fleet.command(number, "mode", {"mode": "hold"}, lambda well, why: None)
        fleet.snapshot()

    def _say(self, *messages: Any) -> None:
        for codec, message in itertools.product(self._codecs, messages):
            self.gateway.udp.datagram_received(message.pack(codec), ("127.0.0.1", self._port + codec.srcSystem))


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(11, 0, 1, 4, 4, 3)


def objects() -> int:
    gc.collect()
    return sys.getallocatedblocks()


@pytest.fixture
def day(tmp_path: Path) -> Iterator[Day]:
    day = Day(tmp_path)
    day.begin()
    yield day
    day.gateway.close()


def test_the_gateway_keeps_no_more_after_thirty_hours_than_after_eleven(day: Day) -> None:
    day.hours(1)
    before = objects()
    day.hours(19)
    after = objects()
    boats = day.gateway.fleet.boats.values()
    print(f"the gateway: {before} objects after 11 hours, {after} after 30")
    assert [len(boat.track) for boat in boats] == [TRACK_MAX] * 10
    assert after - before < 500


async def test_the_page_holds_no_more_after_thirty_hours_than_after_eleven(tmp_path: Path) -> None:
    """Of each hour it is told the tracks as the gateway tells them, a point a second, a mission and a warning of each boat, and
    thirty times all there is of the boats."""
    gateway = Standin(fleet(10))
    async with gateway.serving(), browser(tmp_path) as page:
        await opened(page, gateway)
        await show(page, 1000, 1000, 1200, 1200)  # beside the boats: how fast they are drawn is another test's
        after_11 = await later(page, gateway, 11)
        after_30 = await later(page, gateway, 19)
    print(f"the page: {after_11} after 11 hours, {after_30} after 30")
    assert after_11["points"] == pytest.approx(TRACK_MAX, rel=0.02), "of a boat's track, as the gateway keeps it"
    assert after_30["nodes"] <= after_11["nodes"] + 20
    assert after_30["bytes"] < 1.1 * after_11["bytes"]


async def later(page: Page, gateway: Standin, hours: int) -> dict[str, int]:
    """What the page holds so many hours later."""
    for hour in range(hours):
        for each in gateway.boats:
            await gateway.tell(track(gateway.at_s, each))
            plan = survey() | {"name": f"{hours} {hour}"}
            await gateway.tell({"t": "mission", "boat": each["id"], "where": "here", "mission": plan})
            await gateway.tell({"t": "text", "boat": each["id"], "severity": 4, "text": plan["name"], "at_s": gateway.at_s})
        gateway.at_s += HOUR_S
        for _ in range(30):
            for each in gateway.boats:
                each["age_s"]["heard"] = 0.1 + gateway.at_s % 7
                each["latitude_deg"] += 1e-6
            await gateway.frame(1.0)
    while await page.value("document.querySelector('.message') !== null"):  # each for some seconds
        await gateway.frame(0.1)
        await asyncio.sleep(0.1)
    await caught_up(page, gateway)
    for _ in range(3):
        await page.call("HeapProfiler.collectGarbage")
    usage, counters = await page.call("Runtime.getHeapUsage"), await page.call("Memory.getDOMCounters")
    points: int = await page.value("delfim.points(1)")
    return {"bytes": round(usage["usedSize"]), "nodes": counters["nodes"], "points": points}


def track(from_s: float, each: Message) -> Message:
    latitude_deg, longitude_deg = each["latitude_deg"], each["longitude_deg"]
    away_deg = [min(n, HOUR_S - n) / 1e7 for n in range(HOUR_S)]  # out and back: no boat jumps
    points = [[from_s + n, latitude_deg + away_deg[n], longitude_deg - away_deg[n]] for n in range(1, HOUR_S)]
    return {"t": "track", "boat": each["id"], "start": False, "points": points}
