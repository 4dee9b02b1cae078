"""The other nodes of the boat: what they say when, whom they obey, and that they stop by themselves."""

import math
import statistics
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.base.geodesy import origin
from delfim.canproxy.dsor.messages import (
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    GPS_SYSSTAT_ID,
    NAVIGATION_ID,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    RESET,
    TIME,
    TIME_FRAME,
    BatteriesCommand,
    BatteriesStatus,
    Fault,
    GpsStatus,
    Navigation,
    Node,
    PropellerCommand,
    PropellerStatus,
    Status,
    SystemStatus,
    pack_batteries_command,
    pack_propeller_command,
    pack_reset,
    sysstat_arb,
    unpack_navigation,
    unpack_sysstat,
)
from delfim.canproxy.dsor.protocol import Message
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.socket import accepts
from delfim.simulator.nodes import Nodes, nodes_of
from delfim.simulator.tables import Sea, Simulation

COMMANDS = nodes_of(config.Vehicle(boat=config.BoatTable(name="test")), 1).hears
UTC_NS = 1_262_304_000_000_000_000
QUIET = Simulation(position_noise_m=0.0, heading_noise_deg=0.0, speed_noise_mps=0.0)


class Boat:
    """The nodes and a receiver of what they say; time goes in steps."""

    def __init__(self, simulation: Simulation = QUIET, rate_hz: float = 5.0, seed: int = 1) -> None:
        boat, rate = config.BoatTable(name="test"), config.NavigationTable(rate_hz=rate_hz)
        self.nodes: Nodes = nodes_of(config.Vehicle(boat=boat, navigation=rate, simulation=simulation), seed)
        self.model = self.nodes.model
        self.now_s = 100.0
        self.counter = 0
        self.receiver = Receiver(Node.VEHICLE, lambda message: True)
        self.said: list[tuple[float, Frame]] = []
        self.messages: list[tuple[float, Message]] = []

    @property
    def utc_ns(self) -> int:
        return UTC_NS + round((self.now_s - 100.0) * 1e9)

    def step(self) -> list[Frame]:
        frames = self.nodes.step(self.now_s, self.utc_ns)
        for frame in frames:
            self.said.append((self.now_s, frame))
            if (message := self.receiver.feed(frame, self.now_s)) is not None:
                self.messages.append((self.now_s, message))
        return frames

    def sail(self, seconds: float, starboard: int | None = None, port: int | None = None, dt_s: float = 0.2) -> None:
        """Steps at `dt_s`, before each the commands of a vehicle; None sends that side none."""
        for _ in range(round(seconds / dt_s)):
            self.counter += 1
            self.command(starboard, port, self.counter)
            self.now_s = round(self.now_s + dt_s, 9)
            self.step()

    def command(self, starboard: int | None, port: int | None, counter: int) -> None:
        sides = ((starboard, PROPELLER_STARBOARD, BATTERIES_STARBOARD), (port, PROPELLER_PORT, BATTERIES_PORT))
        for rpm, propeller, batteries in sides:
            if rpm is not None:
                self.nodes.feed(Frame(propeller, pack_propeller_command(PropellerCommand(rpm, True, counter))), self.now_s)
                self.nodes.feed(Frame(batteries, pack_batteries_command(BatteriesCommand(True, counter))), self.now_s)

    def status(self, node: Node) -> list[tuple[float, SystemStatus]]:
        return [(t, unpack_sysstat(node, frame.data)) for t, frame in self.said if frame.arb == sysstat_arb(node)]

    def propeller(self, node: Node = Node.PROPELLER_STARBOARD) -> PropellerStatus:
        status = self.status(node)[-1][1]
        assert isinstance(status, PropellerStatus)
        return status

    def batteries(self, node: Node = Node.BATTERIES_STARBOARD) -> BatteriesStatus:
        status = self.status(node)[-1][1]
        assert isinstance(status, BatteriesStatus)
        return status

    def navigation(self) -> list[Navigation]:
        return [unpack_navigation(message.data) for _, message in self.messages if message.id == NAVIGATION_ID]


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 3.0])
def test_navigation_comes_at_its_rate_and_tells_the_truth_but_for_the_noise(rate_hz: float) -> None:
    boat = Boat(rate_hz=rate_hz)
    boat.sail(20, 700, 900, dt_s=1.0 / rate_hz)
    seen = boat.navigation()
    assert len(seen) == 20 * rate_hz
    assert [n.counter for n in seen] == [(seen[0].counter + i) % 256 for i in range(len(seen))]
    last, model = seen[-1], boat.model
    assert last.utc_ns == boat.utc_ns
    assert last.latitude_rad == pytest.approx(model.latitude_rad, abs=1e-9)
    assert last.longitude_rad == pytest.approx(model.longitude_rad, abs=1e-9)
    assert last.heading_rad == pytest.approx(model.heading_rad, abs=1e-4)
    assert last.north_mps == pytest.approx(model.north_mps, abs=1e-3)
    assert last.east_mps == pytest.approx(model.east_mps, abs=1e-3)
    assert last.roll_rad == pytest.approx(model.roll_rad, abs=1e-4)
    assert (last.fix, last.satellites, last.hdop) == (3, 10, 0.9)
    assert not boat.receiver.errors


def test_navigation_noise_has_the_asked_deviation() -> None:
    boats = [Boat(Simulation(position_noise_m=2.0, heading_noise_deg=1.0, speed_noise_mps=0.1), seed=i) for i in range(200)]
    measured = [(boat, boat.nodes.navigation.measured(UTC_NS)) for boat in boats]
    north = [(n.latitude_rad - b.model.latitude_rad) * b.model.origin.north_m_per_rad for b, n in measured if n.latitude_rad]
    heading = [
        math.degrees(math.remainder(n.heading_rad - b.model.heading_rad, math.tau)) for b, n in measured if n.heading_rad
    ]
    speed = [n.east_mps for _, n in measured if n.east_mps is not None]
    assert statistics.stdev(north) == pytest.approx(2.0, rel=0.2)
    assert statistics.stdev(heading) == pytest.approx(1.0, rel=0.2)
    assert statistics.stdev(speed) == pytest.approx(0.1, rel=0.2)


def test_the_error_of_position_leads_across_the_date_line() -> None:
    """A longitude of more than 180 degrees is refused aboard: a boat beside the line was stopped."""
    boat = Boat(Simulation(position_noise_m=2.0))
    boat.model.origin = origin(0.7, math.pi)
    longitudes = [boat.nodes.navigation.measured(UTC_NS).longitude_rad or 0.0 for _ in range(1000)]
    assert -math.pi <= min(longitudes) < -3.14
    assert 3.14 < max(longitudes) <= math.pi


def test_the_error_of_position_wanders_and_does_not_jump() -> None:
    boat = Boat(Simulation(position_noise_m=2.0))
    errors = [boat.nodes.navigation.measured(UTC_NS).latitude_rad or 0.0 for _ in range(3000)]
    metres = [(error - boat.model.latitude_rad) * boat.model.origin.north_m_per_rad for error in errors]
    steps = [after - before for before, after in pairwise(metres)]
    assert statistics.stdev(steps) == pytest.approx(2.0 * math.sqrt(2 * 0.2 / 60), rel=0.1)
    assert 0.5 < statistics.stdev(metres) < 4.0


def test_the_same_seed_gives_the_same_frames_and_another_does_not() -> None:
    def frames(seed: int) -> list[tuple[float, Frame]]:
        boat = Boat(Simulation(sea=Sea(wind_mps=5.0)), seed=seed)
        boat.sail(20, 700, 800)
        return boat.said

    assert frames(3) == frames(3)
    assert frames(3) != frames(4)


def test_gps_reports_and_sends_the_time_at_each_full_second() -> None:
    boat = Boat()
    boat.now_s = 100.5
    boat.step()
    boat.said.clear()
    boat.messages.clear()
    boat.sail(5, dt_s=0.1)
    times = [(t, TIME.unpack(frame.data)[0]) for t, frame in boat.said if frame.arb == TIME_FRAME]
    assert times == [(101.0 + i, UTC_NS + (1 + i) * 1_000_000_000) for i in range(5)]
    reports = [(t, m) for t, m in boat.messages if m.id == GPS_SYSSTAT_ID]
    assert [t for t, _ in reports] == [t for t, _ in times]
    assert unpack_sysstat(reports[0][1].source, reports[0][1].data) == GpsStatus(Status.GOOD, Fault(0), 3, 10, 0.9, times[0][1])


def test_frames_come_in_order_of_priority() -> None:
    boat = Boat()
    boat.step()
    boat.sail(3, 500, 500)
    for now_s in {t for t, _ in boat.said}:
        arbs = [frame.arb for t, frame in boat.said if t == now_s]
        assert arbs == sorted(arbs)
    assert {frame.arb for _, frame in boat.said} >= {TIME_FRAME, *(sysstat_arb(n) for n in Node if 0x10 <= n < 0x30)}


def test_each_propeller_obeys_its_own_commands() -> None:
    boat = Boat()
    boat.sail(10, 600, -400)
    starboard, port = boat.propeller(), boat.propeller(Node.PROPELLER_PORT)
    assert (starboard.rpm, port.rpm) == (600, -400)
    assert starboard.status is port.status is Status.GOOD
    assert starboard.current_a is not None
    assert starboard.current_a > 1.0
    assert starboard.temperature_c is not None
    reports = boat.status(Node.PROPELLER_STARBOARD)
    assert [t for t, _ in reports] == pytest.approx([100.2 + 0.2 * i for i in range(50)])
    assert [s.counter for _, s in reports if isinstance(s, PropellerStatus)] == list(range(1, 51))


def test_a_propeller_without_command_stops_itself_after_its_time_and_says_so() -> None:
    boat = Boat()
    boat.sail(10, 800, 800)
    silent_s = boat.now_s - 0.2  # when the last command came
    boat.sail(0.75, None, 800, dt_s=0.05)
    assert boat.propeller().faults == Fault(0), "0.95 s of silence are allowed"
    assert boat.model.starboard.run
    boat.now_s = silent_s + 1.0
    boat.step()
    assert not boat.model.starboard.run
    boat.sail(5, None, 800)
    assert boat.propeller().status is Status.BAD
    assert boat.propeller().faults == Fault.NO_COMMAND
    assert boat.propeller().rpm == pytest.approx(0, abs=3)
    assert boat.propeller(Node.PROPELLER_PORT).rpm == 800, "the other side goes on"
    boat.sail(5, 800, 800)
    assert boat.propeller().status is Status.GOOD
    assert boat.propeller().rpm == 800


def test_a_frozen_sender_does_not_keep_a_motor_running() -> None:
    boat = Boat()
    boat.sail(5, 800, 800)
    for _ in range(10):
        boat.command(800, 800, boat.counter)
        boat.now_s += 0.2
        boat.step()
    assert not boat.model.starboard.run
    assert boat.propeller().faults == Fault.NO_COMMAND
    boat.nodes.feed(Frame(PROPELLER_STARBOARD, pack_propeller_command(PropellerCommand(800, True, boat.counter))), boat.now_s)
    assert not boat.model.starboard.run


def test_a_stop_is_obeyed_at_once_whatever_its_counter() -> None:
    boat = Boat()
    boat.sail(5, 800, 800)
    boat.nodes.feed(Frame(PROPELLER_PORT, pack_propeller_command(PropellerCommand(800, False, boat.counter))), boat.now_s)
    assert not boat.model.port.run
    assert boat.model.starboard.run


def test_nothing_turns_before_the_first_command() -> None:
    boat = Boat()
    boat.sail(3)
    assert boat.propeller().faults == Fault.NO_COMMAND | Fault.LOW_VOLTAGE
    assert boat.propeller().rpm == 0
    assert boat.model.north_m == boat.model.east_m == 0.0


def test_an_open_contactor_is_a_dead_propeller() -> None:
    boat = Boat()
    boat.sail(5, 800, 800)
    boat.nodes.feed(Frame(BATTERIES_STARBOARD, pack_batteries_command(BatteriesCommand(False, 0))), boat.now_s)
    for _ in range(50):
        boat.counter += 1
        boat.nodes.feed(
            Frame(PROPELLER_STARBOARD, pack_propeller_command(PropellerCommand(800, True, boat.counter))), boat.now_s
        )
        boat.now_s += 0.2
        boat.step()
    assert boat.propeller().rpm == pytest.approx(0, abs=1)
    assert boat.propeller().faults == Fault.LOW_VOLTAGE
    assert boat.batteries().current_a == 0.0
    boat.sail(5, 800, 800)
    assert boat.propeller().rpm == 800


def test_batteries_report_each_second_and_drain_with_the_propeller() -> None:
    boat = Boat()
    boat.sail(60, 1000, 0)
    reports = boat.status(Node.BATTERIES_STARBOARD)
    assert [t for t, _ in reports] == pytest.approx([100.2 + i for i in range(60)])
    starboard, port = boat.batteries(), boat.batteries(Node.BATTERIES_PORT)
    assert starboard.status is Status.GOOD
    assert starboard.current_a is not None
    assert starboard.current_a > 15
    assert port.current_a == 0.5
    assert boat.model.starboard.charge < boat.model.port.charge < 1.0
    assert starboard.voltage_v is not None
    assert 42 < starboard.voltage_v < 54


@pytest.mark.parametrize(
    ("charge", "status", "faults"),
    [(0.5, Status.GOOD, Fault(0)), (0.15, Status.DEGRADED, Fault.LOW_VOLTAGE), (0.01, Status.BAD, Fault.LOW_VOLTAGE)],
)
def test_batteries_say_when_they_are_low(charge: float, status: Status, faults: Fault) -> None:
    boat = Boat()
    boat.model.port.charge = charge
    boat.sail(2, 0, 0)
    report = boat.batteries(Node.BATTERIES_PORT)
    assert (report.status, report.faults) == (status, faults)
    assert report.charge == pytest.approx(charge, abs=0.01)


@pytest.mark.parametrize("arb", [PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT])
def test_a_malformed_command_is_counted_and_changes_nothing(arb: int) -> None:
    boat = Boat()
    boat.sail(2, 800, 800)
    boat.nodes.feed(Frame(arb, b"\1"), boat.now_s)
    assert sum(getattr(node, "malformed", 0) for node in boat.nodes.named.values()) == 1
    boat.sail(0.6, 800, 800)
    assert boat.model.starboard.run
    assert boat.model.port.run


@given(
    st.lists(
        st.tuples(st.sampled_from([a.arb for a in COMMANDS]) | st.integers(0, 0xFFFFFFFF), st.binary(max_size=8)), max_size=40
    )
)
@settings(deadline=None, max_examples=60)
def test_no_frame_breaks_the_nodes(frames: list[tuple[int, bytes]]) -> None:
    boat = Boat()
    for arb, data in frames:
        boat.nodes.feed(Frame(arb, data), boat.now_s)
        boat.now_s += 0.1
        for frame in boat.step():
            assert len(frame.data) <= 8
    assert math.isfinite(boat.model.north_m)
    assert not boat.receiver.errors


@pytest.mark.parametrize(("number", "silent"), [(Node.PROPELLER_PORT, 1), (Node.BROADCAST, 2), (Node.GPS, 0)])
def test_a_node_that_is_reset_says_nothing_until_it_has_started(number: int, silent: int) -> None:
    boat = Boat()
    boat.sail(2.0, 0, 0)
    boat.said.clear()
    boat.nodes.feed(Frame(RESET, pack_reset(number)), boat.now_s)
    boat.nodes.feed(Frame(RESET, b"\x7f\0\0\0"), boat.now_s)
    boat.sail(0.8, 0, 0)
    propellers = (Node.PROPELLER_STARBOARD, Node.PROPELLER_PORT)
    assert sum(not boat.status(node) for node in propellers) == silent
    boat.sail(1.0, 0, 0)
    assert all(boat.status(node) for node in propellers)


def test_commands_are_what_a_socket_of_the_nodes_accepts() -> None:
    for arb in (PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT):
        assert [accepts(address, arb) for address in COMMANDS].count(True) == 1
    assert not any(accepts(address, extended(0x40)) or accepts(address, TIME_FRAME) for address in COMMANDS)


def test_stepping_when_something_is_due_says_the_same_as_stepping_all_the_time() -> None:
    often, sparing = Boat(), Boat()
    for _ in range(1001):
        often.step()
        often.now_s = round(often.now_s + 0.01, 9)
    turns = 0
    while sparing.now_s <= 110.0:
        sparing.step()
        assert sparing.nodes.due_s > sparing.now_s, "time goes on"
        sparing.now_s = round(sparing.nodes.due_s, 9)
        turns += 1
    assert turns < 60
    assert [frame.arb for _, frame in sparing.said] == [frame.arb for _, frame in often.said]
    assert [t for t, _ in sparing.said] == pytest.approx([t for t, _ in often.said])


def test_due_counts_the_end_of_a_command() -> None:
    boat = Boat(rate_hz=0.5)
    boat.step()
    boat.now_s += 0.05
    boat.command(500, 500, 1)
    boat.step()
    seen = []
    while boat.model.port.run:
        boat.now_s = boat.nodes.due_s
        boat.step()
        seen.append(boat.now_s)
    assert seen[-1] == pytest.approx(101.05)


def test_a_stalled_simulator_does_not_sail_on_nor_send_what_it_missed() -> None:
    boat = Boat()
    boat.step()
    boat.sail(10, 1000, 1000)
    north_m = boat.model.north_m
    boat.said.clear()
    boat.now_s += 3600.0
    boat.step()
    assert boat.model.north_m - north_m < 5.0
    assert len([frame for _, frame in boat.said if frame.arb == sysstat_arb(Node.PROPELLER_PORT)]) == 1
    assert boat.propeller().faults == Fault.NO_COMMAND
    boat.said.clear()
    boat.sail(1, 0, 0, dt_s=0.05)
    assert len(boat.status(Node.PROPELLER_PORT)) == 5
