"""Sensors on a DroneCAN bus: pydronecan makes the frames, the source and the batteries read them, field by field."""

import math
import struct
from collections.abc import Iterator
from random import Random

import dronecan
import pytest
from dronecan import transport, uavcan
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import BusError
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame, extended
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Navigation, Status
from delfim.canproxy.socket import ANYTHING
from delfim.parts.dronecan.sensor import open_sensor
from delfim.parts.dronecan.source import FLAT_S, DronecanNavigation, open_source
from delfim.parts.dronecan.table import Dronecan
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.build import build
from delfim.vehicle.inputhealth import KINDS
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.magnetic import Tilt
from delfim.vehicle.state import NoLog, State

EQ = uavcan.equipment
GNSS, COMPASS, BATTERY, MOTORS = 40, 41, 42, 20
GRAVITY = 9.80665
FIELD_GA, DIP = 0.44, math.radians(52.0)  # of the earth at Lisbon
UTC_US = 1_700_000_000_000_000
STALE_S = config.NavigationTable().stale_s
TWIN = tuple(
    config.ThrusterTable(name=name, driver="dronecan", address=address, y_m=y_m, thrust_n=(-10.0, 20.0))
    for address, (name, y_m) in enumerate((("starboard", 1.0), ("port", -1.0)))
)


def rounded(value: float, bits: int) -> float:
    code = {16: "<e", 32: "<f"}[bits]
    return struct.unpack(code, struct.pack(code, value))[0]


def fix(status: int = 3, mode: int = 0, sub_mode: int = 0, east_mps: float = 1.5, **said: float) -> object:
    message = EQ.gnss.Fix2(status=status, mode=mode, sub_mode=sub_mode, sats_used=14, pdop=1.5, gnss_time_standard=2)
    message.latitude_deg_1e8, message.longitude_deg_1e8 = 3_869_070_000, -921_530_000
    message.gnss_timestamp.usec = UTC_US
    message.ned_velocity = [-0.5, east_mps, 0.1]
    for name, value in said.items():
        setattr(message, name, value)
    return message


def field(vector: tuple[float, float, float], kind: int = 2) -> object:
    message = {
        1: EQ.ahrs.MagneticFieldStrength,
        2: EQ.ahrs.MagneticFieldStrength2,
        3: dronecan.dronecan.sensors.magnetometer.MagneticFieldStrengthHiRes,
    }[kind]()
    message.magnetic_field_ga = list(vector)
    return message


def imu(rate: tuple[float, float, float] = (0.0, 0.0, 0.0), force: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)) -> object:
    message = EQ.ahrs.RawIMU(integration_interval=0.02)
    message.rate_gyro_latest, message.accelerometer_latest = list(rate), list(force)
    return message


def turned(heading: float, roll: float = 0.0, pitch: float = 0.0) -> list[tuple[float, float, float]]:
    """North, east and down in the axes of a body that lies so: the rows of the usual rotation."""
    (ch, sh), (cr, sr), (cp, sp) = ((math.cos(each), math.sin(each)) for each in (heading, roll, pitch))
    return [
        (cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh),
        (cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch),
        (-sp, sr * cp, cr * cp),
    ]


def earth(axes: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    """The magnetic field in these axes, gauss."""
    north, _, down = axes
    level, deep = FIELD_GA * math.cos(DIP), FIELD_GA * math.sin(DIP)
    x, y, z = (level * n + deep * d for n, d in zip(north, down, strict=True))
    return x, y, z


def still(axes: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    x, y, z = (-GRAVITY * each for each in axes[2])
    return x, y, z


class Bench:
    """A source with its bus; time goes on by 0.1 s with each message."""

    def __init__(self, stale_s: float = STALE_S, **table: object) -> None:
        navigation = config.NavigationTable(sources=("dronecan",), stale_s=stale_s)
        self.settings = config.Vehicle(boat=config.BoatTable(name="test"), navigation=navigation, dronecan=Dronecan(**table))
        self.clock = ManualClock(100.0)
        self.bus = LockstepBus(self.clock)
        self.devices = self.bus.socket("devices")
        self.links = Links(lambda interface, filters: self.bus.bound(*filters), lambda device, baud, form="8N1": None)
        self.state = State()
        self.source: DronecanNavigation = open_source(self.settings, self.links, self.state)
        self.told = list[tuple[str, tuple[float, ...], int]]()
        self.deviations = list[tuple[str, float]]()
        self.source.tell(self.hear)
        self.numbers = dict[tuple[type, int], int]()

    def hear(self, kind: str, value: tuple[float, ...], utc_ns: int, deviation: float = 0.0) -> None:
        self.told.append((kind, value, utc_ns))
        self.deviations.append((kind, deviation))

    def say(self, message: object, node: int = GNSS) -> Navigation | None:
        for frame in frames(message, node, self.numbers):
            self.devices.sendmsg(frame)
        now_s = self.clock.monotonic_s()
        fix = self.source.read(now_s)
        self.clock.advance(0.1)
        if fix is None:
            return None
        assert fix.received_s == self.source.heard_s == now_s
        return fix.navigation

    def heading_deg(self) -> float | None:
        said = self.say(fix())
        return None if said is None or said.heading_rad is None else math.degrees(said.heading_rad)

    def settled(self) -> None:
        """Long enough that a node without an accelerometer is known to have none."""
        for _ in range(int(FLAT_S / 0.1) + 2):
            self.say(fix())


def frames(message: object, node: int, numbers: dict | None = None) -> Iterator[Frame]:
    numbers = {} if numbers is None else numbers
    key = str(message)[:60].partition("(")[0], node
    number = numbers[key] = numbers.get(key, -1) + 1 & 31
    sent = transport.Transfer(payload=message, source_node_id=node, transfer_id=number, transfer_priority=16)
    for frame in sent.to_frames():
        yield Frame(extended(frame.message_id), bytes(frame.bytes))


# The receiver.


def test_a_fix_of_pydronecan_is_this_message_field_by_field():
    random = Random(17)
    bench = Bench()
    for number in range(200):
        latitude, longitude = random.randint(-(89 * 10**8), 89 * 10**8), random.randint(-(180 * 10**8), 180 * 10**8)
        velocity = [rounded(random.uniform(-20.0, 20.0), 32) for _ in range(3)]
        satellites, hdop = random.randint(0, 63), rounded(random.uniform(0.5, 20.0), 16)
        bench.say(EQ.gnss.Auxiliary(hdop=hdop, sats_used=satellites))
        said = bench.say(
            fix(
                latitude_deg_1e8=latitude,
                longitude_deg_1e8=longitude,
                ned_velocity=velocity,
                sats_used=satellites,
                covariance=[0.5] * (number % 2 * 6),
            )
        )
        assert said == Navigation(
            UTC_US * 1000,
            pytest.approx(math.radians(latitude * 1e-8), abs=1e-12),
            pytest.approx(math.radians(longitude * 1e-8), abs=1e-12),
            velocity[0],
            velocity[1],
            None,
            None,
            None,
            None,
            3,
            satellites,
            hdop,
            number + 1 & 255,
            1.0 if number % 2 else None,
        )
        assert [kind for kind, *_ in bench.told[-2:]] == ["velocity", "position"]
        assert {utc_ns for *_, utc_ns in bench.told} == {UTC_US * 1000}
    assert not bench.state.counts


@pytest.mark.parametrize(
    "covariance",
    [
        [0.25, 0.25, 9.0, 0.01, 0.01, 9.0],
        [0.25, *(9.0,) * 5, 0.25, *(9.0,) * 8, 0.01, 9.0, 9.0, 0.01, 9.0, 9.0],
        [{0: 0.25, 7: 0.25, 21: 0.01, 28: 0.01}.get(place, 9.0) for place in range(36)],
    ],
    ids=len,
)
def test_the_accuracy_that_a_receiver_states_is_in_the_message_and_told_per_axis(covariance):
    bench = Bench()
    said = bench.say(fix(covariance=covariance))
    assert said.accuracy_m == pytest.approx(math.hypot(0.5, 0.5))
    assert bench.deviations == [("velocity", pytest.approx(0.1, abs=1e-4)), ("position", pytest.approx(0.5))]
    bench.say(dronecan.ardupilot.gnss.RelPosHeading(reported_heading_acc_available=True, reported_heading_acc_deg=0.5))
    assert bench.deviations[-1] == ("heading", pytest.approx(math.radians(0.5)))


@pytest.mark.parametrize("covariance", [[], [1.0], [math.nan] * 6, [0.0] * 6, [-1.0] * 6, [1.0] * 7], ids=str)
def test_an_accuracy_that_makes_no_sense_is_none(covariance):
    bench = Bench()
    assert bench.say(fix(covariance=covariance)).accuracy_m is None
    assert [deviation for _, deviation in bench.deviations] == [0.0, 0.0]
    assert bench.say(fix(0, covariance=[1.0] * 6)).accuracy_m is None, "and that of no position is none"


@pytest.mark.parametrize(
    ("status", "mode", "sub_mode", "kind"),
    [(0, 0, 0, 0), (1, 0, 0, 0), (2, 2, 1, 2), (3, 0, 0, 3), (3, 1, 0, 4), (3, 2, 0, 6), (3, 2, 1, 5), (3, 3, 0, 3)],
)
def test_the_kind_of_a_fix_and_no_fix_is_no_position(status, mode, sub_mode, kind):
    bench = Bench()
    said = bench.say(fix(status, mode, sub_mode))
    assert said.fix == kind
    assert (said.latitude_rad is None) == (said.north_mps is None) == (kind == 0)
    assert len(bench.told) == (2 if kind else 0)


def test_what_a_receiver_does_not_know_is_unknown():
    said = Bench().say(fix(ned_velocity=[math.nan, 1.0, 0.0], gnss_time_standard=0))
    assert said.north_mps is said.east_mps is said.hdop is None
    assert said.utc_ns == 0
    bench = Bench()
    bench.say(EQ.gnss.Auxiliary(hdop=math.nan))
    assert bench.say(fix()).hdop is None


def test_of_two_receivers_the_preferred_one_counts_and_the_other_takes_over():
    bench = Bench(preferred_sources=(GNSS + 5,))
    assert bench.say(fix(), GNSS) is not None
    assert bench.say(fix(), GNSS + 5) is not None
    assert bench.say(fix(), GNSS) is None
    bench.clock.advance(STALE_S)
    assert bench.say(fix(), GNSS) is not None
    assert bench.source.report(bench.clock.monotonic_s())["kinds"]["position"]["node"] == GNSS


# The compass.

ANGLE = st.floats(-math.pi, math.pi)
LEAN = st.floats(-0.5, 0.5)


@given(ANGLE, LEAN, LEAN, st.booleans(), ANGLE, st.sampled_from([1, 2, 3]))
def test_the_heading_is_the_boats_however_it_heels_and_however_the_device_lies(heading, roll, pitch, on_face, arrow, kind):
    bench = Bench(compass_deg=math.degrees(arrow), variation_deg=-1.5)
    axes = turned(heading, roll, pitch)  # of the boat
    c, s = math.cos(arrow), math.sin(arrow)
    axes = [(x * c + y * s, y * c - x * s, z) for x, y, z in axes]
    if on_face:
        axes = [(x, -y, -z) for x, y, z in axes]
    bench.say(fix())
    bench.say(imu(force=still(axes)), COMPASS)
    bench.say(field(earth(axes), kind), COMPASS)
    said = bench.say(fix())
    assert math.remainder(said.heading_rad - heading - math.radians(-1.5), math.tau) == pytest.approx(0.0, abs=0.01)
    assert said.roll_rad == pytest.approx(roll, abs=0.01)
    assert said.pitch_rad == pytest.approx(pitch, abs=0.01)
    assert said.yaw_rate_radps == 0.0
    assert 0.0 <= said.heading_rad < math.tau


def test_a_compass_without_an_accelerometer_is_taken_to_lie_flat_but_not_before_it_had_time_to_tell_its_gravity():
    bench = Bench()
    bench.say(fix())
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() is None
    bench.settled()
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() == pytest.approx(math.degrees(1.0), abs=0.3)
    told = bench.source.report(bench.clock.monotonic_s())
    assert told["compasses"][str(COMPASS)]["flat"] is True
    assert told["refused"] == {"compass without its tilt": 1}


def test_the_iron_of_the_boat_is_taken_off():
    bench = Bench(hard_iron_ut=(12.0, -30.0, 5.0), soft_iron=(1.1, 0.9, 1.0, 0.05, 0.0, -0.1))
    bench.settled()
    rows = (1.1, 0.05, 0.0), (0.05, 0.9, -0.1), (0.0, -0.1, 1.0)
    for heading_deg in range(0, 360, 30):
        wanted = earth(turned(math.radians(heading_deg)))
        x, y, z = wanted
        for _ in range(200):  # the measured field of which the calibration makes this, by trying
            made = [sum(a * b for a, b in zip(row, (x, y, z), strict=True)) for row in rows]
            x, y, z = (each + w - m for each, w, m in zip((x, y, z), wanted, made, strict=True))
        bench.say(field((x + 0.12, y - 0.30, z + 0.05), 3), COMPASS)
        assert math.remainder(bench.heading_deg() - heading_deg, 360.0) == pytest.approx(0.0, abs=0.1)


def test_a_boat_that_was_turned_through_a_circle_tells_its_calibration_and_with_it_the_heading_is_right():
    def measured(heading_deg: float) -> object:
        x, y, z = earth(turned(math.radians(heading_deg)))
        return field((1.2 * x + 0.12, 0.9 * y - 0.30, z), 3)

    def told(bench: Bench) -> object:
        return bench.source.report(0.0)["compasses"][str(COMPASS)]["calibration"]

    bench = Bench()
    for heading_deg in range(0, 360, 5):
        bench.say(measured(heading_deg), COMPASS)
        if heading_deg < 240:
            assert told(bench) == "turn the boat through two circles"
    calibration = told(bench)
    assert calibration["hard_iron_ut"] == pytest.approx([12.0, -30.0, 0.0], abs=0.1)
    again = Bench(**calibration)
    again.settled()
    for heading_deg in range(3, 360, 20):
        again.say(measured(heading_deg), COMPASS)
        assert math.remainder(again.heading_deg() - heading_deg, 360.0) == pytest.approx(0.0, abs=0.3)


def test_a_field_without_a_direction_is_no_heading_and_ends_the_one_before():
    bench = Bench()
    bench.settled()
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() is not None
    bench.say(field((0.01, 0.02, 0.4)), COMPASS)
    assert bench.heading_deg() is None


def test_one_magnetometer_of_a_device_counts():
    bench = Bench()
    bench.settled()
    for number, heading in ((3, 1.0), (4, 2.0)):
        message = field(earth(turned(heading)))
        message.sensor_id = number
        bench.say(message, COMPASS)
    assert bench.heading_deg() == pytest.approx(math.degrees(1.0), abs=0.3)


def test_two_antennas_are_better_than_a_compass_while_they_speak():
    bench = Bench(antennas_deg=-90.0)
    bench.settled()
    bench.say(field(earth(turned(1.0))), COMPASS)
    relative = dronecan.ardupilot.gnss.RelPosHeading(reported_heading_deg=30.0)
    for _ in range(int(STALE_S / 0.2) + 2):
        bench.say(relative, GNSS)
        bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() == pytest.approx(120.0)
    assert bench.told[-1][0] == "position"
    headings = [value for kind, value, _ in bench.told if kind == "heading"]
    assert headings[-1] == pytest.approx((math.radians(120.0),)), "the estimator hears them, too"
    bench.clock.advance(STALE_S)
    bench.settled()
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() == pytest.approx(math.degrees(1.0), abs=0.3)


# The gyro.


def test_the_rate_of_turn_is_around_the_vertical_whatever_the_device_calls_it():
    for axes in (turned(0.3), turned(0.3, roll=math.pi), turned(2.0, roll=0.4, pitch=-0.3)):
        bench = Bench()
        rate = tuple(0.2 * each for each in axes[2])  # to starboard
        bench.say(imu(rate, still(axes)), COMPASS)
        assert bench.told[-1] == ("rate", (pytest.approx(0.2, abs=1e-3),), 0)


def test_the_gyro_carries_the_tilt_through_a_wave_that_the_accelerometer_does_not_see():
    """On the side of a wave gravity and the boat's acceleration together point at the deck."""
    tilt = Tilt()
    for number in range(400):
        t_s = 0.02 * number
        roll, rate = 0.2 * math.sin(math.tau * t_s / 3.0), 0.2 * math.tau / 3.0 * math.cos(math.tau * t_s / 3.0)
        tilt.feed((rate, 0.0, 0.0), (0.0, 0.0, -GRAVITY), t_s)
        if t_s > 1.0:
            assert math.atan2(tilt.down[1], tilt.down[2]) == pytest.approx(roll, abs=math.radians(3.5))


def test_gravity_corrects_the_gyro_and_a_gap_or_a_set_clock_begins_anew():
    tilt = Tilt()
    for number in range(2000):
        tilt.feed((math.radians(0.3), 0.0, 0.0), (0.0, 0.0, -GRAVITY + 1e-3 * (number % 2)), 0.02 * number)
    assert math.degrees(math.atan2(tilt.down[1], tilt.down[2])) == pytest.approx(1.5, abs=0.1), "the bias by the time constant"
    for at_s in (100.0, 50.0):
        assert tilt.feed((0.0, 0.0, 0.1), still(turned(0.0, roll=0.3)), at_s) is not None
        assert math.atan2(tilt.down[1], tilt.down[2]) == pytest.approx(0.3)
    assert tilt.feed((0.0, 0.0, 0.1), (0.0, 0.0, -1.0), 200.0) is None, "that is no gravity"


def test_a_compass_whose_accelerometer_falls_silent_has_no_heading():
    bench = Bench()
    bench.say(fix())
    bench.say(imu(), COMPASS)
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() is not None
    for _ in range(int(STALE_S / 0.1) + 2):
        bench.say(fix())
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert bench.heading_deg() is None


def test_a_frozen_field_is_a_frozen_heading_and_a_frozen_gyro_a_frozen_rate_however_the_boat_heels():
    bench = Bench()
    bench.say(fix())
    for number in range(50):
        axes = turned(1.0, roll=0.2 * math.sin(0.3 * number))
        bench.say(imu((0.1, 0.0, 0.2), still(axes if number < 25 else turned(1.0))), COMPASS)
        bench.say(field(earth(turned(1.0))), COMPASS)
    for kind in ("heading", "rate"):
        told = [value for each, value, _ in bench.told if each == kind]
        assert len(set(told[-10:])) == 1, kind
        assert len(told) > 45


def test_silence_is_unknown():
    bench = Bench()
    bench.say(fix())
    bench.say(imu(), COMPASS)
    bench.say(field(earth(turned(1.0))), COMPASS)
    assert None not in bench.say(fix())[1:9]
    for _ in range(int(STALE_S / 0.1) + 2):
        said = bench.say(fix())
    assert said.heading_rad is said.yaw_rate_radps is said.roll_rad is None


# Batteries.


def battery(percent: int = 80, number: int = 0, flags: int = 1, **said: object) -> object:
    values = {"voltage": 25.5, "current": 3.0, "temperature": 293.0, **said}
    return EQ.power.BatteryInfo(
        state_of_charge_pct=percent, state_of_health_pct=127, battery_id=number, status_flags=flags, **values
    )


def heard(*messages: tuple[object, int]) -> State:
    bench = Bench()
    sensor = open_sensor(bench.settings, bench.links)
    for message, node in messages:
        for frame in frames(message, node):
            bench.devices.sendmsg(frame)
    sensor.read(bench.state, 5.0)
    return bench.state


@pytest.mark.parametrize(
    ("message", "name", "report"),
    [
        (battery(), "batteries_starboard", BatteriesStatus(Status.GOOD, Fault(0), 25.5, 3.0, 0.8, 20)),
        (
            battery(127, 1, voltage=math.nan, current=math.nan, temperature=0.0),
            "batteries_port",
            (0, 0, None, None, None, None),
        ),
        (battery(flags=8 | 32), "batteries_starboard", (Status.DEGRADED, Fault.OVERHEATED | Fault.OVERCURRENT)),
        (battery(flags=64), "batteries_starboard", (Status.BAD, Fault.HARDWARE)),
        (battery(flags=256), "batteries_starboard", (Status.BAD, Fault.HARDWARE)),
    ],
)
def test_a_battery_is_one_of_the_boats_batteries(message, name, report):
    state = heard((message, BATTERY))
    assert list(state.sysstat) == [name]
    assert state.sysstat[name][0][: len(report)] == tuple(report)
    assert state.sysstat[name][1] == 5.0


def test_of_two_devices_with_one_battery_the_first_counts_and_a_third_battery_is_counted():
    state = heard((battery(80), BATTERY), (battery(20), BATTERY + 1), (battery(5, 2), BATTERY))
    assert state.sysstat["batteries_starboard"][0].charge == 0.8
    assert state.counts == {"dronecan_other_batteries": 1}
    assert heard((battery(101), BATTERY)).counts == {"dronecan_malformed": 1}


# All of it on one bus, with the motors.


def test_one_bus_has_motors_and_sensors_and_low_batteries_send_the_boat_home():
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"),
        navigation=config.NavigationTable(sources=("dronecan",), rate_hz=10.0, estimator=True),
        sensors=config.Sensors(names=("dronecan",)),
        thrusters=TWIN,
    )
    clock, state = ManualClock(100.0), State()
    bus = LockstepBus(clock)
    devices = bus.socket("devices")
    devices.bind(ANYTHING)
    links = Links(lambda interface, filters: bus.bound(*filters), lambda device, baud, form="8N1": None)
    built = build(settings, clock, state, links, NoLog())
    numbers: dict = {}
    for number in range(200):
        wobble = 1e-4 * (number % 5)
        said = [(fix(latitude_deg_1e8=3_869_070_000 + number % 5, east_mps=wobble), GNSS)]
        said += [(imu((0.0, 0.0, wobble)), COMPASS), (field(earth(turned(1.0 + wobble)), 3), COMPASS)]
        said += [(EQ.esc.Status(esc_index=motor, rpm=0, voltage=24.0), MOTORS) for motor in (0, 1)]
        said += [(battery(80 if number < 100 else 20), BATTERY)] * (number % 10 == 0)
        for message, node in said:
            for frame in frames(message, node, numbers):
                devices.sendmsg(frame)
        for source in built.vehicle.sources:
            while built.vehicle.on_navigation(source):
                pass
        for each in built.inputs:
            built.vehicle.on_sensor(each)
        if number % 10 == 0:
            built.vehicle.on_watchdog()
        clock.advance(0.1)
    assert state.source == "dronecan"
    assert state.motion.has == {"position", "heading", "velocity"}
    assert state.motion.heading_rad == pytest.approx(1.0, abs=0.01)
    assert set(state.thrusters) == {"starboard", "port"}
    assert state.counts == {}
    assert [each.refused for each in state.inputs["dronecan"]] == [0] * len(KINDS)
    assert state.mode is Mode.IDLE
    assert any(notice.name == "battery_low" and "batteries starboard at 20%" in notice.reason for notice in state.notices)
    sent = set[int]()
    while (frame := devices.receive()) is not None:
        sent.add(frame.identifier >> 8 & 0xFFFF)
    assert 1030 in sent, "and the motors are commanded on it"


def test_a_bus_that_fails_is_counted():
    class Failing:
        def receive(self) -> None:
            raise BusError("off")

    bench = Bench()
    bench.source.input = Failing()
    assert bench.source.read(1.0) is None
    sensor = open_sensor(bench.settings, bench.links)
    sensor.input = Failing()
    sensor.read(bench.state, 1.0)
    assert bench.state.counts == {"dronecan_bus_errors": 2}


def test_a_flood_is_read_in_parts_and_nothing_of_it_is_lost():
    bench = Bench()
    for number in range(100):
        for frame in frames(field((0.2, 0.1, 0.3 + 1e-3 * number), 1), COMPASS, bench.numbers):
            bench.devices.sendmsg(frame)
    waiting = list[int]()
    while left := len(bench.source.input._transport.queue):
        waiting.append(left)
        bench.source.read(bench.clock.monotonic_s())
    assert waiting == [100, 84, 68, 52, 36, 20, 4]
    assert bench.source._said[COMPASS][0][2] == pytest.approx(39.9e-6, abs=1e-7)


# Whatever comes.


def test_mutated_frames_raise_nothing_and_nothing_grows(mutations):
    """About 26,000 frames; a million with --mutations 1600."""
    random = Random(17)
    bench = Bench()
    bench.source.tell(lambda kind, value, utc_ns, deviation=0.0: None)
    sensor = open_sensor(bench.settings, bench.links)
    relative = dronecan.ardupilot.gnss.RelPosHeading(reported_heading_deg=30.0)
    said = [fix(), EQ.gnss.Auxiliary(hdop=1.0), relative, field(earth(turned(1.0))), imu(), battery()]
    good = [list(frames(message, node)) for message in said for node in (1, GNSS, 125)]
    taken, sizes = 0, set[int]()
    for number in range(200 * mutations):
        for frame in random.choice(good):
            data, arb = bytearray(frame.data), frame.arb
            if random.random() < 0.1:
                data[random.randrange(len(data))] ^= 1 << random.randrange(8)
            if random.random() < 0.05:
                arb ^= random.choice((CAN_RTR, CAN_ERR, 1 << random.randrange(29)))
            if random.random() < 0.05:
                del data[random.randrange(len(data)) :]
            if random.random() > 0.02:
                bench.devices.sendmsg(Frame(arb, bytes(data)))
        bench.clock.advance(random.choice((0.0, 0.01, 0.1, 3.0)))
        found = bench.source.read(bench.clock.monotonic_s())
        sensor.read(bench.state, bench.clock.monotonic_s())
        if found is not None:
            taken += 1
            numbers = [each for each in found.navigation if each is not None]
            assert all(math.isfinite(each) for each in numbers), found
        if number % 1000 == 999:
            report = bench.source.report(bench.clock.monotonic_s())
            sizes.add(len(report["devices"]) + len(report["compasses"]))
    assert taken > 200
    refused = bench.source.report(0.0)["refused"]
    assert any(reason.endswith("impossible values") for reason in refused)
    assert any(reason.endswith("wrong checksum") for reason in refused)
    assert len(refused) < 30, "by kind, whatever comes"
    assert max(sizes) <= 254
    assert set(bench.state.counts) <= {"dronecan_malformed", "dronecan_other_batteries"}
    assert len(bench.source._receiver._streams) <= 64
