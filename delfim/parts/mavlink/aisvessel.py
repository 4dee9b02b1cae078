"""AIS_VESSEL read: a vessel that somebody heard of, for the boat and for the console. Pure."""

import math
from typing import Final

from delfim.base.vessels import STATUS_UNKNOWN, VesselFacts, VesselPosition, readable
from delfim.parts.mavlink.wire import Message, dialect

TURNS: Final = math.radians(0.1)  # rad/s, of one count of a turn rate


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
