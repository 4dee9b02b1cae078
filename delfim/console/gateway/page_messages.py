"""The messages of a page, as its reference has them (manual/reference.py). `msgspec` refuses anything else with the reason."""

from typing import Annotated, Literal

import msgspec

Number = Annotated[int, msgspec.Meta(ge=0, le=255)]  # of a boat; 0: none yet

Percent = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
Real = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]  # and finite


class Said(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="t", tag=str.lower):
    seq: int | None = None  # the number that the answer carries


class Command(Said, frozen=True, forbid_unknown_fields=False):
    """An order in the boat's own words (`delfim.vehicle.console`), whose keys are the other fields: `mode` with one of the
    boat's `modes`, `order` with the name of one of its parts' and `values`, and so on."""

    boat: Number | Literal["all"]  # all: for `stop` only
    command: str


class Input(Said, frozen=True):
    """Thrust by hand, now."""

    boat: Number
    n: int  # counts up
    port_pct: Percent
    starboard_pct: Percent


class Release(Said, frozen=True):
    """The end of thrust by hand."""

    boat: Number
    why: str = ""


class Profile(Said, frozen=True):
    """How much a boat tells."""

    boat: Number
    profile: str  # lean, radio or wifi


class Forget(Said, frozen=True):
    """Takes a silent boat off all pages, until it is heard again."""

    boat: Number


class Home(Said, frozen=True):
    """Asks where a boat's way home ends; `way_home` tells it."""

    boat: Number


class Afford(Said, frozen=True):
    """Asks whether the mission aboard fits the energy that is left, before it is sailed; the answer says what lacks."""

    boat: Number


class Here(Said, frozen=True):
    """Answers a word about who commands (`bridge`)."""

    n: int
    grant: int = 0  # that it knows of


class Handover(Said, frozen=True):
    """The command of the boats: taken where nobody has it, offered to a page or to none, accepted, left or declined."""

    do: Literal["take", "offer", "accept", "leave"]
    page: int = 0


class Replay(Said, frozen=True):
    """Where a replay goes on, and how fast."""

    at_s: float | None = None  # since 1970
    rate: float | None = None  # of real time; 0 stands still


Ids = Annotated[list[int], msgspec.Meta(max_length=100)]


class Acknowledge(Said, frozen=True):
    """Somebody has taken note of these alerts."""

    ids: Ids


class Quiet(Said, frozen=True):
    """No sound of these alerts for half a minute, on any page; nobody has taken note of them."""

    ids: Ids


class Note(Said, frozen=True):
    """What an operator has seen, for the log of the watch and the time line of a boat, or of all (0)."""

    boat: Number
    text: Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
    at_s: float | None = None  # since 1970, when it was; null: now


class Place(msgspec.Struct, frozen=True):
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)]
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]


class Waypoint(Place, frozen=True):
    speed_mps: Real | None = None
    acceptance_m: Real | None = None
    hold_s: Real | None = None


class Obstacle(Place, frozen=True):
    radius_m: Real


class ShownZone(msgspec.Struct, frozen=True):
    """An area that the page shows and does not edit."""

    kind: Literal["keep_in", "keep_out"]
    name: Annotated[str, msgspec.Meta(max_length=64)] = ""
    polygon: Annotated[list[tuple[Real, Real]], msgspec.Meta(max_length=1000)] = []
    centre: Annotated[list[tuple[Real, Real]], msgspec.Meta(max_length=1)] = []
    radius_m: Real = 0.0


class PathPoint(Place, frozen=True):
    turn_deg: Real | None = None
    radius_m: Real | None = None
    speed_mps: Real | None = None


class Plan(msgspec.Struct, frozen=True):
    """A mission; other fields are the page's own."""

    name: Annotated[str, msgspec.Meta(max_length=200)]
    waypoints: Annotated[list[Waypoint], msgspec.Meta(max_length=1000)]
    fence: Annotated[list[tuple[Real, Real]], msgspec.Meta(max_length=1000)] = []
    obstacles: Annotated[list[Obstacle], msgspec.Meta(max_length=1000)] = []
    zones: Annotated[list[ShownZone], msgspec.Meta(max_length=200)] = []
    path: Annotated[list[PathPoint], msgspec.Meta(max_length=1000)] | None = None
    home: Place | None = None


class Mission(Said, frozen=True):
    """A plan: drawn, sent to the boat, read from it, compared, checked, tried, or a file of the console's folder."""

    boat: Number
    do: Literal["put", "upload", "download", "compare", "check", "dryrun", "save", "load", "list"]
    mission: Plan | None = None
    name: str = ""


Corner = tuple[Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)], Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]]
Ring = Annotated[list[Corner], msgspec.Meta(min_length=3, max_length=10_000)]
Length = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]


class Survey(Said, frozen=True):
    """Asks for the lines of areas, each an outline and its holes, or with `lines` for what of these is left by the depths that
    this console heard; `survey` tells them. A later one of the same page takes the place of one that waits."""

    boat: Number
    areas: Annotated[list[tuple[Ring, list[Ring]]], msgspec.Meta(max_length=100)]
    lines: Annotated[list[tuple[Corner, Corner]], msgspec.Meta(max_length=1000)] = []  # of the survey, as it was planned
    across: Annotated[int, msgspec.Meta(ge=0)] = 0  # so many of the lines, the last ones, lie across
    at: Corner | None = None  # where the boat is that sails what is left
    others: Annotated[list[Corner | None], msgspec.Meta(max_length=7)] = []  # and other boats, who get a share of it each
    closed: Annotated[list[Ring], msgspec.Meta(max_length=200)] = []  # zones of the plan, which the boat must not enter
    spacing_m: Length = 0.0  # 0: by swath and overlap
    swath_m: Length = 0.0  # that a line covers; 0: the spacing
    overlap_pct: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 20.0
    heading_deg: Real | None = None  # of the lines; null: the quickest
    cross_m: Length = 0.0  # spacing of cross lines; 0: none
    start: Literal["", "nw", "ne", "sw", "se"] = ""  # the corner to begin near
    inside: bool = False  # lines end where they leave the area
    side: Literal["", "port", "starboard"] = ""  # that the sensor looks to; empty: both
    run_in_m: Length = 0.0  # 0: the boat's own
    speed_mps: Length = 0.0  # 0: the boat's own
    fence: Annotated[list[Corner], msgspec.Meta(max_length=1000)] = []  # of the plan
    obstacles: Annotated[list[Obstacle], msgspec.Meta(max_length=1000)] = []  # of the plan
    name: Annotated[str, msgspec.Meta(max_length=200)] = "Survey"
    sailed: bool = False  # time and energy by lines that the simulated boat sails; without it, the time by speed and turns


class Depths(Said, frozen=True):
    """Another survey of the same water begins: the depths that were heard until now go from all pages, and count no longer."""

    do: Literal["forget"]


class Adopt(Said, frozen=True):
    """A trial of a boat's motors and hull (docs/adopt.md), or of its motors at the berth: begins it, or begins it afresh,
    answers its question, ends it, or takes it off the pages. Any other order to that boat ends it, too."""

    boat: Number
    do: Literal["begin", "afresh", "berth", "yes", "no", "end", "close"]
    radius_m: Annotated[float, msgspec.Meta(ge=15.0, le=160.0)] = 60.0  # of its circle


class Itself(Said, frozen=True):
    """What a boat tells of itself: the keys of its file that may change under way, or the checks before the start; `aboard`
    tells them. `change` gives a key another value for this voyage."""

    boat: Number
    do: Literal["settings", "checks", "change"]
    key: Annotated[str, msgspec.Meta(max_length=64)] = ""
    value: bool | Real | Annotated[str, msgspec.Meta(max_length=64)] = ""


class Logs(Said, frozen=True):
    """Fetches the logs of a boat, those of its state or all, or ends that; `progress` tells how far it is. The answer comes at
    the end. `chart` sends it a chart of this console, `unsent` asks whether that is possible: the answer says why not."""

    boat: Number
    do: Literal["state", "all", "end", "chart", "unsent"]
    chart: Annotated[str, msgspec.Meta(max_length=60)] = ""


class SeeLive(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A page's end of a connection by WebRTC (docs/camera.md)."""

    payload: Annotated[int, msgspec.Meta(ge=0, le=127)]  # number of VP8
    certificate: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]  # its SHA-256
    user: Annotated[str, msgspec.Meta(pattern="^[A-Za-z0-9+/]{4,32}$")]  # of ICE
    password: Annotated[str, msgspec.Meta(pattern="^[A-Za-z0-9+/]{22,64}$")]
    shown: bool = False  # its pictures come: stills need not


class See(Said, frozen=True):
    """The page shows the picture of a boat's camera; said again each second, as long as it does. Without a name it is the
    first. `picture` tells it, or why there is none. With `live` the page asks for it by WebRTC as well; `live` answers."""

    boat: Number
    camera: Annotated[str, msgspec.Meta(max_length=32)] = ""
    live: SeeLive | None = None


class Snapshot(Said, frozen=True):
    """Writes the picture that is shown to a file beside the console's sessions, with place and time; the answer's reason names
    it. A picture that came by WebRTC only the page has: it brings it along, with the time when it was taken, since 1970."""

    boat: Number
    jpeg: Annotated[str, msgspec.Meta(max_length=700_000)] = ""  # base64
    taken_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e11)] = 0.0


Message = (
    Command
    | Input
    | Release
    | Profile
    | Forget
    | Home
    | Afford
    | Here
    | Handover
    | Replay
    | Acknowledge
    | Quiet
    | Note
    | Mission
    | Survey
    | Depths
    | Adopt
    | Itself
    | Logs
    | See
    | Snapshot
)
NO_NUMBERS = frozenset({"t", "seq", "boat", "command"})
