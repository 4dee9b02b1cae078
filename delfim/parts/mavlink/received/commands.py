"""Commands of consoles by COMMAND_LONG and COMMAND_INT: one row a command, a function of a few lines each.

A row turns numbers into the console's words (`delfim/vehicle/console.py`); the vehicle obeys those or says why not. The
numbers of other autopilots are never guessed: PX4's code for "hold" is our number for something that moves the boat.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.base.errors import FormatError, Refused
from delfim.base.modes import PAYLOADS, Mode
from delfim.base.numberedorders import numbered
from delfim.base.parts import OrderRow
from delfim.parts.mavlink.codec import params
from delfim.parts.mavlink.codec.plans import GLOBAL
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.vehicle import console

ACCEPTED: Final = int(dialect.MAV_RESULT_ACCEPTED)
LATER: Final = int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
DENIED: Final = int(dialect.MAV_RESULT_DENIED)
UNSUPPORTED: Final = int(dialect.MAV_RESULT_UNSUPPORTED)
RTL: Final = 11  # ArduRover's number for the straight way home: this boat takes the way that it came, and tells so
CHANGE_MODE: Final = int(dialect.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
PLACE: Final = ("latitude_deg", "longitude_deg")
NOWHERE: Final = 0x7FFFFFFF  # of an integer position: not given

PX4: Final[dict[tuple[float, float], console.Commands]] = {  # main mode, sub mode: MAVSDK sends these to an unknown autopilot
    (4, 3): console.Pause(),  # but a boat at rest or driven by hand stops: "hold" must not start its propellers
    (4, 4): console.SetMode("play"),  # goes on with a paused mission
    (4, 5): console.SetMode("home"),
}


class Order(NamedTuple):
    """A command as it came: seven numbers, positions in degrees; NaN: not given."""

    command: int
    p: tuple[float, ...]
    target_system: int
    confirmation: int = 0
    frame: int = 0


class Terms(NamedTuple):
    """The vehicle's data needed to understand an order."""

    leg: Callable[[int], int]  # of an item of the mission; raises FormatError
    mode: Mode  # that the boat is in
    payloads: tuple[str, ...]  # programs that may have the boat
    guided_waits: bool  # as in ArduRover: mode 15 waits for a point, and does not go to the first waypoint


def order(message: Message) -> Order:
    """Of a COMMAND_LONG or a COMMAND_INT."""
    first = message.param1, message.param2, message.param3, message.param4
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG:
        rest = message.param5, message.param6, message.param7
        return Order(message.command, (*first, *rest), message.target_system, message.confirmation)
    x, y = (math.nan if each == NOWHERE else each / 1e7 for each in (message.x, message.y))
    return Order(message.command, (*first, x, y, message.z), message.target_system, frame=message.frame)


def stops(o: Order) -> bool:
    """Whether this is a stop in any form: valid whenever it comes, and however often."""
    asked = o.p[1] == Mode.IDLE if o.command == dialect.MAV_CMD_DO_SET_MODE else not o.p[0]
    return asked and o.command in (dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_COMPONENT_ARM_DISARM)


def _mode(o: Order, boat: Terms) -> console.Commands:
    """DO_SET_MODE. Raises FormatError for a mode that is not ours, which must change nothing. The third number of the path is
    the piece to begin with, from 1, or its fourth the line of a survey: no other autopilot has that mode."""
    base, custom, sub, line = (*o.p, 0.0)[:4]
    if custom == Mode.PATH and line > 0.0:
        return console.asked(console.SetMode, mode="path", line=_whole(line))
    if sub and custom == Mode.PATH:
        return console.asked(console.SetMode, mode="path", piece=_whole(sub) - 1)
    if sub:
        if (custom, sub) not in PX4:
            raise FormatError(f"mode {custom:g}/{sub:g} is another autopilot's: choose one of this boat's modes")
        asked = PX4[custom, sub]
        return console.Stop() if isinstance(asked, console.Pause) and boat.mode in (Mode.IDLE, Mode.MANUAL) else asked
    if not (math.isfinite(base) and int(base) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
        raise FormatError("ask for the mode by its custom number")
    if custom == RTL:
        return console.SetMode("home")
    if custom in range(PAYLOADS, PAYLOADS + len(boat.payloads)):
        return console.Entrust(boat.payloads[int(custom) - PAYLOADS])
    if custom not in list(Mode):
        raise FormatError(f"no mode {custom:g}")
    if custom == Mode.GOTO and not boat.guided_waits:
        return console.Goto()
    return console.Stop() if custom == Mode.IDLE else console.SetMode(Mode(int(custom)).name.lower())


def _arm(o: Order, boat: Terms) -> console.Commands:
    if o.p[0] not in (0.0, 1.0):
        raise FormatError(f"1 arms, 0 disarms; {o.p[0]:g} does nothing")
    return console.Arm() if o.p[0] else console.Stop()


def _start(o: Order, boat: Terms) -> console.Commands:
    return console.asked(console.Play, leg=boat.leg(_whole(o.p[0])))


def _current(o: Order, boat: Terms) -> console.Commands:
    return console.asked(console.Leg, leg=boat.leg(_whole(o.p[0])))


def _home(o: Order, boat: Terms) -> console.Commands:
    return console.SetMode("home")


def _heading(o: Order, boat: Terms) -> console.Commands:
    if o.p[0] == dialect.HEADING_TYPE_COURSE_OVER_GROUND:
        return console.asked(console.Course, course_deg=o.p[1])
    if o.p[0] != dialect.HEADING_TYPE_HEADING:
        raise FormatError(f"0 is a course over ground, 1 a heading; {o.p[0]:g} is neither")
    return console.asked(console.Heading, heading_deg=o.p[1])


def _goto(o: Order, boat: Terms) -> console.Commands:
    """DO_REPOSITION. Without a position it is the present one, where the boat holds. Raises Refused if the boat must not
    leave its mode for this."""
    if o.frame not in GLOBAL:
        raise FormatError(f"a position in frame {o.frame} has no latitude and longitude")
    if math.isinf(o.p[0]):
        raise FormatError(f"{o.p[0]} is not a speed")
    if boat.mode is not Mode.GOTO and not _whole(o.p[1]) & CHANGE_MODE:
        raise Refused("goto refused: the boat is in another mode; choose goto first, or set the flag that changes the mode")
    if math.isnan(o.p[4]) and math.isnan(o.p[5]):
        return console.SetMode("hold")
    place = {name: degrees for name, degrees in zip(PLACE, o.p[4:6], strict=True) if not math.isnan(degrees)}
    return console.asked(console.Goto, **place, speed_mps=o.p[0] if o.p[0] > 0.0 else None)


def _pause(o: Order, boat: Terms) -> console.Commands:
    """DO_PAUSE_CONTINUE"""
    if o.p[0] not in (0.0, 1.0):
        raise FormatError(f"0 pauses, 1 continues; {o.p[0]:g} does nothing")
    return console.Continue() if o.p[0] else console.Pause()


def _speed(o: Order, boat: Terms) -> console.Commands:
    """In m/s if given, otherwise in % of the boat's top speed; -2 is the plan's own speed."""
    if o.p[1] == -2.0:
        return console.SetSpeed(None)
    if o.p[1] >= 0.0:
        return console.asked(console.SetSpeed, speed_mps=o.p[1])
    if not 0.0 <= o.p[2] <= 100.0:
        raise FormatError("give the speed in m/s, or as 0 to 100 %")
    return console.asked(console.SetSpeed, speed_pct=o.p[2])


def _terminate(o: Order, boat: Terms) -> console.Commands:
    """DO_FLIGHTTERMINATION"""
    if o.p[0] not in (0.0, 1.0):
        raise FormatError(f"1 kills, 0 clears the kill; {o.p[0]:g} does nothing")
    return console.Kill() if o.p[0] else console.Clear()


def _reset(o: Order, boat: Terms) -> console.Commands:
    if o.p[0] or o.p[1] or o.p[2] != 1.0:
        raise FormatError("only the other nodes can be restarted: send 0, 0, 1")
    return console.asked(console.Reset, node=_whole(o.p[3]) or 127)


def of_part(row: OrderRow, o: Order, boat: Terms) -> console.Commands:
    """The order of a part; its keys are the command's numbers, in their order."""
    try:
        values = numbered(row.number, row.name, row.table).values([params.single(each) for each in o.p])
    except ValueError as error:
        raise FormatError(str(error)) from None
    return console.asked(console.PartOrder, name=row.name, values=values)


def _whole(value: float) -> int:
    """Raises FormatError for anything but a whole number from 0 to 65535."""
    if not 0.0 <= value <= 65535.0 or value != int(value):
        raise FormatError(f"{value:g} is not a whole number from 0 to 65535")
    return int(value)


COMMANDS: Final[dict[int, Callable[[Order, Terms], console.Commands]]] = {
    dialect.MAV_CMD_DO_SET_MODE: _mode,
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    dialect.MAV_CMD_MISSION_START: _start,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _current,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _home,
    dialect.MAV_CMD_GUIDED_CHANGE_HEADING: _heading,
    dialect.MAV_CMD_DO_REPOSITION: _goto,
    dialect.MAV_CMD_DO_PAUSE_CONTINUE: _pause,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reset,
}
