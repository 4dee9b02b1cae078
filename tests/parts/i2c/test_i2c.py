"""Sensors on I2C: registers and packets of the data sheets, any bytes at all, buses that fail, and a voyage by a BNO085."""

import errno
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError, FormatError
from delfim.base.modes import Mode
from delfim.lines.nmea0183.framing import Sentences
from delfim.lines.nmea0183.sentences import Bearing, Measurement, Turning
from delfim.parts.i2c import i2cd, shtp
from delfim.parts.i2c.bmp390 import Bmp390, Trimming
from delfim.parts.i2c.bno085 import Bno085
from delfim.parts.i2c.chips import Air, ChipTurn, Supply, sentences
from delfim.parts.i2c.i2cd import WatchedBus, buses_of
from delfim.parts.i2c.icm20948 import Icm20948
from delfim.parts.i2c.ina226 import CONTINUOUS, Ina226
from delfim.parts.i2c.table import I2cSensor
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog
from tests.parts.i2c.played import (
    AIR,
    AIR_C,
    AIR_PA,
    TRIMMING,
    PlayedBmp390,
    PlayedBno085,
    PlayedBus,
    PlayedChip,
    PlayedIcm20948,
    PlayedIna226,
)

ROOT = Path(__file__).parents[3]
DELFIMX = ROOT / "etc/delfimx.toml"
BATTERY = I2cSensor(chip="ina226", shunt_ohm=0.001, empty_v=10.5, full_v=12.5, inner_ohm=0.02)
COMPASS = I2cSensor(chip="bno085")
angles = st.floats(-0.5, 0.5)


def read_ina(chip: PlayedIna226, table: I2cSensor = BATTERY) -> Supply | None:
    bus, device = PlayedBus(at_40=chip), Ina226(table)
    device.begin(bus)
    return device.read(bus, 0.0)


# --- INA226


def test_the_registers_of_an_ina226_are_volts_and_amperes():
    chip = PlayedIna226()
    chip.at |= {0x01: 0x1000, 0x02: 0x2570}  # 10.24 mV; 11.98 V, as the example of its data sheet (SBOS547, table 7) has it
    told = read_ina(chip)
    assert told is not None
    assert (told.voltage_v, told.current_a) == pytest.approx((11.98, 10.24))
    assert told.charge == pytest.approx((11.98 + 10.24 * 0.02 - 10.5) / 2.0)
    assert chip.written == [(0x00, CONTINUOUS.to_bytes(2, "big"))]


@given(volts=st.floats(0.0, 36.0), amperes=st.floats(-80.0, 80.0), turned=st.booleans())
def test_an_ina226_is_read_as_it_was_set(volts: float, amperes: float, turned: bool):
    table = I2cSensor(chip="ina226", shunt_ohm=0.001, reversed=turned)
    told = read_ina(PlayedIna226(volts, amperes * 0.001), table)
    assert told is not None
    assert told.voltage_v == pytest.approx(volts, abs=0.0007)
    assert told.current_a == pytest.approx(-amperes if turned else amperes, abs=0.0013)
    assert told.charge is None


def test_an_ina226_that_has_measured_nothing_new_says_nothing():
    chip, bus = PlayedIna226(), PlayedBus()
    bus.chips[0x40], device = chip, Ina226(BATTERY)
    device.begin(bus)
    assert device.read(bus, 0.0) is not None
    assert device.read(bus, 0.0) is None
    chip.measure(12.0, 0.02)
    assert device.read(bus, 0.0) == Supply(12.0, 20.0, pytest.approx(0.95))


@pytest.mark.parametrize(
    ("register", "value", "words"),
    [
        (0x01, 0x7FFF, "more current than 82 A, which its shunt can tell"),
        (0x01, 0x8000, "more current than 82 A"),
        (0x02, 0xFFFF, "a voltage below zero"),
        (0xFE, 0xFFFF, "no INA226 answers there"),
    ],
)
def test_what_no_battery_has_is_refused(register: int, value: int, words: str):
    chip = PlayedIna226()
    chip.at[register] = value
    with pytest.raises(FormatError, match=words):
        read_ina(chip)


# --- BMP390


def test_the_air_of_a_real_chip_is_what_another_program_reckons():
    air = Trimming(TRIMMING).air(AIR)
    assert air == (pytest.approx(AIR_PA, abs=1e-4), pytest.approx(AIR_C, abs=1e-6))
    bus, device = PlayedBus(at_76=PlayedBmp390()), Bmp390(I2cSensor(chip="bmp390", address=0x76))
    device.begin(bus)
    assert device.read(bus, 0.0) == air
    assert device.read(bus, 0.0) is None, "not the same one twice"


@given(trimming=st.binary(min_size=21, max_size=21), data=st.binary(min_size=6, max_size=6))
def test_any_registers_of_a_barometer_are_air_or_refused(trimming: bytes, data: bytes):
    try:
        air = Trimming(trimming).air(data)
    except FormatError:
        return
    assert 30_000.0 <= air.pressure_pa <= 125_000.0


def test_a_chip_that_is_no_barometer_is_refused():
    with pytest.raises(FormatError, match="no BMP390 answers there: the chip's number is 0x00, not 0x60"):
        Bmp390(I2cSensor(chip="bmp390", address=0x76)).begin(PlayedBus(at_76=PlayedChip()))


# --- BNO085


def begun(chip: PlayedBno085, table: I2cSensor = COMPASS) -> tuple[Bno085, PlayedBus]:
    bus, device = PlayedBus(at_4a=chip), Bno085(table)
    device.begin(bus)
    assert device.read(bus, 0.0) is None, "that it was reset, and what it can do"
    return device, bus


def test_a_heading_is_asked_for_as_the_data_sheet_has_it():
    chip = PlayedBno085()
    begun(chip)
    asked = bytes.fromhex("fd05000000a0860100") + bytes(8)  # rotation vector each 100,000 us: figure 5-1 of the data sheet
    assert chip.written[0] == (2, asked)
    assert chip.written[-1][1][:2] == bytes.fromhex("fd02")
    assert shtp.packed(2, 0, asked)[:4] == bytes.fromhex("15000200")


@given(
    heading_rad=st.floats(0.0, 6.28),
    rate_radps=st.floats(-4.0, 4.0),
    roll_rad=angles,
    pitch_rad=angles,
    turned_deg=st.floats(-180.0, 180.0),
)
def test_heading_attitude_and_rate_are_read_as_they_were_told(
    heading_rad: float, rate_radps: float, roll_rad: float, pitch_rad: float, turned_deg: float
):
    chip = PlayedBno085()
    device, bus = begun(chip)
    chip.measure(heading_rad, rate_radps, (roll_rad, pitch_rad))
    told = device.read(bus, 0.0)
    assert told is not None
    assert told.heading_rad is not None
    assert math.cos(told.heading_rad - heading_rad) == pytest.approx(1.0, abs=1e-6)
    assert told.rate_radps == pytest.approx(rate_radps, abs=0.001)
    assert told.attitude == pytest.approx((roll_rad, pitch_rad), abs=4e-4)
    chip = PlayedBno085()
    turned, bus = begun(chip, I2cSensor(chip="bno085", turned_deg=turned_deg))
    chip.measure(heading_rad + math.radians(turned_deg))  # lies turned on a level boat
    level = turned.read(bus, 0.0)
    assert level is not None
    assert level.heading_rad is not None
    assert math.cos(level.heading_rad - heading_rad) == pytest.approx(1.0, abs=1e-6)
    assert level.attitude == pytest.approx((0.0, 0.0), abs=4e-4)


def test_a_chip_that_lies_across_tells_roll_as_roll():
    chip = PlayedBno085()
    device, bus = begun(chip, I2cSensor(chip="bno085", turned_deg=90.0))
    chip.measure(math.pi / 2.0, attitude=(0.0, -0.2))  # x to starboard, and down
    told = device.read(bus, 0.0)
    assert told is not None
    assert math.cos(told.heading_rad or 0.0) == pytest.approx(1.0, abs=1e-6)
    assert told.attitude == pytest.approx((0.2, 0.0), abs=1e-3)


@pytest.mark.parametrize(("sure_deg", "quality", "known"), [(14.0, 1, True), (16.0, 3, False), (1.0, 0, False)])
def test_a_heading_of_which_it_is_not_sure_is_not_told(sure_deg: float, quality: int, known: bool):
    chip = PlayedBno085()
    device, bus = begun(chip)
    chip.measure(1.0, 0.1, sure_rad=math.radians(sure_deg), quality=quality)
    told = device.read(bus, 0.0)
    assert told is not None
    assert (told.heading_rad is not None) is known
    assert told.rate_radps == pytest.approx(0.1, abs=0.001)


def test_reports_that_repeat_themselves_and_a_chip_on_its_back():
    chip = PlayedBno085()
    device, bus = begun(chip)
    chip.frozen = True
    chip.measure(1.0)
    assert device.read(bus, 0.0) is not None
    chip.measure(1.0)
    assert device.read(bus, 0.0) is None
    chip.frozen = False
    chip.measure(1.0, attitude=(math.pi, 0.0))
    with pytest.raises(FormatError, match="its top up"):
        device.read(bus, 0.0)


def test_a_chip_that_was_reset_is_asked_again():
    chip = PlayedBno085()
    device, bus = begun(chip)
    chip.reset()
    device.read(bus, 0.0)
    chip.measure(2.0)
    told = device.read(bus, 0.0)
    assert told is not None
    assert told.heading_rad == pytest.approx(2.0, abs=1e-3)


@given(cargo=st.tuples(st.sampled_from((b"", b"\x02", b"\x05", b"\xfb")), st.binary(max_size=60)).map(b"".join))
def test_any_cargo_is_reports_or_refused(cargo: bytes):
    try:
        found = shtp.reports(cargo)
    except FormatError:
        return
    for each in found:
        if isinstance(each, shtp.Rotation):
            assert math.isclose(each.x**2 + each.y**2 + each.z**2 + each.w**2, 1.0, abs_tol=1e-9)


@pytest.mark.parametrize(
    ("head", "words"),
    [(b"\xff\xff\xff\xff", "nothing but ones"), (b"\x02\x00\x03\x00", "a packet of 2 bytes"), (b"\x00\x70\x03\x00", "28672")],
)
def test_a_length_that_no_packet_has_is_refused(head: bytes, words: str):
    with pytest.raises(FormatError, match=words):
        shtp.length_of(head)


# --- ICM-20948


class Icm:
    """The chip on its bus, read ten times a second."""

    def __init__(self, **keys: object) -> None:
        self.chip, self.now_s = PlayedIcm20948(), 50.0
        self.bus = PlayedBus(at_68=self.chip, at_0c=self.chip.mag)
        self.device = Icm20948(I2cSensor(chip="icm20948", address=0x68, **keys))
        self.device.begin(self.bus)

    def read(self, *told: object) -> ChipTurn | None:
        self.now_s += 0.1
        self.chip.measure(*told)
        return self.device.read(self.bus, self.now_s)


@given(heading_rad=st.floats(0.0, 6.28), roll_rad=angles, pitch_rad=angles)
def test_a_heading_of_the_field_is_right_however_the_boat_leans(heading_rad: float, roll_rad: float, pitch_rad: float):
    told = Icm().read(heading_rad, 0.0, (roll_rad, pitch_rad))
    assert told is not None
    assert told.heading_rad is not None
    assert math.cos(told.heading_rad - heading_rad) == pytest.approx(1.0, abs=1e-3)
    assert told.attitude == pytest.approx((roll_rad, pitch_rad), abs=1e-3)


def test_a_biased_gyro_leans_no_boat_and_turns_are_read():
    icm = Icm()
    icm.chip.bias = 0.08, -0.08, 0.0  # 5 degrees a second, as bad as the data sheet allows
    heading_rad = 0.0
    for _ in range(600):
        heading_rad += 0.02
        told = icm.read(heading_rad, 0.2)
    assert told is not None
    assert told.rate_radps == pytest.approx(0.2, abs=0.002)
    assert told.attitude == pytest.approx((0.0, 0.0), abs=0.01)
    assert math.cos((told.heading_rad or 0.0) - heading_rad) == pytest.approx(1.0, abs=1e-3)
    found = icm.device.calibration()
    assert found is not None
    assert found["hard_iron_ut"] == pytest.approx([0.0, 0.0, 0.0], abs=0.2)
    assert found["soft_iron"] == pytest.approx([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], abs=0.02)


def test_a_magnetometer_that_says_nothing_new_gives_no_heading():
    icm = Icm()
    assert icm.read(1.0) is not None
    icm.chip.measure(1.0)
    icm.chip.mag.at[0x10] = 0
    told = icm.device.read(icm.bus, icm.now_s + 0.1)
    assert told is not None
    assert (told.heading_rad, told.rate_radps) == (None, pytest.approx(0.0, abs=1e-3))
    assert icm.device.read(icm.bus, icm.now_s + 0.2) is None, "nor does the gyro"
    icm.chip.measure(1.0)
    icm.chip.mag.at[0x18] = 0x08
    told = icm.device.read(icm.bus, icm.now_s + 0.3)
    assert told is not None
    assert told.heading_rad is None, "a field too strong for it"


def test_chips_that_are_no_icm_are_refused():
    with pytest.raises(FormatError, match="no ICM-20948 answers there: the chip's number is 0x00, not 0xea"):
        Icm20948(I2cSensor(chip="icm20948", address=0x68)).begin(PlayedBus(at_68=PlayedChip()))
    chip = PlayedIcm20948()
    chip.mag.at[0x01] = 0x48
    with pytest.raises(FormatError, match="its magnetometer's number is 0x48, not 0x09"):
        Icm20948(I2cSensor(chip="icm20948", address=0x68)).begin(PlayedBus(at_68=chip, at_0c=chip.mag))


# --- sentences


def said(reading: ChipTurn | Supply | Air, name: str = "x") -> list[object]:
    line = Sentences()
    found = [each.message for each in line.feed(sentences(name, reading))]
    assert not line.refused
    return found


@given(heading_rad=st.floats(0.0, math.tau), rate_radps=st.floats(-8.0, 8.0), attitude=st.tuples(angles, angles))
def test_a_turn_is_read_as_it_was_told(heading_rad: float, rate_radps: float, attitude: tuple[float, float]):
    turning, measured, bearing = said(ChipTurn(heading_rad, rate_radps, attitude), "compass")
    assert isinstance(bearing, Bearing)
    assert bearing.magnetic_rad is not None
    assert math.cos(bearing.magnetic_rad - heading_rad) == pytest.approx(1.0, abs=1e-7)
    assert turning == Turning(pytest.approx(rate_radps, abs=2e-5))
    assert isinstance(measured, tuple)
    pitch, roll = measured
    assert (pitch.name, roll.name) == ("compass_pitch", "compass_roll")
    assert (math.radians(roll.value), math.radians(pitch.value)) == pytest.approx(attitude, abs=1e-4)


def test_a_battery_and_the_air_are_transducers():
    assert said(Supply(12.5, -3.25, 0.875), "battery") == [
        (
            Measurement("U", 12.5, "V", "battery"),
            Measurement("I", -3.25, "A", "battery"),
            Measurement("E", 87.5, "P", "battery"),
        )
    ]
    assert said(Supply(12.5, 0.0)) == [(Measurement("U", 12.5, "V", "x"), Measurement("I", 0.0, "A", "x"))]
    assert said(Air(101_325.0, 21.04)) == [(Measurement("P", 1.01325, "B", "x"), Measurement("C", 21.0, "C", "x"))]
    assert said(ChipTurn()) == []


# --- buses that fail


class Watch:
    """The sensors of a file on a played bus."""

    def __init__(self, bus: PlayedBus, **sensors: I2cSensor) -> None:
        self.clock, self.bus = ManualClock(monotonic_s=100.0), bus
        (self.watched,) = buses_of(sensors or {"battery": BATTERY}, self.clock, bus)

    def run(self, seconds: float) -> bytes:
        told, end_s = b"", self.clock.monotonic_s() + seconds
        while self.clock.monotonic_s() < end_s:
            told += self.watched.step()
            self.clock.advance(max(self.watched.due_s - self.clock.monotonic_s(), 0.01))
        return told

    def trouble(self, name: str = "battery") -> object:
        return self.watched.report()[name]["trouble"]


def test_a_battery_is_told_once_a_second():
    chip = PlayedIna226()
    watch = Watch(PlayedBus(at_40=chip))
    told = b""
    for _ in range(10):
        chip.measure(12.0, 0.001)
        told += watch.run(1.0)
    assert 8 <= told.count(b"IIXDR,U,12.000,V,battery,I,1.000,A,battery,E,76.0,P,battery") <= 10
    assert watch.watched.report()["battery"] == {
        "chip": "ina226",
        "age_s": pytest.approx(1.0, abs=0.2),
        "trouble": "",
        "told": told.count(b"\n"),
        "failed": 0,
    }


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (errno.EREMOTEIO, "nothing answers there: is it wired, and has it power?"),
        (errno.ETIMEDOUT, "the bus hangs: something holds its clock or data low"),
        (errno.EBUSY, "a driver of the kernel has it"),
        (errno.ENODEV, "nothing answers there"),
        (errno.EIO, "its answer broke off"),
    ],
)
def test_a_bus_that_fails_is_told_in_words_and_its_sensors_come_back(error: int, words: str):
    chip = PlayedIna226()
    watch = Watch(PlayedBus(at_40=chip))
    assert watch.run(2.5)
    watch.bus.error, before = error, watch.bus.transfers
    assert watch.run(30.0) == b""
    assert str(watch.trouble()).startswith(words)
    assert watch.bus.opened > 10, "one that was pulled out comes back as another one"
    assert watch.bus.transfers - before <= 40, "tried once a second, not as fast as it goes"
    watch.bus.error = 0
    chip.measure(12.0, 0.0)
    assert watch.run(4.0)
    assert watch.trouble() == ""


def test_a_bus_that_is_not_there_is_looked_for():
    watch = Watch(PlayedBus(at_40=PlayedIna226()))
    watch.bus.error = errno.ENOENT
    watch.run(5.0)
    assert watch.trouble() == "there is no such bus: is I2C switched on? (docs/i2c.md)"
    watch.bus.error = 0
    assert watch.run(4.0)


def test_one_lost_transfer_is_no_trouble():
    chip = PlayedBno085()
    watch = Watch(PlayedBus(at_4a=chip), compass=COMPASS)
    watch.run(0.5)
    chip.measure(1.0)
    assert watch.run(0.3)
    watch.bus.error = errno.EREMOTEIO
    watch.run(0.15)
    watch.bus.error = 0
    chip.measure(1.0)
    assert watch.run(0.3)
    assert (watch.trouble("compass"), watch.watched.report()["compass"]["failed"]) == ("", 2)


def test_a_chip_that_measures_nothing_new_is_set_up_anew():
    chip = PlayedIna226()
    watch = Watch(PlayedBus(at_40=chip))
    watch.run(2.0)
    written = len(chip.written)
    watch.run(5.0)
    assert watch.trouble() == "it answers, and measures nothing new for 3 s"
    watch.run(2.0)
    assert len(chip.written) > written
    silent = PlayedBno085()
    watch = Watch(PlayedBus(at_4a=silent), compass=COMPASS)
    watch.run(8.0)
    assert (shtp.EXECUTABLE, bytes((shtp.RESET,))) in silent.written, "a BNO085 is reset, too"


def test_a_sensor_that_fails_takes_nothing_from_its_neighbours():
    chip = PlayedBno085()
    watch = Watch(PlayedBus(at_4a=chip), battery=BATTERY, compass=COMPASS)
    told = b""
    for _ in range(50):
        chip.measure(1.0)
        told += watch.run(0.1)
    assert told.count(b"HCHDG") >= 40
    assert watch.trouble() == "nothing answers there: is it wired, and has it power?"


@given(answers=st.lists(st.binary(max_size=40), max_size=30))
def test_any_answers_of_a_bus_are_survived(answers: list[bytes]):
    class Garbled(PlayedChip):
        def _next(self, size: int) -> bytes:
            return (answers.pop() if answers else b"").ljust(size, b"\x05")[:size]

        def registers(self, first: int, size: int) -> bytes:
            return self._next(size)

        def read(self, size: int) -> bytes:
            return self._next(size)

        def write(self, data: bytes) -> None:
            pass

    bus = PlayedBus(at_40=Garbled(), at_4a=Garbled(), at_76=Garbled(), at_68=Garbled(), at_0c=Garbled())
    sensors = {"air": I2cSensor(chip="bmp390", address=0x76), "other": I2cSensor(chip="icm20948", address=0x68)}
    watch = Watch(bus, battery=BATTERY, compass=COMPASS, **sensors)
    watch.run(5.0)


def test_a_round_that_does_not_come_back_is_told():
    bus = PlayedBus(at_40=PlayedIna226())
    clock = ManualClock(monotonic_s=100.0)
    watched = WatchedBus("/dev/i2c-1", (i2cd.WatchedSensor("battery", BATTERY),), clock, bus)
    watched.busy_s = 90.0
    assert watched.report()["battery"]["trouble"] == "/dev/i2c-1 has not come back for 10 s"


# --- the vehicle's file

PORT = (
    'nmea0183.ports.i2c.device="udp:127.0.0.1:10120"',
    'i2c.to="udp:127.0.0.1:10120"',
    'i2c.sensors.compass.chip="bno085"',
)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (("i2c.sensors.compass.address=0x68",), "address: a bno085 has one of 0x4a to 0x4b, not 0x68"),
        (('i2c.sensors.compass.bus="/dev/ttyUSB0"',), "/dev/i2c-NUMBER, as ls /dev/i2c-* lists them"),
        (('i2c.to="udp:127.0.0.1:10121"',), "i2c.to: no port of nmea0183 has the device udp:127.0.0.1:10121"),
        (('i2c.to="udp:10.0.0.1:10121"',), "udp:127.0.0.1:PORT, or empty"),
        (
            ('i2c.sensors.second.chip="bno085"',),
            "i2c.sensors.second: /dev/i2c-1 has compass at 0x4a already",
        ),
        (
            ('i2c.sensors.battery={chip="ina226", empty_v=12.0, full_v=11.0}',),
            "full_v: 11 V is not above empty_v, 12 V",
        ),
        (('i2c.sensors.compass={chip="icm20948", rate_hz=2.0}',), "rate_hz: an icm20948 needs 5 or more"),
        (
            ('i2c.sensors.a.chip="icm20948"', 'i2c.sensors.b={chip="icm20948", address=0x68}'),
            "i2c.sensors.b: /dev/i2c-1 has the magnetometer of a at 0xc",
        ),
        (('i2c.sensors.compass.chip="mpu6050"',), '"mpu6050" is not allowed'),
    ],
)
def test_a_file_that_cannot_be_is_refused_in_words(values: tuple[str, ...], words: str):
    with pytest.raises(ConfigError) as error:
        config.load(DELFIMX, (*PORT, *values))
    assert words in str(error.value)


def test_a_sensor_at_the_address_of_the_motors_chip_is_refused():
    rows = ", ".join(f'{{name="m{at}", driver="pwm", address={at}, y_m={at - 0.5}, thrust_n=[-50.0, 50.0]}}' for at in (0, 1))
    battery = ('i2c.sensors.battery.chip="ina226"', 'pwm.chip="/dev/i2c-1"', f"thrusters=[{rows}]")
    with pytest.raises(ConfigError, match=r"i2c\.sensors\.battery: /dev/i2c-1 has pwm at 0x40 already"):
        config.load(DELFIMX, (*PORT, *battery))
    config.load(DELFIMX, (*PORT, *battery, "i2c.sensors.battery.address=0x41"))


# --- at sea

VARIATION_RAD = math.radians(-30.0)


class Voyage:
    """A boat by NMEA 0183 whose compass is a BNO085 on a played bus, which i2cd's sensors read and tell to its port."""

    def __init__(self, chip: str = "bno085") -> None:
        values = (
            *('simulation.instruments=["gnss:receiver"]', "nmea0183.variation_deg=-30.0"),
            *('nmea0183.pitch="compass_pitch"', 'nmea0183.roll="compass_roll"', 'nmea0183.batteries=["battery"]'),
            *('nmea0183.barometer="air"', 'sensors.names=["sysstat", "nmea0183"]'),
            *(*PORT[:2], f'i2c.sensors.compass.chip="{chip}"'),
            *('i2c.sensors.battery.chip="ina226"', 'i2c.sensors.air={chip="bmp390", address=0x76}'),
        )
        settings = config.load(ROOT / "etc/boats/bait-boat.toml", values)
        self.run = Lockstep(settings, 1, lambda clock: NoLog())
        self.line = self.run.lines["udp:127.0.0.1:10120"]
        self.compass, self.battery, self.air = PlayedBno085(), PlayedIna226(), PlayedBmp390()
        self.raw = PlayedIcm20948()
        raw = {"at_69": self.raw, "at_0c": self.raw.mag}
        self.bus = PlayedBus(at_4a=self.compass, at_40=self.battery, at_76=self.air, **raw)
        (self.watched,) = buses_of(settings.table("i2c").sensors, self.run.clock, self.bus)
        self.hangs = False

    def sail(self, seconds: float) -> None:
        run, next_s = self.run, 0.0
        for _ in run.cycles(seconds):
            now_s = run.clock.monotonic_s()
            if now_s < next_s or self.hangs:
                continue
            next_s = now_s + 0.1
            model = run.nodes.model
            self.compass.measure(model.heading_rad - VARIATION_RAD, model.yaw_rate_radps, (0.05, -0.02))
            self.raw.measure(model.heading_rad - VARIATION_RAD, model.yaw_rate_radps, (0.05, -0.02))
            self.battery.measure(25.0, 0.004)
            self.air.measure()
            if told := self.watched.step():
                self.line.put(told)


@pytest.fixture
def chip() -> str:
    return "bno085"


@pytest.fixture
def voyage(chip: str) -> Voyage:
    voyage = Voyage(chip)
    voyage.sail(6.0)
    assert voyage.run.command(console.Heading(90.0, 1.0)) is None
    voyage.sail(30.0)
    return voyage


@pytest.mark.parametrize("chip", ["bno085", "icm20948"])
def test_a_voyage_by_sensors_on_i2c(voyage: Voyage):
    run = voyage.run
    state, model = run.state, run.nodes.model
    assert (state.source, state.mode, state.counts) == ("nmea0183", Mode.HEADING, {})
    assert math.cos(state.motion.heading_rad - model.heading_rad) == pytest.approx(1.0, abs=0.005)
    assert math.cos(model.heading_rad - math.radians(90.0)) > 0.99
    assert state.navigation is not None
    assert (state.navigation.roll_rad, state.navigation.pitch_rad) == pytest.approx((0.05, -0.02), abs=0.03)
    battery, heard_s = state.sysstat["batteries_starboard"]
    assert battery[2:] == (25.0, 2.0, None, None)
    assert run.clock.monotonic_s() - heard_s < 1.5
    assert state.measured["air_pa"][0] == pytest.approx(AIR_PA, abs=0.1)
    run.close()


@pytest.mark.parametrize("kind", ["killed", "stopped", "silent", "garbage", "frozen", "unsure"])
def test_what_befalls_its_compass_stops_the_boat(voyage: Voyage, kind: str):
    match kind:
        case "killed" | "stopped":
            voyage.hangs = True
        case "silent":
            voyage.bus.error = errno.ETIMEDOUT
        case "garbage":
            voyage.compass.read = lambda size: b"\xa5" * size
        case "frozen":
            voyage.compass.frozen = True
        case "unsure":
            measure = voyage.compass.measure
            voyage.compass.measure = lambda *told: measure(*told, quality=0)
    voyage.sail(4.0)
    assert voyage.run.state.mode is not Mode.HEADING
    assert "heading silent" in voyage.run.state.reason
    assert not voyage.run.state.actuation.run
    voyage.run.close()
