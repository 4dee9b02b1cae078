"""The messages of a page: docs/console.md. `msgspec` refuses anything else with the reason."""

from typing import Annotated, Literal

import msgspec

Number = Annotated[int, msgspec.Meta(ge=0, le=255)]  # of a boat; 0: none yet

Percent = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
Real = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]  # and finite


class Said(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="t", tag=str.lower):
    """`seq` is the number that the answer carries."""

    seq: int | None = None


class Command(Said, frozen=True, forbid_unknown_fields=False):
    """Other fields are the numbers of the command: `delfim.console.orders`."""

    boat: Number | Literal["all"]
    command: str


class Input(Said, frozen=True):
    """Thrust by hand, now. `n` counts up."""

    boat: Number
    n: int
    port_pct: Percent
    starboard_pct: Percent


class Release(Said, frozen=True):
    boat: Number
    why: str = ""


class Profile(Said, frozen=True):
    boat: Number
    profile: str


class Replay(Said, frozen=True):
    at_s: float | None = None
    rate: float | None = None


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
    """A mission, as docs/console.md has it. Other fields are the page's own."""

    name: Annotated[str, msgspec.Meta(max_length=200)]
    waypoints: Annotated[list[Waypoint], msgspec.Meta(max_length=1000)]
    fence: Annotated[list[tuple[Real, Real]], msgspec.Meta(max_length=1000)] = []
    obstacles: Annotated[list[Obstacle], msgspec.Meta(max_length=1000)] = []
    zones: Annotated[list[ShownZone], msgspec.Meta(max_length=200)] = []
    path: Annotated[list[PathPoint], msgspec.Meta(max_length=1000)] | None = None
    home: Place | None = None


class Mission(Said, frozen=True):
    boat: Number
    do: Literal["put", "upload", "download", "compare", "check", "dryrun", "save", "load", "list"]
    mission: Plan | None = None
    name: str = ""


Message = Command | Input | Release | Profile | Replay | Mission
NO_NUMBERS = frozenset({"t", "seq", "boat", "command"})
