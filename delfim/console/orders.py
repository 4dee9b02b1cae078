"""The operator's commands: one row for each word, with the numbers that it takes and its MAVLink command; the names of the
boat's modes are commands, too, and so are those of the orders of its parts, behind OF_PART.

An unknown word, an unknown or missing argument and an argument that is no number are refused with the reason. Nothing is
ignored in silence, and nothing is guessed.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.base.numberedorders import NumberedOrder
from delfim.console.mavlink import mavlink

REQUEST_CONTROL: Final = 32100  # MAV_CMD_REQUEST_OPERATOR_CONTROL
OF_PART: Final = "order "  # begins the word for an order of a part
OWN_SPEED: Final = -1.0  # the boat's
Numbers = Mapping[str, float]


class CommandLong(NamedTuple):
    """A MAVLink command. `place`: latitude and longitude, 1e-7 degrees; too fine for the floats of `numbers`."""

    command: int
    numbers: tuple[float, ...]
    place: tuple[int, int] | None = None


class WordRow(NamedTuple):
    """Of a word."""

    make: Callable[[Numbers], CommandLong]
    mode: str = ""  # that the boat enters by it
    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()  # and these, where they are known
    title: str = ""  # in the page's menu "More", where that offers it as it is
    key: str = ""  # of the page's keyboard


def row_of(word: str, modes: Mapping[int, str], orders: Mapping[str, NumberedOrder]) -> WordRow:
    """The row of a word, that of a mode that the boat has, or of an order of its parts. Raises FormatError."""
    for number, name in modes.items() if word not in ORDERS else ():
        if name == word:
            return _enter(name, number)
    if word.startswith(OF_PART) and (found := orders.get(word.removeprefix(OF_PART))) is not None:
        return _of_part(found)
    try:
        return ORDERS[word]
    except KeyError:
        raise FormatError(f"no command {word!r}") from None


def order(word: str, row: WordRow, words: Mapping[str, Any]) -> CommandLong:
    """Raises FormatError."""
    if unknown := sorted(set(words) - {*row.needs, *row.takes}):
        raise FormatError(f"{word} does not take {', '.join(map(repr, unknown))}")
    if missing := [name for name in row.needs if name not in words]:
        raise FormatError(f"{word} needs {', '.join(missing)}")
    return row.make({name: _number(word, name, value) for name, value in words.items()})


def _number(word: str, name: str, value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e9:  # NaN is not, either
        raise FormatError(f"{word}: {name} is a number, not {value!r:.40}")
    return float(value)


def _enter(mode: str, number: int) -> WordRow:
    asked = CommandLong(mavlink.MAV_CMD_DO_SET_MODE, (1.0, float(number)))
    return WordRow(lambda n: asked, mode)


def _of_part(found: NumberedOrder) -> WordRow:
    """Keys that are not given are NaN, for which the boat takes what its part says."""
    names = tuple(key.name for key in found.keys)
    return WordRow(lambda n: CommandLong(found.number, tuple(n.get(name, math.nan) for name in names)), takes=names)


def _heading(n: Numbers) -> CommandLong:
    if "heading_deg" not in n:
        return _enter("heading", Mode.HEADING).make(n)
    return CommandLong(mavlink.MAV_CMD_GUIDED_CHANGE_HEADING, (1.0, n["heading_deg"] % 360.0, 0.0))


def _course(n: Numbers) -> CommandLong:
    if "course_deg" not in n:
        return _enter("course", Mode.COURSE).make(n)
    return CommandLong(mavlink.MAV_CMD_GUIDED_CHANGE_HEADING, (0.0, n["course_deg"] % 360.0, 0.0))


def _goto_point(n: Numbers) -> CommandLong:
    latitude, longitude = round(n["latitude_deg"] * 1e7), round(n["longitude_deg"] * 1e7)
    if abs(latitude) > 890_000_000 or abs(longitude) > 1_800_000_000:
        raise FormatError(f"{n['latitude_deg']}, {n['longitude_deg']} is no position on Earth")
    return CommandLong(mavlink.MAV_CMD_DO_REPOSITION, (n.get("speed_mps", OWN_SPEED), 1.0), (latitude, longitude))


def _speed(n: Numbers) -> CommandLong:
    if len(n) != 1:
        raise FormatError("speed needs either speed_mps or speed_pct")
    return CommandLong(mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, n.get("speed_mps", OWN_SPEED), n.get("speed_pct", OWN_SPEED)))


def _play(n: Numbers) -> CommandLong:
    leg = n.get("leg", 0.0)
    if leg < 0.0 or leg != int(leg):
        raise FormatError(f"play: leg is the number of a waypoint, not {leg:g}")
    return CommandLong(mavlink.MAV_CMD_MISSION_START, (leg, 0.0))


def _path(n: Numbers) -> CommandLong:
    whole = _enter("path", Mode.PATH).make(n)
    if "piece" not in n:
        return whole
    if n["piece"] < 0.0 or n["piece"] != int(n["piece"]):
        raise FormatError(f"path: piece is the number of a piece, not {n['piece']:g}")
    return whole._replace(numbers=(*whole.numbers, n["piece"] + 1.0))


def _pause(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, (0.0,))


def _continue(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, (1.0,))


def _arm(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))


def _disarm(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))


def _reset(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (0.0, 0.0, 1.0, n.get("component", 0.0)))


def _kill(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (1.0,))


def _clear(n: Numbers) -> CommandLong:
    return CommandLong(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (0.0,))


def _take(n: Numbers) -> CommandLong:
    return CommandLong(REQUEST_CONTROL, (0.0, 1.0, 1.0))


ORDERS: Final[dict[str, WordRow]] = {
    "stop": _enter("idle", Mode.IDLE),
    "heading": WordRow(_heading, "heading", takes=("heading_deg",)),
    "heading_to": WordRow(_heading, "heading", needs=("heading_deg",)),
    "course": WordRow(_course, "course", takes=("course_deg",)),
    "goto_point": WordRow(_goto_point, "goto", needs=("latitude_deg", "longitude_deg"), takes=("speed_mps",)),
    "play": WordRow(_play, "play", takes=("leg",)),
    "path": WordRow(_path, "path", takes=("piece",)),
    "pause": WordRow(_pause, "hold", key="B"),
    "continue": WordRow(_continue, key="C"),
    "speed": WordRow(_speed, takes=("speed_mps", "speed_pct")),
    "arm": WordRow(_arm),
    "disarm": WordRow(_disarm, "idle"),
    "reset": WordRow(_reset, takes=("component",), title="Reset the peripherals", key="R"),
    "kill": WordRow(_kill, "idle", title="Kill: idle until it is cleared"),
    "clear": WordRow(_clear, title="Clear the kill"),
    "take": WordRow(_take),
}
OFFERED: Final = [{"command": word, "title": row.title, "key": row.key} for word, row in ORDERS.items() if row.title or row.key]
