"""Other vessels to consoles: AIS_VESSEL (docs/traffic.md).

Consoles know a vessel by its number. One that has none, of the fleet or of a payload, and the second one with a number, are
told under a number below 1000, which no vessel has, that is made of the key.
"""

import math
import zlib
from collections.abc import Iterator
from typing import Final

from delfim.base.geodesy import Origin, from_plane
from delfim.parts.mavlink.wire import Message, dialect
from delfim.vehicle.state import State
from delfim.vehicle.target import NEVER_S, Target

NEAR: Final = 10  # of the nearest one is told in each call, besides one of all
ORDERED: Final = b"ORDER_CRS"  # names of values
GUARDED: Final = b"GUARD"
GUARD: Final = ("off", "on", "cannot avoid")
NUMBERS: Final = 1000  # from here on they are those of vessels
_FLAGS: Final = dialect.AIS_FLAGS_VALID_COG | dialect.AIS_FLAGS_VALID_VELOCITY | dialect.AIS_FLAGS_VALID_NAME
_U16: Final = 0xFFFF


def vessels(state: State, turn: int) -> Iterator[Message]:
    """One of the nearest and one of all, in turn: the next ones at the next `turn`. However many there are, a link carries no
    more; those that matter come soon again."""
    targets, origin = state.traffic.targets, state.origin
    if not targets or origin is None:
        return
    near = targets[turn % min(len(targets), NEAR)]
    next_one = sorted(targets, key=_key)[turn % len(targets)]  # by their keys: the nearest change, and none is passed over
    for target in (near,) if near is next_one else (near, next_one):
        yield _vessel(target, origin)


def _key(target: Target) -> str:
    return target.key


def ordered(state: State, boot_ms: int) -> Iterator[Message]:
    """The course that keeps the boat clear of others, degrees; NaN: it follows its way. Nothing where nobody was ever heard."""
    order = state.traffic.order
    if state.traffic.heard_s != NEVER_S:
        course_deg = math.nan if order is None else round(math.degrees(order.course_rad) % 360.0, 1)
        yield dialect.MAVLink_named_value_float_message(boot_ms, ORDERED, course_deg)


def guard(state: State, boot_ms: int) -> Iterator[Message]:
    """Whether the boat keeps clear of others: the place of the word in `GUARD`. Nothing where nobody was ever heard."""
    if state.traffic.heard_s != NEVER_S:
        word = state.traffic.guard.partition(":")[0]
        yield dialect.MAVLink_named_value_int_message(boot_ms, GUARDED, GUARD.index(word) if word in GUARD else 0)


def number(key: str) -> int:
    """Of a vessel, by its key."""
    return int(key) if key.isascii() and key.isdigit() else zlib.crc32(key.encode()) % (NUMBERS - 1) + 1


def _vessel(target: Target, origin: Origin) -> Message:
    """The place is the middle of the hull, so bow and stern are as far from there, and so are the sides; it is that of the last
    report, whose age goes with it."""
    back_m = target.speed_mps * target.age_s
    north_m, east_m = back_m * math.cos(target.course_rad), back_m * math.sin(target.course_rad)
    latitude_rad, longitude_rad = from_plane(origin, target.north_m - north_m, target.east_m - east_m)
    ahead_m, aside_m = round(target.length_m / 2.0), min(round(target.beam_m / 2.0), 0xFF)
    has_heading = not math.isnan(target.heading_rad)
    return dialect.MAVLink_ais_vessel_message(
        number(target.key),
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
