"""Numbers of the vehicle's file as MAVLink's parameters. Ranges are the file's own; a change lasts for the voyage."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.base.errors import FormatError
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.vehicle import console

REAL32: Final = int(dialect.MAV_PARAM_TYPE_REAL32)


class Param(NamedTuple):
    name: str  # up to 16 characters
    key: str  # of the vehicle's file
    unit: str
    choices: tuple[str, ...] = ()  # words, numbered from 0


# The link's own; then what `config.CHANGEABLE` lets change.
PROFILE: Final = "LINK_PROFILE"  # of the asking peer: 0 lean, 1 radio, 2 wifi
PARAMS: Final = (
    Param("LOSS_TIMEOUT", "failsafe.console_silent.after_s", "s"),
    Param("LOSS_ACTION", "failsafe.console_silent.action", "", ("warn", "hold", "home", "stop")),
    Param("LOG_REQUIRED", "log.required", "", ("no", "yes")),
    Param("MAN_TIMEOUT", "failsafe.manual_silent.after_s", "s"),
    Param("MAN_THRUST_TIME", "failsafe.manual_silent.thrust_s", "s"),
    Param("SPEED_MAX", "control.speed.max_mps", "m/s"),
    Param("SPEED_CRUISE", "control.speed.cruise_mps", "m/s"),
    Param("SPEED_RAMP", "control.speed.ramp_mps2", "m/s2"),
    Param("SPEED_P", "control.speed.p_n_per_mps", "N per m/s"),
    Param("SPEED_I", "control.speed.i_n_per_m", "N per m"),
    Param("SPEED_I_MAX", "control.speed.i_limit_n", "N"),
    Param("HEAD_P", "control.heading.p_nm_per_rad", "N m per rad"),
    Param("HEAD_P_MAX", "control.heading.p_limit_nm", "N m"),
    Param("HEAD_D", "control.heading.d_nm_per_radps", "N m per rad/s"),
    Param("HEAD_TURN", "control.heading.turn_nm_per_radps", "N m per rad/s"),
    Param("HEAD_I", "control.heading.i_nm_per_rad_s", "N m per rad s"),
    Param("HEAD_I_MAX", "control.heading.i_limit_nm", "N m"),
    Param("PATH_LOOKAHEAD", "control.path.lookahead_m", "m"),
    Param("PATH_I", "control.path.integral_gain", "m/s"),
    Param("PATH_CRAB_TIME", "control.path.crab_s", "s"),
    Param("WP_RADIUS", "control.path.acceptance_m", "m"),
    Param("GOTO_END", "control.goto.end", "", ("hold", "idle")),
    Param("HOLD_RADIUS", "control.hold.radius_m", "m"),
    Param("HOLD_SPEED", "control.hold.speed_mps", "m/s"),
    Param("HOME_SPEED", "control.home.speed_mps", "m/s"),
)
BOAT_NAME: Final = "BOAT_NAME"  # the parameters that are texts; read only
SAILS_BY: Final = "SAILS_BY"  # the digest of its vehicle's file, as its report has it
BOAT_SIZE: Final = "BOAT_SIZE"  # length and beam, m, and revolutions a minute at full command, 0: not known
BOAT_RUN: Final = "BOAT_RUN"  # drawn at the start: two addresses with the same value are one boat
ENERGY: Final = "ENERGY"  # the array of the energy
WAY_HOME: Final = "WAY_HOME"  # the arrays of the way home (`delfim.parts.mavlink.codec.wayhome`)
STATIONS: Final = "STATIONS"  # the array of the stations that are done
SENSED: Final = "SENSED"  # the array of what the sensors behind an estimator said last, in a trial
SENSED_VALUES: Final = {"heading": 1, "rate": 1, "velocity": 2}  # rad, rad/s, m/s north and east; before each its age, s
TROUBLES: Final = "TROUBLES"  # the named value of those that are there now: bit n is number n of `Trigger`
LINE: Final = "LINE"  # the named value of the line of a survey that the boat is on; 0: none
NAMES: Final = (PROFILE, *(param.name for param in PARAMS))
BY_NAME: Final = {param.name: param for param in PARAMS}


def value(settings: config.Vehicle, param: Param) -> float:
    """The parameter's present value."""
    table: Any = settings
    for part in param.key.split("."):
        table = getattr(table, part)
    return float(param.choices.index(table) if isinstance(table, str) and param.choices else table)


def command(name: str, number: float) -> console.Commands:
    """The command that changes a parameter. Raises FormatError for a number outside its choices."""
    param = BY_NAME[name]
    if not param.choices:
        return console.Set(param.key, single(number))
    if number not in range(len(param.choices)):
        raise FormatError(f"{name} is one of 0 to {len(param.choices) - 1}: {', '.join(param.choices)}")
    return console.Set(param.key, param.choices[int(number)])


def named(text: bytes | str) -> str:
    """The name in a parameter message."""
    return (text if isinstance(text, str) else text.decode("ascii", "replace")).partition("\0")[0]


def single(number: float) -> float:
    """The decimal number that a single-precision one stands for: 0.1, not 0.10000000149."""
    return float(f"{number:.7g}")


def message(name: str, number: float) -> Message:
    """PARAM_VALUE"""
    return dialect.MAVLink_param_value_message(name.encode(), number, REAL32, len(NAMES), NAMES.index(name))


def text(texts: Mapping[str, str], name: str) -> Message:
    """PARAM_EXT_VALUE"""
    place, kind = [*texts].index(name), dialect.MAV_PARAM_EXT_TYPE_CUSTOM
    return dialect.MAVLink_param_ext_value_message(name.encode(), texts[name].encode(), kind, len(texts), place)


def error(to: tuple[int, int], name: str, index: int, code: int) -> Message:
    """PARAM_ERROR, the answer to a request for an unknown parameter."""
    return dialect.MAVLink_param_error_message(*to, name.encode("ascii", "replace")[:16], index, code)
