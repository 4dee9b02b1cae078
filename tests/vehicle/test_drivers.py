"""What all drivers of thrusters have in common, each against its played device: commanded, stopped, silent, beside noise."""

import contextlib
import os
from collections import deque
from collections.abc import Callable, Iterator
from itertools import count
from random import Random
from typing import NamedTuple, Protocol

import pytest

from delfim import config
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.frames import extended
from delfim.pulses import PulseAnswer, pack_answer, unpack_command
from delfim.services.outlet import Guard
from delfim.vehicle.actuators import Actuator, open_actuator
from delfim.vehicle.links import Links
from delfim.vehicle.state import Actuation, State, ThrusterReport
from tests.vehicle.played_devices import PlayedRover, PlayedSeat, PlayedVesc

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

    def __init__(self, bus: CanSocket, wire: Wire) -> None:
        self._wire, self.played = wire, PlayedRover()

    def efforts(self, now_s: float) -> tuple[float, float]:
        while self._wire.written:
            self.played.hear(self._wire.written.pop(0), now_s)
        return self.played.efforts(now_s)

    def report(self, now_s: float) -> None:
        self._wire.waiting.append(self.played.report())

    def noise(self, random: Random) -> None:
        self._wire.waiting.append(random.randbytes(random.randrange(1, 50)) + b"\xfd")


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
DRIVERS = {
    "vesc": Known(settings("vesc"), VescDevice, ThrusterReport(7.0, 750.0, 5.5, 24.1, 31.4)),
    "otter": Known(
        settings("otter"), lambda bus, wire: SeatDevice(bus, wire, 3.0), ThrusterReport(7.0, 750.0, temperature_c=21.0)
    ),
    "heron": Known(settings("heron"), lambda bus, wire: SeatDevice(bus, wire, None), ThrusterReport(7.0, voltage_v=15.2)),
    "mavlink_front_seat": Known(settings("mavlink_front_seat"), RoverDevice, ThrusterReport(7.0, None, 4.5, 15.2)),
    "pwm": Known(PULSES, PwmDevice, ThrusterReport(7.0)),
}


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
        driver = open_actuator(request.param, known.settings, Links(bus, lambda device, baud: wire))
        yield Bench(driver, known.device(far, wire), wire, State(), known)


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
    bench.wire.is_full = True
    if bench.driver.name != "vesc":
        with pytest.raises(OSError, match="stop"):
            bench.driver.stop()


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


def test_a_line_that_is_full_is_counted(bench: Bench) -> None:
    bench.wire.is_full = True
    assert bench.driver.send(AHEAD, 1.0) == (0 if bench.driver.name == "vesc" else 2)


def test_a_board_that_does_not_obey_says_why_and_hears_a_ground_station() -> None:
    wire, state = Wire(), State()
    driver = open_actuator(
        "mavlink_front_seat", settings("mavlink_front_seat"), Links(lambda name, filters: None, lambda device, baud: wire)
    )
    board = RoverDevice(None, wire)
    for armed, mode, why in ((False, 0, ("not armed",)), (True, 4, ("its mode is 4, not MANUAL (0)",)), (True, 0, None)):
        board.played.armed, board.played.mode = armed, mode
        board.report(1.0)
        driver.inputs[0].read(state, 1.0)
        assert state.thrusters["port"].faults == why
        assert state.thrusters["port"].refuses == "".join(why or ())
    for tick in range(15):
        driver.repeat(1.0 + 0.2 * tick)
    assert board.efforts(4.0) == (0.0, 0.0)
    assert board.played.heartbeats == 3, "one a second, and no command of its own"


@pytest.mark.parametrize("driver", ["otter", "heron", "mavlink_front_seat"])
def test_a_front_seat_is_left_alone_before_the_first_command_and_after_a_stop(driver: str) -> None:
    wire = Wire()
    front = open_actuator(driver, settings(driver), Links(lambda name, filters: None, lambda device, baud: wire))
    front.send(OFF, 1.0)
    assert wire.written == []
    front.send(AHEAD, 1.0)
    for _ in range(100):
        front.send(OFF, 1.0)
    assert len(wire.written) == 11


@pytest.mark.parametrize("driver", ["otter", "heron", "mavlink_front_seat"])
def test_a_stop_that_the_line_does_not_take_is_said_until_it_does(driver: str) -> None:
    """A Heron would go on for ever with its last command, once a broken connection is back."""
    wire = Wire()
    front = open_actuator(driver, settings(driver), Links(lambda name, filters: None, lambda device, baud: wire))
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

    boat = settings("vesc", vesc=config.Vesc(command=command))
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
