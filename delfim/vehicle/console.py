"""The console's side of the vehicle (console.c in the thesis): typed commands in, the state back.

A class declares a command, its keys and their ranges; a row of `Helm` carries it out. `command.py` carries these words over
a local socket; the console's link carries those that are an `OperatorOrder`, and the console's menu offers what has a title.
"""

from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, TypeVar

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.cooperative import Work
from delfim.base.errors import FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.vehicle.grex import SeenVessel
from delfim.vehicle.plans.mission import Mission as MissionTables
from delfim.vehicle.voyagestate import VoyageState

Degrees = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]
Latitude = Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
Speed = Annotated[float, msgspec.Meta(ge=0.0, le=30.0)]
Thrust = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
PieceTime = Annotated[float, msgspec.Meta(gt=0.0, le=30.0)]  # s
Parts = Annotated[tuple[Thrust, ...], msgspec.Meta(min_length=1, max_length=16)]
Short = Annotated[str, msgspec.Meta(max_length=100)]
Key = Annotated[str, msgspec.Meta(max_length=64)]
Values = Annotated[dict[Key, int | float | bool | Short], msgspec.Meta(max_length=20, description="a table of up to 20 values")]

ZONE, ROW = 10, 1  # time to write one, counted in comparisons
PART, TEXT = 1 << 14, 1 << 20  # characters: of a part of a mission's text, and of all of it


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="command", tag=str.lower):
    """A command of the operator. On the wire: one JSON object a line, `{"command": "heading", "heading_deg": 90}`."""

    TITLE: ClassVar[str] = ""  # in the menu of a console, which asks for those of its keys that are numbers with two limits
    KEY: ClassVar[str] = ""  # of a console's keyboard
    ENTERS: ClassVar[str] = ""  # the mode that the boat is then in; empty: no other one, or the one that is named


class OperatorOrder(Command, frozen=True):
    """A command that any console may give over its link."""


class Alive(Command, frozen=True):
    """The console is there and listens."""


class Stop(OperatorOrder, frozen=True):
    """Idle, now."""

    ENTERS = "idle"


class Kill(Command, frozen=True):
    """Stop, and refuse every mode until the kill is cleared. `switch`: by a switch, which now says kill, or no longer does."""

    TITLE, ENTERS = "Kill: idle until it is cleared", "idle"
    by: Short = "operator"
    reason: Short = "commanded"
    switch: Literal["", "on", "off"] = ""


class Clear(OperatorOrder, frozen=True):
    """End a kill, once every switch that says kill was released. The boat stays in idle."""

    TITLE = "Clear the kill"


class Leave(Command, frozen=True):
    """Give the boat back: idle, and nobody commands. `lost`: the operator was lost, in words; the mode stays, without thrust by
    hand, and the next one to command has the boat."""

    lost: Short = ""


class SetMode(OperatorOrder, frozen=True, tag="mode"):
    """Enter a mode with the set points as they are; manual without thrust, goto without a point: the boat waits for one.
    `piece` is the piece of the path to begin with, or `line` the line of a survey, from 1, with its run-in; without them a path
    begins at its first piece, or goes on after a pause."""

    mode: str
    piece: Annotated[int, msgspec.Meta(ge=0, le=100_000)] | None = None
    line: Annotated[int, msgspec.Meta(ge=1, le=100_000)] | None = None


class Manual(Command, frozen=True):
    """Thrust of each propeller as a fraction of its maximum; enters manual mode. Repeat it, or the thrust ends."""

    starboard: Thrust
    port: Thrust


class Try(OperatorOrder, frozen=True, tag="trial"):
    """Play a manoeuvre, which tries the motors; `begin` enters trial mode. The next one replaces it, the same number again is a
    sign of life: without one it ends. `pieces`: seconds, with a part of full command for each row of the vehicle's file, and
    after these, for each row that turns, one of its greatest angle, to starboard positive."""

    ENTERS = "trial"
    number: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
    pieces: Annotated[tuple[tuple[PieceTime, Parts], ...], msgspec.Meta(min_length=1, max_length=16)]
    latitude_deg: Latitude  # middle of the circle in which the boat stays
    longitude_deg: Longitude
    radius_m: Annotated[float, msgspec.Meta(ge=5.0, le=200.0)]
    name: Short = ""  # for people and the log
    turn_dps: Annotated[float, msgspec.Meta(gt=0.0, le=90.0)] = 50.0  # a faster turn ends it
    begin: bool = False  # otherwise it is refused in any other mode
    comes_back: bool = False  # from the edge of the circle: only a quarter beyond it ends it


class Actuate(Command, frozen=True):
    """Turn one thruster by itself, in idle, at a part of its full command. Repeat it, or it ends; 0 ends it."""

    thruster: Short
    part: Annotated[float, msgspec.Meta(ge=-0.3, le=0.3)]
    for_s: Annotated[float, msgspec.Meta(gt=0.0, le=60.0)] = 2.0  # at most, from the first of these commands


class Heading(OperatorOrder, frozen=True):
    """Hold a true heading; enters heading mode."""

    ENTERS = "heading"
    heading_deg: Degrees
    speed_mps: Speed | None = None


class Course(OperatorOrder, frozen=True):
    """Steer a true course over ground, in a current too; enters course mode."""

    ENTERS = "course"
    course_deg: Degrees
    speed_mps: Speed | None = None


class SetSpeed(OperatorOrder, frozen=True, tag="speed"):
    """Change the speed, keep the mode: it overrides the speeds of mission, path and way home until the next change of mode.
    Without a value, their own speeds apply again. `speed_pct`: of the boat's top speed, in place of metres a second."""

    speed_mps: Speed | None = None
    speed_pct: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] | None = None

    def __post_init__(self) -> None:
        if self.speed_mps is not None and self.speed_pct is not None:
            raise FormatError("speed is either speed_mps or speed_pct")


class Goto(OperatorOrder, frozen=True):
    """Go to a position, or to the mission's first waypoint when none is given; enters goto mode. `end`: the mode in which the
    boat stays there; hold starts the propellers again and again, idle is a stop. None: as the vehicle's file says."""

    ENTERS = "goto"
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    speed_mps: Speed | None = None
    end: config.EndMode | None = None

    def __post_init__(self) -> None:
        if (self.latitude_deg is None) != (self.longitude_deg is None):  # one alone is a mistake, not the first waypoint
            raise FormatError("goto needs a latitude and a longitude, or neither")


class Pause(OperatorOrder, frozen=True):
    """Hold here, or idle where the boat cannot hold; remembers the place in mission, path or way."""

    KEY, ENTERS = "B", "hold"


class Continue(OperatorOrder, frozen=True):
    """Go on with the mode that a hold interrupted, a failsafe's hold too, from where it was."""

    KEY = "C"


class LoadMission(Command, frozen=True, tag="mission"):
    """Load a mission, given as the text of its file. The mode stays; play is a command of its own. A long text comes in
    parts, in order: `at` is the part's place in the text, `more` says that another part follows."""

    text: Annotated[str, msgspec.Meta(max_length=PART)]
    at: Annotated[int, msgspec.Meta(ge=0, le=TEXT)] = 0
    more: bool = False


class Upload(Command, frozen=True):
    """Load a mission given as tables, from a link that has no text of it."""

    mission: MissionTables


class Play(OperatorOrder, frozen=True):
    """Play the mission from this leg on (0: the leg to the first waypoint)."""

    ENTERS = "play"
    leg: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0


class Leg(Command, frozen=True):
    """Set the leg that play begins with; a mission that is being played continues there."""

    leg: Annotated[int, msgspec.Meta(ge=0, le=100_000)]


class Unload(Command, frozen=True):
    """Forget the mission; its zones stay."""


class SetFence(Command, frozen=True, tag="fence"):
    """Replace the mission's zones. A mission that crosses the new ones is removed."""

    zones: config.Zones


class Rally(Command, frozen=True):
    """Set the harbours: the way home ends at the first one that it passes."""

    points: Annotated[tuple[config.Position, ...], msgspec.Meta(max_length=100)]


class Entrust(OperatorOrder, frozen=True, tag="payload"):
    """Give the boat to a payload program of the vehicle's file: it holds until the program orders something. Any other order of
    an operator takes it back."""

    name: Short


class Sight(Command, frozen=True):
    """A vessel that a payload program sees."""

    target: SeenVessel


class Sampled(Command, frozen=True):
    """A payload program has taken the sample that it was asked for, or could not."""

    number: Annotated[int, msgspec.Meta(ge=1, le=1 << 31)]  # as it was asked
    ok: bool = True
    reason: Annotated[str, msgspec.Meta(max_length=200)] = ""  # in words, for the log


class Tell(Command, frozen=True):
    """What a payload program measures, for the trouble `beyond`: numbers by their names."""

    values: Annotated[dict[Key, float], msgspec.Meta(min_length=1, max_length=16)]


class OfPayload(Command, frozen=True, tag="ordered"):
    """An order of a payload program, from the service that runs it."""

    payload: Short
    order: Alive | Pause | Continue | Goto | Heading | Course | SetSpeed | Upload | Play | Sight | Sampled | Tell


class Overrule(OperatorOrder, frozen=True):
    """Give way to nobody for `traffic.guard.overruled_s`, whatever is told of vessels and things; given again, give way again.
    The operator has looked: what is told is not there, or it is in the way of what matters more."""

    TITLE, KEY = "Overrule the guard; again: end that", "O"


class Take(OperatorOrder, frozen=True):
    """Take over: this console commands from now on, and its silence is a trouble."""


class Arm(OperatorOrder, frozen=True):
    """Check that the boat may leave idle; refused with the reason if not. Stop disarms."""


class Reset(OperatorOrder, frozen=True):
    """Restart the other nodes (thesis 4.3, key R); in idle only. `node`: 127 is all of them."""

    TITLE, KEY = "Reset the peripherals", "R"
    node: Annotated[int, msgspec.Meta(ge=1, le=127)] = 127


class Set(Command, frozen=True):
    """Change a key of the vehicle's file, for this voyage."""

    key: Annotated[str, msgspec.Meta(max_length=64)]
    value: float | Annotated[str, msgspec.Meta(max_length=64)]


class PartOrder(OperatorOrder, frozen=True, tag="order"):
    """Give an order of a laboratory's part (docs/own-parts.md). `values`: the keys of its table."""

    name: Annotated[str, msgspec.Meta(max_length=64)]
    values: Values = {}


class TellState(Command, frozen=True, tag="state"):
    """Ask for the state once."""


class Watch(Command, frozen=True):
    """Ask for every state from now on, newest only: five times a second, or, with `quick`, ten times."""

    quick: bool = False


class Return(Command, frozen=True):
    """Go on after a restart, as the vehicle's file says (`returning.py`). The program gives it to itself, and what the operator
    had sent after it; a console may not."""

    sailed: VoyageState
    t_ns: int = 0  # when it was written
    age_s: float | None = None  # how long ago; None: the computer's clock does not say
    why_not: str = ""  # why the boat does not go on, in words
    fence: bool = False  # zones were aboard, or may have been
    mission: str = ""  # the name of the mission that was aboard
    lost: bool = False  # neither of them is sent again


class ShutDown(Command, frozen=True):
    """Stop and end everything in order, so that the power may be cut; or restart the computer."""

    reboot: bool = False


Commands: TypeAlias = Command
_declared = (*Command.__subclasses__(), *OperatorOrder.__subclasses__())
KINDS: dict[str, type[Command]] = {str(kind.__struct_config__.tag): kind for kind in _declared if kind is not OperatorOrder}
EVERY: Any = reduce(or_, KINDS.values())  # their union, to read one
Meant = Stop | Pause | Continue | SetMode | Heading | Course | SetSpeed | Goto | Play  # an order of a part may stand for these
Halts = Stop | Kill  # anybody may stop the boat, whoever commands it
Plan = LoadMission | Upload | SetFence  # checking these takes longer than a callback may
Kind = TypeVar("Kind", bound=Command)
_decoder: msgspec.json.Decoder[Command] = msgspec.json.Decoder(EVERY)
_encode = msgspec.json.Encoder().encode


def written(command: Plan) -> Work[bytes]:
    """A plan as one line of JSON, which is long."""
    yield 0
    if isinstance(command, LoadMission):
        return _encode(command)
    mission = command.mission if isinstance(command, Upload) else None
    zones = command.zones if isinstance(command, SetFence) else mission.fence if mission else config.Zones()
    areas = {"keep_in": (yield from _pieces(zones.keep_in, ZONE)), "keep_out": (yield from _pieces(zones.keep_out, ZONE))}
    fence = msgspec.structs.asdict(zones) | areas
    if mission is None:
        return _encode({"command": "fence", "zones": fence})
    rows = {"waypoint": (yield from _pieces(mission.waypoint, ROW)), "path": (yield from _pieces(mission.path, ROW))}
    rows["action"] = yield from _pieces(mission.action, ROW)
    return _encode({"command": "upload", "mission": msgspec.structs.asdict(mission) | rows | {"fence": fence}})


def _pieces(rows: Sequence[object], each: int) -> Work[list[msgspec.Raw]]:
    pieces = []
    for row in rows:
        yield each
        pieces.append(msgspec.Raw(_encode(row)))
    return pieces


def parse(line: bytes) -> Commands:
    """The command in one line of JSON. Raises FormatError in words."""
    try:
        return _decoder.decode(line)
    except UNREADABLE as error:
        text = str(error)
    try:
        tree = msgspec.json.decode(line)
    except UNREADABLE:
        raise FormatError("command not understood: it is not JSON") from None
    raise FormatError(f"command not understood: {_why(tree, text)}")


def parse_order(line: bytes) -> OperatorOrder:
    """The order of a console in one line of JSON. Raises FormatError in words."""
    command = parse(line)
    if not isinstance(command, OperatorOrder):
        raise FormatError(f"{command.__struct_config__.tag} is no order of a console on a link")
    return command


def asked(kind: type[Kind], **numbers: object) -> Kind:
    """A command with these values, checked as in a line of JSON: in range and finite. Raises FormatError in words."""
    try:
        return msgspec.convert(numbers, kind)
    except msgspec.ValidationError as error:
        raise FormatError(_why(numbers | {"command": kind.__struct_config__.tag}, str(error))) from None


def _why(tree: Any, text: str) -> str:
    """Why this is not a command, for the operator. Of `text`, the library's message, only our own sentences are kept."""
    word = tree.get("command") if isinstance(tree, dict) else None
    kind = KINDS.get(word) if isinstance(word, str) else None
    if kind is None:
        return f"there is no command {word[:40]!r}" if isinstance(word, str) else "it names no command"
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for name in tree.keys() - fields.keys() - {"command"}:
        return f"{word} has no {name[:40]!r}"
    for name, field in fields.items():
        if name not in tree and field.required:
            return f"{word} needs {name}"
        try:
            msgspec.convert(tree.get(name), field.type)
        except msgspec.ValidationError:
            if name in tree:
                return f"{name} must be {tables.allowed(field.type)}"
    return text


def answer(reason: str | None, report: bytes) -> bytes:
    """The answer: whether the command was carried out, the reason if not, and the boat's report now."""
    return b'{"ok":%b,"reason":%b,"state":%b}\n' % (b"true" if reason is None else b"false", _encode(reason or ""), report)
