"""NMEA 2000 messages of instruments beside navigation: bytes in, values out. A row of MESSAGES for each PGN.

The names of values are those of `State.measured`, with their units. A value that the device does not have is None. Layouts are
those that the canboat project documents.
"""

import math
import struct
from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

BATTERY_CHARGE: Final = 127506
BATTERY: Final = 127508
WATER_SPEED: Final = 128259
WATER_DEPTH: Final = 128267
WIND: Final = 130306
SURROUNDINGS: Final = 130310
SURROUNDINGS_BY_SOURCE: Final = 130311
TEMPERATURE: Final = 130312
TEMPERATURE_FINE: Final = 130316
FAST: Final = frozenset({BATTERY_CHARGE})  # fast packets; all others are single frames

DEPTH_MAX_M, SPEED_MAX_MPS = 12_000.0, 200.0
KELVIN: Final = 273.15
COLD_C, HOT_C = -100.0, 200.0
_U16, _U32, _I16 = 0xFFFD, 0xFFFFFFFD, 0x7FFD  # these and two above: not available, error, reserved
_WINDS: Final = {2: "apparent", 3: "true", 4: "true"}  # by reference: angles from the bow. 0 and 1 are directions from north
_PLACES: Final = {0: "water_c", 1: "air_c"}  # of a temperature


class Battery(NamedTuple):
    """PGN 127508, usually once in 1.5 s: 0.01 V, 0.1 A (positive: the sign of the device), 0.01 K."""

    instance: int
    voltage_v: float | None
    current_a: float | None
    temperature_c: float | None


class BatteryCharge(NamedTuple):
    """PGN 127506, usually once in 1.5 s: state of charge."""

    instance: int
    charge: float | None  # 0..1


Told = tuple[tuple[str, float | None], ...] | Battery | BatteryCharge | None  # None: nothing that is used here


def _bounded(value: float, low: float, high: float, name: str) -> float:
    if low <= value <= high:
        return value
    raise FormatError(f"impossible {name} {value:.6g}")


def _celsius(raw: int, unit_k: float, unavailable: int) -> float | None:
    return None if raw >= unavailable else _bounded(raw * unit_k - KELVIN, COLD_C, HOT_C, "temperature in degrees Celsius")


def _speed(raw: int, name: str) -> float | None:
    return None if raw >= _U16 else _bounded(raw * 0.01, 0.0, SPEED_MAX_MPS, name)


def _water_speed(_sid: int, speed: int, _ground: int, _kind: int, _reserved: int) -> Told:
    return (("speed_water_mps", _speed(speed, "speed through the water in m/s")),)


def _depth(_sid: int, depth: int, offset: int, _range: int) -> Told:
    """Decode PGN 128267, the offset in 0.001 m: above zero from the transducer to the water line, below to the keel."""
    depth_m = None if depth >= _U32 else _bounded(depth * 0.01, 0.0, DEPTH_MAX_M, "depth in m")
    return ("depth_m", depth_m), ("depth_offset_m", None if offset >= _I16 else offset * 0.001)


def _wind(_sid: int, speed: int, angle: int, reference: int, _reserved: int) -> Told:
    kind = _WINDS.get(reference & 7)
    if kind is None:
        return None
    angle_rad = None if angle >= _U16 else _bounded(angle * 1e-4, 0.0, math.tau + 1e-4, "angle of the wind in rad")
    return (f"wind_{kind}_rad", angle_rad), (f"wind_{kind}_mps", _speed(speed, "wind in m/s"))


def _surroundings(_sid: int, water: int, air: int, _pressure: int, _reserved: int) -> Told:
    return ("water_c", _celsius(water, 0.01, _U16)), ("air_c", _celsius(air, 0.01, _U16))


def _by_source(_sid: int, source: int, celsius: int, _humidity: int, _pressure: int) -> Told:
    return _of_place(source & 0x3F, _celsius(celsius, 0.01, _U16))


def _temperature(_sid: int, _instance: int, source: int, celsius: int, _set: int, _reserved: int) -> Told:
    return _of_place(source, _celsius(celsius, 0.01, _U16))


def _fine(_sid: int, _instance: int, source: int, low: int, high: int, _set: int) -> Told:
    return _of_place(source, _celsius(low | high << 16, 0.001, 0xFFFFFD))


def _of_place(source: int, celsius: float | None) -> Told:
    return ((_PLACES[source], celsius),) if source in _PLACES else None


def _battery(instance: int, voltage: int, current: int, celsius: int, _sid: int) -> Told:
    volts, amperes = (None if raw >= 0x7FFD else raw for raw in (voltage, current))
    return Battery(
        instance,
        None if volts is None else volts * 0.01,
        None if amperes is None else amperes * 0.1,
        _celsius(celsius, 0.01, _U16),
    )


def _charge(_sid: int, instance: int, kind: int, charge: int) -> Told:
    """Decode PGN 127506 of batteries alone: chargers and panels send the same message."""
    if kind:
        return None
    return BatteryCharge(instance, None if charge >= 0xFD else _bounded(charge, 0, 100, "charge in %") / 100.0)


class _Kind(NamedTuple):
    fields: struct.Struct
    read: Callable[..., Told]


MESSAGES: Final = {
    BATTERY_CHARGE: _Kind(struct.Struct("<BBBB"), _charge),  # 9 or 11 bytes, of which the first four are read
    BATTERY: _Kind(struct.Struct("<BhhHB"), _battery),
    WATER_SPEED: _Kind(struct.Struct("<BHHBH"), _water_speed),
    WATER_DEPTH: _Kind(struct.Struct("<BIhB"), _depth),
    WIND: _Kind(struct.Struct("<BHHBH"), _wind),
    SURROUNDINGS: _Kind(struct.Struct("<BHHHB"), _surroundings),
    SURROUNDINGS_BY_SOURCE: _Kind(struct.Struct("<BBHhH"), _by_source),
    TEMPERATURE: _Kind(struct.Struct("<BBBHHB"), _temperature),
    TEMPERATURE_FINE: _Kind(struct.Struct("<BBBHBH"), _fine),
}


def decode(pgn: int, data: bytes) -> Told:
    """The values of one complete message of MESSAGES. Raises FormatError for a wrong length and for values that no boat has."""
    row = MESSAGES[pgn]
    size = row.fields.size
    if len(data) != size and not (pgn in FAST and 9 <= len(data) <= 11):
        raise FormatError(f"{len(data)} bytes instead of {'9 to 11' if pgn in FAST else size}")
    return row.read(*row.fields.unpack_from(data))
