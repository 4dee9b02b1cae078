"""The DroneCAN messages that are used here, as values and as bytes: a row each, SI units inside, None for what a device does
not know (NaN, or a percentage of 127). Rates are those that devices have by default.
"""

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.canproxy.dronecan.fields import F16, F32, DataType, pack, signed, unpack, unsigned, void
from delfim.canproxy.dronecan.transfers import Transfer

ALLOCATION: Final = DataType("Allocation", 1, 0xF258, (unsigned(7), unsigned(1)), (unsigned(8),), 16)
NODE_STATUS: Final = DataType("NodeStatus", 341, 0xBE5F, tuple(map(unsigned, (32, 2, 3, 3, 16))))
MAGNETIC_FIELD_FIRST: Final = DataType("MagneticFieldStrength", 1001, 0x037C, (F16, F16, F16), (F16,), 9)
MAGNETIC_FIELD: Final = DataType("MagneticFieldStrength2", 1002, 0xBA25, (unsigned(8), F16, F16, F16), (F16,), 9)
RAW_IMU: Final = DataType(
    "RawIMU", 1003, 0x4E3E, (unsigned(56), F32, *(F16,) * 3, *(F32,) * 3, *(F16,) * 3, *(F32,) * 3), (F16,), 36
)
MAGNETIC_FIELD_FINE: Final = DataType("MagneticFieldStrengthHiRes", 1043, 0x9AF4, (unsigned(8), F32, F32, F32))
ARRAY_COMMAND: Final = DataType("ArrayCommand", 1010, 0x5E37, (), (unsigned(8), unsigned(8), F16), 15)
RAW_COMMAND: Final = DataType("RawCommand", 1030, 0xE4B8, (), (signed(14),), 20)
RPM_COMMAND: Final = DataType("RPMCommand", 1031, 0xF8B4, (), (signed(18),), 20)
ESC_STATUS: Final = DataType("Status", 1034, 0x1591, (unsigned(32), F16, F16, F16, signed(18), unsigned(7), unsigned(5)))
AUXILIARY: Final = DataType("Auxiliary", 1061, 0x24AE, (*(F16,) * 7, unsigned(7), unsigned(6)))
FIX2: Final = DataType(  # up to the number of covariances, which are the items, with what follows them
    "Fix2",
    1063,
    0xC798,
    (
        *(unsigned(56), unsigned(56), unsigned(3), void(13), unsigned(8), signed(37), signed(37), signed(27), signed(27)),
        *(F32, F32, F32, unsigned(6), unsigned(2), unsigned(4), unsigned(6), unsigned(6)),
    ),
    (F16,),
    37,
)
RANGE: Final = DataType(  # the beam's roll, pitch and yaw, which may be unknown, are not used: the vehicle's file says them
    "Measurement", 1050, 0x049C, (*map(unsigned, (56, 8)), *(signed(5),) * 3, unsigned(1), F16, *map(unsigned, (5, 3)), F16)
)
BATTERY_INFO: Final = DataType(
    "BatteryInfo", 1092, 0xF674, (*(F16,) * 7, *map(unsigned, (11, 7, 7, 7, 8, 32))), (unsigned(8),), 31
)
ARMING_STATUS: Final = DataType("ArmingStatus", 1100, 0x1890, (unsigned(8),))
SAFETY_STATE: Final = DataType("SafetyState", 20000, 0x06A7, (unsigned(8),))
RELATIVE_HEADING: Final = DataType("RelPosHeading", 20006, 0xF95D, (unsigned(56), unsigned(1), F32, F32, F16, F16))

RAW_MAX: Final = 8191  # of RawCommand: all ahead; astern it is -8192, of which one step is left out
ON, OFF = bytes((255,)), bytes((0,))  # payloads of ArmingStatus (armed) and SafetyState (the motors may have power)
RPM_MAX: Final = 20_000  # a report beyond it is refused: no propeller turns like that
_KELVIN: Final = 273.15
_TESLA: Final = 1e-4  # in a gauss
_new = tuple.__new__  # in half the time of EscStatus(...): a motor reports 25 times a second
_UNKNOWN_PERCENT: Final = 127
_VALID: Final = 1  # reading of a rangefinder; 2 too close, 3 too far
_DIAGONALS: Final = {
    6: (0, 1, 3, 4),
    21: (0, 6, 15, 18),
    36: (0, 7, 21, 28),
}  # north and east in a matrix of so many covariances


class CommandKind(IntEnum):
    """The meaning of an ArrayCommand's value."""

    UNITLESS = 0  # -1..1 of the actuator's range
    POSITION = 1  # rad, m


class NodeStatus(NamedTuple):
    """The status of a node, at 1 Hz."""

    uptime_s: int
    health: int  # 0 well, 1 warning, 2 error, 3 critical
    mode: int  # 0 operational, 1 initialization, 2 maintenance, 3 software update, 7 offline
    vendor_code: int  # of the maker


class EscStatus(NamedTuple):
    """The status of a motor controller, at 10 to 50 Hz."""

    errors: int  # since the motor started
    voltage_v: float | None
    current_a: float | None  # negative: the motor feeds the battery
    temperature_c: float | None
    rpm: int  # of the shaft; negative is astern
    power: float | None  # 0..1.26 of its rating
    motor: int  # its index in RawCommand


class BatteryInfo(NamedTuple):
    """The state of a battery, at 0.2 to 1 Hz."""

    voltage_v: float | None
    current_a: float | None
    temperature_c: float | None
    charge: float | None  # 0..1
    health: float | None  # 0..1
    flags: int  # 8 hot, 16 cold, 32 overload, 64 bad, 256 its electronics are faulty
    battery: int  # its number on the boat


class GnssFix(NamedTuple):
    """The fix of a GNSS receiver, at 5 to 10 Hz."""

    utc_ns: int | None  # None, too, where the receiver counts in another standard
    latitude_rad: float
    longitude_rad: float
    north_mps: float | None
    east_mps: float | None
    satellites: int
    status: int  # 0 no fix, 1 time alone, 2 2D, 3 3D
    mode: int  # 0 single, 1 differential, 2 RTK, 3 precise point
    sub_mode: int  # of RTK: 0 float, 1 fixed
    pdop: float | None
    accuracy_m: float | None = None  # standard deviation of the position in the plane
    accuracy_mps: float | None = None  # of the velocity in the plane


class Dilution(NamedTuple):
    """The dilution of precision, sent beside a fix: what Fix2 lacks."""

    hdop: float | None
    satellites: int


class RelativeHeading(NamedTuple):
    """The direction from one antenna to another, and the distance, for comparison with a tape."""

    heading_rad: float | None
    accuracy_rad: float | None
    distance_m: float | None


class MagneticField(NamedTuple):
    """The field of a magnetometer in the device's axes, at 10 to 50 Hz, which is not a heading. Three types carry it."""

    sensor: int  # its number in the device; 0 where the type has none
    field_t: tuple[float, float, float]


class ImuSample(NamedTuple):
    """Rates and accelerations of gyroscope and accelerometer, in the device's axes."""

    rate_radps: tuple[float, float, float]
    force_mps2: tuple[float, float, float]  # specific force: at rest it points up


class RangeMeasured(NamedTuple):
    """What a rangefinder measures, at 5 to 50 Hz."""

    sensor: int  # its number in the device
    kind: int  # 1 sonar, 2 lidar, 3 radar
    distance_m: float | None  # of the nearest thing in its beam; None: there is none, or it is too close
    beam_rad: float  # the width of the beam; 0: unknown


class NumberRequest(NamedTuple):
    """Allocation: the request of a device for a number, or the answer to it."""

    node: int  # asked for or given; 0: any, or none yet
    is_first: bool  # of the parts of its identity
    identity: bytes  # a part of the 16, or all that was heard


Message = (
    NodeStatus
    | EscStatus
    | BatteryInfo
    | GnssFix
    | Dilution
    | RelativeHeading
    | MagneticField
    | ImuSample
    | RangeMeasured
    | NumberRequest
)


def decode(transfer: Transfer) -> Message:
    """Decode a message that is used here. Raises FormatError when it is too short or impossible."""
    kind, read = _READ[transfer.type]
    return read(*unpack(kind, transfer.payload))


def raw_command(fractions: Sequence[float]) -> bytes:
    """RawCommand: a fraction, -1..1, for each motor, by index."""
    stream = 0
    for fraction in fractions:  # as `pack`, in a third of its time: this is on the critical path
        raw = round(fraction * RAW_MAX) & 0x3FFF
        stream = stream << 14 | (raw & 0xFF) << 6 | raw >> 8
    bits = 14 * len(fractions)
    return (stream << -bits % 8).to_bytes((bits + 7) // 8, "big")


def rpm_command(rpms: Sequence[float]) -> bytes:
    """RPMCommand: revolutions per minute for each motor, by index."""
    return pack(RPM_COMMAND, (), [round(rpm) for rpm in rpms])


def array_command(commands: Sequence[tuple[int, CommandKind, float]]) -> bytes:
    """ArrayCommand: (the actuator's number, kind, value) each, up to 15."""
    return pack(ARRAY_COMMAND, (), [value for command in commands for value in command])


def node_status(uptime_s: float, health: int = 0, mode: int = 0) -> bytes:
    return pack(NODE_STATUS, (int(uptime_s), health, mode, 0, 0))


def number_request(asked: NumberRequest) -> bytes:
    return pack(ALLOCATION, (asked.node, asked.is_first), tuple(asked.identity))


def _known(value: float) -> float | None:
    return value if value - value == 0.0 else None  # finite; in half the time of a call


def _share(percent: float) -> float | None:
    return None if percent == _UNKNOWN_PERCENT else percent / 100.0


def _celsius(kelvin: float) -> float | None:
    """Convert kelvin to degrees Celsius; None for 0 K, which devices without a sensor send."""
    return round(kelvin - _KELVIN, 2) if 0.0 < kelvin < math.inf else None


def _vector(values: Sequence[float], name: str) -> tuple[float, float, float]:
    x, y, z = values
    if not math.isfinite(x + y + z):
        raise FormatError(f"{name} that is not finite")
    return x, y, z


def _read_node_status(values: Sequence[Any], items: Sequence[Any]) -> NodeStatus:
    uptime_s, health, mode, _, code = values
    return _new(NodeStatus, (uptime_s, health, mode, code))


def _read_esc_status(values: Sequence[Any], items: Sequence[Any]) -> EscStatus:
    errors, voltage_v, current_a, kelvin, rpm, percent, index = values
    if abs(rpm) > RPM_MAX:
        raise FormatError(f"impossible {rpm} rpm of motor {index}")
    voltage_v = voltage_v if voltage_v - voltage_v == 0.0 else None  # as `_known`, without a call
    current_a = current_a if current_a - current_a == 0.0 else None
    power = None if percent == _UNKNOWN_PERCENT else percent / 100.0
    return _new(EscStatus, (errors, voltage_v, current_a, _celsius(kelvin), rpm, power, index))


def _read_battery(values: Sequence[Any], items: Sequence[Any]) -> BatteryInfo:
    kelvin, voltage_v, current_a, _power, _left, _full, _hours, flags, health, charge, _deviation, battery, _model = values
    if charge > 100 and charge != _UNKNOWN_PERCENT:
        raise FormatError(f"battery {battery} with an impossible charge of {charge} %")
    known = _known(voltage_v), _known(current_a), _celsius(kelvin)
    return BatteryInfo(*known, _share(charge), _share(health), flags, battery)


def _read_fix(values: Sequence[Any], items: Sequence[Any]) -> GnssFix:
    _bus, microseconds, standard, _leap, longitude, latitude, _ellipsoid, _sea, north, east, _down, *rest = values
    satellites, status, mode, sub_mode, covariances = rest
    latitude_deg, longitude_deg = latitude * 1e-8, longitude * 1e-8
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
        raise FormatError(f"impossible position {latitude_deg:.6f}, {longitude_deg:.6f}")
    if len(items) <= covariances:
        raise FormatError("Fix2 ends before its dilution of precision")
    return GnssFix(
        microseconds * 1000 if standard == 2 and microseconds else None,
        math.radians(latitude_deg),
        math.radians(longitude_deg),
        _known(north),
        _known(east),
        satellites,
        status,
        mode,
        sub_mode,
        _known(items[covariances]),
        *_accuracies(items[:covariances]),
    )


def _accuracies(covariances: Sequence[float]) -> tuple[float | None, float | None]:
    """The standard deviations in the plane, of position and velocity."""
    places = _DIAGONALS.get(len(covariances))
    if places is None:
        return None, None
    north, east, north_speed, east_speed = (covariances[place] for place in places)
    found = north + east, north_speed + east_speed
    position, velocity = (math.sqrt(each) if 0.0 < each < math.inf else None for each in found)
    return position, velocity


def _read_dilution(values: Sequence[Any], items: Sequence[Any]) -> Dilution:
    return Dilution(_known(values[2]), values[8])


def _read_heading(values: Sequence[Any], items: Sequence[Any]) -> RelativeHeading:
    _bus, has_accuracy, heading_deg, accuracy_deg, distance_m, _down_m = values
    if math.isfinite(heading_deg) and abs(heading_deg) > 360.0:
        raise FormatError(f"impossible heading {heading_deg:.1f} degrees")
    heading_rad = math.radians(heading_deg) % math.tau if math.isfinite(heading_deg) else None
    accuracy_rad = math.radians(accuracy_deg) if has_accuracy and math.isfinite(accuracy_deg) else None
    return RelativeHeading(heading_rad, accuracy_rad, _known(distance_m))


def _read_magnetic(values: Sequence[Any], items: Sequence[Any]) -> MagneticField:
    x, y, z = _vector(values[-3:], "magnetic field")
    return _new(MagneticField, (values[0] if len(values) > 3 else 0, (x * _TESLA, y * _TESLA, z * _TESLA)))


def _read_imu(values: Sequence[Any], items: Sequence[Any]) -> ImuSample:
    return _new(ImuSample, (_vector(values[2:5], "rate of turn"), _vector(values[8:11], "acceleration")))


def _read_range(values: Sequence[Any], items: Sequence[Any]) -> RangeMeasured:
    _bus, sensor, _roll, _pitch, _yaw, _is_defined, beam_rad, kind, reading, distance_m = values
    if reading != _VALID:
        return RangeMeasured(sensor, kind, None, 0.0)
    if not 0.0 <= distance_m < math.inf:
        raise FormatError(f"impossible distance {distance_m} m of rangefinder {sensor}")
    return RangeMeasured(sensor, kind, distance_m, beam_rad if 0.0 < beam_rad < math.pi else 0.0)


def _read_allocation(values: Sequence[Any], items: Sequence[Any]) -> NumberRequest:
    return NumberRequest(values[0], bool(values[1]), bytes(items))


_READ: Final[dict[int, tuple[DataType, Callable[[Sequence[Any], Sequence[Any]], Message]]]] = {
    kind.id: (kind, read)
    for kind, read in (
        (ALLOCATION, _read_allocation),
        (NODE_STATUS, _read_node_status),
        (MAGNETIC_FIELD_FIRST, _read_magnetic),
        (MAGNETIC_FIELD, _read_magnetic),
        (MAGNETIC_FIELD_FINE, _read_magnetic),
        (RAW_IMU, _read_imu),
        (ESC_STATUS, _read_esc_status),
        (AUXILIARY, _read_dilution),
        (FIX2, _read_fix),
        (RANGE, _read_range),
        (BATTERY_INFO, _read_battery),
        (RELATIVE_HEADING, _read_heading),
    )
}
