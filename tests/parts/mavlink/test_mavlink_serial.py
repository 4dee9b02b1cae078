"""MAVLink over a pair of SiK radios: a pseudo terminal, and behind it a radio with its buffer, its air rate, its packets that
are lost, and its reports. The clock is the test's.
"""

import asyncio
import contextlib
import os
import tty
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.base.tables import decode
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.stationserial import QUEUE_BYTES, STALE_S, StationSerial
from delfim.parts.mavlink.stationsocket import MavlinkLink
from delfim.parts.mavlink.table import Mavlink

KEY, BAUD = bytes(range(32)), 57_600
STEP_S, TICKS = 0.01, 5  # steps of the radio from one tick of the station to the next


class Radio:
    """A pair of radios with the boat's port on `master`. `air_bps`: what they carry. Packets of 64 bytes, cut anywhere."""

    BUFFER_BYTES, PACKET_BYTES = 2048, 64

    def __init__(self, master: int, clock: Any, air_bps: float = 32_000, loss: float = 0.0, reports: bool = True) -> None:
        os.set_blocking(master, False)
        self.master, self.clock, self.loss, self.reports = master, clock, loss, reports
        self.air_bytes_per_s, self.random = air_bps / 8, Random(15)
        self.buffer, self.ashore, self.overflown, self.stalls = b"", b"", 0, False
        self._credit, self._steps, self._codec = 0.0, 0, dialect.MAVLink(None, 51, 68)

    def step(self) -> bytes:
        """Let STEP_S pass; the bytes that came out ashore."""
        self._steps += 1
        if self.stalls:
            return b""
        with contextlib.suppress(BlockingIOError):
            self.buffer += os.read(self.master, round(BAUD / 10 * STEP_S))
        self.overflown += len(self.buffer[self.BUFFER_BYTES :])
        self.buffer = self.buffer[: self.BUFFER_BYTES]
        self._credit = min(self._credit + self.air_bytes_per_s * STEP_S, 2.0 * self.PACKET_BYTES)
        came = b""
        while self.buffer and self._credit >= min(self.PACKET_BYTES, len(self.buffer)):
            packet, self.buffer = self.buffer[: self.PACKET_BYTES], self.buffer[self.PACKET_BYTES :]
            self._credit -= len(packet)
            came += packet if self.random.random() >= self.loss else b""
        if self.reports and self._steps % 100 == 0:
            self.report(round(100 * (1 - len(self.buffer) / self.BUFFER_BYTES)))
        return came

    def report(self, free_percent: int) -> None:
        status = dialect.MAVLink_radio_status_message(180, 170, free_percent, 40, 41, 0, 0)
        os.write(self.master, status.pack(self._codec, force_mavlink1=True))

    def carry(self, data: bytes) -> None:
        """From ashore to the boat."""
        while data:
            size = self.random.randrange(1, self.PACKET_BYTES)
            packet, data = data[:size], data[size:]
            if self.random.random() >= self.loss:
                os.write(self.master, packet)


class Sea:
    """A boat that is fit, with a radio and a console ashore that has the key."""

    def __init__(self, boat: Any, device: Path, **radio: Any) -> None:
        self.boat, self.device, self.clock = boat, device, boat.clock
        boat.clock.step(16 * 365 * 86400.0)  # time stamps begin in 2015
        settings = Mavlink(serial=str(device), key="a key", peers=())
        boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1), mavlink=settings)
        self.master = -1
        self.plug()
        self.serial = StationSerial(settings, boat.clock, lambda frame, address: self.station.receive(frame, address))
        signing = Signing(KEY, boat.clock)
        send, is_ready = lambda data, _: self.serial.send(data), lambda _: self.serial.is_ready()
        self.station = Station(boat.vehicle, boat.vehicle.on_command, send, signing, None, is_ready)
        self.radio = Radio(self.master, boat.clock, **radio)
        self.cutter, self.heard = wire.Cutter(), list[tuple[float, Any]]()
        self.sender = wire.Sender(250, 190, KEY, Signing(KEY, boat.clock).stamp)
        boat.ready()
        self.pass_time(0.1)

    def plug(self) -> None:
        self.master, port = os.openpty()
        tty.setraw(port)
        self.device.unlink(missing_ok=True)
        self.device.symlink_to(os.ttyname(port))
        self._port = port  # kept open, as the driver does: a pty without one hangs up

    def unplug(self) -> None:
        os.close(self._port)
        os.close(self.master)
        self.device.unlink()

    def close(self) -> None:
        self.serial.close()
        self.unplug()

    def say(self, name: str, *fields: object) -> None:
        self.radio.carry(self.sender.pack(getattr(dialect, f"MAVLink_{name}_message")(*fields)))

    def mode(self, number: int) -> None:
        self.say("command_long", 1, 1, 176, 0, 1, number, 0, 0, 0, 0, 0)

    def pass_time(self, seconds: float, beats: bool = True) -> list[Any]:
        """What the console heard meanwhile."""
        before = len(self.heard)
        for n in range(round(seconds / STEP_S)):
            for frame in self.cutter.cut(self.radio.step()):
                self.heard.append((self.clock.monotonic_s(), wire.decode(frame)))
            if beats and n % 100 == 50:
                self.say("heartbeat", 6, 8, 0, 0, 4, 3)
            self.clock.advance(STEP_S)
            if n % TICKS == 0:
                self._tick()
        return [message for _, message in self.heard[before:]]

    def _tick(self) -> None:
        self.boat.vehicle.on_watchdog()
        self.boat.navigate()
        self.boat.report()
        for _ in range(20):
            self.serial.readable()
        if self.serial.is_due():
            self.serial.open()
        while self.station.turn():
            pass
        self.station.tick()


@pytest.fixture
def sea(boat, tmp_path):
    afloat = Sea(boat, tmp_path / "radio")
    yield afloat
    afloat.close()


def names(heard: list[Any]) -> set[str]:
    return {message.get_type() for message in heard}


def test_a_boat_is_watched_and_commanded_by_radio(sea):
    heard = sea.pass_time(5.0)
    assert {"HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "GPS_RAW_INT"} <= names(heard)
    assert sum(m.get_type() == "HEARTBEAT" for m in heard) in (4, 5)
    sea.mode(3)
    heard = sea.pass_time(1.0)
    assert sea.boat.state.mode is Mode.HEADING
    assert [m.result for m in heard if m.get_type() == "COMMAND_ACK"] == [0]
    assert sea.station.consoles.commander == (250, 190, 0)
    assert sea.serial.report() | {"bytes_per_s": 0} == {
        "device": str(sea.device), "trouble": "", "bytes_per_s": 0, "dropped": 0, "losses": 0,
        "rssi": 180, "remote_rssi": 170, "noise": 40, "free_percent": 100,
    }  # fmt: skip


def test_nobody_is_heard_without_the_key(sea):
    for sender in (wire.Sender(250, 190, None, lambda: 0), wire.Sender(250, 190, bytes(32), lambda: 1 << 47)):
        sea.radio.carry(sender.pack(dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)))
    heard = sea.pass_time(2.0, beats=False)
    assert sea.boat.state.mode is Mode.IDLE
    assert sea.station.consoles.counts == {"unsigned": 1, "forged": 1}
    assert names(heard) == {"HEARTBEAT"}, "only that the boat exists"


def test_a_radio_needs_a_key():
    with pytest.raises(ConfigError, match="it needs a key; make one with"):
        decode({"serial": "/dev/ttyUSB0"}, Mavlink, "boat.toml")
    port = {"boat": {"name": "x"}, "slipd": {"device": "/dev/ttyS1"}, "mavlink": {"serial": "/dev/ttyS1", "key": "k"}}
    with pytest.raises(ConfigError, match="one port"):
        decode(port, config.Vehicle, "boat.toml")


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_commands_repeated_get_through_a_radio_that_loses_packets(boat, tmp_path, loss):
    sea = Sea(boat, tmp_path / "radio", loss=loss)
    for number, mode in ((3, Mode.HEADING), (5, Mode.HOLD), (4, Mode.IDLE)) * 3:
        for _ in range(30):
            sea.mode(number)
            acks = [m for m in sea.pass_time(0.5) if m.get_type() == "COMMAND_ACK"]
            if acks:
                break
        assert (sea.boat.state.mode, {m.result for m in acks}) == (mode, {0})
    sea.close()


@pytest.mark.parametrize("air_bps", [4_000, 16_000, 64_000])
def test_telemetry_is_as_fast_as_the_radio_carries_it(boat, tmp_path, air_bps):
    """The console asks for all of it, 15 kbit/s. The radio's reports slow the boat down."""
    sea = Sea(boat, tmp_path / "radio", air_bps=air_bps)
    sea.pass_time(1.0)
    sea.say("param_set", 1, 1, b"LINK_PROFILE", 2.0, 9)
    sea.pass_time(16.0)
    overflown, before = sea.radio.overflown, len(sea.heard)
    heard = sea.pass_time(10.0)
    assert names(heard) >= {"GLOBAL_POSITION_INT", "ATTITUDE", "VFR_HUD", "SYS_STATUS", "BATTERY_STATUS", "RAW_RPM"}
    assert sum(m.get_type() == "HEARTBEAT" for m in heard) >= 9
    assert sea.radio.overflown - overflown <= 0.02 * 10 * sea.radio.air_bytes_per_s
    ages_s = [at_s - m.time_boot_ms / 1e3 for at_s, m in sea.heard[before:] if m.get_type() == "GLOBAL_POSITION_INT"]
    carried = sum(len(m.get_msgbuf()) for m in heard) / 10
    assert carried >= min(0.6 * sea.radio.air_bytes_per_s, 1500)
    assert max(ages_s) < 2.0


def test_a_radio_that_stalls_gets_little_and_hears_nothing_old_afterwards(sea):
    sea.pass_time(2.0)
    sea.radio.stalls = True
    sent = sea.station.consoles.peers
    sea.pass_time(15.0)
    assert sea.serial._queued <= QUEUE_BYTES
    assert len(sent.known) == 1
    sea.radio.stalls = False
    os.set_blocking(sea.master, False)
    while True:  # the kernel's own buffer, which a port of a few kilobytes has not
        try:
            os.read(sea.master, 1 << 16)
        except BlockingIOError:
            break
    sea.cutter, now_s = wire.Cutter(), sea.clock.monotonic_s()
    sea.pass_time(3.0)
    ages_s = [at_s - m.time_boot_ms / 1e3 for at_s, m in sea.heard if at_s >= now_s and m.get_type() == "GLOBAL_POSITION_INT"]
    assert ages_s
    assert max(ages_s) < STALE_S + 0.2


def test_a_radio_that_is_unplugged_is_told_and_used_when_it_is_back(sea, caplog):
    sea.pass_time(2.0)
    sea.unplug()
    for _ in range(100):
        sea.clock.advance(0.05)
        sea._tick()
    report = sea.serial.report()
    assert (report["losses"], report["trouble"]) == (1, "No such file or directory")
    assert sea.serial._queued == 0
    assert len([each for each in caplog.messages if "radio" in each]) <= 4, "once each, not each second"
    sea.plug()
    sea.radio.master = sea.master
    os.set_blocking(sea.master, False)
    sea.cutter = wire.Cutter()
    assert "GLOBAL_POSITION_INT" in names(sea.pass_time(3.0))


def test_a_forged_report_slows_the_boat_but_does_not_silence_it(sea):
    for _ in range(50):
        sea.radio.report(0)
        sea.pass_time(0.1)
    assert sea.serial.report()["bytes_per_s"] == BAUD / 10 / 16
    heard = sea.pass_time(10.0)
    assert "GLOBAL_POSITION_INT" in names(heard)
    assert sum(m.get_type() == "HEARTBEAT" for m in heard) >= 9


def test_the_port_is_served_on_the_loop(boat, tmp_path: Path) -> None:
    """The real link: opened by a worker, read and written by the loop."""
    boat.clock.step(16 * 365 * 86400.0)
    (tmp_path / "key").write_text(KEY.hex() + "\n")
    (tmp_path / "key").chmod(0o600)
    master, port = os.openpty()
    tty.setraw(port)
    settings = Mavlink(listen="127.0.0.1:0", peers=(), key=str(tmp_path / "key"), serial=os.ttyname(port))
    boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1), mavlink=settings)
    boat.ready()
    sender, board = wire.Sender(250, 190, KEY, Signing(KEY, boat.clock).stamp), dict[str, Any]()

    async def serve() -> None:
        with MavlinkLink(boat.vehicle, boat.vehicle.on_command, None, tmp_path / "stamps", board):
            while board["mavlink"]()["serial"]["trouble"]:
                await asyncio.sleep(0)
            os.write(master, sender.pack(dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)))
            loop, at_s = asyncio.get_running_loop(), 0.0
            while "COMMAND_ACK" not in names(heard):
                # As fast as the loop's clock, by which the link is served: else an answer is stale before it is its turn.
                passed_s, at_s = loop.time() - at_s, loop.time()
                boat.clock.advance(min(passed_s, 1e-3))
                await asyncio.sleep(0)
                with contextlib.suppress(BlockingIOError):
                    heard.extend(wire.decode(frame) for frame in cutter.cut(os.read(master, 4096)))

    os.set_blocking(master, False)
    heard, cutter = list[Any](), wire.Cutter()
    asyncio.run(asyncio.wait_for(serve(), 60))
    assert boat.state.mode is Mode.HEADING
    os.close(master)
    os.close(port)


# The stream.


def frame(number: int) -> bytes:
    return wire.Sender(1, 1, KEY, lambda: number).pack(dialect.MAVLink_named_value_int_message(number, b"N", number))


@given(noise=st.lists(st.binary(max_size=80), min_size=8, max_size=8), cuts=st.lists(st.integers(1, 90), min_size=1))
def test_noise_and_cuts_hide_no_frame(noise: list[bytes], cuts: list[int]) -> None:
    said = [frame(n) for n in range(8)]
    stream, cutter, found = b"".join(a + b for a, b in zip(noise, said, strict=True)), wire.Cutter(), list[bytes]()
    while stream:
        size = cuts[len(stream) % len(cuts)]
        found, stream = found + cutter.cut(stream[:size]), stream[size:]
        assert len(cutter.rest) < 293
    assert found == said


@given(lost=st.integers(1, 40), begun=st.binary(max_size=3))
def test_a_frame_does_not_wait_for_the_rest_of_a_broken_one(lost: int, begun: bytes) -> None:
    """A stop behind a frame that lost its end comes at once."""
    cutter = wire.Cutter()
    torn = cutter.cut(b"\xfd\xff\x01" + frame(1)[:-lost] + begun)
    assert (torn + cutter.cut(frame(2)))[-1] == frame(2)
