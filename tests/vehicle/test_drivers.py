"""What all drivers of thrusters have in common, each against its played device: commanded, stopped, silent, beside noise."""

import contextlib
import os
from collections import deque
from collections.abc import Callable, Iterator
from itertools import count
from random import Random
from typing import NamedTuple, Protocol

import msgspec
import pytest
from pymavlink.dialects.v20 import development as dialect

from delfim import config
from delfim.base.frames import extended
from delfim.base.pulses import PulseAnswer, pack_answer, unpack_command
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.parts.pwm.outlet import Guard
from delfim.parts.vesc.table import Vesc
from delfim.vehicle.links import Links
from delfim.vehicle.propulsion.actuators import Actuator, open_actuator
from delfim.vehicle.state import Actuation, State, ThrusterReport
from tests.vehicle.played_devices import PlayedPx4, PlayedRover, PlayedSeat, PlayedVesc

AHEAD = Actuation((0.5, -0.25), (0.0, 0.0), True)
OFF = Actuation((0.0, 0.0), (0.0, 0.0), False)
NAMES = ("starboard", "port")
_names = count()


def settings(driver: str, **tables: config.Table) -> config.Vehicle:
    """A boat with two thrusters of this driver; the port one is mounted the wrong way round."""
    rows = tuple(
        config.ThrusterTable(
            name=name,
            driver=driver,
            address=address,
            y_m=0.5 - address,
            thrust_n=(-50.0, 50.0),
            rpm_max=1500.0,
            reversed=name == "port",
        )
        for address, name in enumerate(NAMES)
    )
    return config.Vehicle(boat=config.BoatTable(name="test"), thrusters=rows, **tables)


class Wire:
    """A line: what was written to it, and what is to be read from it."""

    t_ns = 0

    def __init__(self) -> None:
        self.written, self.waiting, self.is_full = list[bytes](), deque[bytes](), False

    def fileno(self) -> int:
        return 0

    def rebind(self) -> bool:
        return True

    def read(self) -> bytes:
        return self.waiting.popleft() if self.waiting else b""

    def write(self, data: bytes) -> bool:
        if not self.is_full:
            self.written.append(data)
        return not self.is_full


class Device(Protocol):
    """The played motors at the other end."""

    timeout_s: float | None  # after which they stop by themselves; None: never

    def efforts(self, now_s: float) -> tuple[float, float]: ...  # of starboard and port, as their driver tells them
    def report(self, now_s: float) -> None: ...  # says what it has to say of itself
    def noise(self, random: Random) -> None: ...  # says something that nobody understands


class VescDevice:
    timeout_s: float | None = 0.5

    def __init__(self, bus: CanSocket, wire: Wire) -> None:
        self._bus, self.played = bus, (PlayedVesc(0), PlayedVesc(1))

    def efforts(self, now_s: float) -> tuple[float, float]:
        while (frame := self._bus.receive()) is not None:
            for each in self.played:
                each.hear(frame.identifier, frame.data, now_s)
        starboard, port = (each.effort(now_s) for each in self.played)
        return starboard, port

    def report(self, now_s: float) -> None:
        for each in self.played:
            for identifier, data in each.status(now_s):
                self._bus.sendto(data, CanAddress(extended(identifier)))

    def noise(self, random: Random) -> None:
        identifier = random.choice((9, 16, 27)) << 8 | random.choice((0, 1))
        self._bus.sendto(random.randbytes(random.randrange(6)), CanAddress(extended(identifier)))


class SeatDevice:
    def __init__(self, bus: CanSocket, wire: Wire, timeout_s: float | None) -> None:
        self.timeout_s, self._wire, self.played = timeout_s, wire, PlayedSeat(timeout_s or 1e9)

    def efforts(self, now_s: float) -> tuple[float, float]:
        while self._wire.written:
            self.played.hear(self._wire.written.pop(0), now_s)
        assert not self.played.refused
        return self.played.efforts(now_s)

    def report(self, now_s: float) -> None:
        self._wire.waiting.append(self.played.report(now_s))

    def noise(self, random: Random) -> None:
        self._wire.waiting.append(random.randbytes(random.randrange(1, 50)) + b"\n")


class RoverDevice:
    timeout_s: float | None = 3.0

    def __init__(self, bus: CanSocket | None, wire: Wire) -> None:
        self._wire, self.played = wire, self.board()

    def board(self) -> PlayedRover:
        return PlayedRover()

    def efforts(self, now_s: float) -> tuple[float, float]:
        while self._wire.written:
            self.played.hear(self._wire.written.pop(0), now_s)
        return self.played.efforts(now_s)

    def report(self, now_s: float) -> None:
        self._wire.waiting.append(self.played.report(now_s))

    def noise(self, random: Random) -> None:
        self._wire.waiting.append(random.randbytes(random.randrange(1, 50)) + b"\xfd")


class Px4Device(RoverDevice):
    timeout_s: float | None = 0.5

    def board(self) -> PlayedRover:
        return PlayedPx4()


class PwmDevice:
    """The outlet's decisions, without its hardware."""

    timeout_s: float | None = 0.7

    def __init__(self, bus: CanSocket, wire: Wire) -> None:
        self.trouble, self._wire, self._guard = "", wire, Guard()

    def efforts(self, now_s: float) -> tuple[float, float]:
        while self._wire.written:
            self._guard.hear("runtime", self._wire.written.pop(0), now_s)
        starboard, port, *_ = self._guard.fractions(now_s) or (0.0, 0.0)
        return starboard, port

    def report(self, now_s: float) -> None:
        self._wire.waiting.append(pack_answer(PulseAnswer(1, "running", self.trouble)))

    def noise(self, random: Random) -> None:
        self._wire.waiting.append(random.randbytes(random.randrange(1, 5)))


class Known(NamedTuple):
    """How a driver is tried."""

    settings: config.Vehicle
    device: Callable[[CanSocket, Wire], Device]
    starboard: ThrusterReport  # what it is to say of its starboard motor


PULSES = settings("pwm")
PX4 = settings("mavlink_front_seat", mavlink_front_seat=MavlinkFrontSeat(autopilot="px4"))
DRIVERS = {
    "vesc": Known(settings("vesc"), VescDevice, ThrusterReport(7.0, 750.0, 5.5, 24.1, 31.4)),
    "otter": Known(
        settings("otter"), lambda bus, wire: SeatDevice(bus, wire, 3.0), ThrusterReport(7.0, 750.0, temperature_c=21.0)
    ),
    "heron": Known(settings("heron"), lambda bus, wire: SeatDevice(bus, wire, None), ThrusterReport(7.0, voltage_v=15.2)),
    "mavlink_front_seat": Known(settings("mavlink_front_seat"), RoverDevice, ThrusterReport(7.0, None, 4.5, 15.2)),
    "px4": Known(PX4, Px4Device, ThrusterReport(7.0, None, 4.5, 15.2)),
    "pwm": Known(PULSES, PwmDevice, ThrusterReport(7.0)),
}


def greet(driver: Actuator, device: Device) -> None:
    """A second in which they hear of each other: a board says what it is, and which version when it is asked."""
    for ticks in (5, 0):
        device.report(0.0)
        for each in driver.inputs:
            each.read(State(), 0.0)
        for _ in range(ticks):
            driver.repeat(0.0)
        device.efforts(0.0)


class Bench(NamedTuple):
    driver: Actuator
    device: Device
    wire: Wire
    state: State
    known: Known


@pytest.fixture(params=DRIVERS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A driver and its played device."""
    known = DRIVERS[request.param]
    with contextlib.ExitStack() as opened:
        name = f"canloop:drivers-{os.getpid()}-{next(_names)}"
        far = opened.enter_context(open_bound(known.settings.can, name, (ANYTHING,)))

        def bus(_: str, filters: tuple[CanAddress, ...]) -> CanSocket:
            return opened.enter_context(open_bound(known.settings.can, name, filters))

        wire = Wire()
        driver = open_actuator(known.settings.thrusters[0].driver, known.settings, Links(bus, lambda device, baud: wire))
        device = known.device(far, wire)
        greet(driver, device)
        yield Bench(driver, device, wire, State(), known)


def near(efforts: tuple[float, float], starboard: float, port: float) -> bool:
    return efforts == pytest.approx((starboard, port), abs=1e-3)


def test_motors_do_as_commanded_whichever_way_they_are_mounted(bench: Bench) -> None:
    assert bench.driver.send(AHEAD, 1.0) == 0
    assert near(bench.device.efforts(1.0), 0.5, 0.25)
    assert bench.driver.send(AHEAD._replace(thrust=(-1.0, 0.0)), 1.2) == 0
    assert near(bench.device.efforts(1.2), -1.0, 0.0)


def test_a_command_to_stop_stops_them_whatever_else_it_says(bench: Bench) -> None:
    bench.driver.send(AHEAD, 1.0)
    bench.driver.send(AHEAD._replace(run=False), 1.1)
    assert near(bench.device.efforts(1.1), 0.0, 0.0)
    bench.driver.send(AHEAD, 1.2)
    assert near(bench.device.efforts(1.2), 0.5, 0.25)
    bench.driver.stop()
    assert near(bench.device.efforts(1.3), 0.0, 0.0)


def test_the_stop_of_a_driver_that_sent_nothing_stops_them(bench: Bench) -> None:
    """The supervisor's, after the runtime's own sent commands."""
    bench.driver.stop()
    assert near(bench.device.efforts(1.0), 0.0, 0.0)


def test_silence_stops_those_that_stop_by_themselves(bench: Bench) -> None:
    bench.driver.send(AHEAD, 1.0)
    assert near(bench.device.efforts(1.0), 0.5, 0.25)
    if bench.device.timeout_s is not None:
        assert near(bench.device.efforts(1.01 + bench.device.timeout_s), 0.0, 0.0)


def test_repetitions_keep_them_running_and_a_frozen_one_no_longer_than_the_loop_repeats(bench: Bench) -> None:
    if bench.driver.period_s is None:
        assert bench.driver.repeat(1.0) == 0
        return
    bench.driver.send(AHEAD, 1.0)
    for step in range(10):
        bench.driver.repeat(1.0 + step * bench.driver.period_s)
        assert near(bench.device.efforts(1.0 + step * bench.driver.period_s), 0.5, 0.25)
    bench.driver.send(OFF, 4.0)
    bench.driver.repeat(4.2)
    assert near(bench.device.efforts(4.2), 0.0, 0.0)


def test_what_they_report_is_in_the_state(bench: Bench) -> None:
    bench.driver.send(AHEAD, 6.9)
    bench.device.efforts(6.9)
    bench.device.report(7.0)
    (reports,) = bench.driver.inputs
    reports.read(bench.state, 7.0)
    starboard, port = bench.state.thrusters["starboard"], bench.state.thrusters["port"]
    assert starboard == bench.known.starboard
    if port.rpm is not None:
        assert port.rpm == pytest.approx(-375.0), "as mounted the right way"


def test_noise_raises_nothing_reports_nothing_and_is_counted(bench: Bench) -> None:
    random, (reports,) = Random(16), bench.driver.inputs
    for _ in range(200):
        bench.device.noise(random)
        reports.read(bench.state, 7.0)
    assert bench.state.counts[f"{bench.driver.name}_malformed"] > 20
    told = [each for each in bench.state.thrusters.values() if each._replace(heard_s=7.0) != ThrusterReport(7.0)]
    assert bench.driver.name == "vesc" or told == [], "bytes on a CAN bus have no other sign that they are whole"


def front_seat(name: str) -> tuple[Actuator, Device, Wire]:
    """A row of DRIVERS without a bus, after the greeting."""
    known, wire = DRIVERS[name], Wire()
    links = Links(lambda name, filters: None, lambda device, baud: wire)
    driver, device = open_actuator(known.settings.thrusters[0].driver, known.settings, links), known.device(None, wire)
    greet(driver, device)
    return driver, device, wire


@pytest.mark.parametrize(("name", "manual"), [("mavlink_front_seat", 0), ("px4", 1)])
def test_a_board_that_does_not_obey_says_why_and_hears_a_ground_station(name: str, manual: int) -> None:
    driver, board, _ = front_seat(name)
    state, before = State(), board.played.heartbeats
    faults = ((False, manual, ("not armed",)), (True, 4, (f"its mode is 4, not MANUAL ({manual})",)), (True, manual, None))
    for armed, mode, why in faults:
        board.played.armed, board.played.mode = armed, mode
        board.report(1.0)
        driver.inputs[0].read(state, 1.0)
        assert state.thrusters["port"].faults == why
        assert state.thrusters["port"].refuses == "".join(why or ())
    for tick in range(15):
        driver.repeat(1.0 + 0.2 * tick)
    assert board.efforts(4.0) == (0.0, 0.0)
    assert board.played.heartbeats - before == 3, "one a second, and no command that moves it"


@pytest.mark.parametrize(
    ("name", "board", "why"),
    [
        ("mavlink_front_seat", PlayedPx4(), "it is no ArduPilot, as mavlink_front_seat.autopilot has it"),
        ("px4", PlayedRover(), "it is no PX4, as mavlink_front_seat.autopilot has it"),
        ("px4", PlayedPx4((1, 15)), "PX4 1.15 is older than 1.16"),
        ("px4", PlayedPx4((2, 0)), ""),
    ],
    ids=["PX4 for ArduPilot", "ArduPilot for PX4", "old PX4", "new PX4"],
)
def test_a_board_that_would_read_the_throttle_otherwise_is_told_nothing(name: str, board: PlayedRover, why: str) -> None:
    """What stops the one is full astern to the other."""
    known, wire, state = DRIVERS[name], Wire(), State()
    driver = open_actuator("mavlink_front_seat", known.settings, Links(lambda name, filters: None, lambda device, baud: wire))
    device = RoverDevice(None, wire)
    device.played = board
    assert driver.send(AHEAD, 0.0) == 2, "before it is heard, too"
    assert wire.written == []
    greet(driver, device)
    for told in (AHEAD, OFF):
        wire.written.clear()
        assert driver.send(told, 1.0) == (2 if why and told.run else 0)
        assert bool(wire.written) is (not why)
    device.report(1.0)
    driver.inputs[0].read(state, 1.0)
    assert state.thrusters["port"].refuses == why


def test_the_gimbal_of_a_boat_is_not_taken_for_its_board() -> None:
    driver, board, _ = front_seat("mavlink_front_seat")
    board.played.autopilot = 8
    board.report(1.0)
    driver.inputs[0].read(State(), 1.0)
    assert driver.send(AHEAD, 1.0) == 0


def test_only_the_autopilot_of_the_board_speaks_for_it() -> None:
    """A gimbal or a camera on it has its system number, and may say that it is an autopilot, or tell a battery of its own."""
    settings = DRIVERS["mavlink_front_seat"].settings
    table = MavlinkFrontSeat(battery=True)
    wire, state = Wire(), State()
    links = Links(lambda name, filters: None, lambda device, baud: wire)
    driver = open_actuator("mavlink_front_seat", msgspec.structs.replace(settings, mavlink_front_seat=table), links)
    greet(driver, RoverDevice(None, wire))
    gimbal = dialect.MAVLink(None, 1, dialect.MAV_COMP_ID_GIMBAL)
    for told in (
        dialect.MAVLink_heartbeat_message(26, 12, 0, 0, 4, 3),
        dialect.MAVLink_sys_status_message(0, 0, 0, 0, 3_200, 10, 3, 0, 0, 0, 0, 0, 0),
    ):
        wire.waiting.append(told.pack(gimbal))
    driver.inputs[0].read(state, 1.0)
    assert state.sysstat == {}
    assert state.thrusters == {}
    wire.written.clear()
    assert driver.send(AHEAD, 1.0) == 0
    assert wire.written


def test_a_px4_at_rest_hears_its_sticks_in_the_middle_all_the_time() -> None:
    """It could not be armed otherwise, and would disarm after each stop."""
    driver, board, _ = front_seat("px4")
    for tick in range(100):
        assert driver.send(OFF, 0.2 * tick) == 0
        driver.repeat(0.2 * tick + 0.1)
        assert board.efforts(0.2 * tick + 0.1) == (0.0, 0.0)
    assert board.played.armed


def test_full_astern_and_full_turn_are_not_the_gesture_that_disarms_a_px4() -> None:
    driver, board, _ = front_seat("px4")
    for starboard, port in ((-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -0.8)):
        driver.send(Actuation((starboard, port), (0.0, 0.0), True), 1.0)
        assert board.efforts(1.0) == pytest.approx((starboard, -port), abs=3e-3)
    assert board.played.armed


def test_the_dead_mans_stop_disarms_a_px4() -> None:
    """It has a connection of its own, and does not know which version listens."""
    wire = Wire()
    links = Links(lambda name, filters: None, lambda device, baud: wire)
    open_actuator("mavlink_front_seat", PX4, links).stop()
    board = Px4Device(None, wire)
    assert board.efforts(1.0) == (0.0, 0.0)
    assert not board.played.armed


@pytest.mark.parametrize("driver", ["otter", "heron", "mavlink_front_seat"])
def test_a_front_seat_is_left_alone_before_the_first_command_and_after_a_stop(driver: str) -> None:
    front, _, wire = front_seat(driver)
    front.send(OFF, 1.0)
    assert wire.written == []
    front.send(AHEAD, 1.0)
    for _ in range(100):
        front.send(OFF, 1.0)
    assert len(wire.written) == 11


@pytest.mark.parametrize("driver", ["otter", "heron", "mavlink_front_seat"])
def test_a_stop_that_the_line_does_not_take_is_said_until_it_does(driver: str) -> None:
    """A Heron would go on for ever with its last command, once a broken connection is back."""
    front, _, wire = front_seat(driver)
    front.send(AHEAD, 1.0)
    wire.is_full = True
    assert [front.send(OFF, 1.0) for _ in range(30)] == [2] * 30
    wire.is_full = False
    wire.written.clear()
    for _ in range(30):
        assert front.send(OFF, 1.0) == 0
    assert len(wire.written) == 10


@pytest.mark.parametrize(("command", "full"), [("duty", 0.95e5), ("current", 20e3), ("rpm", 10_500)])
def test_a_vesc_is_told_duty_current_or_speed(command: str, full: float) -> None:
    sent = list[tuple[int, bytes]]()

    class Bus:
        name = "can1"

        def send_many(self, frames: list[tuple[int, bytes]]) -> int:
            sent.extend(frames)
            return 0

    boat = settings("vesc", vesc=Vesc(command=command))
    driver = open_actuator("vesc", boat, Links(lambda name, filters: Bus(), lambda device, baud: None))
    driver.send(AHEAD, 1.0)
    kind = {"duty": 0, "current": 1, "rpm": 3}[command]
    assert sent[0] == (extended(kind << 8), round(0.5 * full).to_bytes(4, "big"))
    sent.clear()
    driver.send(AHEAD._replace(thrust=(0.0, 1.0)), 1.0)
    assert sent[0] == (extended(0), b"\0\0\0\0"), "at rest it is held, whatever it is told otherwise"


def test_motors_whose_pulses_cannot_be_written_do_not_obey() -> None:
    wire, state = Wire(), State()
    driver = open_actuator("pwm", settings("pwm"), Links(lambda name, filters: None, lambda device, baud: wire))
    for trouble in ("Remote I/O error", ""):
        wire.waiting.append(pack_answer(PulseAnswer(1, "stopped", trouble)))
        driver.inputs[0].read(state, 1.0)
        assert state.thrusters["starboard"].refuses == trouble


def test_a_servo_turns_with_the_angle_of_its_row() -> None:
    wire = Wire()
    row = config.ThrusterTable(
        name="outboard",
        driver="pwm",
        address=3,
        x_m=-1.0,
        thrust_n=(-50.0, 100.0),
        steer=config.Steer(kind="azimuth", address=4, angle_max_deg=30.0),
    )
    boat = config.Vehicle(boat=config.BoatTable(name="test"), thrusters=(row,))
    driver = open_actuator("pwm", boat, Links(lambda name, filters: None, lambda device, baud: wire))
    driver.send(Actuation((0.5,), (-0.2618,), True), 1.0)
    assert unpack_command(wire.written[0]).fractions[3:5] == pytest.approx((0.5, -0.5), abs=1e-3)


AZIMUTH = config.Steer(kind="azimuth", address=1)


@pytest.mark.parametrize(
    ("driver", "changes", "reason"),
    [
        ("vesc", {}, "starboard: vesc.command is rpm: rpm_max must say"),
        ("vesc", {"rpm_max": 1.0, "steer": AZIMUTH}, "it cannot steer"),
        ("otter", {"steer": AZIMUTH}, "turns nothing"),
        ("heron", {"address": 2}, "has address 0, starboard, and 1, port"),
        ("mavlink_front_seat", {"driver": "pwm"}, "mixes two sides"),
        ("pwm", {"steer": AZIMUTH}, "starboard and port have one address, 1 of pwm"),
        ("pwm", {"address": 1, "steer": AZIMUTH}, "its motor and what turns it have one address"),
        ("pwm", {"address": 16}, "channels 0 to 15, not 16"),
    ],
)
def test_rows_that_a_driver_cannot_drive_are_refused_in_words(driver: str, changes: dict[str, object], reason: str) -> None:
    rows = [{"name": n, "driver": driver, "address": a, "y_m": 0.5 - a, "thrust_n": (-50.0, 50.0)} for a, n in enumerate(NAMES)]
    thrusters = tuple(config.ThrusterTable(**row) for row in (rows[0] | changes, rows[1]))
    with pytest.raises(ValueError, match=reason):
        config.Vehicle(boat=config.BoatTable(name="test"), thrusters=thrusters)
