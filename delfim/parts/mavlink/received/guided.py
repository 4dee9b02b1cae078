"""Set points of a program ashore or on board: SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT.

They are commands like others, of the console that commands: a velocity is a course over ground with its speed, a position is a
point to go to. A stream that did not end must not change the operator's choice, so they count only in the modes of STEERED.
"""

import math
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec.plans import GLOBAL
from delfim.parts.mavlink.codec.wire import Message, Speaker, dialect
from delfim.parts.mavlink.consoles import Consoles
from delfim.parts.mavlink.peers import Peer
from delfim.vehicle import console
from delfim.vehicle.loop import VehicleLoop

STEERED: Final = {Mode.GOTO: console.Goto, Mode.COURSE: console.Course, Mode.HEADING: console.Heading}
NO_PLACE, NO_VELOCITY, FORCE = 0b11, 0b11000, 0x200  # of the type mask
LOCAL_NED: Final = int(dialect.MAV_FRAME_LOCAL_NED)


def guided(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """Of equal ones in a row the first counts: the others would begin the mode anew."""
    mode = consoles.boat.state.mode
    if message.target_system != consoles.system or source != consoles.commander or mode not in STEERED:
        consoles.count("guided_ignored")
        return
    command, refused = _command(consoles.boat, message)
    if command is not None and command == consoles.guided and isinstance(command, STEERED[mode]):
        return
    if command is not None:
        refused = consoles.ask(source, command)
    if refused is not None:
        consoles.count("guided_refused")
    if refused is not None and refused != consoles.guided_refused:
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, refused)
    consoles.guided, consoles.guided_refused = command, refused


def _command(boat: VehicleLoop, message: Message) -> tuple[console.Commands | None, str | None]:
    """The command, or why there is none."""
    try:
        return _understood(boat, message), None
    except FormatError as error:
        return None, str(error)


def _understood(boat: VehicleLoop, m: Message) -> console.Commands:
    """Raises FormatError for what the boat cannot steer by."""
    is_local = m.get_msgId() == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    if m.type_mask & FORCE or not (m.coordinate_frame == LOCAL_NED if is_local else m.coordinate_frame in GLOBAL):
        raise FormatError("a set point is a velocity or a position, north and east or latitude and longitude")
    speed_mps = None if m.type_mask & NO_VELOCITY else math.hypot(m.vx, m.vy)
    if m.type_mask & NO_PLACE:
        if speed_mps is None:
            raise FormatError("a set point needs a velocity or a position")
        course_deg = math.degrees(math.atan2(m.vy, m.vx)) % 360.0
        return console.asked(console.Course, course_deg=course_deg, speed_mps=speed_mps)
    latitude_deg, longitude_deg = _place(boat, m) if is_local else (m.lat_int / 1e7, m.lon_int / 1e7)
    return console.asked(console.Goto, latitude_deg=latitude_deg, longitude_deg=longitude_deg, speed_mps=speed_mps or None)


def _place(boat: VehicleLoop, m: Message) -> tuple[float, float]:
    """Metres north and east of the local plane's origin."""
    if boat.state.origin is None:
        raise FormatError("no position yet: a local position has no place")
    latitude_rad, longitude_rad = from_plane(boat.state.origin, m.x, m.y)
    return math.degrees(latitude_rad), math.degrees(longitude_rad)
