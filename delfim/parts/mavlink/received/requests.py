"""Answers to single requests of a console: the vehicle's version, its modes, the home position."""

import math
from collections.abc import Callable, Iterable
from typing import Final

from delfim import __version__
from delfim.base.geodesy import from_plane
from delfim.base.modes import PAYLOADS, Mode
from delfim.parts.mavlink.codec import ownorders, wayhome
from delfim.parts.mavlink.codec.params import WAY_HOME
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.parts.mavlink.telemetry import TelemetryView, array, shown_mode
from delfim.vehicle.orders.entrusting import starts_and_stops

CAPABILITIES: Final = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | dialect.MAV_PROTOCOL_CAPABILITY_COMPONENT_ACCEPTS_GCS_CONTROL
)
STANDARD: Final[dict[int, int]] = {
    Mode.HOLD: dialect.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.PLAY: dialect.MAV_STANDARD_MODE_MISSION,
    Mode.HOME: dialect.MAV_STANDARD_MODE_SAFE_RECOVERY,
}


def version(view: TelemetryView, index: int) -> Iterable[Message]:
    """AUTOPILOT_VERSION: 1.2.3 is 0x010203FF, a release."""
    parts = [int(part) for part in __version__.split(".")[:3] if part.isdigit()]
    number = sum(part << 8 * (3 - at) for at, part in enumerate(parts)) | 0xFF
    none = [0] * 8
    boat = view.boat.helm.settings.boat.id
    return (dialect.MAVLink_autopilot_version_message(CAPABILITIES, number, 0, 0, 0, none, none, none, 0, 0, boat),)


def modes(view: TelemetryView, index: int) -> Iterable[Message]:
    """AVAILABLE_MODES: one of them, counted from 1; 0 is all."""
    names = view.boat.helm.settings.helmsmen
    every = {int(mode): mode.name.lower() for mode in Mode} | {PAYLOADS + i: f"payload {name}" for i, name in enumerate(names)}
    for number, (mode, name) in enumerate(every.items(), 1):
        if index in (0, number):
            standard = STANDARD.get(mode, dialect.MAV_STANDARD_MODE_NON_STANDARD)
            yield dialect.MAVLink_available_modes_message(len(every), number, standard, mode, 0, name.encode())


def offers(view: TelemetryView, index: int) -> Iterable[Message]:
    """V2_EXTENSION: an entry of a console's menu, counted from 1; 0 is all."""
    helm = view.boat.helm
    every = ownorders.offers((each.row for each in helm.orders.values()), starts_and_stops(helm.settings))
    return (ownorders.told(place, each, len(every)) for place, each in enumerate(every, 1) if index in (0, place))


def mode(view: TelemetryView, index: int) -> Iterable[Message]:
    now = shown_mode(view)
    standard = STANDARD.get(now, dialect.MAV_STANDARD_MODE_NON_STANDARD)
    return (dialect.MAVLink_current_mode_message(standard, now, now),)


def home(view: TelemetryView, index: int) -> Iterable[Message]:
    """HOME_POSITION: where the way home ends; then DEBUG_FLOAT_ARRAY WAY_HOME: the way there, as it is now."""
    helm = view.boat.helm
    place, origin = helm.home(), helm.state.origin
    if place is None or origin is None:
        return
    latitude, longitude = (round(math.degrees(angle) * 1e7) for angle in place)
    yield dialect.MAVLink_home_position_message(latitude, longitude, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    points = list[tuple[float, float]]()
    if not helm.homeward.why:
        angles = (from_plane(origin, *point) for point in wayhome.thinned(helm.track.way_home()))
        points = [(math.degrees(north) - latitude / 1e7, math.degrees(east) - longitude / 1e7) for north, east in angles]
    for number, told in enumerate(wayhome.arrays(points, helm.settings.control.home.speed_mps)):
        yield array(view, WAY_HOME, told, number)


def time(view: TelemetryView, index: int) -> Iterable[Message]:
    return (dialect.MAVLink_system_time_message(view.boat.clock.time_ns() // 1000, int(view.now_s * 1e3) & 0xFFFFFFFF),)


ANSWERS: Final[dict[int, Callable[[TelemetryView, int], Iterable[Message]]]] = {
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: version,
    dialect.MAVLINK_MSG_ID_AVAILABLE_MODES: modes,
    dialect.MAVLINK_MSG_ID_V2_EXTENSION: offers,
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: mode,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: home,
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: time,
}
