"""The DroneCAN codec: test vectors, random values there and back, pydronecan as judge byte for byte, and damaged frames."""

import contextlib
import math
import random
import struct
from collections.abc import Callable, Sequence

import dronecan
import pytest
from dronecan import transport, uavcan
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, extended, standard
from delfim.canproxy.dronecan import datatypes as types
from delfim.canproxy.dronecan.datatypes import (
    ALLOCATION,
    ARRAY_COMMAND,
    AUXILIARY,
    BATTERY_INFO,
    ESC_STATUS,
    FIX2,
    MAGNETIC_FIELD,
    MAGNETIC_FIELD_FINE,
    MAGNETIC_FIELD_FIRST,
    NODE_STATUS,
    RANGE,
    RAW_COMMAND,
    RAW_IMU,
    RELATIVE_HEADING,
    RPM_COMMAND,
    BatteryInfo,
    CommandKind,
    Dilution,
    EscStatus,
    GnssFix,
    ImuSample,
    MagneticField,
    NodeStatus,
    NumberRequest,
    RangeMeasured,
    RelativeHeading,
    decode,
)
from delfim.canproxy.dronecan.fields import DataType, WireField, pack, unpack
from delfim.canproxy.dronecan.nodenumbers import FOLLOW_UP_S, SILENT_S, Allocator
from delfim.canproxy.dronecan.transfers import COMMAND, SENSOR, STATUS, Publisher, Transfer, TransferReceiver, checksum
from delfim.canproxy.socket import accepts

EQ = uavcan.equipment
MESSAGE = uavcan.protocol.NodeStatus.kind
LISBON = math.radians(38.6907), math.radians(-9.2153)
KINDS = tuple(each for each in vars(types).values() if isinstance(each, DataType))
HEARD = tuple(kind for kind in KINDS if kind.id in types._READ)
ESC = pack(ESC_STATUS, (0, 24.0, 3.0, 300.0, -812, 17, 1))


def told(kind: DataType, payload: bytes, source: int = 20, priority: int = STATUS, number: int = 0) -> list[Frame]:
    """The frames of a message."""
    publisher = Publisher(kind, source, priority)
    for _ in range(number):
        publisher.frames(payload)
    return [Frame(arb, data) for arb, data in publisher.frames(payload)]


def heard(frames: Sequence[Frame], receiver: TransferReceiver | None = None) -> list[Transfer]:
    receiver = receiver or TransferReceiver(HEARD)
    return [transfer for frame in frames if (transfer := receiver.feed(frame, 0.0)) is not None]


# The wire, against vectors that two other implementations agree on.


@pytest.mark.parametrize(
    ("kind", "payload", "source", "priority", "number", "identifier", "data"),
    [
        (RAW_COMMAND, types.raw_command((-1000 / 8191, 2000 / 8191)), 10, COMMAND, 3, 0x0804060A, ["18f34070c3"]),
        (RPM_COMMAND, types.rpm_command((-1000, 2000)), 10, COMMAND, 3, 0x0804070A, ["18fcf401c0c3"]),
        (NODE_STATUS, types.node_status(258.9), 10, STATUS, 1, 0x1801550A, ["02010000000000c1"]),
        (types.ARMING_STATUS, types.ON, 10, SENSOR, 0, 0x10044C0A, ["ffc0"]),
        (types.SAFETY_STATE, types.ON, 10, SENSOR, 0, 0x104E200A, ["ffc0"]),
        (ARRAY_COMMAND, types.array_command([(1, CommandKind.UNITLESS, 0.25)]), 10, COMMAND, 0, 0x0803F20A, ["01000034c0"]),
        (ESC_STATUS, ESC, 20, 20, 5, 0x14040A14, ["60e8000000000085", "4e0042b05cd4fc25", "c88445"]),
    ],
)
def test_messages_are_these_bytes(kind, payload, source, priority, number, identifier, data):
    frames = told(kind, payload, source, priority, number)
    assert [frame.identifier for frame in frames] == [identifier] * len(data)
    assert [frame.data.hex() for frame in frames] == data
    assert all(frame.extended for frame in frames)


def test_the_checksum_is_the_usual_one():
    assert checksum(b"123456789") == 0x29B1


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_row_is_the_published_definition(kind):
    definition = dronecan.DATATYPES[kind.id, MESSAGE]
    assert definition.full_name.rpartition(".")[2] == kind.name
    assert checksum(struct.pack("<Q", definition.get_data_type_signature())) == kind.seed


# Values there and back.


def number_of(field: WireField) -> st.SearchStrategy[float]:
    if field.kind == "float":
        return st.floats(width=16 if field.bits == 16 else 32)
    if field.kind == "unsigned":
        return st.integers(0, (1 << field.bits) - 1)
    return st.integers(-1 << (field.bits - 1), (1 << (field.bits - 1)) - 1)


@st.composite
def messages(draw):
    kind = draw(st.sampled_from(KINDS))
    values = [draw(number_of(field)) for field in kind.fields if field.kind != "void"]
    repeats = draw(st.integers(0, kind.items_max)) if kind.item else 0
    return kind, values, [draw(number_of(field)) for _ in range(repeats) for field in kind.item]


def same(ours: Sequence[float], theirs: Sequence[float]) -> bool:
    return len(ours) == len(theirs) and all(a == b or (a != a and b != b) for a, b in zip(ours, theirs, strict=True))


@given(messages())
def test_all_values_of_a_message_come_back(message):
    kind, values, items = message
    receiver = TransferReceiver((kind,))
    (transfer,) = heard(told(kind, pack(kind, values, items)), receiver)
    assert transfer[:2] == (kind.id, 20)
    back_values, back_items = unpack(kind, transfer.payload)
    assert same(back_values, values)
    assert same(back_items[: len(items)], items)
    assert not receiver.errors


def bits_of(field: WireField, value: float) -> str:
    """A field as the specification has it, bit by bit."""
    raw = int.from_bytes(struct.pack({16: "<e", 32: "<f"}[field.bits], value), "little") if field.kind == "float" else value
    raw, (whole, odd) = int(raw) & ((1 << field.bits) - 1), divmod(field.bits, 8)
    return "".join(f"{raw >> 8 * i & 255:08b}" for i in range(whole)) + (f"{raw >> 8 * whole:0{odd}b}" if odd else "")


FIELDS = st.one_of(
    st.builds(WireField, st.sampled_from(("unsigned", "void")), st.integers(1, 64)),
    st.builds(WireField, st.just("signed"), st.integers(2, 64)),
    st.builds(WireField, st.just("float"), st.sampled_from((16, 32))),
)


@given(st.data(), st.lists(FIELDS, max_size=8), st.lists(FIELDS.filter(lambda each: each.kind != "void"), max_size=3))
def test_any_layout_is_read_and_written_as_bit_by_bit(data, fields, item):
    kind = DataType("Any", 1, 0, tuple(fields), tuple(item), 5)
    repeats = data.draw(st.integers(0, 5)) if item else 0
    given_all = [(each, 0 if each.kind == "void" else data.draw(number_of(each))) for each in (*fields, *item * repeats)]
    values, items = ([value for each, value in part if each.kind != "void"] for part in (
        given_all[: len(fields)], given_all[len(fields) :]
    ))  # fmt: skip
    bits = "".join(bits_of(each, value) for each, value in given_all)
    payload = pack(kind, values, items)
    assert payload == int(bits.ljust(8 * len(payload), "0") or "0", 2).to_bytes((len(bits) + 7) // 8, "big")
    back_values, back_items = unpack(kind, payload)
    assert same(back_values, values)
    assert same(back_items[: len(items)], items)


def test_a_number_beyond_its_field_becomes_the_nearest_one():
    assert unpack(RAW_COMMAND, pack(RAW_COMMAND, (), (9000, -9000)))[1] == (8191, -8192)
    assert unpack(ARRAY_COMMAND, pack(ARRAY_COMMAND, (), (300, -1, 1e6)))[1] == (255, 0, 65504.0)
    assert unpack(ARRAY_COMMAND, pack(ARRAY_COMMAND, (), (1, 1, -math.inf)))[1] == (1, 1, -math.inf)


@pytest.mark.parametrize(("values", "items"), [((1.0,), (1,)), ((), (1, 2)), ((), (0, 0, 0.0) * 16)])
def test_another_number_of_values_than_a_message_has_is_an_error(values, items):
    with pytest.raises(FormatError, match=r"ArrayCommand of \d values"):
        pack(ARRAY_COMMAND, values, items)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=20))
def test_the_quick_way_to_command_motors_is_the_general_one(fractions):
    assert types.raw_command(fractions) == pack(RAW_COMMAND, (), [round(fraction * 8191) for fraction in fractions])


# pydronecan as judge.

rnd = random.Random(16)


def f16(most: float = 50.0) -> float:
    return struct.unpack("<e", struct.pack("<e", rnd.uniform(-most, most)))[0]


def f32(most: float = 50.0) -> float:
    return struct.unpack("<f", struct.pack("<f", rnd.uniform(-most, most)))[0]


def of_raw_command():
    raw = [rnd.randint(-8192, 8191) for _ in range(rnd.randint(1, 20))]
    return RAW_COMMAND, EQ.esc.RawCommand(cmd=raw), (), raw


def of_rpm_command():
    rpms = [rnd.randint(-131072, 131071) for _ in range(rnd.randint(1, 20))]
    return RPM_COMMAND, EQ.esc.RPMCommand(rpm=rpms), (), rpms


def of_array_command():
    message, items = EQ.actuator.ArrayCommand(), []
    for number in range(rnd.randint(1, 15)):
        items += [number, number % 5, f16(1.0)]
        message.commands.append(EQ.actuator.Command(actuator_id=number, command_type=number % 5, command_value=items[-1]))
    return ARRAY_COMMAND, message, (), items


def of_esc_status():
    v = (rnd.getrandbits(32), f16(), f16(), f16(400), rnd.randint(-131072, 131071), rnd.getrandbits(7), rnd.getrandbits(5))
    names = ("error_count", "voltage", "current", "temperature", "rpm", "power_rating_pct", "esc_index")
    return ESC_STATUS, EQ.esc.Status(**dict(zip(names, v, strict=True))), v, ()


def of_node_status():
    v = rnd.getrandbits(32), rnd.getrandbits(2), rnd.getrandbits(3), rnd.getrandbits(3), rnd.getrandbits(16)
    names = ("uptime_sec", "health", "mode", "sub_mode", "vendor_specific_status_code")
    return NODE_STATUS, uavcan.protocol.NodeStatus(**dict(zip(names, v, strict=True))), v, ()


def of_battery_info():
    floats = [f16() for _ in range(7)]
    whole = [rnd.getrandbits(bits) for bits in (11, 7, 7, 7, 8, 32)]
    name = bytes(rnd.randrange(97, 122) for _ in range(rnd.randint(0, 31)))
    names = [
        *("temperature", "voltage", "current", "average_power_10sec", "remaining_capacity_wh", "full_charge_capacity_wh"),
        *("hours_to_full_charge", "status_flags", "state_of_health_pct", "state_of_charge_pct", "state_of_charge_pct_stdev"),
        *("battery_id", "model_instance_id"),
    ]
    message = EQ.power.BatteryInfo(**dict(zip(names, floats + whole, strict=True)))
    message.model_name = name.decode()
    return BATTERY_INFO, message, floats + whole, list(name)


def of_fix():
    message = EQ.gnss.Fix2()
    message.timestamp.usec, message.gnss_timestamp.usec = times = rnd.getrandbits(56), rnd.getrandbits(56)
    small = (2, 18, rnd.randint(-(10**10), 10**10), rnd.randint(-(10**9), 10**9), rnd.randint(-9999, 9999), 7)
    message.gnss_time_standard, message.num_leap_seconds, message.longitude_deg_1e8 = small[:3]
    message.latitude_deg_1e8, message.height_ellipsoid_mm, message.height_msl_mm = small[3:]
    message.ned_velocity = ned = [f32(), f32(), f32()]
    message.sats_used, message.status, message.mode, message.sub_mode = state = (14, 3, 2, 1)
    message.covariance = covariance = [f16() for _ in range(rnd.choice((0, 6, 36)))]
    message.pdop = pdop = f16(9.0)
    return FIX2, message, (*times, *small, *ned, *state, len(covariance)), [*covariance, pdop]


def of_auxiliary():
    v = [*(f16() for _ in range(7)), rnd.getrandbits(7), rnd.getrandbits(6)]
    names = [*(f"{letter}dop" for letter in "gphvtne"), "sats_visible", "sats_used"]
    return AUXILIARY, EQ.gnss.Auxiliary(**dict(zip(names, v, strict=True))), v, ()


def of_relative_heading():
    message = dronecan.ardupilot.gnss.RelPosHeading()
    message.timestamp.usec = time = rnd.getrandbits(56)
    v = rnd.getrandbits(1), f32(), f32(), f16(), f16()
    message.reported_heading_acc_available, message.reported_heading_deg, message.reported_heading_acc_deg = v[:3]
    message.relative_distance_m, message.relative_down_pos_m = v[3:]
    return RELATIVE_HEADING, message, (time, *v), ()


def of_range():
    message = EQ.range_sensor.Measurement()
    message.timestamp.usec = time = rnd.getrandbits(56)
    message.sensor_id, angles, known = rnd.getrandbits(8), [rnd.randint(-16, 15) for _ in range(3)], rnd.getrandbits(1)
    beam = message.beam_orientation_in_body_frame
    beam.fixed_axis_roll_pitch_yaw, beam.orientation_defined = angles, known
    v = f16(), rnd.getrandbits(5), rnd.getrandbits(3), f16()
    message.field_of_view, message.sensor_type, message.reading_type, message.range = v
    return RANGE, message, [time, message.sensor_id, *angles, known, *v], ()


def of_magnetic_field():
    field, covariance = [f16(1.0) for _ in range(3)], [f16() for _ in range(rnd.choice((0, 3, 9)))]
    message = EQ.ahrs.MagneticFieldStrength2(sensor_id=3)
    message.magnetic_field_ga, message.magnetic_field_covariance = field, covariance
    return MAGNETIC_FIELD, message, [3, *field], covariance


def of_first_magnetic_field():
    field, covariance = [f16(1.0) for _ in range(3)], [f16() for _ in range(rnd.choice((0, 3, 9)))]
    message = EQ.ahrs.MagneticFieldStrength()
    message.magnetic_field_ga, message.magnetic_field_covariance = field, covariance
    return MAGNETIC_FIELD_FIRST, message, field, covariance


def of_fine_magnetic_field():
    field = [f32(1.0) for _ in range(3)]
    message = dronecan.dronecan.sensors.magnetometer.MagneticFieldStrengthHiRes(sensor_id=3)
    message.magnetic_field_ga = field
    return MAGNETIC_FIELD_FINE, message, [3, *field], ()


def of_imu():
    message = EQ.ahrs.RawIMU()
    v = [f32(), *(f16() for _ in range(3)), *(f32() for _ in range(3)), *(f16() for _ in range(3)), *(f32() for _ in range(3))]
    message.timestamp.usec = time = rnd.getrandbits(56)
    message.integration_interval, message.rate_gyro_latest, message.rate_gyro_integral = v[0], v[1:4], v[4:7]
    message.accelerometer_latest, message.accelerometer_integral = v[7:10], v[10:13]
    return RAW_IMU, message, [time, *v], ()


def of_allocation():
    identity = [rnd.getrandbits(8) for _ in range(rnd.choice((6, 12, 16)))]
    message = uavcan.protocol.dynamic_node_id.Allocation(node_id=5, first_part_of_unique_id=1)
    message.unique_id = bytes(identity)
    return ALLOCATION, message, (5, 1), identity


@pytest.mark.parametrize(
    "make",
    [
        *(of_raw_command, of_rpm_command, of_array_command, of_esc_status, of_node_status, of_battery_info, of_fix),
        *(
            of_auxiliary,
            of_relative_heading,
            of_range,
            of_magnetic_field,
            of_first_magnetic_field,
            of_fine_magnetic_field,
            of_imu,
        ),
        of_range,
        of_allocation,
    ],
)
def test_random_transfers_are_byte_for_byte_those_of_pydronecan(make: Callable[[], tuple]):
    publishers: dict[int, Publisher] = {}
    for number in range(100):
        kind, message, values, items = make()
        theirs = transport.Transfer(payload=message, source_node_id=10, transfer_id=number, transfer_priority=16).to_frames()
        ours = publishers.setdefault(kind.id, Publisher(kind, 10, 16)).frames(pack(kind, values, items))
        assert [(extended(frame.message_id), bytes(frame.bytes)) for frame in theirs] == ours
        (transfer,) = heard([Frame(arb, data) for arb, data in ours], TransferReceiver((kind,)))
        back, more = unpack(kind, transfer.payload)
        assert same(back, values)
        assert same(more[: len(items)], items)


# What the boat reads of them.


@pytest.mark.parametrize(
    ("kind", "values", "items", "read"),
    [
        (NODE_STATUS, (77, 2, 1, 0, 9), (), NodeStatus(77, 2, 1, 9)),
        (ESC_STATUS, (4, 24.0, -3.0, 300.0, -812, 17, 1), (), EscStatus(4, 24.0, -3.0, pytest.approx(26.85), -812, 0.17, 1)),
        (ESC_STATUS, (0, math.nan, math.inf, 0.0, 5, 127, 0), (), EscStatus(0, None, None, None, 5, None, 0)),
        (
            BATTERY_INFO,
            (293.0, 25.5, 3.0, *(0.0,) * 4, 8, 127, 80, 1, 2, 7),
            b"bank",
            BatteryInfo(25.5, 3.0, pytest.approx(19.85), 0.8, None, 8, 2),
        ),
        (BATTERY_INFO, (*(math.nan,) * 7, 0, 99, 127, 1, 0, 0), b"", BatteryInfo(None, None, None, None, 0.99, 0, 0)),
        (
            FIX2,
            (1, 5_000_000, 2, 0, -921530000, 3869070000, 0, 0, 1.5, -0.5, 0.0, 14, 3, 2, 1, 2),
            (9.0, 9.0, 1.5),
            GnssFix(
                5_000_000_000,
                pytest.approx(math.radians(38.6907)),
                pytest.approx(math.radians(-9.2153)),
                1.5,
                -0.5,
                14,
                3,
                2,
                1,
                1.5,
            ),
        ),
        (AUXILIARY, (1.0, 2.0, 1.5, math.nan, 1.0, 1.0, 1.0, 20, 12), (), Dilution(1.5, 12)),
        (
            RELATIVE_HEADING,
            (1, 1, -90.0, 0.5, 0.75, 0.0),
            (),
            RelativeHeading(pytest.approx(math.radians(270.0)), pytest.approx(math.radians(0.5)), 0.75),
        ),
        (RELATIVE_HEADING, (1, 0, math.nan, 0.5, math.nan, 0.0), (), RelativeHeading(None, None, None)),
        (MAGNETIC_FIELD, (1, 0.25, 0.0, -0.5), (1.0,) * 9, MagneticField(1, pytest.approx((0.25e-4, 0.0, -0.5e-4)))),
        (MAGNETIC_FIELD_FIRST, (0.25, 0.0, -0.5), (), MagneticField(0, pytest.approx((0.25e-4, 0.0, -0.5e-4)))),
        (MAGNETIC_FIELD_FINE, (2, 0.25, 0.0, -0.5), (), MagneticField(2, pytest.approx((0.25e-4, 0.0, -0.5e-4)))),
        (RAW_IMU, (0, 0.1, *(1.0, 2.0, 3.0), *(0.0,) * 3, *(4.0, 5.0, 6.0), *(0.0,) * 3), (), ImuSample((1, 2, 3), (4, 5, 6))),
        (RANGE, (9, 4, 1, 2, 3, 1, 0.5, 2, 1, 12.5), (), RangeMeasured(4, 2, 12.5, 0.5)),
        (RANGE, (9, 4, 1, 2, 3, 1, math.nan, 1, 1, 12.5), (), RangeMeasured(4, 1, 12.5, 0.0)),
        (RANGE, (9, 4, 1, 2, 3, 1, 4.0, 3, 1, 0.0), (), RangeMeasured(4, 3, 0.0, 0.0)),
        (RANGE, (9, 4, 1, 2, 3, 1, 0.5, 2, 2, math.nan), (), RangeMeasured(4, 2, None, 0.0)),
        (ALLOCATION, (5, 1), (1, 2, 3), NumberRequest(5, True, b"\1\2\3")),
    ],
)
def test_messages_are_read_in_si_units_and_what_is_unknown_is_none(kind, values, items, read):
    assert decode(Transfer(kind.id, 20, pack(kind, values, tuple(items)))) == read


@pytest.mark.parametrize(
    ("kind", "values", "items", "words"),
    [
        (ESC_STATUS, (0, 0.0, 0.0, 0.0, 20_001, 0, 3), (), "impossible 20001 rpm of motor 3"),
        (BATTERY_INFO, (*(0.0,) * 7, 0, 0, 101, 0, 1, 0), (), "impossible charge of 101 %"),
        (FIX2, (0, 0, 2, 0, 0, 9_000_000_001, 0, 0, 0.0, 0.0, 0.0, 1, 3, 0, 0, 0), (1.0,), "impossible position"),
        (FIX2, (0, 0, 2, 0, 18_000_000_001, 0, 0, 0, 0.0, 0.0, 0.0, 1, 3, 0, 0, 0), (1.0,), "impossible position"),
        (FIX2, (0, 0, 2, 0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 1, 3, 0, 0, 6), (1.0,), "ends before"),
        (RANGE, (0, 4, 0, 0, 0, 0, 0.1, 2, 1, math.nan), (), "impossible distance nan m of rangefinder 4"),
        (RANGE, (0, 4, 0, 0, 0, 0, 0.1, 2, 1, -1.0), (), "impossible distance"),
        (RELATIVE_HEADING, (0, 0, 361.0, 0.0, 0.0, 0.0), (), "impossible heading"),
        (MAGNETIC_FIELD, (1, math.nan, 0.0, 0.0), (), "not finite"),
        (RAW_IMU, (0, 0.1, *(0.0,) * 6, *(math.inf, 0.0, 0.0), *(0.0,) * 3), (), "not finite"),
    ],
)
def test_impossible_values_are_refused_whole(kind, values, items, words):
    with pytest.raises(FormatError, match=words):
        decode(Transfer(kind.id, 20, pack(kind, values, items)))


# Damaged, repeated, interrupted.


def changed(frame: Frame, tail: int) -> Frame:
    return frame._replace(data=frame.data[:-1] + bytes((tail,)))


A = told(ESC_STATUS, ESC, number=1)
B = told(ESC_STATUS, ESC, number=2)
OTHER = told(ESC_STATUS, ESC, source=21)


@pytest.mark.parametrize(
    ("frames", "whole", "errors"),
    [
        (A + B, 2, {}),
        ([A[0], OTHER[0], A[1], OTHER[1], A[2], OTHER[2]], 2, {}),
        ([A[0], A[1], A[1], A[2]], 1, {"repeated frame": 1}),
        ([A[0], A[0], A[1], A[2]], 1, {"incomplete": 1}),
        ([*A, A[2]], 1, {"start lost": 1}),
        ([A[1], A[2]], 0, {"start lost": 2}),
        ([A[0], *B], 1, {"incomplete": 1}),
        ([A[0], B[1], A[1], A[2]], 0, {"incomplete": 1, "start lost": 2}),
        ([A[0], A[2]], 0, {"repeated frame": 1}),
        ([A[0]._replace(data=A[0].data[1:]), *A[1:]], 0, {"malformed frame": 1, "start lost": 2}),
        ([A[0], A[1]._replace(data=A[1].data[1:]), A[2]], 0, {"malformed frame": 1, "start lost": 1}),
        ([changed(A[0], A[0].data[-1] | 0x20)], 0, {"malformed frame": 1}),
        ([A[0]._replace(data=b"\xff" + A[0].data[1:]), *A[1:]], 0, {"Status: wrong checksum": 1}),
        ([A[0], changed(A[1], A[1].data[-1] | 0x40)], 0, {"Status: wrong checksum": 1}),
        ([Frame(A[0].arb), Frame(A[0].arb | CAN_RTR, A[0].data), Frame(CAN_ERR, bytes(8))], 0, {"not a message": 3}),
        ([Frame(standard(0x10), A[0].data), Frame(A[0].arb | 0x80 << 3, A[0].data)], 0, {"not a message": 2}),
        ([Frame(extended(24 << 24 | 1999 << 8 | 7), b"\1\xc0")], 0, {}),
        ([Frame(extended(1 << 8), b"\1\1\1\1\1\1\1\x80")], 0, {"malformed frame": 1}),
    ],
)
def test_frames_that_do_not_belong_together_are_counted_and_harmless(frames, whole, errors):
    receiver = TransferReceiver(HEARD)
    transfers = heard(frames, receiver)
    assert [each.payload for each in transfers] == [ESC] * whole
    assert dict(receiver.errors) == errors


def test_a_transfer_that_takes_too_long_is_dropped():
    receiver = TransferReceiver(HEARD)
    assert [receiver.feed(frame, now_s) for frame, now_s in zip(A, (0.0, 1.9, 2.1), strict=True)] == [None] * 3
    assert dict(receiver.errors) == {"incomplete": 1}


def test_no_more_than_so_many_transfers_are_under_way_and_the_oldest_gives_way():
    receiver = TransferReceiver(HEARD)
    many = [told(ESC_STATUS, ESC, source) for source in range(1, 66)]
    for now_s, frames in enumerate(many):
        receiver.feed(frames[0], now_s / 100.0)
    assert dict(receiver.errors) == {"incomplete": 1}
    assert len(heard(many[0][1:], receiver)) == 0
    assert len(heard([frame for frames in many[1:] for frame in frames[1:]], receiver)) == 64


def test_a_transfer_without_end_is_dropped():
    receiver = TransferReceiver(HEARD)
    start, *_ = told(ESC_STATUS, ESC)
    receiver.feed(start, 0.0)
    for number in range(50):
        receiver.feed(Frame(start.arb, bytes(7) + bytes((0x20 if number % 2 == 0 else 0,))), 0.0)
    assert receiver.errors["malformed frame"] == 1


@given(st.data(), st.lists(st.binary(min_size=8, max_size=300), min_size=1, max_size=4), st.booleans())
def test_transfers_that_mix_on_the_bus_arrive_each_as_it_was_sent(
    data: st.DataObject, payloads: list[bytes], loses: bool
) -> None:
    receiver = TransferReceiver(HEARD)
    left = [told(RAW_IMU, payload, source, number=source) for source, payload in enumerate(payloads, 1)]
    whole = dict(enumerate(payloads, 1))
    if loses:
        source = data.draw(st.integers(1, len(payloads)))
        del whole[source], left[source - 1][data.draw(st.integers(0, len(left[source - 1]) - 1))]
    found = {}
    while any(left):
        frame = data.draw(st.sampled_from([frames for frames in left if frames])).pop(0)
        if (transfer := receiver.feed(frame, 0.0)) is not None:
            found[transfer.source] = transfer.payload
    assert found == whole
    assert bool(receiver.errors) <= loses


@given(
    st.lists(st.tuples(st.sampled_from([*HEARD, RAW_COMMAND]), st.integers(0, 127), st.integers(0, 31), st.binary(max_size=8))),
    st.integers(0, CAN_ERR | CAN_RTR | CAN_IDE),
)
def test_random_frames_raise_nothing(frames, flags):
    receiver = TransferReceiver(HEARD)
    for number, (kind, source, priority, data) in enumerate(frames):
        arb = extended(priority << 24 | kind.id << 8 | source) ^ flags
        transfer = receiver.feed(Frame(arb, data), number / 10.0)
        if transfer is not None:
            with contextlib.suppress(FormatError):
                decode(transfer)


@given(st.sampled_from(HEARD), st.binary(max_size=300))
def test_random_payloads_are_read_or_refused(kind, payload):
    with contextlib.suppress(FormatError):
        assert decode(Transfer(kind.id, 20, payload))


def test_the_filters_take_the_types_that_are_read_from_anyone_at_any_priority_and_nothing_else():
    filters = TransferReceiver((ESC_STATUS, ALLOCATION)).filters

    def taken(arb: int) -> bool:
        return any(accepts(address, arb) for address in filters)

    assert all(taken(frame.arb) for priority in (0, 31) for frame in told(ESC_STATUS, ESC, 125, priority))
    assert taken(extended(30 << 24 | 0x2A55 << 10 | 1 << 8)), "a device without a number: any discriminator"
    for other in (24 << 24 | 1035 << 8 | 20, 24 << 24 | 1034 << 8 | 0x80 | 20, 24 << 24 | 0x2A55 << 10 | 2 << 8):
        assert not taken(extended(other))
    assert not taken(standard(0x10))


# Numbers for devices that have none.


def asking(identity: bytes, preferred: int = 0) -> list[NumberRequest]:
    parts = (identity[:6], identity[6:12], identity[12:])
    return [NumberRequest(preferred, i == 0, part) for i, part in enumerate(parts)]


def answers(allocator: Allocator, requests: Sequence[NumberRequest], apart_s: float = 0.1) -> list[NumberRequest | None]:
    return [allocator.feed(request, i * apart_s) for i, request in enumerate(requests)]


def test_a_device_gets_a_number_part_by_part_and_the_same_one_when_it_comes_back():
    table: dict[bytes, int] = {}
    first, second = bytes(range(16)), bytes(range(1, 17))
    allocator = Allocator(table, own=10)
    allocator.hear(125, 0.0)
    told = [NumberRequest(0, False, first[:6]), NumberRequest(0, False, first[:12]), NumberRequest(124, False, first)]
    assert answers(allocator, asking(first)) == told
    assert answers(allocator, asking(second, preferred=10))[-1].node == 11, "upward from the one that it would like"
    again = Allocator(dict(table), own=10)
    again.hear(124, 0.0)
    assert answers(again, asking(first))[-1].node == 124, "although somebody speaks with it: that is the device itself"


@pytest.mark.parametrize(
    "requests",
    [
        asking(bytes(16))[1:],
        [*asking(bytes(16))[:2], NumberRequest(0, False, bytes(6))],
        [NumberRequest(0, True, bytes(16))],
        [*asking(bytes(16))[:2], *asking(bytes(range(16)))[:1]],
    ],
)
def test_parts_that_do_not_belong_together_give_no_number(requests):
    allocator = Allocator({}, own=10)
    answers(allocator, requests)
    assert allocator.table == {}


def test_a_part_that_comes_too_late_starts_again():
    allocator = Allocator({}, own=10)
    assert answers(allocator, asking(bytes(16)), FOLLOW_UP_S + 0.1)[1:] == [None, None]


def test_when_all_numbers_are_given_away_the_next_device_gets_none():
    table = {bytes(15) + bytes((number,)): number for number in range(1, 126) if number != 10}
    allocator = Allocator(table, own=10)
    assert answers(allocator, asking(bytes(range(16))))[-1] is None
    assert allocator.refused == 1
    assert len(table) == 124


def test_made_up_devices_do_not_have_all_numbers_for_ever():
    """The number that was silent for longest goes to the next one that asks; devices that speak keep theirs."""
    table = {bytes(15) + bytes((number,)): number for number in range(1, 126) if number != 10}
    allocator, true = Allocator(table, own=10), bytes(range(16))
    assert answers(allocator, asking(true))[-1] is None, "nobody had the time to speak yet"
    for number in range(1, 126):
        allocator.hear(number, 50.0 if number == 77 else 100.0)
    late = [allocator.feed(each, 49.0 + SILENT_S + i / 10.0) for i, each in enumerate(asking(true))]
    assert late[-1] is None
    late = [allocator.feed(each, 50.0 + SILENT_S + i / 10.0) for i, each in enumerate(asking(true))]
    assert late[-1] == NumberRequest(77, False, true)
    assert (len(table), table[true]) == (124, 77)
    again = [allocator.feed(each, 55.0 + SILENT_S + i / 10.0) for i, each in enumerate(asking(bytes(15) + b"\x4d"))]
    assert again[-1] is None, "but not to another one as soon"


@given(st.lists(st.tuples(st.integers(0, 127), st.booleans(), st.binary(max_size=16))))
def test_random_requests_raise_nothing_and_give_nobody_a_number_of_another(requests):
    allocator = Allocator({}, own=10)
    for i, request in enumerate(requests):
        allocator.feed(NumberRequest(*request), i / 10.0)
    numbers = list(allocator.table.values())
    assert len(numbers) == len(set(numbers))
    assert all(1 <= number <= 125 and number != 10 for number in numbers)
