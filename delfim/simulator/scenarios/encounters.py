"""Encounters with other vessels: files of them, and random ones by seed, each staged as a scenario (docs/encounters.md).

The boat plays a straight mission to the north; where nobody does anything, the vessels come into each other's way.
"""

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

import msgspec

from delfim.base import tables
from delfim.base.errors import ConfigError, in_words
from delfim.base.geodesy import from_plane, origin, wrap
from delfim.base.input.untrusted import read_text
from delfim.simulator.nodes.other_vessels import axes_m, within
from delfim.simulator.scenarios.scenario import Scenario, laid_over, mission_of

RANDOM: Final = "random"
LATITUDE_DEG, LONGITUDE_DEG = 38.6, -9.6  # of the start: the open sea off Lisbon
OWN_MPS: Final = 1.5  # of a random encounter, unless its scenario says another
LEAD_S: Final = 400.0  # a run begins so long before the first domain would be entered: all names were told
AMPLE: Final = 5.0  # and at least so many times as long as the boat takes from the middle of a domain out of its side
AFTER_S: Final = 300.0  # and ends so long after the last meeting
START_S: Final = 10.0  # the boat has its speed about then, and the encounter begins
PLAY_S: Final = 3.0
FARTHER_S: Final = 600.0  # the mission goes on so far behind the end of the run
LOOK_S: Final = 5.0  # step in which domains are looked for
TARGETS_MAX: Final = 5
CLEAR_S: Final = 240.0  # a random vessel would not come into anybody's domain before this


class StraightWay(NamedTuple):
    """The motion of a vessel that keeps course and speed: where it begins, and the cosine and the sine of its course."""

    north_m: float
    east_m: float
    speed_mps: float
    c: float
    s: float

    def at(self, t_s: float) -> tuple[float, float]:
        """The position at this time: north and east, m."""
        north_m, east_m, speed_mps, c, s = self
        way_m = speed_mps * t_s
        return north_m + way_m * c, east_m + way_m * s


class Ship(tables.Table, frozen=True):
    """The position of a vessel at the beginning, from where the boat is. `kind`: the meeting for the boat, by rules 13 to
    15."""

    north_m: float
    east_m: float
    course_deg: float
    speed_mps: float
    length_m: float
    beam_m: float = 0.0
    kind: str = ""
    tcpa_s: float = 0.0
    dcpa_m: float = 0.0

    @property
    def way(self) -> StraightWay:
        course_rad = math.radians(self.course_deg)
        return StraightWay(self.north_m, self.east_m, self.speed_mps, math.cos(course_rad), math.sin(course_rad))


class Encounter(tables.Table, frozen=True):
    """One row of a file."""

    id: str
    title: str
    own: Ship
    targets: tuple[Ship, ...]


class EncounterFile(tables.Table, frozen=True):
    """A file of encounters (etc/encounters)."""

    scale: str
    own_mps: float
    frame: str
    notice: str
    encounters: tuple[Encounter, ...]


class Staged(NamedTuple):
    """A scenario to sail, and the text of its mission. The name is the encounter's, or empty."""

    name: str
    scenario: Scenario
    mission: str


def staged_of(scenario: Scenario, path: str | Path) -> tuple[Staged, ...]:
    """The scenarios that a scenario's file stages: itself, or each encounter of its file. Random ones are staged by `drawn`.
    Raises ConfigError."""
    if scenario.encounters in ("", RANDOM):
        return (Staged("", scenario, mission_of(scenario, path)),)
    file = read_encounters(Path(path).parent / scenario.encounters)
    return tuple(map(partial(staged, scenario), file.encounters))


def read_encounters(place: Path) -> EncounterFile:
    """Read the encounters of a file. Raises ConfigError."""
    try:
        return msgspec.json.decode(read_text(place), type=EncounterFile)
    except (OSError, msgspec.DecodeError, msgspec.ValidationError) as error:
        raise ConfigError(str(place), "file", in_words(error)) from None


def staged(scenario: Scenario, encounter: Encounter) -> Staged:
    """The scenario with the vessels of an encounter, all speeds and metres scaled to its `speed_mps`."""
    own_mps = encounter.own.speed_mps
    scale = scenario.speed_mps / own_mps if scenario.speed_mps else 1.0
    begin_s = max(min(_entered_s(own_mps, ship) - _lead_s(own_mps, ship) for ship in encounter.targets), 0.0)
    seconds = START_S + max(ship.tcpa_s for ship in encounter.targets) - begin_s + AFTER_S
    rows = tuple(_row(ship, own_mps, scale, begin_s) for ship in encounter.targets)
    here = {"latitude_deg": LATITUDE_DEG, "longitude_deg": LONGITUDE_DEG, "heading_deg": 0.0}
    lower = {"simulation": here, "control": {"speed": {"cruise_mps": own_mps * scale}}}
    scene = msgspec.structs.replace(
        scenario,
        encounters="",
        name=f"{scenario.name}: {encounter.title}",
        seconds=seconds,
        vehicle=laid_over(lower, scenario.vehicle),
        vessel=(*scenario.vessel, *rows),
        command=({"at_s": PLAY_S, "command": "play"}, *scenario.command),
    )
    return Staged(encounter.id, scene, _mission(own_mps * scale * (seconds + FARTHER_S)))


def _row(ship: Ship, own_mps: float, scale: float, begin_s: float) -> dict[str, Any]:
    """A row of `simulation.traffic`. Until the encounter begins the vessel sails to where it then is."""
    north_m, east_m = ship.way.at(begin_s - START_S)
    return {
        "name": f"{ship.kind or 'vessel'}".upper()[:20],
        "length_m": ship.length_m * scale,
        "beam_m": max((ship.beam_m or 0.2 * ship.length_m) * scale, 0.1),
        "north_m": (north_m - own_mps * begin_s) * scale,
        "east_m": east_m * scale,
        "course_deg": ship.course_deg,
        "speed_mps": ship.speed_mps * scale,
        "meets_s": ship.tcpa_s - begin_s + START_S,
        "meeting": ship.kind,
    }


def _lead_s(own_mps: float, ship: Ship) -> float:
    """The time, s, before which a boat knows nothing of a vessel that it could act on."""
    return max(LEAD_S, AMPLE * axes_m(ship.length_m)[1] / own_mps)


def _entered_s(own_mps: float, ship: Ship) -> float:
    """The time, s, when the boat would enter the domain of a vessel, or be nearest."""
    axes, way, t_s = axes_m(ship.length_m), ship.way, 0.0
    while t_s < ship.tcpa_s:
        north_m, east_m = way.at(t_s)
        if within(own_mps * t_s - north_m, -east_m, way.c, way.s, axes) < 1.0:
            return t_s
        t_s += LOOK_S
    return ship.tcpa_s


def _mission(way_m: float) -> str:
    """The mission: a leg to the north, on which the boat starts."""
    place = origin(math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG))
    corners = (math.degrees(from_plane(place, each_m, 0.0)[0]) for each_m in (0.0, way_m))
    rows = [f"[[waypoint]]\nlatitude_deg = {each:.8f}\nlongitude_deg = {LONGITUDE_DEG}\n" for each in corners]
    return "\n".join(['version = 1\nname = "To the north"\n', *rows])


def drawn(seed: int, own_mps: float) -> Encounter:
    """A random encounter with 1 to 5 vessels that come near the boat at different times, half of them small craft."""
    random = Random(f"encounter {seed}")
    own = Ship(north_m=0.0, east_m=0.0, course_deg=0.0, speed_mps=own_mps, length_m=4.5)
    count = random.randint(1, TARGETS_MAX)
    return Encounter(id=f"random-{seed}", title=f"Random {seed}", own=own, targets=tuple(_ships(random, own_mps, count)))


def _ships(random: Random, own_mps: float, count: int) -> Iterator[Ship]:
    while count:
        is_small = random.random() < 0.5
        length_m = random.uniform(6.0, 20.0) if is_small else random.uniform(20.0, 200.0)
        speed_mps = random.uniform(0.5, 6.0) if is_small else random.uniform(2.0, 8.0)
        meets_s, course_deg = random.uniform(500.0, 1300.0), random.uniform(0.0, 360.0)
        miss_m = axes_m(length_m)[1] * random.uniform(-1.0, 1.0)
        c, s = math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))
        north_m = own_mps * meets_s - miss_m * s - speed_mps * meets_s * c
        east_m = miss_m * c - speed_mps * meets_s * s
        ship = Ship(
            north_m=north_m,
            east_m=east_m,
            course_deg=course_deg,
            speed_mps=speed_mps,
            length_m=length_m,
            beam_m=0.2 * length_m,
            kind=kind_of(own_mps, north_m, east_m, course_deg, speed_mps),
            tcpa_s=meets_s,
            dcpa_m=abs(miss_m),
        )
        if _entered_s(own_mps, ship) >= CLEAR_S:
            count -= 1
            yield ship


def kind_of(own_mps: float, north_m: float, east_m: float, course_deg: float, speed_mps: float) -> str:
    """The kind of meeting with a vessel for a boat that steers north, by rules 13 to 15: from bearings and speeds alone."""
    bearing_rad, course_rad = math.atan2(east_m, north_m), math.radians(course_deg)
    seen_deg = abs(math.degrees(bearing_rad))  # the vessel from the boat, off its bow ...
    seen_back_deg = abs(math.degrees(wrap(bearing_rad + math.pi - course_rad)))  # ... and the boat from the vessel
    if seen_back_deg >= 112.5 and own_mps > speed_mps:
        return "overtaking"
    if seen_deg >= 112.5 and speed_mps > own_mps:
        return "overtaken"
    if abs(math.degrees(wrap(course_rad))) > 170.0 and seen_deg < 10.0:
        return "head-on"
    if seen_back_deg >= 112.5 and seen_deg < 112.5:
        return "parallel"
    return "give-way" if bearing_rad >= 0.0 and seen_back_deg < 112.5 else "stand-on"
