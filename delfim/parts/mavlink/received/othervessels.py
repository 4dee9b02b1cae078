"""Other vessels that the boat hears of on the console's link: by a console, and of boats of the fleet (docs/traffic.md)."""

import math
from typing import Final

from delfim.base.vessels import MMSI_MAX, VesselPosition
from delfim.parts.mavlink.codec.aisvessel import NUMBERS, facts_of, position_of
from delfim.parts.mavlink.codec.wire import GUEST, Message, Speaker
from delfim.parts.mavlink.consoles import Consoles
from delfim.parts.mavlink.peers import Peer
from delfim.parts.mavlink.telemetry import COMPONENT

OLD_S: Final = 600  # a report that was older when it came is none


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


def _is_heard(consoles: Consoles) -> bool:
    return "mavlink" in consoles.boat.helm.settings.traffic.hears
