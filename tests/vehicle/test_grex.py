"""The guest computer's link over real TCP on loopback."""

import asyncio
import json
import math

import pytest

from delfim.base.modes import Mode
from delfim.vehicle import console


def test_a_reference_is_taken_and_obeyed_in_grex_mode_only(boat):
    boat.ready()
    boat.vehicle.on_guest(b'{"heading_deg": 90, "speed_mps": 1.0}')
    boat.pass_time(1.0)
    assert not boat.propellers()[0].run, "idle obeys no guest"
    boat.vehicle.on_guest(b'{"heading_deg": 90, "speed_mps": 1.0}')
    assert boat.vehicle.on_command(console.SetMode("grex")) is None
    boat.pass_time(1.0)
    starboard, port = boat.propellers()
    assert port.rpm > starboard.rpm
    assert boat.state.reference.heading_rad == pytest.approx(math.pi / 2)


def test_grex_mode_needs_a_fresh_guest(boat):
    boat.ready()
    boat.vehicle.on_guest(b'{"heading_deg": 90}')
    boat.pass_time(6.0)
    assert boat.vehicle.on_command(console.SetMode("grex")) == "grex refused: no set point from the guest"


def test_a_silent_guest_makes_the_boat_hold(boat):
    boat.ready()
    boat.vehicle.on_guest(b'{"heading_deg": 0, "speed_mps": 1.0}')
    boat.vehicle.on_command(console.SetMode("grex"))
    boat.pass_time(5.5)
    assert boat.state.mode is Mode.HOLD
    assert boat.state.reason.startswith("guest silent")


@pytest.mark.parametrize(
    "line",
    [b"", b"[]", b"{}", b'{"heading_deg": null}', b'{"heading_deg": 1e999}', b'{"heading_deg": 1, "x": 2}', b"\xff\x00"],
)
def test_nonsense_changes_nothing_and_is_counted(boat, line):
    boat.vehicle.on_guest(line)
    assert boat.state.setpoint.guest_heading_rad is None
    assert boat.state.counts == {"guest_malformed": 1}


def test_navigation_goes_out_each_cycle_and_a_new_guest_replaces_the_old(boat):
    async def guests() -> tuple[dict[str, object], bytes]:
        server = await asyncio.get_running_loop().create_server(lambda: boat.guest, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        first, first_writer = await asyncio.open_connection("127.0.0.1", port)
        second, second_writer = await asyncio.open_connection("127.0.0.1", port)
        assert await first.read() == b"", "the old connection ends"
        boat.navigate()
        line = json.loads(await second.readline())
        second_writer.write(b'{"heading_deg": 10}\n{"heading_deg"')
        second_writer.write(b": 20}\n")
        while boat.state.setpoint.guest_heading_rad != pytest.approx(math.radians(20)):
            await asyncio.sleep(0)
        for writer in (first_writer, second_writer):
            writer.close()
        server.close()
        while boat.guest.is_connected:
            await asyncio.sleep(0)
        return line, b""

    line, _ = asyncio.run(asyncio.wait_for(guests(), 10))
    assert line["latitude_deg"] == pytest.approx(38.6925)
    assert line["mode"] == "idle"


def test_a_guest_that_does_not_read_loses_the_newest_and_delays_nothing(boat):
    async def stuck() -> None:
        server = await asyncio.get_running_loop().create_server(lambda: boat.guest, "127.0.0.1", 0)
        _, writer = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1], limit=1)
        while not boat.guest.is_connected:
            await asyncio.sleep(0)
        writer.transport.pause_reading()
        boat.navigate()
        for _ in range(200_000):
            boat.guest.send()
            if boat.state.counts.get("guest_not_reading"):
                break
        writer.close()
        boat.guest.close()
        server.close()

    asyncio.run(asyncio.wait_for(stuck(), 20))
    assert boat.state.counts["guest_not_reading"] == 1
