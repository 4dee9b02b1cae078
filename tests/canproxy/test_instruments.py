"""Instruments on NMEA 2000: recorded traffic of real boats, against the independent decoder, and whatever else may come."""

import logging
import math
import struct
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea2000.decoder import NMEA2000Decoder

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError, FormatError
from delfim.base.frames import Frame, extended
from delfim.base.tables import decode as decode_table
from delfim.canproxy.nmea2000 import instruments, ownpgns
from delfim.canproxy.nmea2000.device import device_name
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.instruments import FAST, KELVIN, MESSAGES, Battery, BatteryCharge, decode
from delfim.canproxy.socket import accepts
from delfim.parts.nmea2000.sensor import FILTERS, VALUES, Nmea2000Instruments
from delfim.parts.nmea2000.table import Nmea2000
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.log import record
from delfim.vehicle.state import NoLog, State
from tests.canproxy.pgn_of import pgn_of
from tests.canproxy.test_recordings import BUSY, RAYMARINE, recording

COUNTS = {  # complete messages of both recordings
    127506: 80, 127508: 156, 128259: 444, 128267: 433, 130306: 1870, 130310: 118, 130311: 512, 130312: 622, 130316: 90,
}  # fmt: skip


def celsius(kelvin: float | None) -> float | None:
    return None if kelvin is None else kelvin - KELVIN


def expected(pgn: int, f: dict[str, Any]) -> object:
    """The independent decoder's fields in the form of ours."""
    place = {0: "water_c", 1: "air_c"}
    match pgn:
        case 127506:
            charge = None if f["stateOfCharge"] is None else f["stateOfCharge"] / 100.0
            return BatteryCharge(f["instance"], charge) if f["dcType"] == 0 else None
        case 127508:
            return Battery(f["instance"], f["voltage"], f["current"], celsius(f["temperature"]))
        case 128259:
            return (("speed_water_mps", f["speedWaterReferenced"]),)
        case 128267:
            return ("depth_m", f["depth"]), ("depth_offset_m", f["offset"])
        case 130306:
            kind = {2: "apparent", 3: "true", 4: "true"}.get(f["reference"])
            return kind and ((f"wind_{kind}_rad", f["windAngle"]), (f"wind_{kind}_mps", f["windSpeed"]))
        case 130310:
            return (
                ("water_c", celsius(f["waterTemperature"])),
                ("air_c", celsius(f["outsideAmbientAirTemperature"])),
            )
    source = f["temperatureSource"] if pgn == 130311 else f["source"]
    kelvin = f["actualTemperature"] if pgn == 130312 else f["temperature"]
    return ((place[source], celsius(kelvin)),) if source in place else None


def flat(told: object) -> list[object]:
    """Names and numbers of a value, however it is nested."""
    return [each for part in told for each in flat(part)] if isinstance(told, tuple) else [told]


def test_every_field_of_every_instrument_is_what_the_independent_decoder_says() -> None:
    logging.getLogger("nmea2000").setLevel(logging.ERROR)
    count: Counter[int] = Counter()
    for name in (BUSY, RAYMARINE):
        theirs, fast = NMEA2000Decoder(), {pgn: FastPacket(Counter()) for pgn in FAST}
        for line in recording(name):
            _, pgn, address, _ = pgn_of(line.frame.arb)
            if pgn not in MESSAGES:
                continue
            message = theirs.decode(line.text)
            data = fast[pgn].feed(address, line.frame.data, line.now_s) if pgn in FAST else line.frame.data
            assert (data is None) == (message is None)
            if data is None or message is None:
                continue
            count[pgn] += 1
            mine = decode(pgn, data)
            other = expected(pgn, {field.id: field.raw_value for field in message.fields})
            assert type(mine) is type(other)
            for value, wanted in zip(flat(mine), flat(other), strict=True):
                assert value == (wanted if isinstance(wanted, str) or wanted is None else pytest.approx(wanted, abs=1e-9))
    assert count == COUNTS


@pytest.mark.parametrize(
    ("pgn", "data", "words"),
    [
        (128267, struct.pack("<BIhB", 0, 1_200_100, 0, 0xFF), "depth in m 12001"),
        (128267, bytes(7), "7 bytes instead of 8"),
        (128259, struct.pack("<BHHBH", 0, 20_100, 0, 0, 0), "speed through the water"),
        (130306, struct.pack("<BHHBH", 0, 100, 63_000, 2, 0), "angle of the wind"),
        (130312, struct.pack("<BBBHHB", 0, 0, 0, 100, 0, 0), "temperature in degrees Celsius -272"),
        (127506, struct.pack("<BBBB", 0, 0, 0, 101) + bytes(5), "charge in %"),
        (127506, bytes(8), "9 to 11"),
    ],
)
def test_what_no_boat_can_have_is_refused(pgn: int, data: bytes, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        decode(pgn, data)


@given(st.sampled_from(sorted(MESSAGES)), st.binary(max_size=20))
def test_any_bytes_are_values_within_bounds_or_refused(pgn: int, data: bytes) -> None:
    try:
        told = decode(pgn, data)
    except FormatError:
        return
    numbers = [each for each in flat(told) if isinstance(each, float)]
    assert all(math.isfinite(each) for each in numbers)
    assert {name for name in flat(told) if isinstance(name, str)} <= {value.name for value in VALUES}


class Bus:
    """The sensor alone, in lock step."""

    def __init__(self, **nmea2000: object) -> None:
        settings = config.Vehicle(boat=config.BoatTable(name="test"), nmea2000=Nmea2000(**nmea2000))  # type: ignore[arg-type]
        self.state = State()
        self._world = LockstepBus(ManualClock())
        self._outlet = self._world.socket("devices")
        self.sensor = Nmea2000Instruments(settings, self._world.bound(*FILTERS))

    def say(self, pgn: int, data: bytes, address: int, now_s: float) -> None:
        parts = [data]
        if pgn in FAST:
            whole = bytes((len(data),)) + data
            parts = [bytes((i,)) + whole[7 * i : 7 * i + 7].ljust(7, b"\xff") for i in range(-(-len(whole) // 7))]
        for part in parts:
            self._outlet.sendmsg(Frame(extended(6 << 26 | pgn << 8 | address), part))
        self.sensor.read(self.state, now_s)

    def claim(self, address: int, name: int) -> None:
        self._outlet.sendmsg(Frame(extended(0x18EEFF00 | address), name.to_bytes(8, "little")))
        self.sensor.read(self.state, 0.0)


def depth(metres: float | None, offset_mm: int = 0x7FFF) -> bytes:
    return struct.pack("<BIhB", 0, 0xFFFFFFFF if metres is None else round(metres * 100), offset_mm, 0xFF)


@pytest.mark.parametrize(("told_mm", "offset_m"), [(-400, -0.4), (1250, 1.25), (0, 0.0)])
def test_the_place_of_the_transducer_is_kept(told_mm: int, offset_m: float) -> None:
    """Above zero to the water line, below to the keel."""
    bus = Bus()
    bus.say(instruments.WATER_DEPTH, depth(4.0), 12, 1.0)
    assert "depth_offset_m" not in bus.state.measured
    bus.say(instruments.WATER_DEPTH, depth(4.0, told_mm), 12, 2.0)
    assert bus.state.measured == {"depth_m": (4.0, 2.0), "depth_offset_m": (pytest.approx(offset_m), 2.0)}


def test_the_preferred_sounder_counts_and_another_one_after_its_silence() -> None:
    bus = Bus(preferred_sources=(35,))
    bus.say(instruments.WATER_DEPTH, depth(4.0), 12, 1.0)
    assert bus.state.measured["depth_m"] == (4.0, 1.0)
    bus.say(instruments.WATER_DEPTH, depth(3.0), 35, 2.0)
    bus.say(instruments.WATER_DEPTH, depth(4.1), 12, 2.1)
    assert bus.state.measured["depth_m"] == (3.0, 2.0), "35 is preferred"
    bus.say(instruments.WATER_DEPTH, depth(None), 35, 3.0)
    assert bus.state.measured["depth_m"] == (3.0, 2.0), "no bottom found: the value ages"
    bus.say(instruments.WATER_DEPTH, depth(4.2), 12, 3.1)
    assert bus.state.measured["depth_m"] == (4.2, 3.1)


def test_batteries_of_the_file_are_the_boats_and_no_others() -> None:
    bus = Bus(batteries=(2, 0))
    power = struct.pack("<BhhHB", 2, 4810, -123, 29_315, 0)
    bus.say(instruments.BATTERY, power, 1, 1.0)
    bus.say(instruments.BATTERY, b"\x01" + power[1:], 1, 1.0)
    bus.say(instruments.BATTERY_CHARGE, struct.pack("<BBBBBHHH", 0, 2, 0, 55, 255, 0xFFFF, 0xFFFF, 0xFFFF), 1, 1.5)
    (report, at_s), *others = bus.state.sysstat.values()
    assert not others
    assert (report.voltage_v, report.current_a, report.charge, report.temperature_c, at_s) == (
        pytest.approx(48.1), pytest.approx(12.3), 0.55, 20, 1.5,
    )  # fmt: skip
    assert list(bus.state.sysstat) == ["batteries_starboard"]


def test_the_preferred_sounder_may_be_named_by_its_name() -> None:
    bus = Bus(preferred_sources=("c07891002fb34d62",))
    bus.claim(35, 0xC078_9100_2FB3_4D62)
    bus.say(instruments.WATER_DEPTH, depth(3.0), 35, 1.0)
    bus.say(instruments.WATER_DEPTH, depth(4.1), 12, 1.1)
    assert bus.state.measured["depth_m"] == (3.0, 1.0)
    bus.claim(36, 0xC078_9100_2FB3_4D62)
    bus.say(instruments.WATER_DEPTH, depth(5.0), 35, 1.2)
    bus.say(instruments.WATER_DEPTH, depth(3.1), 36, 1.3)
    bus.say(instruments.WATER_DEPTH, depth(5.0), 35, 1.4)
    assert bus.state.measured["depth_m"] == (3.1, 1.3)


def test_the_boat_does_not_take_what_it_says_itself_for_a_battery() -> None:
    bus = Bus(batteries=(0,), unique_number=77)
    said = ownpgns.battery(0, 25.0, -3.0, 20.0)
    bus.claim(100, device_name(77))
    bus.say(instruments.BATTERY, said, 100, 1.0)
    assert bus.state.sysstat == {}
    bus.say(instruments.BATTERY, said, 101, 1.0)
    assert bus.state.sysstat["batteries_starboard"][0].current_a == 3.0, "discharging, as it was said"  # type: ignore[union-attr]


def test_malformed_frames_are_counted_and_change_nothing() -> None:
    bus = Bus()
    bus.say(instruments.WATER_DEPTH, bytes(5), 12, 1.0)
    bus.say(instruments.WATER_DEPTH, struct.pack("<BIhB", 0, 2_000_000, 0, 0xFF), 12, 1.0)
    assert (bus.state.counts, bus.state.measured) == ({"nmea2000_128267_malformed": 2}, {})


def test_a_charge_of_which_a_frame_is_missing_is_counted_under_its_reason() -> None:
    bus, arb = Bus(batteries=(0,)), extended(6 << 26 | instruments.BATTERY_CHARGE << 8 | 1)
    for data, now_s in ((bytes((0, 9)) + bytes(6), 1.0), (bytes((0, 9)) + bytes(6), 2.0), (bytes(3), 2.1)):
        bus.sensor.hear(bus.state, Frame(arb, data), now_s)
    assert bus.state.counts == {"nmea2000_127506_timed_out": 1, "nmea2000_127506_malformed_frame": 1}


@given(st.lists(st.tuples(st.integers(0, 0xFFFFFFFF), st.binary(max_size=8)), max_size=30))
def test_no_frame_does_harm(frames: list[tuple[int, bytes]]) -> None:
    bus = Bus(batteries=(0, 1))
    for arb, data in frames:
        bus.sensor.hear(bus.state, Frame(arb, data), 1.0)
    for value, _ in bus.state.measured.values():
        assert math.isfinite(value)


def test_the_filters_pass_these_messages_and_no_navigation() -> None:
    def passes(pgn: int) -> bool:
        return any(accepts(each, extended(6 << 26 | pgn << 8 | 35)) for each in FILTERS)

    assert all(passes(pgn) for pgn in MESSAGES)
    assert not any(passes(pgn) for pgn in (127250, 129025, 129029, 60928))


def test_a_boat_without_another_use_for_the_bus_logs_and_tells_its_depth() -> None:
    settings = config.Vehicle(boat=config.BoatTable(name="test"), sensors=config.Sensors(names=("sysstat", "nmea2000")))
    run = Lockstep(settings, 1, lambda clock: NoLog())
    run.cycle()
    assert run.state.measured["depth_m"] == (12.0, 0.0), "of the modelled sounder"
    assert run.vehicle.report().measured == {"depth_m": 12.0, "depth_offset_m": 0.0}
    fields = record.of(settings)
    logged = dict(zip([f.name for f in fields.fields], record.values(fields, run.state, 0.0), strict=True))
    assert (logged["depth_m"], math.isnan(logged["water_c"])) == (12.0, True)  # type: ignore[arg-type]


def test_two_sensors_of_the_same_values_are_refused() -> None:
    tree = {"boat": {"name": "test"}, "sensors": {"names": ["nmea0183", "nmea2000"]}}
    tree["nmea0183"] = {"ports": {"a": {"device": "/dev/a"}}}
    with pytest.raises(ConfigError, match="name one of them"):
        decode_table(tree, config.Vehicle, "test.toml")
