"""Other vessels that the boat hears of on the console's link: by a console, and of boats of the fleet; and what a sensor sees
around the boat (docs/traffic.md)."""

import math
from typing import Final

from delfim.base.echoes import CONFIDENCE, EVERY_S, STALE_S, nearest
from delfim.base.geodesy import from_plane
from delfim.base.vessels import MMSI_MAX, VesselPosition
from delfim.parts.mavlink.codec.aisvessel import NUMBERS, facts_of, position_of
from delfim.parts.mavlink.codec.wire import GUEST, Message, Speaker, dialect
from delfim.parts.mavlink.consoles import Consoles
from delfim.parts.mavlink.peers import Peer
from delfim.parts.mavlink.telemetry import COMPONENT
from delfim.vehicle.grex import SeenVessel

OLD_S: Final = 600  # a report that was older when it came is none
NEAREST: Final = 8  # things of one message, the nearest
FROM_BOW: Final[dict[int, bool]] = {dialect.MAV_FRAME_GLOBAL: False, dialect.MAV_FRAME_BODY_FRD: True}  # the frames it may have
SENSORS: Final = {0: "lidar", 1: "ultrasound", 2: "infrared", 3: "radar"}


def vessel(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """AIS_VESSEL: a vessel that a console, or a receiver at its end, heard of some seconds ago."""
    if not _is_heard(consoles) or source.component == GUEST or not NUMBERS <= message.MMSI <= MMSI_MAX or message.tslc > OLD_S:
        consoles.count("vessels_refused")
        return
    state, now_s, facts = consoles.boat.state, consoles.clock.monotonic_s() - message.tslc, facts_of(message)
    state.hear(position_of(message), source.name, now_s)
    if facts is not None:
        state.hear(facts, source.name, now_s)


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


def obstacles(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """OBSTACLE_DISTANCE: how far the nearest obstacle is in each of up to 72 directions, each a thing that stands, as wide as
    its direction. Nobody tells what they are, so that a swimmer is one of them."""
    state, now_s = consoles.boat.state, consoles.clock.monotonic_s()
    is_from_bow, motion = FROM_BOW.get(message.frame), state.motion
    is_sane = math.isfinite(message.increment_f + message.angle_offset)
    if not (_is_heard(consoles) and is_sane) or source.component == GUEST or is_from_bow is None:
        consoles.count("vessels_refused")
        return
    if now_s - consoles.obstacles_s < EVERY_S:
        return
    if state.origin is None or not {"position", "heading"} <= motion.has or now_s - state.navigation_s > STALE_S:
        consoles.count("vessels_refused")
        return
    consoles.obstacles_s = now_s
    step_deg = abs(message.increment_f) or float(message.increment)
    first_rad = math.radians(message.angle_offset) + (motion.heading_rad if is_from_bow else 0.0)
    step_rad = math.copysign(math.radians(step_deg), message.increment_f)
    echoes = (
        (cm / 100.0, first_rad + i * step_rad)
        for i, cm in enumerate(message.distances)
        if message.min_distance <= cm <= message.max_distance and cm
    )
    for north_m, east_m, radius_m in nearest(echoes, math.radians(0.5 * step_deg), NEAREST):
        at = motion.north_m + north_m, motion.east_m + east_m
        north, east = (math.degrees(each) for each in from_plane(state.origin, *at))
        target = SeenVessel(str(source.component), north, east, kind="thing", radius_m=radius_m, confidence=CONFIDENCE)
        consoles.see(SENSORS.get(message.sensor_type, "sensor"), target)


def _is_heard(consoles: Consoles) -> bool:
    return "mavlink" in consoles.boat.helm.settings.traffic.hears
