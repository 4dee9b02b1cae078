"""The guest computer: what it asks for, and how it holds on to the vehicle over a real TCP connection."""

import asyncio
import contextlib
import json
import logging
import math
from collections.abc import AsyncIterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base import geodesy
from delfim.base.clock import ManualClock
from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import Navigation
from delfim.simulator.guest import Asked, Circle, Heard, Script, Zigzag, guest, heard, reference, written
from delfim.vehicle.grex import Guest
from delfim.vehicle.grex import reference as read_reference
from delfim.vehicle.state import State

HERE = geodesy.origin(math.radians(38.6925), math.radians(-9.215))
CIRCLE = Circle(38.6925, -9.215, radius_m=30.0, speed_mps=1.2)
ZIGZAG = Zigzag(course_deg=350.0, amplitude_deg=20.0, leg_s=10.0)
START_NS = 1_262_304_000_000_000_000
AT_ONCE = (0.001, 0.01)


def at(north_m: float, east_m: float, after_s: float = 0.0) -> Heard:
    latitude_rad, longitude_rad = geodesy.from_plane(HERE, north_m, east_m)
    return Heard(START_NS + round(after_s * 1e9), "grex", math.degrees(latitude_rad), math.degrees(longitude_rad))


@pytest.mark.parametrize(
    ("north_m", "east_m", "radius_m", "heading_deg"),
    [
        (30, 0, 30, 90),
        (0, 30, 30, 180),
        (-30, 0, 30, 270),
        (30, 0, -30, 270),
        (3000, 0, 30, 180),
        (3000, 0, -30, 180),
        (0, -3000, 30, 90),
    ],
)
def test_a_circle_is_steered_along_its_tangent_or_towards_it(north_m, east_m, radius_m, heading_deg):
    asked = reference(CIRCLE._replace(radius_m=radius_m), at(north_m, east_m), START_NS)
    assert asked is not None
    assert asked.heading_deg == pytest.approx(heading_deg, abs=1.0)
    assert asked.speed_mps == 1.2


@given(st.floats(-200, 200), st.floats(-200, 200), st.sampled_from([30.0, -30.0]))
def test_from_anywhere_a_boat_that_obeys_ends_on_the_circle_and_goes_round(north_m, east_m, radius_m):
    bearings = []
    for _ in range(500):
        asked = reference(CIRCLE._replace(radius_m=radius_m), at(north_m, east_m), START_NS)
        assert asked is not None
        north_m += math.cos(math.radians(asked.heading_deg))
        east_m += math.sin(math.radians(asked.heading_deg))
        bearings.append(math.atan2(east_m, north_m))
    assert math.hypot(north_m, east_m) == pytest.approx(30.0, abs=1.5)
    assert math.copysign(1.0, geodesy.wrap(bearings[-1] - bearings[-2])) == math.copysign(1.0, radius_m)


def test_without_position_nothing_is_asked_on_a_circle() -> None:
    assert reference(CIRCLE, Heard(START_NS, "grex"), START_NS) is None


@pytest.mark.parametrize(("after_s", "heading_deg"), [(0, 10), (9.9, 10), (10, 330), (19.9, 330), (20, 10)])
def test_a_zigzag_changes_sides_each_leg(after_s: float, heading_deg: float) -> None:
    assert reference(ZIGZAG, at(0, 0, after_s), START_NS) == Asked(pytest.approx(heading_deg), 1.2)


@pytest.mark.parametrize(("after_s", "heading_deg"), [(0, 0), (5, 90), (10, 270), (15, 0)])
def test_a_script_is_followed_and_repeated(after_s: float, heading_deg: float) -> None:
    script = Script((0.0, 90.0, -90.0), leg_s=5.0, speed_mps=0.8)
    assert reference(script, at(0, 0, after_s), START_NS) == Asked(heading_deg, 0.8)


def test_lines_of_the_vehicle_are_read_and_more_of_them_is_no_harm() -> None:
    assert heard(b'{"utc_ns":1,"mode":"idle","latitude_deg":null,"depth_m":3}\n') == Heard(1, "idle")


@given(st.binary(max_size=60))
def test_other_lines_are_refused(line: bytes) -> None:
    with pytest.raises(FormatError, match="not a line of the vehicle"):
        heard(b"[" + line)


def test_what_is_written_is_what_the_vehicle_reads() -> None:
    asked = read_reference(written(Asked(270.0, 1.5)).strip())
    assert asked is not None
    assert (asked.heading_deg, asked.speed_mps) == (270.0, 1.5)


Connections = asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]]


@contextlib.asynccontextmanager
async def over_tcp() -> AsyncIterator[tuple[int, asyncio.Server, Connections]]:
    """A guest that zigzags, and the vehicle's end of its connections."""
    connections, opened = Connections(), []

    def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        opened.append(writer)
        connections.put_nowait((reader, writer))

    server = await asyncio.start_server(accept, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    running = asyncio.create_task(guest("127.0.0.1", port, ZIGZAG, backoff_s=AT_ONCE))
    try:
        async with asyncio.timeout(20):
            yield port, server, connections
        assert not running.done()
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        for writer in opened:
            writer.close()
        server.close()
        await server.wait_closed()


def navigation(after_s: float) -> bytes:
    return json.dumps({"utc_ns": START_NS + round(after_s * 1e9), "mode": "grex", "heading_deg": 5.0}).encode() + b"\n"


async def test_every_line_is_answered_and_the_plan_survives_a_lost_connection() -> None:
    async with over_tcp() as (_port, _server, connections):
        reader, writer = await connections.get()
        for after_s, heading_deg in ((100, 10.0), (105, 10.0), (110, 330.0)):
            writer.write(navigation(after_s))
            assert json.loads(await reader.readline())["heading_deg"] == pytest.approx(heading_deg)
        writer.close()
        reader, writer = await connections.get()
        writer.write(navigation(115))
        assert json.loads(await reader.readline())["heading_deg"] == pytest.approx(330.0), "still the second leg"


@pytest.mark.parametrize("nonsense", [b"hello\n", b"[]\n", b"x" * 100_000 + b"\n"], ids=["text", "list", "endless"])
async def test_a_vehicle_that_talks_nonsense_is_left_and_tried_again(nonsense: bytes, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "delfim.simulator.guest")
    async with over_tcp() as (_port, _server, connections):
        reader, writer = await connections.get()
        writer.write(nonsense)
        reader, writer = await connections.get()
        writer.write(navigation(0))
        assert json.loads(await reader.readline())["speed_mps"] == 1.2
    assert any("again in" in message for message in caplog.messages)


async def test_it_waits_for_a_vehicle_that_is_not_there_yet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "delfim.simulator.guest")
    async with over_tcp() as (port, server, connections):
        _, writer = await connections.get()
        writer.transport.abort()
        server.close()
        await server.wait_closed()
        while len(caplog.messages) < 6:
            await asyncio.sleep(0.001)
        again = await asyncio.start_server(lambda r, w: connections.put_nowait((r, w)), "127.0.0.1", port)
        reader, writer = await connections.get()
        writer.write(navigation(0))
        assert await reader.readline()
        writer.close()
        again.close()
    pauses = [message.rpartition(" in ")[2] for message in caplog.messages]
    assert pauses[:5] == ["0.001 s", "0.002 s", "0.004 s", "0.008 s", "0.01 s"]


def test_with_the_vehicles_own_server() -> None:
    """Both ends of the protocol as they are: navigation goes out, the reference arrives."""
    state, clock, lines = State(mode=Mode.GREX), ManualClock(), list[bytes]()
    state.navigation = Navigation(START_NS, HERE.latitude_rad, HERE.longitude_rad, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3, 9, 0.9, 0)

    async def play() -> None:
        vehicle = Guest(state, clock)
        vehicle.on_line = lines.append
        server = await asyncio.get_running_loop().create_server(lambda: vehicle, "127.0.0.1", 0)
        running = asyncio.create_task(guest("127.0.0.1", server.sockets[0].getsockname()[1], ZIGZAG, backoff_s=AT_ONCE))
        while not lines:
            vehicle.send()
            await asyncio.sleep(0.001)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        vehicle.close()
        server.close()
        await server.wait_closed()

    asyncio.run(asyncio.wait_for(play(), 20))
    asked = read_reference(lines[0])
    assert asked is not None
    assert (asked.heading_deg, asked.speed_mps) == (pytest.approx(10.0), 1.2)
    assert not state.counts
