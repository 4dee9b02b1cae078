"""The boat tells an NMEA 2000 bus what it knows: every message, field by field, as an independent decoder has it (package
`nmea2000`), against the state of the vehicle.
"""

import asyncio
import errno
import logging
import math
from collections import defaultdict
from random import Random
from types import SimpleNamespace
from typing import get_args

import msgspec
import pytest
from nmea2000.decoder import NMEA2000Decoder

from delfim import config
from delfim.base.errors import BusError
from delfim.base.frames import Frame, identifier
from delfim.base.geodesy import origin
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Navigation, Status
from delfim.canproxy.nmea2000.device import FIRST
from delfim.canproxy.nmea2000.parcels import CLAIM, REQUEST, Parcel, frames
from delfim.parts.nmea2000.nmea2000d import FULL, OLD_S, WAITING, BoatDevice, Memory
from delfim.parts.nmea2000.nmea2000rows import TOLD, pgns_of
from delfim.parts.nmea2000.table import Nmea2000, ToldName
from delfim.services.runtime import LoadedService, Runtime
from delfim.vehicle.console import answer
from delfim.vehicle.report import reported
from delfim.vehicle.snapshot import in_json, report
from delfim.vehicle.state import Actuation, Motion, Notice, Reference, State, ThrusterReport

logging.getLogger("nmea2000").setLevel(logging.ERROR)
EVERYTHING = get_args(ToldName)
UTC_NS = 1_795_348_800_500_000_000
ROWS = (
    config.ThrusterTable(name="main", driver="dronecan", address=0, x_m=-1.0, thrust_n=(-10.0, 20.0)),
    config.ThrusterTable(
        name="outboard",
        driver="dronecan",
        address=1,
        x_m=-1.0,
        thrust_n=(-10.0, 20.0),
        steer=config.Steer(kind="azimuth", angle_max_deg=35.0),
    ),
)


def settings(*send, **more):
    return config.Vehicle(
        boat=config.BoatTable(name="Otter"), nmea2000=Nmea2000(send=send, unique_number=77, **more), thrusters=ROWS
    )


class Bus:
    """What was sent, and what is to be heard. `fault`: raised by the next frames."""

    def __init__(self):
        self.sent, self.waiting, self.fault, self.takes = [], [], None, math.inf

    def sendto(self, data, address):
        if self.fault is not None:
            raise self.fault
        if self.takes <= 0:
            raise BlockingIOError(errno.EAGAIN, "full")
        self.takes -= 1
        self.sent.append((address.arb, data))

    def receive(self):
        if isinstance(self.fault, BusError):
            raise self.fault
        return self.waiting.pop(0) if self.waiting else None

    def hear(self, parcel):
        self.waiting += [Frame(arb, data) for arb, data in frames(parcel, 0)]


class Boat:
    """A vehicle that publishes its state ten times a second, and its device on the bus."""

    def __init__(self, *send, clock_s=100.0):
        self.now_s, self.bus, self.settings = clock_s, Bus(), settings(*send)
        self.state = State(mode=Mode.PLAY)
        clock = SimpleNamespace(monotonic_s=lambda: self.now_s)
        self.speaker = BoatDevice(self.bus, self.settings, clock, FIRST, Random(1))
        self._decoder, self._chance = NMEA2000Decoder(), Random(2)

    def run(self, seconds, *, publishes=True, navigates=True, navigation_hz=10):
        """The vehicle's ticks come a little sooner or later than every 0.1 s."""
        for step in range(1, round(seconds * 50) + 1):
            self.now_s += 0.02
            self.speaker.on_frames()
            if step % 5 == 0 and publishes:
                if navigates and step % (50 // navigation_hz) == 0:
                    self.state.cycles += 1
                    self.state.navigation_s = self.now_s
                wait_s = self._chance.uniform(0.0, 0.015)
                self.now_s += wait_s
                self.publish()
                self.now_s -= wait_s

    def publish(self):
        told = in_json(report(self.state, self.now_s, self.settings.thrusters))
        self.speaker.heard(reported(answer(None, told)))

    def heard(self):
        """Fields of all messages since the last time, by PGN, as the independent decoder has them."""
        found = defaultdict(list)
        for arb, data in self.bus.sent:
            message = self._decoder.decode(f"(1700000000.000000) can0 {identifier(arb):08X}#{data.hex().upper()}")
            if message is not None:
                found[message.PGN].append({field.id: field.raw_value for field in message.fields})
                assert message.source in (self.speaker.device.address, 254)
        self.bus.sent.clear()
        return found


@pytest.fixture
def boat():
    boat = Boat(*EVERYTHING)
    boat.run(1.0, publishes=False)
    boat.heard()
    return boat


def sailing(boat):
    state, now_s = boat.state, boat.now_s
    state.navigation = Navigation(UTC_NS, 0.675432, -0.161234, 1.5, -0.8, 5.6789, -0.1234, 0.0712, -0.0345, 6, 11, 0.9, 1)
    state.motion = Motion(frozenset({"position", "heading", "velocity"}), 10.0, 5.0, 5.6789, -0.1234, 1.5, -0.8)
    state.origin = origin(0.675432, -0.161234)
    state.reference = Reference(cross_track_m=-3.21, distance_m=456.78, north_m=300.0, east_m=-200.0, leg=4)
    state.actuation = Actuation((0.5, -0.25), (0.0, 0.3), True)
    state.thrusters = {
        "main": ThrusterReport(now_s, rpm=1234.5, temperature_c=41.0),
        "outboard": ThrusterReport(now_s, rpm=-500.0, angle_rad=0.25),
    }
    state.sysstat = {
        "batteries_port": (BatteriesStatus(Status.GOOD, Fault(0), 25.43, 12.3, 0.815, 23), now_s),
        "batteries_starboard": (BatteriesStatus(Status.GOOD, Fault(0), 25.5, -4.0, None, None), now_s),
    }
    state.notices = (
        Notice("battery_low", "battery low: port at 12 %", now_s - 3.0, "home"),
        Notice("gnss_poor", "satellite navigation poor: 4 satellites", now_s - 1.0, "warn"),
    )


def near(value, unit):
    return pytest.approx(value, abs=0.51 * unit)


@pytest.fixture
def said(boat):
    """All messages of one state."""
    sailing(boat)
    boat.state.navigation_s = boat.now_s
    boat.state.cycles += 1
    boat.publish()
    return boat.heard()


def test_no_message_is_missing_and_none_is_unexpected(said):
    assert set(said) == set(pgns_of(EVERYTHING))


def test_navigation_equals_the_state_field_by_field(boat, said):
    n, m = boat.state.navigation, boat.state.motion
    (rapid,) = said[129025]
    assert math.radians(rapid["latitude"]) == near(n.latitude_rad, math.radians(1e-7) * 2)
    assert math.radians(rapid["longitude"]) == near(n.longitude_rad, math.radians(1e-7) * 2)
    (gnss,) = said[129029]
    assert (gnss["latitude"], gnss["longitude"]) == (near(rapid["latitude"], 1e-7), near(rapid["longitude"], 1e-7))
    assert gnss["date"] * 86400 * 10**9 + round(gnss["time"] * 1e4) * 100_000 == UTC_NS
    assert (gnss["method"], gnss["numberOfSvs"], gnss["hdop"]) == (5, 11, near(0.9, 0.01))
    assert gnss["altitude"] is None
    (time,) = said[126992]
    assert time["date"] * 86400 * 10**9 + round(time["time"] * 1e4) * 100_000 == UTC_NS
    (course,) = said[129026]
    assert course["cogReference"] == 0
    assert course["cog"] == near(math.atan2(m.east_mps, m.north_mps) % math.tau, 2e-4)
    assert course["sog"] == near(math.hypot(m.north_mps, m.east_mps), 0.01)
    (heading,) = said[127250]
    assert (heading["heading"], heading["reference"]) == (near(n.heading_rad, 2e-4), 0)
    assert (heading["deviation"], heading["variation"]) == (None, None)
    (turn,) = said[127251]
    assert turn["rate"] == near(n.yaw_rate_radps, 1e-7)
    (attitude,) = said[127257]
    assert (attitude["yaw"], attitude["pitch"], attitude["roll"]) == (None, near(n.pitch_rad, 1e-4), near(n.roll_rad, 1e-4))


def test_thrusters_and_batteries_equal_the_state_field_by_field(said):
    main, outboard = said[127488]
    assert (main["instance"], main["speed"], outboard["instance"], outboard["speed"]) == (0, near(1234.5, 0.25), 1, 500.0)
    (engine,) = said[127489]
    assert (engine["instance"], engine["temperature"]) == (0, near(314.15, 0.01))
    assert all(engine[name] is None for name in ("oilPressure", "oilTemperature", "fuelRate", "engineLoad"))
    (rudder,) = said[127245]
    assert (rudder["instance"], rudder["position"], rudder["angleOrder"]) == (1, near(-0.25, 1e-3), near(-0.3, 1e-3))

    port, starboard = said[127508]
    assert (port["instance"], port["voltage"], port["current"]) == (0, near(25.43, 0.01), near(-12.3, 0.1))
    assert port["temperature"] == near(296.15, 0.01)
    assert (starboard["instance"], starboard["voltage"], starboard["current"]) == (1, near(25.5, 0.01), near(4.0, 0.1))
    assert starboard["temperature"] is None
    (charge,) = said[127506]
    assert (charge["instance"], charge["stateOfCharge"], charge["dcType"]) == (0, near(81.5, 1.0), 0)


def test_the_route_equals_the_state_field_by_field(boat, said):
    n, r = boat.state.navigation, boat.state.reference
    (cross,) = said[129283]
    assert (cross["xte"], cross["xteMode"], cross["navigationTerminated"]) == (near(r.cross_track_m, 0.01), 0, 0)
    (route,) = said[129284]
    assert route["distanceToWaypoint"] == near(r.distance_m, 0.01)
    assert route["bearingPositionToDestinationWaypoint"] == near(math.atan2(-200.0, 300.0) % math.tau, 1e-3)
    assert (route["destinationLatitude"], route["destinationLongitude"]) == (
        near(math.degrees(n.latitude_rad) + math.degrees(300.0 / 6.37e6), 1e-4),
        near(math.degrees(n.longitude_rad) - math.degrees(200.0 / 6.37e6 / math.cos(n.latitude_rad)), 1e-4),
    )
    assert (route["courseBearingReference"], route["destinationWaypointNumber"]) == (0, 4)
    assert route["waypointClosingVelocity"] == near((1.5 * 300.0 + 0.8 * 200.0) / math.hypot(300.0, 200.0), 0.02)
    assert route["etaTime"] is None
    assert (route["perpendicularCrossed"], route["arrivalCircleEntered"]) == (3, 3), "not available"


def test_troubles_are_alerts_with_their_words(boat, said):
    low, poor = said[126983]
    assert (low["alertType"], low["alertId"], low["alertState"], low["alertOccurrenceNumber"]) == (2, 11, 2, 1)
    assert (poor["alertType"], poor["alertId"]) == (5, 13)
    assert (low["acknowledgeSupport"], low["temporarySilenceSupport"], low["triggerCondition"]) == (0, 0, 1)
    words = [each["alertTextDescription"] for each in said[126985]]
    assert words == [notice.reason for notice in boat.state.notices]
    assert boat.speaker.report()["lost"] == {}


def test_each_is_sent_as_often_as_the_standard_has_it(boat):
    sailing(boat)
    assert boat.speaker.is_quick
    boat.run(12.0)
    said = {pgn: len(found) / 12.0 for pgn, found in boat.heard().items()}
    assert all(said[pgn] == pytest.approx(10.0, rel=0.01) for pgn in (129025, 127250, 127251, 127245))
    assert said[129026] == pytest.approx(4.0, rel=0.03)
    assert all(said[pgn] == pytest.approx(1.0, rel=0.09) for pgn in (129029, 126992, 127257, 129283, 129284))


def test_navigation_that_comes_less_often_is_told_once(boat):
    sailing(boat)
    boat.run(12.0, navigation_hz=5)
    said = {pgn: len(found) / 12.0 for pgn, found in boat.heard().items()}
    assert all(said[pgn] == pytest.approx(5.0, rel=0.01) for pgn in (129025, 127250, 127251))


@pytest.mark.parametrize(("word", "is_quick"), [("heading", True), ("course", False), ("battery", False)])
def test_the_vehicle_is_asked_ten_times_a_second_only_where_a_message_is_due_so_often(word, is_quick):
    assert Boat(word).speaker.is_quick is is_quick


def test_what_is_unknown_old_or_not_asked_for_is_not_told(boat):
    boat.run(2.0)
    assert set(boat.heard()) == set(), "the boat knows nothing yet"
    sailing(boat)
    boat.run(6.0)
    boat.heard()
    boat.run(2.0)
    silent = boat.heard()
    assert 127488 not in silent, "reports of thrusters are old"
    assert 127508 not in silent
    assert 129025 in silent
    boat.run(0.5, navigates=False)
    boat.heard()
    boat.run(3.0, navigates=False)
    assert not {129025, 127250, 129283} & set(boat.heard()), "navigation is silent"
    boat.run(3.0, publishes=False)
    assert set(boat.heard()) <= {126993}, "the vehicle is silent"

    only = Boat("heading")
    sailing(only)
    only.run(3.0)
    assert set(only.heard()) == {REQUEST, CLAIM, 126993, 127250}


def test_the_end_of_a_trouble_is_told_once_and_its_return_is_another_occurrence(boat):
    sailing(boat)
    boat.run(1.0)
    boat.heard()
    notices, boat.state.notices = boat.state.notices, ()
    boat.run(3.0)
    ended = boat.heard()[126983]
    assert [(each["alertId"], each["alertState"]) for each in sorted(ended, key=lambda each: each["alertId"])] == [
        (11, 1),
        (13, 1),
    ]
    boat.state.notices = notices
    boat.run(1.2)
    assert {each["alertOccurrenceNumber"] for each in boat.heard()[126983]} == {2}


def test_a_message_that_somebody_asks_for_comes_with_the_next_state(boat):
    sailing(boat)
    boat.run(2.0)
    boat.heard()
    boat.bus.hear(Parcel(REQUEST, (127508).to_bytes(3, "little"), 7, 6, FIRST))
    boat.state.sysstat = {"batteries_port": (BatteriesStatus(Status.GOOD, Fault(0), 24.0, None, None, None), boat.now_s)}
    boat.run(0.2)
    assert len(boat.heard()[127508]) == 1


def test_a_full_bus_gets_the_rest_of_a_message_first_and_loses_what_is_old(boat):
    sailing(boat)
    boat.bus.takes = 3
    boat.run(0.2)
    assert len(boat.bus.sent) == 3
    boat.bus.takes = math.inf
    boat.run(0.2)
    assert boat.heard()[129029], "it was interrupted, and is whole"
    boat.bus.takes = 0
    boat.run(OLD_S + 3.0)
    report = boat.speaker.report()
    assert report["troubles"] == {"NMEA 2000": FULL}
    assert report["lost"]["too old"] > 0
    assert len(boat.speaker.parcels._waiting) <= WAITING


@pytest.mark.parametrize("fault", [BusError("can1: bus off"), BlockingIOError(errno.EAGAIN, "full")])
def test_when_the_bus_comes_back_the_device_joins_it_anew(boat, fault):
    sailing(boat)
    boat.run(1.0)
    boat.heard()
    boat.bus.fault = fault
    boat.run(5.0)
    assert set(boat.speaker.report()["troubles"]) == {"NMEA 2000"}
    assert boat.heard() == {}
    boat.bus.fault = None
    boat.run(0.4)
    first = boat.bus.sent[:12]
    assert REQUEST in {identifier(arb) >> 8 & 0x3FF00 for arb, _ in first}, "it asks who is there"
    boat.run(1.0)
    assert boat.speaker.report()["troubles"] == {}
    assert {CLAIM, 129025} <= set(boat.heard())


def test_a_short_jam_costs_no_new_claim(boat):
    sailing(boat)
    boat.run(1.0)
    boat.bus.takes = 0
    boat.run(0.5)
    boat.bus.takes = math.inf
    boat.heard()
    boat.run(1.0)
    assert CLAIM not in boat.heard()


def test_without_an_address_nothing_is_told(boat):
    sailing(boat)
    boat.run(1.0)
    boat.heard()
    boat.bus.hear(Parcel(CLAIM, (1).to_bytes(8, "little"), FIRST))
    boat.run(0.2)
    assert boat.speaker.device.address == FIRST + 1
    assert set(boat.heard()) == {CLAIM}
    boat.run(0.6)
    assert 129025 in boat.heard()


def test_nothing_that_the_bus_says_changes_what_the_boat_tells(boat):
    """A heading command, a new instance, and a route of a plotter."""
    sailing(boat)
    boat.run(1.0)
    before = boat.speaker.report()
    command = b"\x01" + (127237).to_bytes(3, "little") + b"\xf8\x01\x0b\x00\x00"
    for parcel in (
        Parcel(126208, command, 7, 3, FIRST),
        Parcel(126208, b"\x01" + CLAIM.to_bytes(3, "little") + b"\xf8\x01\x03\x05", 7, 3, FIRST),
        Parcel(126984, bytes(25), 7, 2, FIRST),
    ):
        boat.bus.hear(parcel)
    boat.run(0.1)
    after = boat.speaker.report()
    assert (after["address"], after["name"]) == (before["address"], before["name"])
    assert after["refused"]["command refused"] == 2


def test_every_word_of_the_file_has_its_rows():
    assert set(TOLD) == set(EVERYTHING)


@pytest.mark.parametrize("text", ["", "abc", "252", "-1", "\x00"])
def test_a_damaged_address_is_none(tmp_path, text):
    place = tmp_path / "address"
    place.write_text(text)
    assert Memory(place).address == FIRST


def test_the_address_is_kept_for_tomorrow(tmp_path, caplog):
    memory = Memory(tmp_path / "address")
    memory.keep(SimpleNamespace(is_claimed=True, address=41, name=1))
    assert Memory(tmp_path / "address").address == 41
    lost = Memory(tmp_path / "missing" / "address")
    lost.keep(SimpleNamespace(is_claimed=True, address=41, name=1))
    assert "may be another one tomorrow" in caplog.text


def test_it_does_not_run_in_the_runtime(tmp_path):
    from delfim.base.clock import SystemClock
    from delfim.parts.nmea2000 import nmea2000d

    its = msgspec.structs.replace(settings("heading"), runtime=config.RuntimeTable(run_directory=str(tmp_path)))
    runtime = Runtime(its, SystemClock())
    with asyncio.Runner(loop_factory=runtime._new_loop) as runner:  # `main` would make the tests' own process a real-time one
        runner.run(runtime.run([LoadedService("nmea2000d", nmea2000d.serve)]))
    assert "place = 'process'" in runtime.status["nmea2000d"].reason
