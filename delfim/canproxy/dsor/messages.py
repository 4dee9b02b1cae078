"""The messages of the boat's CAN nodes: identifiers, layouts, units. Little endian throughout.

Frames of up to 8 bytes stand in `etc/delfimx.dbc` too, and a test holds the two against each other. Longer messages travel
as DSOR segmented messages (`docs/dsor.md`). A number that a node does not know is sent as the largest value of its field
and arrives as None: an unknown is never a zero.

Propulsion nodes stop by themselves when `PROPELLER_TIMEOUT_S` pass without a command; that is part of the protocol.
"""

import math
import struct
from enum import IntEnum, IntFlag
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import extended, standard


class Node(IntEnum):
    """7-bit node identifiers of the DSOR protocol. 0 is the gateway that the vehicle's computer impersonates (thesis 3.2)."""

    VEHICLE = 0x00
    GPS = 0x01
    NAVIGATION = 0x02
    PROPELLER_STARBOARD = 0x10
    PROPELLER_PORT = 0x11
    BATTERIES_STARBOARD = 0x20
    BATTERIES_PORT = 0x21
    BROADCAST = 0x7F


PROPELLER_TIMEOUT_S: Final = 1.0


def time_frame(vehicle: int) -> int:
    """Arbitration field of a vehicle's time frame. `vehicle`: its DSOR identifier, 0x00 to 0xF0, bits 4 to 7 (thesis 3.2)."""
    return standard(vehicle)


# Standard format frames, most urgent first.
PROPELLER_STARBOARD: Final = standard(0x040)
PROPELLER_PORT: Final = standard(0x041)
BATTERIES_STARBOARD: Final = standard(0x042)
BATTERIES_PORT: Final = standard(0x043)
RESET: Final = standard(0x0A0)  # a node, or all of them, starts again
TIME_FRAME: Final = time_frame(0xC0)  # UTC at the start of each second; of DSOR vehicle 0xC0 (thesis 3.2)
SHUTDOWN: Final = standard(0x0C8)  # to every computer of the boat: end in order, the power will be cut (thesis 3.3)
SHUTDOWN_ACKNOWLEDGE: Final = standard(0x0C9)  # how far the vehicle's computer is with it

# Extended format frames outside the segmented protocol: priority 8, kind 2 = 3, source node 7, subject 12 bits.
SYSSTAT_PRIORITY: Final = 0x80
SYSSTAT_SUBJECT: Final = 1


def sysstat_arb(node: Node) -> int:
    """Arbitration field of a node's system status frame."""
    return extended(SYSSTAT_PRIORITY << 21 | 3 << 19 | node << 12 | SYSSTAT_SUBJECT)


SYSSTAT_MASK: Final = 0x7F << 12 << 3  # as don't-care bits: the status frame of any node

# 32-bit identifiers of segmented messages.
NAVIGATION_ID: Final = 0x0000_0001
GPS_SYSSTAT_ID: Final = 0x0000_0002
LOG_ID: Final = 0x0000_0003  # bytes that a node wants logged, text by preference
NAVIGATION_PRIORITY: Final = 0x20

_I32_UNKNOWN: Final = 0x7FFFFFFF
_I16_UNKNOWN: Final = 0x7FFF
_U16_UNKNOWN: Final = 0xFFFF
_U8_UNKNOWN: Final = 0xFF
_I8_UNKNOWN: Final = 0x7F


class Status(IntEnum):
    GOOD = 0
    DEGRADED = 1
    BAD = 2


class Fault(IntFlag):
    """The faults of a node; shown to people as words."""

    OVERHEATED = 1 << 0
    OVERCURRENT = 1 << 1
    NO_COMMAND = 1 << 2  # the propeller stopped itself: no command within PROPELLER_TIMEOUT_S
    LOW_VOLTAGE = 1 << 3
    NO_SIGNAL = 1 << 4  # no satellites, no sensor
    HARDWARE = 1 << 7


class Navigation(NamedTuple):
    """Position, velocity and attitude at one instant. None is unknown. Angles in rad, speeds over ground in m/s."""

    utc_ns: int
    latitude_rad: float | None
    longitude_rad: float | None
    north_mps: float | None
    east_mps: float | None
    heading_rad: float | None  # 0..2 pi, true north
    yaw_rate_radps: float | None
    roll_rad: float | None
    pitch_rad: float | None
    fix: int  # 0 none, 2 two-dimensional, 3 three-dimensional, 4 differential, 5 RTK, 6 RTK float
    satellites: int
    hdop: float | None
    counter: int  # 0..255, one up each message
    accuracy_m: float | None = None  # standard deviation of the position in the plane, as the receiver states it
    corrections_s: float | None = None  # age of the receiver's last correction


NAVIGATION: Final = struct.Struct("<QiihhHhhhBBBB")  # 32 bytes
_DEGREES_1E7: Final = math.radians(1e-7)


def pack_navigation(n: Navigation) -> bytes:
    """Pack the 32 bytes of a navigation message: without accuracy and corrections; values beyond a field's range as unknown."""
    return NAVIGATION.pack(
        n.utc_ns,
        _scaled(n.latitude_rad, 1 / _DEGREES_1E7, _I32_UNKNOWN),
        _scaled(n.longitude_rad, 1 / _DEGREES_1E7, _I32_UNKNOWN),
        _scaled(n.north_mps, 1e3, _I16_UNKNOWN),
        _scaled(n.east_mps, 1e3, _I16_UNKNOWN),
        _unsigned(None if n.heading_rad is None else n.heading_rad % math.tau, 1e4, _U16_UNKNOWN),
        _scaled(n.yaw_rate_radps, 1e4, _I16_UNKNOWN),
        _scaled(n.roll_rad, 1e4, _I16_UNKNOWN),
        _scaled(n.pitch_rad, 1e4, _I16_UNKNOWN),
        n.fix,
        n.satellites,
        _hdop(n.hdop),
        n.counter & 0xFF,
    )


def unpack_navigation(data: bytes) -> Navigation:
    """Unpack a navigation message. Raises FormatError on a wrong length or a value that no boat can have (latitude beyond 90
    degrees, heading of 7 rad)."""
    if len(data) != NAVIGATION.size:
        raise FormatError(f"navigation message of {len(data)} bytes instead of {NAVIGATION.size}")
    utc, lat, lon, north, east, heading, rate, roll, pitch, fix, satellites, hdop, counter = NAVIGATION.unpack(data)
    known = lat != _I32_UNKNOWN and lon != _I32_UNKNOWN and fix
    if known and not (-900_000_000 <= lat <= 900_000_000 and -1_800_000_000 <= lon <= 1_800_000_000):
        raise FormatError(f"impossible position {lat / 1e7:.7f}, {lon / 1e7:.7f} degrees")
    if heading != _U16_UNKNOWN and heading > 62_832:
        raise FormatError(f"impossible heading {heading / 1e4:.4f} rad")
    moving = north != _I16_UNKNOWN and east != _I16_UNKNOWN
    fields = (
        utc,
        lat * _DEGREES_1E7 if known else None,
        lon * _DEGREES_1E7 if known else None,
        north / 1e3 if moving else None,
        east / 1e3 if moving else None,
        heading / 1e4 % math.tau if heading != _U16_UNKNOWN else None,
        rate / 1e4 if rate != _I16_UNKNOWN else None,
        roll / 1e4 if roll != _I16_UNKNOWN else None,
        pitch / 1e4 if pitch != _I16_UNKNOWN else None,
        fix,
        satellites,
        hdop / 10 if hdop != _U8_UNKNOWN else None,
        counter,
        None,
        None,
    )
    return tuple.__new__(Navigation, fields)  # a third of the time of Navigation(...): this is on the critical path


class PropellerCommand(NamedTuple):
    """The command to a propeller node, each navigation cycle. The same bytes serve both sides; only the identifier differs."""

    rpm: int  # reference, positive ahead
    run: bool  # False: motor off, whatever rpm says
    counter: int  # one up each command, so that a node sees a frozen sender


PROPELLER_COMMAND: Final = struct.Struct("<hBB")


def pack_propeller_command(c: PropellerCommand) -> bytes:
    """Pack a propeller command. A reference that is not a number or does not fit the field is sent as motor off."""
    rpm = _scaled(c.rpm, 1, _I16_UNKNOWN)
    return PROPELLER_COMMAND.pack(*((0, False) if rpm == _I16_UNKNOWN else (rpm, c.run)), c.counter & 0xFF)


def unpack_propeller_command(data: bytes) -> PropellerCommand:
    if len(data) != PROPELLER_COMMAND.size:
        raise FormatError(f"propeller command of {len(data)} bytes instead of {PROPELLER_COMMAND.size}")
    rpm, flags, counter = PROPELLER_COMMAND.unpack(data)
    return tuple.__new__(PropellerCommand, (rpm, bool(flags & 1), counter))


class BatteriesCommand(NamedTuple):
    connected: bool  # main contactor closed
    counter: int


BATTERIES_COMMAND: Final = struct.Struct("<BB")


def pack_batteries_command(c: BatteriesCommand) -> bytes:
    return BATTERIES_COMMAND.pack(c.connected, c.counter & 0xFF)


def unpack_batteries_command(data: bytes) -> BatteriesCommand:
    if len(data) != BATTERIES_COMMAND.size:
        raise FormatError(f"batteries command of {len(data)} bytes instead of {BATTERIES_COMMAND.size}")
    flags, counter = BATTERIES_COMMAND.unpack(data)
    return tuple.__new__(BatteriesCommand, (bool(flags & 1), counter))


class PropellerStatus(NamedTuple):
    """The status of a propeller node; None is unknown."""

    status: Status
    faults: Fault
    rpm: int | None  # measured, positive ahead
    current_a: float | None
    temperature_c: int | None
    counter: int


PROPELLER_STATUS: Final = struct.Struct("<BBhhbB")


class BatteriesStatus(NamedTuple):
    """The status of a bank of batteries; None is unknown."""

    status: Status
    faults: Fault
    voltage_v: float | None
    current_a: float | None  # positive: discharging
    charge: float | None  # 0..1
    temperature_c: int | None


BATTERIES_STATUS: Final = struct.Struct("<BBHhBb")


class GpsStatus(NamedTuple):
    """The status of the GPS node. It comes as a segmented message (thesis 3.4), so that legacy receivers can add fields."""

    status: Status
    faults: Fault
    fix: int
    satellites: int
    hdop: float | None
    utc_ns: int


GPS_STATUS: Final = struct.Struct("<BBBBBxxxQ")


def pack_propeller_status(s: PropellerStatus) -> bytes:
    return PROPELLER_STATUS.pack(
        s.status,
        s.faults,
        _scaled(s.rpm, 1, _I16_UNKNOWN),
        _scaled(s.current_a, 10, _I16_UNKNOWN),
        _scaled(s.temperature_c, 1, _I8_UNKNOWN),
        s.counter & 0xFF,
    )


def pack_batteries_status(s: BatteriesStatus) -> bytes:
    return BATTERIES_STATUS.pack(
        s.status,
        s.faults,
        _unsigned(s.voltage_v, 100, _U16_UNKNOWN),
        _scaled(s.current_a, 10, _I16_UNKNOWN),
        _unsigned(s.charge, 200, _U8_UNKNOWN),
        _scaled(s.temperature_c, 1, _I8_UNKNOWN),
    )


def pack_gps_status(s: GpsStatus) -> bytes:
    return GPS_STATUS.pack(s.status, s.faults, s.fix, s.satellites, _hdop(s.hdop), s.utc_ns)


SystemStatus = PropellerStatus | BatteriesStatus | GpsStatus
_PROPELLERS: Final = (Node.PROPELLER_STARBOARD, Node.PROPELLER_PORT)
_BATTERIES: Final = (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT)
_WELL: Final = Status.GOOD, Fault(0)


def unpack_sysstat(node: int, data: bytes) -> SystemStatus:
    """The status that a node reports. Raises FormatError for a node that has none, a wrong length or a wrong status."""
    try:
        if node in _PROPELLERS:
            status, faults, rpm, current, temperature, counter = PROPELLER_STATUS.unpack(data)
            known_rpm = rpm if rpm != _I16_UNKNOWN else None
            current_a = current / 10 if current != _I16_UNKNOWN else None
            celsius = temperature if temperature != _I8_UNKNOWN else None
            return tuple.__new__(PropellerStatus, (*_health(status, faults), known_rpm, current_a, celsius, counter))
        if node in _BATTERIES:
            status, faults, voltage, current, part, temperature = BATTERIES_STATUS.unpack(data)
            voltage_v = voltage / 100 if voltage != _U16_UNKNOWN else None
            current_a = current / 10 if current != _I16_UNKNOWN else None
            celsius = temperature if temperature != _I8_UNKNOWN else None
            charge = part / 200 if part <= 200 else None
            return tuple.__new__(BatteriesStatus, (*_health(status, faults), voltage_v, current_a, charge, celsius))
        if node == Node.GPS:
            status, faults, fix, satellites, hdop, utc = GPS_STATUS.unpack(data)
            return GpsStatus(*_health(status, faults), fix, satellites, None if hdop == _U8_UNKNOWN else hdop / 10, utc)
    except (struct.error, ValueError) as error:
        raise FormatError(f"system status of node {node:#04x}: {error}") from None
    raise FormatError(f"node {node:#04x} has no system status")


def _health(status: int, faults: int) -> tuple[Status, Fault]:
    """Status and faults, without a look-up in the enumerations for a node that is well. Raises ValueError for a wrong
    status."""
    return (Status(status), Fault(faults)) if status or faults else _WELL


RESET_WORD: Final = 0x5EED  # so that no stray frame resets a boat
RESET_COMMAND: Final = struct.Struct("<BxH")


def pack_reset(node: int) -> bytes:
    """Pack a reset of `node`: its number, or Node.BROADCAST for all of them."""
    return RESET_COMMAND.pack(node, RESET_WORD)


def unpack_reset(data: bytes) -> int:
    """The node to reset. Raises FormatError if this is not a reset."""
    if len(data) != RESET_COMMAND.size or RESET_COMMAND.unpack(data)[1] != RESET_WORD:
        raise FormatError(f"not a reset: {data.hex()}")
    return int(data[0])


TIME: Final = struct.Struct("<Q")  # the time frame: UTC, ns since 1970


class Shutdown(NamedTuple):
    """An order to shut everything down."""

    reboot: bool  # start again afterwards, instead of waiting for the power to be cut


SHUTDOWN_ORDER: Final = struct.Struct("<IB")
SHUTDOWN_KEY: Final = 0x0FF15AFE  # so that no frame of another meaning that strays here ends a voyage


def pack_shutdown(s: Shutdown) -> bytes:
    return SHUTDOWN_ORDER.pack(SHUTDOWN_KEY, s.reboot)


def unpack_shutdown(data: bytes) -> Shutdown:
    """Unpack an order to shut down. Raises FormatError on a wrong length or key."""
    if len(data) != SHUTDOWN_ORDER.size:
        raise FormatError(f"shutdown order of {len(data)} bytes instead of {SHUTDOWN_ORDER.size}")
    key, flags = SHUTDOWN_ORDER.unpack(data)
    if key != SHUTDOWN_KEY:
        raise FormatError(f"shutdown order with key {key:#010x} instead of {SHUTDOWN_KEY:#010x}")
    return Shutdown(bool(flags & 1))


class ShutdownStage(IntEnum):
    """The stages of a shutdown. 0 is none of them: a frame of zeros must not say that the power may be cut."""

    BEGUN = 1  # understood; the propellers are stopped first
    SAFE = 2  # the log partition is unmounted, or read-only: the power may be cut
    HELD = 3  # everything was synced to it, but it is still in use


class ShutdownAcknowledge(NamedTuple):
    stage: ShutdownStage
    holders: int  # how many still use the log partition, 255 at most


SHUTDOWN_STATUS: Final = struct.Struct("<BB")


def pack_shutdown_acknowledge(a: ShutdownAcknowledge) -> bytes:
    return SHUTDOWN_STATUS.pack(a.stage, min(a.holders, 0xFF))


def unpack_shutdown_acknowledge(data: bytes) -> ShutdownAcknowledge:
    """Unpack the acknowledgement of a shutdown. Raises FormatError on a wrong length or an unknown stage."""
    try:
        stage, holders = SHUTDOWN_STATUS.unpack(data)
        return ShutdownAcknowledge(ShutdownStage(stage), holders)
    except (struct.error, ValueError) as error:
        raise FormatError(f"shutdown acknowledge: {error}") from None


def _scaled(value: float | None, per_unit: float, unknown: int) -> int:
    """A field's integer; unknown where the value is None or does not fit below the unknown mark."""
    if value is None or not -unknown < (units := value * per_unit) < unknown:
        return unknown
    return round(units)


def _unsigned(value: float | None, per_unit: float, unknown: int) -> int:
    """The integer of a field without sign, as `_scaled`."""
    if value is None or not -0.5 <= (units := value * per_unit) < unknown:
        return unknown
    return round(units)


def _hdop(value: float | None) -> int:
    """Encode a dilution of precision; beyond the field's 25.4 it is as useless as 25.4 and is sent so."""
    return _unsigned(None if value is None else min(value, 25.4), 10, _U8_UNKNOWN)
