"""The NMEA 2000 messages that Delfim sends and does not read: their data, from values in SI units.

Layouts are those that the canboat project documents. A value that is None, not finite, or beyond its field is sent as not
available.
"""

import math
import struct
from collections.abc import Sequence
from typing import Final

HEARTBEAT_S: Final = 60.0
VERSION: Final = 2100  # of the standard, thousandths
TEXT: Final = 150  # characters of a text that a display has room for, at most
NO_CODE, NO_LEVEL, LOAD = 0xFFFF, 0xFF, 1  # product code and certification, which we have not; 50 mA
UNKNOWN_NAME: Final = 0xFFFFFFFFFFFFFFFF
ENGLISH: Final = 1  # of the United Kingdom
WARNING, ALARM = 5, 2  # type of an alert
ACTIVE, NORMAL = 2, 1  # state of an alert
_TECHNICAL, _AUTOMATIC, _EXCEEDED = 1, 1, 1
_U8, _U16, _U32, _I8, _I16 = 0xFF, 0xFFFF, 0xFFFFFFFF, 0x7F, 0x7FFF  # not available


def engine_rapid(instance: int, rpm: float | None) -> bytes:
    """127488: revolutions a minute, 1/4; the field has no sign, so that astern is sent as ahead."""
    return struct.pack("<BHHbH", instance, _unsigned(None if rpm is None else abs(rpm), 0.25, 16), _U16, _I8, _U16)


def engine(instance: int, temperature_c: float | None) -> bytes:
    """127489: temperature, 0.01 K. The rest of it is about oil, fuel and water."""
    kelvin = _unsigned(_kelvin(temperature_c), 0.01, 16)
    unknown = _I16, _I16, _U32, _U16, _U16, _U8, 0, 0, _I8, _I8  # 0, 0: no fault is told by bits
    return struct.pack("<BHHHhhIHHBHHbb", instance, _U16, _U16, kelvin, *unknown)


def battery(instance: int, voltage_v: float | None, current_a: float | None, temperature_c: float | None) -> bytes:
    """127508: 0.01 V; 0.1 A, positive into the battery; 0.01 K."""
    measured = _signed(voltage_v, 0.01, 16), _signed(current_a, 0.1, 16), _unsigned(_kelvin(temperature_c), 0.01, 16)
    return struct.pack("<BhhHB", instance, *measured, _U8)


def dc_status(instance: int, charge: float | None) -> bytes:
    """127506 of a battery: charge 0..1, in percent."""
    return struct.pack("<BBBBBHHH", _U8, instance, 0, _unsigned(charge, 0.01, 8), _U8, _U16, _U16, _U16)


def rudder(instance: int, angle_rad: float | None, order_rad: float | None) -> bytes:
    """127245: measured and ordered angle, 1e-4 rad, positive where it turns the bow of a boat under way to starboard."""
    return struct.pack("<BBhhH", instance, _U8, _signed(order_rad, 1e-4, 16), _signed(angle_rad, 1e-4, 16), _U16)


def cross_track(metres: float | None) -> bytes:
    """129283: cross-track error, 0.01 m, positive where the boat is to starboard of its line. Mode autonomous; navigation goes
    on."""
    return struct.pack("<BBiH", _U8, 0x30, _signed(metres, 0.01, 32), _U16)


def route(
    distance_m: float | None,
    bearing_rad: float | None,
    waypoint: int,
    latitude_deg: float | None,
    longitude_deg: float | None,
    closing_mps: float | None,
) -> bytes:
    """129284: the waypoint steered for: distance 0.01 m, true bearing from here 1e-4 rad, number, place 1e-7 degrees, and how
    fast it comes nearer, 0.01 m/s. Rhumb line; whether it was reached or passed is not told, nor when it will be."""
    return struct.pack(
        "<BIBIHHHIIiih",
        _U8,
        _unsigned(distance_m, 0.01, 32),
        0x7C,  # true; passed and reached unknown; rhumb line
        _U32,
        _U16,
        _U16,
        _U16 if bearing_rad is None or not math.isfinite(bearing_rad) else round(bearing_rad % math.tau * 1e4) % 62_832,
        _U32,
        waypoint,
        _signed(latitude_deg, 1e-7, 32),
        _signed(longitude_deg, 1e-7, 32),
        _signed(closing_mps, 0.01, 16),
    )


def alert(number: int, kind: int, state: int, occurrence: int, name: int) -> bytes:
    """126983: a trouble `number` of the device `name`. Nobody can silence or acknowledge it from elsewhere."""
    about = _TECHNICAL << 4 | kind, 0, 0, number, name, 0, 0, occurrence & 0xFF
    judged = _AUTOMATIC | (_EXCEEDED if state == ACTIVE else 0) << 4
    return struct.pack("<BBBHQBBBBQBBB", *about, 0xC0, UNKNOWN_NAME, judged, _U8, state)


def alert_text(number: int, kind: int, occurrence: int, name: int, words: str) -> bytes:
    """126985: the words of an alert."""
    about = _TECHNICAL << 4 | kind, 0, 0, number, name, 0, 0, occurrence & 0xFF
    return struct.pack("<BBBHQBBBB", *about, ENGLISH) + _text(words) + _text("")


def product(model: str, software: str, version: str, serial: str) -> bytes:
    """126996: product information. Each text has room for 32 characters."""
    texts = (each.encode("ascii", "replace")[:32].ljust(32, b"\xff") for each in (model, software, version, serial))
    return struct.pack("<HH", VERSION, NO_CODE) + b"".join(texts) + bytes((NO_LEVEL, LOAD))


def configuration(first: str, second: str, maker: str) -> bytes:
    """126998: two descriptions of the installation, and the maker's text."""
    return b"".join(_text(each[:60]) for each in (first, second, maker))


def pgn_list(received: bool, pgns: Sequence[int]) -> bytes:
    """126464: the list of PGNs that are sent, or received."""
    return bytes((received,)) + b"".join(pgn.to_bytes(3, "little") for pgn in pgns)


def heartbeat(sequence: int) -> bytes:
    """126993: interval in ms, number 0..252; device and controller are all right, and there is no second controller."""
    return struct.pack("<HBB", round(HEARTBEAT_S * 1e3), sequence % 253, 0xCC) + b"\xff" * 4


def refusal(pgn: int) -> bytes:
    """59392: the answer that the requested PGN is not known here."""
    return b"\x01\xff\xff\xff\xff" + pgn.to_bytes(3, "little")


def group_acknowledge(pgn: int, pgn_error: int, interval_error: int, parameter_error: int, parameters: int) -> bytes:
    """126208, acknowledge: the errors, 0..15 each, of a request or command with so many parameters."""
    nibbles = bytes((parameter_error << 4 | parameter_error,)) * (parameters // 2)
    last = bytes((0xF0 | parameter_error,)) if parameters % 2 else b""
    return b"\x02" + pgn.to_bytes(3, "little") + bytes((interval_error << 4 | pgn_error, parameters)) + nibbles + last


def _text(words: str) -> bytes:
    """A text with its length, itself included, and its code, 1: ASCII."""
    data = words[:TEXT].encode("ascii", "replace")
    return bytes((len(data) + 2, 1)) + data


def _kelvin(temperature_c: float | None) -> float | None:
    return None if temperature_c is None else temperature_c + 273.15


def _unsigned(value: float | None, unit: float, bits: int) -> int:
    return _field(value, unit, 0, (1 << bits) - 1)


def _signed(value: float | None, unit: float, bits: int) -> int:
    largest = (1 << bits - 1) - 1
    return _field(value, unit, -largest, largest)


def _field(value: float | None, unit: float, least: int, unavailable: int) -> int:
    """A field's integer; its three largest values mean not available, error, and reserved."""
    if value is None or not math.isfinite(value):
        return unavailable
    raw = round(value / unit)
    return raw if least <= raw <= unavailable - 3 else unavailable
