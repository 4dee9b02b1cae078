"""The boats in Foxglove: a client of its WebSocket protocol at the real server, and the layout."""

import asyncio
import contextlib
import json
import socket
import struct
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import pytest

from delfim.base.errors import ConfigError
from delfim.console.gateway import foxglove
from delfim.console.gateway.foxglove import FoxgloveView
from delfim.logging.ashore import topics
from tests.console.test_gateway import let_in, opened
from tests.console.test_othervessels import vessel

pytest.importorskip("foxglove", reason="make formats brings it")
DATA = 1  # of a binary message
SQUARE = [[38.69, -9.22], [38.69, -9.21], [38.70, -9.21], [38.70, -9.22]]
MISSION = {
    "name": "round",
    "waypoints": [{"latitude_deg": 38.691, "longitude_deg": -9.215}, {"latitude_deg": 38.692, "longitude_deg": -9.216}],
    "fence": SQUARE,
    "obstacles": [{"latitude_deg": 38.695, "longitude_deg": -9.215, "radius_m": 20.0}],
    "zones": [{"kind": "keep_out", "polygon": SQUARE}, {"kind": "keep_in", "centre": [[38.69, -9.21]], "radius_m": 900.0}],
}


class Watcher:
    """A client that subscribes to all that it is offered."""

    def __init__(self, link: aiohttp.ClientWebSocketResponse) -> None:
        self._link = link
        self.offered: dict[int, dict[str, Any]] = {}

    async def hear(self) -> tuple[str, dict[str, Any]]:
        """The next message, with its topic."""
        while True:
            got = await self._link.receive(timeout=60.0)
            if got.type is aiohttp.WSMsgType.TEXT:
                told = json.loads(got.data)
                if told["op"] == "advertise":
                    self.offered |= {each["id"]: each for each in told["channels"]}
                    wanted = [{"id": each["id"], "channelId": each["id"]} for each in told["channels"]]
                    await self._link.send_json({"op": "subscribe", "subscriptions": wanted})
            elif got.type is aiohttp.WSMsgType.BINARY and got.data[0] == DATA:
                number, _ = struct.unpack_from("<IQ", got.data, 1)
                return self.offered[number]["topic"], json.loads(got.data[13:])
            else:
                assert got.type is aiohttp.WSMsgType.BINARY, got

    async def until(self, topic: str) -> dict[str, Any]:
        while True:
            heard, message = await self.hear()
            if heard == topic:
                return message


@contextlib.asynccontextmanager
async def watching(view: FoxgloveView) -> AsyncIterator[Watcher]:
    async with aiohttp.ClientSession() as session, session.ws_connect(view.url, protocols=["foxglove.sdk.v1"]) as link:
        yield Watcher(link)


@pytest.fixture
def view():
    shown = FoxgloveView(0)
    yield shown
    shown.close()


async def test_state_place_plan_and_words_of_a_boat_are_seen_in_foxglove(view, tmp_path):
    async with opened(tmp_path) as sea, watching(view) as watcher:
        sea.gateway.viewers.append(view.tell)
        sea.boats[0].name = "Delfim X"
        stops = [each | {"speed_mps": 0, "acceptance_m": 0, "hold_s": 0} for each in MISSION["waypoints"]]
        plan = {"name": "round", "waypoints": stops, "fence": SQUARE, "obstacles": [], "home": None}
        async with asyncio.TaskGroup() as group:
            saw = asyncio.Event()
            seeing = group.create_task(see(watcher, saw))
            async with sea.session.ws_connect(sea.url + "ws") as page:
                await sea.until(page, lambda m: m["t"] == "boats" and any(b["name"] == "Delfim X" for b in m["boats"]))
                await page.send_json({"t": "mission", "seq": 1, "boat": 1, "do": "put", "mission": plan})
                await page.send_json({"t": "mission", "seq": 2, "boat": 1, "do": "upload"})
                await saw.wait()
                sea.boats[0].say(vessel(north_m=1000.0))
                await page.send_json({"t": "input", "boat": 1, "n": 1, "port_pct": 0.0, "starboard_pct": 0.0})
                await page.send_json({"t": "release", "boat": 1, "why": "a test"})
                await seeing
        async with sea.session.get(sea.url + "foxglove.json") as answer:
            assert "/delfim-x/location" in await answer.text()
    schemas = {each["topic"]: each["schemaName"] for each in watcher.offered.values()}
    assert schemas["/delfim-x/location"] == "foxglove.LocationFix"
    assert not [topic for topic in schemas if "boat-2" in topic], "a boat without a name has no topics yet"


async def see(watcher: Watcher, saw: asyncio.Event) -> None:
    left = {"state", "location", "plan", "targets", "log"}
    while left:
        topic, message = await watcher.hear()
        names = [each["properties"]["name"] for each in json.loads(message.get("geojson", '{"features": []}'))["features"]]
        if names or not topic.endswith(("plan", "targets")):  # the boat's own empty mission comes first
            left.discard(topic.rpartition("/")[2])
        match topic:
            case "/delfim-x/state":
                saw.set()
                assert message["starboard_rpm_measured"] == 310.0
                assert message["heading"] == pytest.approx(1.5708, abs=1e-3)
                assert message["charge"] == 0.8
            case "/delfim-x/location":
                assert message["latitude"] == pytest.approx(38.6901, abs=1e-6)
            case "/delfim-x/plan" if names:
                assert names == ["waypoint 1", "waypoint 2", "round", "fence"]
            case "/delfim-x/targets" if names:
                assert names == ["MARIA", "MARIA"], "its place and its way ahead"


async def test_without_the_token_there_is_no_layout(tmp_path):
    async with opened(tmp_path) as sea, aiohttp.ClientSession() as stranger:
        async with stranger.get(sea.url + "foxglove.json") as answer:
            assert answer.status == 403
        await let_in(sea.session, sea.url)


def test_a_plan_on_the_map_has_all_its_areas():
    told = foxglove.geojson(MISSION)["features"]
    assert [each["properties"]["name"] for each in told[3:]] == ["fence", "keep out", "keep out", "keep in"]
    for each in told[3:]:
        (ring,) = each["geometry"]["coordinates"]
        assert ring[0] == ring[-1], "RFC 7946 wants a ring closed"
        assert all(-10.0 < longitude < -9.0 and 38.0 < latitude < 39.0 for longitude, latitude in ring)


def test_a_number_that_is_not_known_or_not_finite_is_left_out():
    nothing = dict.fromkeys(
        ("latitude_deg", "longitude_deg", "course_deg", "speed_mps", "heading_deg", "roll_deg", "pitch_deg")
    )
    boat = nothing | {
        "mode": "a mode of others",
        "reference": dict.fromkeys(("heading_deg", "cross_track_m", "distance_m", "leg")),
    }
    boat |= {"rpm": [None, 3.0], "battery_v": None, "battery_pct": None, "satellites": None, "age_s": {"heard": 1.0}}
    boat |= {
        "link": {"rtt_ms": None, "loss_pct": 50.0},
        "measured": {"depth_m": {"value": float("inf")}, "wind": {"value": 2.0}},
    }
    assert foxglove.state(boat) == {"starboard_rpm_measured": 3.0, "link_loss": 0.5, "heard": 1.0, "wind": 2.0}


def test_a_port_that_is_taken_is_told():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match=r"--foxglove: .* cannot be served"):
            FoxgloveView(other.getsockname()[1])


def test_a_topic_is_called_by_the_boats_name():
    assert topics.topic("Delfim X/2", topics.STATE) == "/delfim-x-2/state"
    assert topics.topic("///", topics.LOG) == "/boat/log"
