"""AIS_VESSEL, and the values beside it: what a boat tells of another vessel, and what is read of it, at both ends.

Consoles know a vessel by its number. One that has none, of the fleet or of a payload, and the second one with a number, are
told under a number below 1000, which no vessel has, that is made of the key. A thing and a swimmer have numbers of aids to
navigation, of no country.
"""

import math
import zlib
from collections.abc import Iterator
from typing import Final

from delfim.base.geodesy import Origin, from_plane
from delfim.base.vessels import STATUS_UNKNOWN, THINGS, VesselFacts, VesselPosition, readable
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.vehicle.state import State
from delfim.vehicle.target import Target

TURNS: Final = math.radians(0.1)  # rad/s, of one count of a turn rate
ORDERED: Final = b"ORDER_CRS"  # names of values: the course that keeps the boat clear, and the place in GUARD
GUARDED: Final = b"GUARD"
GUARD: Final = ("off", "on", "cannot avoid")
NEAR: Final = 10  # of the nearest one is told in each call, besides one of all
NUMBERS: Final = 1000  # from here on they are those of vessels
THING, PERSON = 990_000_000, 990_001_000  # the numbers of things and swimmers follow
_FLAGS: Final = dialect.AIS_FLAGS_VALID_COG | dialect.AIS_FLAGS_VALID_VELOCITY | dialect.AIS_FLAGS_VALID_NAME
_U16: Final = 0xFFFF


def number_of(key: str) -> int:
    """The number of a vessel or a thing, by its key."""
    kind, _, rest = key.partition(" ")
    if kind in THINGS and rest.isascii() and rest.isdigit() and len(rest) < 4:
        return (THING if kind == "thing" else PERSON) + int(rest)
    return int(key) if key.isascii() and key.isdigit() else zlib.crc32(key.encode()) % (NUMBERS - 1) + 1


def kind_of(number: int) -> str:
    """What has this number: "thing", "person"; empty: a vessel."""
    return "person" if PERSON < number < PERSON + NUMBERS else "thing" if THING < number < PERSON else ""


def told(target: Target, origin: Origin) -> Message:
    """AIS_VESSEL. The place is the middle of the hull, so bow and stern are as far from there, and so are the sides; it is that
    of the last report, whose age goes with it."""
    back_m = target.speed_mps * target.age_s
    north_m, east_m = back_m * math.cos(target.course_rad), back_m * math.sin(target.course_rad)
    latitude_rad, longitude_rad = from_plane(origin, target.north_m - north_m, target.east_m - east_m)
    least_m = 1 if target.kind in THINGS else 0
    ahead_m, aside_m = max(round(target.length_m / 2.0), least_m), max(min(round(target.beam_m / 2.0), 0xFF), least_m)
    has_heading = not math.isnan(target.heading_rad)
    return dialect.MAVLink_ais_vessel_message(
        number_of(target.key),
        round(math.degrees(latitude_rad) * 1e7),
        round(math.degrees(longitude_rad) * 1e7),
        round(math.degrees(target.course_rad) * 100.0) % 36_000,
        round(math.degrees(target.heading_rad) * 100.0) % 36_000 if has_heading else _U16,
        min(round(target.speed_mps * 100.0), _U16),
        0,
        target.status,
        0,
        ahead_m,
        ahead_m,
        aside_m,
        aside_m,
        b"",
        target.name.encode("ascii", "replace")[:20],
        min(round(target.age_s), _U16),
        _FLAGS | (dialect.AIS_FLAGS_VALID_DIMENSIONS if target.is_size_known else 0),
    )


def vessels(state: State, turn: int) -> Iterator[Message]:
    """One of the nearest and one of all, in turn: the next ones at the next `turn`. However many there are, a link carries no
    more; those that matter come soon again."""
    targets, origin = state.traffic.targets, state.origin
    if not targets or origin is None:
        return
    near = targets[turn % min(len(targets), NEAR)]
    next_one = sorted(targets, key=_key)[turn % len(targets)]  # by their keys: the nearest change, and none is passed over
    for target in (near,) if near is next_one else (near, next_one):
        yield told(target, origin)


def _key(target: Target) -> str:
    return target.key


def ordered(state: State, boot_ms: int) -> Iterator[Message]:
    """The course that keeps the boat clear of others, degrees; NaN: it follows its way. Nothing where nobody was ever heard."""
    order = state.traffic.order
    if not state.traffic.is_empty:
        course_deg = math.nan if order is None else round(math.degrees(order.course_rad) % 360.0, 1)
        yield dialect.MAVLink_named_value_float_message(boot_ms, ORDERED, course_deg)


def guard(state: State, boot_ms: int) -> Iterator[Message]:
    """Whether the boat keeps clear of others: the place of the word in `GUARD`. Nothing where nobody was ever heard."""
    if not state.traffic.is_empty:
        word = state.traffic.guard.partition(":")[0]
        yield dialect.MAVLink_named_value_int_message(boot_ms, GUARDED, GUARD.index(word) if word in GUARD else 0)


def position_of(message: Message) -> VesselPosition:
    """Where it was at its last report, `tslc` seconds before the message was sent. The message tells no class of AIS: a status
    is told by class A alone."""
    flags, status = message.flags, message.navigational_status
    has_rate = flags & dialect.AIS_FLAGS_VALID_TURN_RATE and not flags & dialect.AIS_FLAGS_TURN_RATE_SIGN_ONLY
    is_fast = flags & dialect.AIS_FLAGS_HIGH_VELOCITY  # as fast as AIS can tell, or faster
    return VesselPosition(
        message.MMSI,
        math.radians(message.lat * 1e-7),
        math.radians(message.lon * 1e-7),
        math.radians(message.COG / 100.0) if flags & dialect.AIS_FLAGS_VALID_COG and message.COG < 36_000 else None,
        message.velocity / 100.0 if flags & dialect.AIS_FLAGS_VALID_VELOCITY and not is_fast else None,
        math.radians(message.heading / 100.0) if message.heading < 36_000 else None,
        message.turn_rate * TURNS if has_rate else None,
        "B" if status >= STATUS_UNKNOWN else "A",
        min(status, STATUS_UNKNOWN),
    )


def facts_of(message: Message) -> VesselFacts | None:
    """Its name and size; None: it tells neither."""
    bow, stern = message.dimension_bow, message.dimension_stern
    port, starboard = message.dimension_port, message.dimension_starboard
    is_sized = bool(message.flags & dialect.AIS_FLAGS_VALID_DIMENSIONS)
    name = readable(message.name) if message.flags & dialect.AIS_FLAGS_VALID_NAME else None
    if not (is_sized or name):
        return None
    size = (float(bow + stern), float(port + starboard), float(starboard), float(bow)) if is_sized else [None] * 4
    return VesselFacts(message.MMSI, name, None, None, *size)
