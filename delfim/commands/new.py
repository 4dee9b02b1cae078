"""`delfim new`: a vehicle's file of your boat, from a few answers, and a short first mission where it lies.

It asks for values that no option gives, or with --yes takes their defaults. No file is replaced, and none stays that is wrong.
"""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.base.errors import ConfigError, DelfimError, FormatError
from delfim.base.outside import read_text
from delfim.commands import PACKAGE

OWN: Final = "own"
LISBON: Final = "38.6907 -9.2153"
WHERE: Final = "Where it lies: latitude and longitude, degrees"
MASS_KG_PER_M2: Final = 20.0  # of length times beam, as config.BoatTable guesses it
MOTORS: Final = {
    "esc": "two motors on ESCs, port and starboard, told by pulses (docs/pwm.md)",
    "rudder": "one motor on an ESC, and a rudder on a servo, told by pulses (docs/pwm.md)",
    "dronecan": "two motors on DroneCAN controllers, port and starboard (docs/dronecan.md)",
    "vesc": "two motors on VESC controllers on a CAN bus (docs/vesc.md)",
    "ardupilot": "the two motors of a board with ArduRover (docs/front-seat.md)",
}
SENSORS: Final = {
    "usb": "a GPS mouse and a compass that speak NMEA 0183, on a USB port each (docs/nmea0183.md)",
    "nmea2000": "a receiver and a compass on an NMEA 2000 bus (docs/nmea2000.md)",
    "dronecan": "a receiver and a compass on a DroneCAN bus (docs/dronecan.md)",
    "ardupilot": "a Pixhawk or another board with ArduRover, and the receiver and compass on it (docs/front-seat.md)",
}
OF_OWN: Final = ("length", "beam", "mass", "motors", "thrust", "speed", "sensors")  # options of a boat of one's own
ON_CAN: Final = ("dronecan", "vesc", "nmea2000")  # each needs a bus, and a bus carries one protocol


ADDRESSES: Final = {
    "esc": "its channel on the chip that makes the pulses",
    "rudder": "the channel of its ESC on the chip that makes the pulses",
    "dronecan": "its controller's ESC_INDEX",
    "vesc": "its controller's number, as VESC Tool has it",
    "ardupilot": "0 is the starboard side, 1 the port side",
}
RUDDER: Final = """\
steer = { kind = "rudder", address = 1, angle_max_deg = 35.0, rate_dps = 60.0 }  # the channel of its servo
"""
BOARD: Final = """\
[mavlink_front_seat]
device = "tcp:127.0.0.1:5760"  # the board, or its serial port as "/dev/ttyACM0"
"""
PULSES: Final = """\
[pwm]
chip = "/sys/class/pwm/pwmchip0"  # the computer's own; "/dev/i2c-1" for a PCA9685 or a Navigator
"""
MOTOR_TABLES: Final = {
    "esc": PULSES,
    "rudder": PULSES,
    "dronecan": """\
[dronecan]
interface = "{interface}"
""",
    "vesc": """\
[vesc]
interface = "{interface}"
command = "duty"  # a part of the battery's voltage; "rpm" is steadier, and needs rpm_max of each motor
""",
    "ardupilot": BOARD,
}
SENSOR_TABLES: Final = {
    "usb": """\
[navigation]
sources = ["nmea0183"]
rate_hz = 10.0
estimator = true  # makes one navigation of separate sensors: docs/estimator.md

[nmea0183]
variation_deg = 0.0  # the magnetic variation of your place, east positive, if the compass is magnetic

[nmea0183.ports.gps]
device = "/dev/ttyACM0"  # a name that stays the same after each start: ls /dev/serial/by-id
baud = 9600

[nmea0183.ports.compass]
device = "/dev/ttyUSB0"
baud = 4800  # not known? delfim sensors --find /dev/ttyUSB0
""",
    "nmea2000": """\
[navigation]
sources = ["nmea2000"]
rate_hz = 10.0
stale_s = 2.5

[nmea2000]
interface = "{interface}"

[failsafe.navigation_silent]
after_s = 2.5
""",
    "dronecan": """\
[navigation]
sources = ["dronecan"]
rate_hz = 10.0
estimator = true  # makes one navigation of separate sensors: docs/estimator.md

[dronecan]
interface = "{interface}"
""",
    "ardupilot": """\
[navigation]
sources = ["mavlink_front_seat"]  # the board is asked for its position so often:
rate_hz = 10.0

"""
    + BOARD,
}
INSTRUMENTS: Final = """\
instruments = ["gps:receiver", "compass:compass", "compass:gyro"]  # what each port is
"""


class Answers(NamedTuple):
    """Lengths in m, thrust of one motor at full power ahead in N, the speed that all reach in m/s, the place in degrees."""

    name: str
    number: int
    length_m: float
    beam_m: float
    mass_kg: float
    motors: str
    thrust_n: float
    full_mps: float
    sensors: str
    latitude_deg: float
    longitude_deg: float


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="Write this file, such as myboat.toml; it must not exist.")
    parser.add_argument("--yes", action="store_true", help="Ask nothing: what has no option gets its default.")
    parser.add_argument("--boat", metavar="BOAT", help=f"One of etc/boats to begin with: {', '.join(_shipped())}; or own.")
    parser.add_argument("--name", metavar="NAME", help="Name of the boat (default: that of FILE).")
    parser.add_argument("--id", metavar="NUMBER", help="Its number, 1 to 249, of which no other boat has the same.")
    for name in ("length", "beam"):
        parser.add_argument(f"--{name}", metavar="M", help=f"Its {name} over all, in metres.")
    parser.add_argument("--mass", metavar="KG", help="Its mass as it sails, in kilograms.")
    parser.add_argument("--motors", metavar="KIND", help=_kinds(MOTORS))
    parser.add_argument("--thrust", metavar="N", help="Force of one motor at full power ahead, in newtons.")
    parser.add_argument("--speed", metavar="MPS", help="Its speed at full power in calm water, in metres a second.")
    parser.add_argument("--sensors", metavar="KIND", help=_kinds(SENSORS))
    told = "Where it lies, in degrees, north and east positive (default: Lisbon)."
    parser.add_argument("--where", nargs=2, metavar=("LAT", "LON"), help=told)


def _kinds(kinds: dict[str, str]) -> str:
    return "; ".join(f"{kind}: {words}" for kind, words in kinds.items()) + "."


def run(asked: argparse.Namespace) -> int:
    from delfim import config

    file = Path(asked.file)
    mission = file.with_name(f"{file.stem}-mission.toml")
    for place in (file, mission):
        if place.exists():
            raise DelfimError(f"{place} exists already, and nothing is replaced: name another file")
    ask = _Asking(asked)
    boats = {OWN: "a boat of your own: more questions follow"} | {name: _about(place) for name, place in _shipped().items()}
    boat = ask("boat", "Which boat", OWN, _one_of(boats), boats)
    if boat == OWN:
        answers = _answers(ask, file.stem)
        text, rectangle = _text(answers, file.name, mission.name), _mission_text(answers.name, answers.length_m, *answers[-2:])
    else:
        if given := [each for each in OF_OWN if getattr(asked, each) is not None]:
            raise DelfimError(f"--{given[0]}: {boat} has its own; leave this away, and change the file afterwards")
        text, rectangle = _copied(ask, _shipped()[boat], file.stem, mission.name)
    try:
        mission.write_text(rectangle, encoding="utf-8")
        file.write_text(text, encoding="utf-8")
        config.load(file)
    except ConfigError as error:
        for place in (file, mission):
            place.unlink(missing_ok=True)
        raise DelfimError(f"nothing was written: {error.key}: {error.reason}") from None
    print(f"delfim: {file} and {mission} are written. Next:\n  delfim check {file}\n  delfim sim {file} --console")
    return 0


def _shipped() -> dict[str, Path]:
    """The boats to start from, by name."""
    return {place.stem: place for place in sorted((PACKAGE / "etc/boats").glob("*.toml"))}


def _about(place: Path) -> str:
    """The first sentence of its file."""
    return read_text(place).removeprefix("# ").replace("\n# ", " ").partition(". ")[0]


def _copied(ask: "_Asking", place: Path, stem: str, mission: str) -> tuple[str, str]:
    """One of the boats to start from, with another name, number and place; and its mission."""
    from delfim import config
    from delfim.services.vehiclefile import changed

    name, number = ask("name", "Name of the boat", stem, _name), _number_of(ask)
    latitude_deg, longitude_deg = ask("where", WHERE, LISBON, _place)
    values: dict[str, Any] = {"boat.name": name, "boat.id": number, "simulation.mission": mission}
    values |= {"simulation.latitude_deg": latitude_deg, "simulation.longitude_deg": longitude_deg}
    length_m = config.load(place).boat.length_m
    return changed(str(place), values), _mission_text(name, length_m, latitude_deg, longitude_deg)


def _number_of(ask: "_Asking") -> int:
    return int(ask("id", "Its number, 1 to 249, of which no other boat has the same", "1", _number))


def _answers(ask: "_Asking", stem: str) -> Answers:
    """Each from its option, or typed, or its default."""
    from delfim import config
    from delfim.vehicle.control.hull import full_mps

    name, number = ask("name", "Name of the boat", stem, _name), _number_of(ask)
    length_m = ask("length", "Its length over all, m", "1.5", _positive)
    beam_m = ask("beam", "Its beam over all, m", f"{0.5 * length_m:.3g}", _positive)
    mass_kg = ask("mass", "Its mass as it sails, kg", f"{MASS_KG_PER_M2 * length_m * beam_m:.3g}", _positive)
    motors = ask("motors", "Motors", "esc", _one_of(MOTORS), MOTORS)
    usual_n = (3.0 if motors == "rudder" else 2.0) * mass_kg  # as boats of etc/boats have it
    thrust_n = ask("thrust", "Force of one motor at full power ahead, N", f"{usual_n:.3g}", _positive)
    guess_mps = full_mps(config.BoatTable(name, length_m=length_m))
    speed_mps = ask("speed", "Its speed at full power in calm water, m/s", f"{guess_mps:.3g}", _positive)
    usual = "ardupilot" if motors == "ardupilot" else "usb"
    sensors = ask("sensors", "Position and heading from", usual, _one_of(SENSORS), SENSORS)
    latitude_deg, longitude_deg = ask("where", WHERE, LISBON, _place)
    hull = length_m, beam_m, mass_kg
    return Answers(name, number, *hull, motors, thrust_n, speed_mps, sensors, latitude_deg, longitude_deg)


class _Asking:
    """Asks for what no option gave. A wrong option ends the command; a wrong word that was typed is asked for again."""

    def __init__(self, asked: argparse.Namespace) -> None:
        self._asked = asked

    def __call__(
        self, option: str, words: str, default: str, read: Callable[[str], Any], kinds: dict[str, str] | None = None
    ) -> Any:
        given = getattr(self._asked, option)
        if given is None and not self._asked.yes and not sys.stdin.isatty():
            raise DelfimError(f"nobody is here to ask: give --{option}, or --yes for all defaults")
        if given is not None or self._asked.yes:
            text = default if given is None else " ".join(given) if isinstance(given, list) else given
            try:
                return read(text)
            except FormatError as error:
                raise DelfimError(f"--{option} {text}: {error}") from None
        for kind, told in (kinds or {}).items():
            print(f"  {kind:10} {told}")
        while True:
            try:
                return read(input(f"{words} [{default}]: ").strip() or default)
            except EOFError:
                raise DelfimError("nothing was written: the answers ended too early") from None
            except FormatError as error:
                print(f"  {error}")


def _name(text: str) -> str:
    kept = "".join(each if each.isascii() and (each.isalnum() or each in "_-") else "-" for each in text)
    if kept != text or not text[:1].isalpha() or len(text) > 32:
        raise FormatError("a name is a letter, then up to 31 letters, digits, _ or -")
    return text


def _number(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 249):
        raise FormatError("this must be a whole number from 1 to 249")
    return int(text)


def _positive(text: str) -> float:
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise FormatError("this must be a number above 0")
    return number


def _one_of(kinds: dict[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in kinds:
            raise FormatError(f"there are {', '.join(kinds)}")
        return text

    return read


def _place(text: str) -> tuple[float, float]:
    try:
        latitude_deg, longitude_deg = map(float, text.replace(",", " ").split())
    except ValueError:
        raise FormatError("write latitude and longitude in degrees, as 38.6907 -9.2153") from None
    if not (abs(latitude_deg) <= 85.0 and abs(longitude_deg) <= 180.0):
        raise FormatError("a latitude goes from -85 to 85 here, and a longitude from -180 to 180")
    return latitude_deg, longitude_deg


def _buses(of: Answers) -> dict[str, str]:
    """The CAN interface of each protocol that needs one, as one carries one protocol: can0, then can1."""
    protocols = [each for each in dict.fromkeys((of.motors, of.sensors)) if each in ON_CAN]
    return {protocol: f"can{number}" for number, protocol in enumerate(protocols)}


def _text(of: Answers, file: str, mission: str) -> str:
    """The vehicle's file."""
    buses = _buses(of)
    return f"""\
# {of.name}. Every table and key with its range: `delfim describe`. After each change: `delfim check {file}`.

[boat]
name = "{of.name}"
id = {of.number}  # on the console's link: another one for each boat, 1 to 249
length_m = {of.length_m:g}
beam_m = {of.beam_m:g}
mass_kg = {of.mass_kg:g}  # as it sails
full_mps = {of.full_mps:g}  # speed at full power in calm water: measure it, for the autopilot reckons with it

[can]
interface = "canloop:nodes"  # a bus within the computer: no node of DelfimX is on this boat

# Motors, a table each: place in metres ahead and to starboard of the middle, force in newtons at full power astern and ahead
# (measure it with a spring scale at a jetty).
{_thrusters(of)}{MOTOR_TABLES.get(of.motors, "").format(interface=buses.get(of.motors))}
# Position and heading.
{_sensors(of, buses)}
# What goes wrong, and what the boat does about it: docs/failsafe.md. Here what a sailor changes most often.
[failsafe.console_silent]
after_s = 10.0
action = "home"  # back the way it came; or "hold", "stop"

# For `delfim sim` alone: where the boat starts, what it sails, and in which sea.
[simulation]
latitude_deg = {of.latitude_deg:.6f}
longitude_deg = {of.longitude_deg:.6f}
mission = "{mission}"
{INSTRUMENTS if of.sensors == "usb" else ""}sea = {{ wind_mps = 2.0, wind_from_deg = 320.0 }}
"""


def _sensors(of: Answers, buses: dict[str, str]) -> str:
    """Motors and sensors on one bus or board share its table, which stands at the motors."""
    text = SENSOR_TABLES[of.sensors].format(interface=buses.get(of.sensors))
    table = {"dronecan": "\n[dronecan]", "ardupilot": "\n[mavlink_front_seat]"}.get(of.sensors, "")
    return text.partition(table)[0] + "\n" if table and of.motors == of.sensors else text


def _thrusters(of: Answers) -> str:
    """A single motor stands in the middle and has a rudder behind it."""
    driver = {"esc": "pwm", "rudder": "pwm", "ardupilot": "mavlink_front_seat"}.get(of.motors, of.motors)
    sides = {"motor": 0.0} if of.motors == "rudder" else {"starboard": 0.35 * of.beam_m, "port": -0.35 * of.beam_m}
    rows = ""
    for address, (name, y_m) in enumerate(sides.items()):
        rows += f"""\
[[thrusters]]
name = "{name}"
driver = "{driver}"
address = {address}  # {ADDRESSES[of.motors]}
x_m = {-0.4 * of.length_m:.3g}
y_m = {y_m:.3g}
thrust_n = [{-0.6 * of.thrust_n:.3g}, {of.thrust_n:.3g}]
{RUDDER if of.motors == "rudder" else ""}
"""
    return rows


def _mission_text(name: str, length_m: float, latitude_deg: float, longitude_deg: float) -> str:
    """A rectangle of legs of about fifteen lengths of the boat, ahead of it and to its starboard, as it lies: bow north."""
    from delfim.base.geodesy import from_plane, origin

    leg_m = max(15.0 * length_m, 30.0)
    at = origin(math.radians(latitude_deg), math.radians(longitude_deg))
    rows = "# A rectangle to begin with. Keys and ranges: docs/missions.md. Draw your own in the console.\n"
    rows += f'version = 1\nname = "{name}"\n'
    for north, east in ((1, 0), (1, 1), (0, 1), (0, 0)):
        latitude_rad, longitude_rad = from_plane(at, north * leg_m, east * leg_m)
        rows += f"\n[[waypoint]]\nlatitude_deg = {math.degrees(latitude_rad):.6f}\n"
        rows += f"longitude_deg = {math.degrees(longitude_rad):.6f}\n"
    return rows
