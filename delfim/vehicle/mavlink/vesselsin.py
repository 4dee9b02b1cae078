"""Other vessels from MAVLink: AIS_VESSEL of a console, and GLOBAL_POSITION_INT of a boat of the fleet (docs/traffic.md)."""

import math
from typing import Final

from delfim.vehicle.mavlink.consoles import Consoles
from delfim.vehicle.mavlink.peers import Peer
from delfim.vehicle.mavlink.telemetry import COMPONENT
from delfim.vehicle.mavlink.wire import GUEST, Message, Speaker, dialect
from delfim.vessels import MMSI_MAX, STATUS_UNKNOWN, VesselFacts, VesselPosition, readable

LEAST: Final = 1000  # numbers below are no vessel's, but made up by a boat that tells of others
OLD_S: Final = 600  # a report that was older when it came is none
TURNS: Final = math.radians(0.1)  # rad/s, of one count of a turn rate


def vessel(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """AIS_VESSEL: a vessel that a console, or a receiver at its end, heard of some seconds ago."""
    if not _is_heard(consoles) or source.component == GUEST or not LEAST <= message.MMSI <= MMSI_MAX or message.tslc > OLD_S:
        consoles.count("vessels_refused")
        return
    flags, state, now_s = message.flags, consoles.boat.state, consoles.clock.monotonic_s() - message.tslc
    status = message.navigational_status
    has_rate = flags & dialect.AIS_FLAGS_VALID_TURN_RATE and not flags & dialect.AIS_FLAGS_TURN_RATE_SIGN_ONLY
    is_fast = flags & dialect.AIS_FLAGS_HIGH_VELOCITY  # as fast as AIS can tell, or faster
    position = VesselPosition(
        message.MMSI,
        math.radians(message.lat * 1e-7),
        math.radians(message.lon * 1e-7),
        math.radians(message.COG / 100.0) if flags & dialect.AIS_FLAGS_VALID_COG and message.COG < 36_000 else None,
        message.velocity / 100.0 if flags & dialect.AIS_FLAGS_VALID_VELOCITY and not is_fast else None,
        math.radians(message.heading / 100.0) if message.heading < 36_000 else None,
        message.turn_rate * TURNS if has_rate else None,
        "B" if status >= STATUS_UNKNOWN else "A",  # which only class A tells
        min(status, STATUS_UNKNOWN),
    )
    state.hear(position, source.name, now_s)
    bow, stern = message.dimension_bow, message.dimension_stern
    port, starboard = message.dimension_port, message.dimension_starboard
    is_sized = bool(flags & dialect.AIS_FLAGS_VALID_DIMENSIONS)
    name = readable(message.name) if flags & dialect.AIS_FLAGS_VALID_NAME else None
    if is_sized or name:
        size = (float(bow + stern), float(port + starboard), float(starboard), float(bow)) if is_sized else [None] * 4
        state.hear(VesselFacts(message.MMSI, name, None, None, *size), source.name, now_s)


def sister(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """GLOBAL_POSITION_INT of another vehicle, as every vehicle says it for itself."""
    if not _is_heard(consoles) or source.component != COMPONENT or source.system == consoles.system:
        consoles.count("vessels_refused")
        return
    position = VesselPosition(
        0,
        math.radians(message.lat * 1e-7),
        math.radians(message.lon * 1e-7),
        math.atan2(message.vy, message.vx),
        math.hypot(message.vx, message.vy) / 100.0,
        math.radians(message.hdg / 100.0) if message.hdg < 36_000 else None,
        None,
        "fleet",
    )
    consoles.boat.state.hear(position, "fleet", consoles.clock.monotonic_s(), f"boat {source.system}")


def _is_heard(consoles: Consoles) -> bool:
    return "mavlink" in consoles.boat.helm.settings.traffic.hears
