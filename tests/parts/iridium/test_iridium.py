"""A boat at an Iridium modem: the vehicle's own station, the service, a played modem and gateway, on the test's clock."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.keys import new_key, read_key
from delfim.base.modes import Mode
from delfim.parts.iridium import orders, reading
from delfim.parts.iridium.iridiumd import SatelliteConsole
from delfim.parts.iridium.modem import SbdLine, SbdSession
from delfim.parts.iridium.table import IridiumTable
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.table import Mavlink
from delfim.services.access.exposure import doors
from delfim.services.suite import services
from delfim.vehicle import console
from tests.parts.iridium.played import PlayedModem
from tests.parts.mavlink.mavlink_console import Console, Radio

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
HERE = ("127.0.0.1", 40001)
AGES_S = 17 * 365.25 * 86_400.0  # the tests' clock stands in 2010, before time stamps began


class Offshore:
    """The vehicle and its modem."""

    def __init__(self, boat: Any, **table: Any) -> None:
        boat.clock.step(AGES_S)
        self.boat, self.clock, self.radio, self.modem = boat, boat.clock, Radio(), PlayedModem()
        mavlink, iridium = Mavlink(key="/key"), IridiumTable(device="/dev/ttyS3", **table)
        settings = config.Vehicle(boat=config.BoatTable(name="test", id=1), mavlink=mavlink, iridium=iridium)
        boat.vehicle.helm.settings = settings
        self.obeyed: list[console.Commands] = []
        self.station = Station(boat.vehicle, self._obey, self._from_vehicle, Signing(KEY, boat.clock))
        self.stamps: list[int] = []
        self.beat_s = 0.0  # the last heartbeat of the satellite's console
        self.satellite = SatelliteConsole(settings, KEY, boat.clock, self._to_vehicle, self._to_modem, 0, self.stamps.append)
        self._said: list[bytes] = []
        boat.ready()

    def _obey(self, asked: console.Commands, who: str) -> str | None:
        refused: str | None = self.boat.vehicle.on_command(asked, who)
        if refused is None and not isinstance(asked, console.Alive):
            self.obeyed.append(asked)
        return refused

    def _to_vehicle(self, frame: bytes) -> None:
        if (message := wire.decode(frame)) is not None and message.get_type() == "HEARTBEAT":
            self.beat_s = self.clock.monotonic_s()
        self.station.receive(frame, HERE)
        while self.station.turn():
            pass

    def _from_vehicle(self, datagram: bytes, address: Any) -> None:
        self.radio(datagram, address)
        if address == HERE:
            self.satellite.from_vehicle(datagram)

    def _to_modem(self, data: bytes) -> None:
        self._said.append(self.modem.write(data))

    def run(self, seconds: float) -> None:
        """The boat sails."""
        for _ in range(round(seconds * 2)):
            self.boat.pass_time(0.5)
            self.boat.navigate()
            self.boat.report()
            self._step()

    def drift(self, seconds: float) -> None:
        """Time passes, and the boat does nothing."""
        for _ in range(round(seconds)):
            self.clock.advance(1.0)
            self._step()

    def _step(self) -> None:
        self.station.tick()
        self.satellite.tick()
        while self._said:
            said = self._said.pop(0)
            for at in range(0, len(said), 7):  # in pieces, as a line brings it
                self.satellite.from_modem(said[at : at + 7])

    def order(
        self, order: console.OperatorOrder, number: int = 77, key: bytes = KEY, boat: int = 1, ago_s: float = 0.0
    ) -> bytes:
        clock = ManualClock(time_ns=self.clock.time_ns() - round(ago_s * 1e9))
        return orders.sealed(order, boat, number, Signing(key, clock))

    def ashore(self) -> list[str]:
        """What the last message says, without its times."""
        return [line.partition(" UTC: ")[2] for line in reading.in_words(self.modem.out[-1], KEY)]


@pytest.fixture
def sea(boat: Any) -> Offshore:
    return Offshore(boat)


def test_a_report_is_sent_each_ten_minutes(sea: Offshore) -> None:
    sea.drift(31 * 60.0)
    assert len(sea.modem.out) == 3 + 1, "the first one half a minute after the start"
    assert all(len(message) <= 340 for message in sea.modem.out)
    (said,) = sea.ashore()
    assert said.startswith("boat 1: idle at 38.")
    assert sea.satellite.report()["troubles"] == {}


@pytest.mark.parametrize(
    ("order", "mode"),
    [
        (orders.WORDS["hold"], Mode.HOLD),
        (console.Goto(38.6930, -9.2150), Mode.GOTO),
        (orders.WORDS["home"], Mode.HOLD),  # she is there
        (orders.WORDS["stop"], Mode.IDLE),
    ],
)
def test_an_order_is_fetched_obeyed_and_answered(sea: Offshore, order: console.OperatorOrder, mode: Mode) -> None:
    sea.modem.waiting = [sea.order(order)]
    sea.run(36.0)
    assert sea.boat.state.mode is mode
    assert [type(each) for each in sea.obeyed] == [type(order)]
    assert sea.ashore() == [sea.ashore()[0], "order 77: obeyed"]
    assert sea.ashore()[0].startswith(f"boat 1: {mode.name.lower()} at "), "the report that follows knows of it"
    assert len(sea.modem.out) == 2, "the answer did not wait ten minutes"


def test_a_refusal_comes_with_the_boats_reason(sea: Offshore) -> None:
    sea.modem.waiting = [sea.order(console.Goto(40.0, -9.2150))]
    sea.run(36.0)
    assert sea.ashore()[1].startswith("order 77: refused: ")
    assert "km" in sea.ashore()[1]
    assert sea.boat.state.mode is Mode.IDLE


def test_orders_wait_and_come_one_after_the_other(sea: Offshore) -> None:
    sea.modem.waiting = [sea.order(orders.WORDS["hold"], 1, ago_s=30.0), sea.order(orders.WORDS["stop"], 2, ago_s=20.0)]
    sea.run(60.0)
    assert [type(each).__name__ for each in sea.obeyed] == ["SetMode", "Stop"]
    told = [line for message in sea.modem.out for line in reading.in_words(message, KEY)]
    assert [line.partition("UTC: ")[2] for line in told if "order" in line] == ["order 1: obeyed", "order 2: obeyed"]


def test_nothing_but_a_fresh_order_of_a_holder_of_the_key_is_obeyed(sea: Offshore) -> None:
    good = sea.order(orders.WORDS["stop"])
    wrong = bytearray(good)
    wrong[20] ^= 1
    sea.modem.waiting = [
        sea.order(orders.WORDS["hold"], key=OTHER),
        bytes(wrong),
        b"noise",
        b"",
        sea.order(orders.WORDS["hold"], ago_s=3700.0),
        sea.order(orders.WORDS["hold"], ago_s=-120.0),
        sea.order(orders.WORDS["hold"], boat=2, ago_s=10.0),
        sea.order(console.SetMode("play"), ago_s=5.0),
        sea.order(console.Goto(), ago_s=4.0),
    ]
    sea.drift(300.0)
    assert (sea.modem.waiting, sea.obeyed, sea.boat.state.mode) == ([], [], Mode.IDLE)
    again = sea.order(orders.WORDS["stop"])
    sea.modem.waiting = [good, again, again]
    sea.drift(1300.0)
    assert [type(each).__name__ for each in sea.obeyed] == ["Stop"], "once"
    assert sea.stamps == sorted(sea.stamps)


def test_who_commands_by_radio_is_not_overruled_but_stop_is_obeyed(sea: Offshore) -> None:
    near = Console(sea.station, sea.radio, 250, ("10.0.0.2", 14550), Signing(KEY, sea.clock))
    near.beat()
    assert near.mode(5)[0] == 0
    sea.modem.waiting = [sea.order(console.Goto(38.6930, -9.2150), 1, ago_s=5.0), sea.order(orders.WORDS["stop"], 2)]
    for _ in range(100):
        near.beat()
        sea.run(0.5)
    assert sea.boat.state.mode is Mode.IDLE
    told = " ".join(line for message in sea.modem.out for line in reading.in_words(message, KEY))
    assert "order 1: refused: console 254 refused: console 250 commands; take over first" in told
    assert "order 2: obeyed" in told


def test_without_a_satellite_it_tries_again_and_again_and_nothing_is_lost(sea: Offshore) -> None:
    sea.drift(40.0)
    assert len(sea.modem.out) == 1
    sea.modem.waiting, sea.modem.has_network = [sea.order(orders.WORDS["stop"])], False
    sea.drift(30 * 60.0)
    assert (len(sea.modem.out), len(sea.modem.waiting)) == (1, 1)
    assert sea.satellite.report()["troubles"] == {"modem": "no session with the satellite: 32"}
    assert 5 <= sea.satellite.counts["failed"] <= 15, "less and less often"
    sea.modem.has_network = True
    sea.drift(6 * 60.0)
    assert [type(each).__name__ for each in sea.obeyed] == ["Stop"]


def test_a_dead_modem_is_told_of_and_comes_back(sea: Offshore) -> None:
    sea.modem.is_alive = False
    sea.drift(100.0)
    assert sea.satellite.report()["troubles"] == {"modem": "no answer to ATE0"}
    sea.modem.is_alive = sea.modem.rings = True
    sea.drift(400.0)
    assert sea.satellite.counts["sessions"] >= 1


def test_a_message_that_the_line_damages_is_read_again(sea: Offshore) -> None:
    sea.modem.waiting, sea.modem.damages = [sea.order(orders.WORDS["hold"])], True
    sea.run(36.0)
    assert [type(each).__name__ for each in sea.obeyed] == ["SetMode"]


def test_when_no_session_succeeds_nobody_watches(sea: Offshore) -> None:
    """Then the boat's failsafe for a silent console decides."""
    sea.drift(60.0)
    assert sea.clock.monotonic_s() - sea.beat_s < 3.0
    sea.modem.has_network = False
    sea.drift(31 * 60.0)
    assert sea.clock.monotonic_s() - sea.beat_s > 30.0


# The modem's answers.


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_whatever_the_line_says_costs_a_session_at_most(pieces: list[bytes]) -> None:
    written: list[bytes] = []
    line = SbdLine(written.append)
    line.begin(b"report", 0.0)
    for piece in pieces:
        line.feed(piece, 0.0)
        assert len(line._heard) <= 1024
    line.tick(1000.0)
    assert not line.is_busy


@given(st.binary(max_size=340), st.binary(min_size=0, max_size=270), st.integers(1, 50))
def test_any_message_goes_out_and_any_comes_in(out: bytes, waiting: bytes, piece: int) -> None:
    modem, said = PlayedModem(), list[bytes]()
    modem.waiting = [waiting] if waiting else []
    line, over = SbdLine(lambda data: said.append(modem.write(data))), list[SbdSession]()
    line.begin(out, 0.0)
    while said:
        heard = said.pop(0)
        for at in range(0, len(heard), piece):
            if (ended := line.feed(heard[at : at + piece], 0.0)) is not None:
                over.append(ended)
    assert modem.out == ([out] if out else [])
    assert over == [SbdSession(True, 0, waiting, 0)]


@given(st.binary(max_size=300))
def test_no_bytes_are_an_order(data: bytes) -> None:
    for frame in wire.frames(data)[0]:
        with pytest.raises(FormatError):
            orders.opened(frame, KEY, 0, 3600.0, 1_800_000_000_000_000_000)
    assert all(isinstance(line, str) for line in reading.in_words(data, KEY))


# The boat's file and the command.


def test_a_modem_needs_a_key(tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text('[boat]\nname = "a"\nid = 1\n[iridium]\ndevice = "/dev/ttyS3"\n')
    with pytest.raises(ConfigError, match="mavlink needs a key"):
        config.load(file, ())


def test_the_service_runs_where_there_is_a_modem_and_says_who_may_order(tmp_path: Path) -> None:
    new_key(tmp_path / "key")
    settings = config.Vehicle(
        boat=config.BoatTable(name="a", id=1),
        mavlink=Mavlink(key=str(tmp_path / "key")),
        iridium=IridiumTable(device="/dev/ttyS3"),
    )
    assert "iridiumd" in [row.name for row in services(settings)]
    assert "iridiumd" not in [row.name for row in services(config.Vehicle(boat=config.BoatTable(name="a", id=1)))]
    (door,) = [each for each in doors(settings, ["iridiumd"]) if each.service == "iridiumd"]
    assert (door.place, door.reach) == ("/dev/ttyS3", "known")


def delfim(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-m", "delfim", *words], capture_output=True, text=True, timeout=200, check=False
    )


def test_an_order_is_written_and_a_report_is_read_by_the_command(tmp_path: Path, sea: Offshore) -> None:
    new_key(tmp_path / "key")
    file, key = tmp_path / "order.sbd", read_key(tmp_path / "key")
    done = delfim("iridium", "order", "--key", str(tmp_path / "key"), "3", "38.69,-9.21", str(file))
    assert done.returncode == 0, done.stderr
    (frame,), whole = wire.frames(file.read_bytes())
    assert (whole, len(frame) < 270, frame.hex() in done.stdout) == (True, True, True)
    number, words = orders.order_in(frame, 3)
    assert f"order {number}, " in done.stdout
    assert console.parse_order(words) == console.Goto(38.69, -9.21)
    assert orders.opened(frame, key, 0, 3600.0, time.time_ns()) > 0
    assert "by satellite there are" in delfim("iridium", "order", "--key", str(tmp_path / "key"), "3", "play", str(file)).stderr
    sea.run(60.0)
    (tmp_path / "report.sbd").write_bytes(sea.modem.out[-1])
    said = delfim("iridium", "read", str(tmp_path / "report.sbd")).stdout
    assert "boat 1: idle at " in said
    assert "(not checked: no key)" in said
    assert (
        "NOT SIGNED WITH THIS KEY"
        in delfim("iridium", "read", "--key", str(tmp_path / "key"), str(tmp_path / "report.sbd")).stdout
    )
