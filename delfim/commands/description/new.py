"""`delfim new`: writes a vehicle's file of your boat from a few answers, and a short first mission where it lies.

It asks for values that no option gives, or with --yes takes their defaults. No file is replaced, and none stays that is wrong.
"""

import argparse
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote
from typing import Any, Final, NamedTuple, Protocol

from delfim.base import parts
from delfim.base.errors import ConfigError, DelfimError, FormatError
from delfim.base.input.untrusted import read_text
from delfim.base.questions import MotorsAnswer, PositionsAnswer
from delfim.commands import PACKAGE

OWN: Final = "own"
LISBON: Final = "38.6907 -9.2153"
WHERE: Final = "Where it lies: latitude and longitude, degrees"
MASS_KG_PER_M2: Final = 20.0  # of length times beam, as config.BoatTable guesses it
OF_OWN: Final = ("length", "beam", "mass", "motors", "thrust", "speed", "sensors")  # options of a boat of one's own
Motors = dict[str, tuple[str, MotorsAnswer]]  # by word: the part's name, and what it says of it
Positions = dict[str, tuple[str, PositionsAnswer]]

UNPROVEN = """\
# Nobody has seen yet which motor does what: manual and trial only, and a failsafe stops. `delfim adopt` finds them; or try each
# by hand (docs/bench.md), and write true.
[adopted]
proven = false
"""


def asked_of_parts() -> tuple[Motors, Positions]:
    """The words for motors and for position and heading, of all the boat's own parts: first what is usual."""
    motors, positions = Motors(), Positions()
    for part in parts.OWN.values():
        if part.ask:
            said = parts.load(part, part.ask)
            motors |= {each.word: (part.name, each) for each in getattr(said, "MOTORS", ())}
            positions |= {each.word: (part.name, each) for each in getattr(said, "POSITIONS", ())}
    return _sorted(motors), _sorted(positions)


def _sorted(words: dict[str, tuple[str, Any]]) -> dict[str, tuple[str, Any]]:
    return dict(sorted(words.items(), key=lambda item: (not item[1][1].usual, item[0])))


def _kinds(words: Mapping[str, tuple[str, MotorsAnswer | PositionsAnswer]]) -> dict[str, str]:
    return {word: each.about for word, (_, each) in words.items()}


class AsksFor(Protocol):
    """Asks for what an option names, in words, until `read` takes the answer; `kinds` are those that it may be, explained."""

    def __call__(
        self, option: str, words: str, default: str, read: Callable[[str], Any], kinds: dict[str, str] | None = None
    ) -> Any: ...


class Answers(NamedTuple):
    """The answers: lengths in m, thrust of one motor at full power ahead in N, the speed that all reach in m/s, the place in
    degrees."""

    name: str
    number: int
    length_m: float
    beam_m: float
    mass_kg: float
    motors: tuple[str, MotorsAnswer]  # with the name of the part
    thrust_n: float
    full_mps: float
    sensors: tuple[str, PositionsAnswer]
    latitude_deg: float
    longitude_deg: float


def options(parser: argparse.ArgumentParser) -> None:
    motors, positions = asked_of_parts()
    parser.add_argument("file", metavar="FILE", help="Write this file, such as myboat.toml; it must not exist.")
    parser.add_argument("--yes", action="store_true", help="Ask nothing: what has no option gets its default.")
    parser.add_argument("--boat", metavar="BOAT", help=f"One of etc/boats to begin with: {', '.join(_shipped())}; or own.")
    parser.add_argument("--name", metavar="NAME", help="Name of the boat (default: that of FILE).")
    parser.add_argument("--id", metavar="NUMBER", help="Its number, 1 to 249, of which no other boat has the same.")
    for name in ("length", "beam"):
        parser.add_argument(f"--{name}", metavar="M", help=f"Its {name} over all, in metres.")
    parser.add_argument("--mass", metavar="KG", help="Its mass as it sails, in kilograms.")
    parser.add_argument("--motors", metavar="KIND", help=_listed(_kinds(motors)))
    parser.add_argument("--thrust", metavar="N", help="Force of one motor at full power ahead, in newtons.")
    parser.add_argument("--speed", metavar="MPS", help="Its speed at full power in calm water, in metres a second.")
    parser.add_argument("--sensors", metavar="KIND", help=_listed(_kinds(positions)))
    told = "Where it lies, in degrees, north and east positive (default: Lisbon)."
    parser.add_argument("--where", nargs=2, metavar=("LAT", "LON"), help=told)


def _listed(kinds: dict[str, str]) -> str:
    return "; ".join(f"{kind}: {words}" for kind, words in kinds.items()) + "."


def run(asked: argparse.Namespace) -> int:
    file, mission = write(Path(asked.file), asked, AsksAtTerminal(asked))
    typed = quote(str(file))
    print(f"delfim: {file} and {mission} are written. Next:\n  delfim check {typed}\n  delfim sim {typed} --console")
    return 0


def write(file: Path, asked: argparse.Namespace, ask: "AsksFor") -> tuple[Path, Path]:
    """Write the vehicle's file and its mission, whose names are returned. Raises DelfimError: nothing is written then."""
    from delfim import config

    mission = file.with_name(f"{file.stem}-mission.toml")
    for place in (file, mission):
        if place.exists():
            raise DelfimError(f"{place} exists already, and nothing is replaced: name another file")
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
    return file, mission


def _shipped() -> dict[str, Path]:
    """The boats to start from, by name."""
    return {place.stem: place for place in sorted((PACKAGE / "etc/boats").glob("*.toml"))}


def _about(place: Path) -> str:
    """The first sentence of a boat's file."""
    return read_text(place).removeprefix("# ").replace("\n# ", " ").partition(". ")[0]


def _copied(ask: "AsksFor", place: Path, stem: str, mission: str) -> tuple[str, str]:
    """Copy one of the boats to start from, with another name, number and place; and its mission."""
    from delfim import config
    from delfim.services.vehiclefile import changed

    name, number = ask("name", "Name of the boat", stem, name_of), _number_of(ask)
    latitude_deg, longitude_deg = ask("where", WHERE, LISBON, _place)
    values: dict[str, Any] = {"boat.name": name, "boat.id": number, "simulation.mission": mission}
    values |= {"simulation.latitude_deg": latitude_deg, "simulation.longitude_deg": longitude_deg}
    length_m = config.load(place).boat.length_m
    return f"{changed(str(place), values)}\n{UNPROVEN}", _mission_text(name, length_m, latitude_deg, longitude_deg)


def _number_of(ask: "AsksFor") -> int:
    return int(ask("id", "Its number, 1 to 249, of which no other boat has the same", "1", _number))


def _answers(ask: "AsksFor", stem: str) -> Answers:
    """Collect the answers, each from its option, or typed, or its default."""
    from delfim import config
    from delfim.vehicle.control.hull import full_mps

    name, number = ask("name", "Name of the boat", stem, name_of), _number_of(ask)
    length_m = ask("length", "Its length over all, m", "1.5", _positive)
    beam_m = ask("beam", "Its beam over all, m", f"{0.5 * length_m:.3g}", _positive)
    mass_kg = ask("mass", "Its mass as it sails, kg", f"{MASS_KG_PER_M2 * length_m * beam_m:.3g}", _positive)
    all_motors, all_positions = asked_of_parts()
    kinds = _kinds(all_motors)
    motors = all_motors[ask("motors", "Motors", next(iter(kinds)), _one_of(kinds), kinds)]
    usual_n = (3.0 if motors[1].rudder else 2.0) * mass_kg  # as boats of etc/boats have it
    thrust_n = ask("thrust", "Force of one motor at full power ahead, N", f"{usual_n:.3g}", _positive)
    guess_mps = full_mps(config.BoatTable(name, length_m=length_m))
    speed_mps = ask("speed", "Its speed at full power in calm water, m/s", f"{guess_mps:.3g}", _positive)
    kinds = _kinds(all_positions)
    usual = motors[1].beside or next(iter(kinds))
    sensors = all_positions[ask("sensors", "Position and heading from", usual, _one_of(kinds), kinds)]
    latitude_deg, longitude_deg = ask("where", WHERE, LISBON, _place)
    hull = length_m, beam_m, mass_kg
    return Answers(name, number, *hull, motors, thrust_n, speed_mps, sensors, latitude_deg, longitude_deg)


class AsksAtTerminal:
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


def name_of(text: str) -> str:
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
    """The CAN interface of each part that needs one, as a bus carries one protocol: can0, then can1."""
    asked = ((of.motors[0], of.motors[1].table), (of.sensors[0], of.sensors[1].text))
    on_can = dict.fromkeys(part for part, text in asked if "{interface}" in text)
    return {part: f"can{number}" for number, part in enumerate(on_can)}


def _text(of: Answers, file: str, mission: str) -> str:
    """The vehicle's file."""
    buses = _buses(of)
    return f"""\
# {of.name}. Every table and key with its range: `delfim describe`. After each change: `delfim check {quote(file)}`.

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
{_thrusters(of)}{of.motors[1].table.format(interface=buses.get(of.motors[0]))}
# Position and heading.
{_sensors(of, buses)}
# What goes wrong, and what the boat does about it: docs/failsafe.md. Here what a sailor changes most often.
[failsafe.console_silent]
after_s = 10.0
action = "home"  # back the way it came; or "hold", "stop"

{UNPROVEN}
# For `delfim sim` alone: where the boat starts, what it sails, and in which sea.
[simulation]
latitude_deg = {of.latitude_deg:.6f}
longitude_deg = {of.longitude_deg:.6f}
mission = "{mission}"
{of.sensors[1].simulation}sea = {{ wind_mps = 2.0, wind_from_deg = 320.0 }}
"""


def _sensors(of: Answers, buses: dict[str, str]) -> str:
    """The tables of the sensors. Motors and sensors on one bus or board share a table, which stands at the motors."""
    part, answer = of.sensors
    text = answer.text.format(interface=buses.get(part))
    return text.partition(f"\n[{part}]")[0] + "\n" if part == of.motors[0] else text


def _thrusters(of: Answers) -> str:
    """The rows of the thrusters. A single motor stands in the middle and has a rudder behind it."""
    driver, motors = of.motors
    sides = {"motor": 0.0} if motors.rudder else {"starboard": 0.35 * of.beam_m, "port": -0.35 * of.beam_m}
    rows = ""
    for address, (name, y_m) in enumerate(sides.items()):
        rows += f"""\
[[thrusters]]
name = "{name}"
driver = "{driver}"
address = {address}  # {motors.address}
x_m = {-0.4 * of.length_m:.3g}
y_m = {y_m:.3g}
thrust_n = [{-0.6 * of.thrust_n:.3g}, {of.thrust_n:.3g}]
{motors.rudder}
"""
    return rows


def _mission_text(name: str, length_m: float, latitude_deg: float, longitude_deg: float) -> str:
    """The mission: a rectangle of legs of about fifteen lengths of the boat, ahead of it and to its starboard, as it lies: bow
    north."""
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
