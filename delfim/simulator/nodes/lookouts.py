"""What stands in the simulated water, and the sensors that look for it: lidar, radar and camera, which miss things and see
ghosts.

A look-out tells what a payload program would that reads such a sensor, in its name: in lock step the boat is told so at once,
in real time by a pipe that the program copies out (delfim/simulator/realtime/lookout_pipes.py). A radar may have a port of NMEA
0183 instead, where it speaks for itself (radars.py). A look-out measures from where the
boat truly is. Who is heard by AIS is not told again.
"""

import math
from collections.abc import Sequence
from random import Random
from typing import Final, Literal, NamedTuple

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.geodesy import from_plane, wrap
from delfim.simulator.model import Model
from delfim.simulator.nodes.other_vessels import Vessel
from delfim.simulator.nodes.period import Period
from delfim.simulator.nodes.radars import PlayedRadar, SeesBy
from delfim.simulator.nodes.talkers import hears
from delfim.simulator.nodes.worlds import Standing, drawn
from delfim.simulator.tables import SimulatedLookout, Simulation
from delfim.vehicle import console
from delfim.vehicle.grex import SeenVessel
from delfim.vehicle.orders.payloadlines import SIGHTS

LOOK_S: Final = 0.25
TURNS: Final = 0.02  # of its full revolutions, from which on a propeller is a danger
TOLD: Final = int(SIGHTS[0] * LOOK_S)  # in one look: the boat takes no more from a program


class SensorSort(NamedTuple):
    """What sensors of a kind can do."""

    reach_m: float
    half_rad: float  # to either side of the bow
    error_m: float  # standard deviation of a distance ...
    error_part: float  # ... and a part of it, too
    error_rad: float  # of a bearing
    confidence: float  # of one sighting
    missed: float
    ghosts: float  # a second
    knows_people: bool


SORTS: Final = {
    "lidar": SensorSort(80.0, math.pi, 0.1, 0.0, math.radians(0.2), 0.5, 0.1, 0.05, False),
    "radar": SensorSort(400.0, math.pi, 2.0, 0.0, math.radians(0.7), 0.3, 0.2, 0.2, False),
    "camera": SensorSort(60.0, math.radians(40.0), 0.0, 0.03, math.radians(0.5), 0.4, 0.25, 0.1, True),
}


class TrueThing:
    """A thing where it truly is, and how near the boat's hull came to it."""

    def __init__(self, number: int, row: Standing) -> None:
        self.number, self.name, self.row = number, f"{row.kind} {number}", row
        self.north_m, self.east_m = row.north_m, row.east_m
        self.nearest_m = math.inf  # from the hull to its edge, while the boat steered itself; negative: it struck it
        self.still_m = math.inf  # the same of a swimmer while the propellers stood still, who is touched then, and not struck
        course_rad = math.radians(row.course_deg)
        self._mps = row.speed_mps * math.cos(course_rad), row.speed_mps * math.sin(course_rad)

    def drift(self, t_s: float, model: Model) -> None:
        """Be where it is at this time since the start; a forged one beside the boat."""
        if self.row.follows_m is not None:
            bearing_rad = math.radians(self.row.follows_deg)
            self.north_m = model.north_m + self.row.follows_m * math.cos(bearing_rad)
            self.east_m = model.east_m + self.row.follows_m * math.sin(bearing_rad)
            return
        self.north_m, self.east_m = self.row.north_m + t_s * self._mps[0], self.row.east_m + t_s * self._mps[1]

    def measure(self, model: Model, half_m: float, half_beam_m: float) -> None:
        """Measure how far it is from the edge of a boat of this half length and half beam."""
        north_m, east_m = self.north_m - model.north_m, self.east_m - model.east_m
        c, s = math.cos(model.heading_rad), math.sin(model.heading_rad)
        ahead_m = max(abs(north_m * c + east_m * s) - half_m, 0.0)
        clear_m = math.hypot(ahead_m, max(abs(east_m * c - north_m * s) - half_beam_m, 0.0)) - self.row.radius_m
        if self.row.kind == "person" and all(abs(drive.part) < TURNS for drive in model.drives.values()):
            self.still_m = min(self.still_m, clear_m)
        else:
            self.nearest_m = min(self.nearest_m, clear_m)


class PlayedSensor:
    """One sensor."""

    def __init__(self, number: int, row: SimulatedLookout, payload: str, model: Model, seed: int) -> None:
        self.payload, self._model, self._random = payload, model, Random(f"look-out {number} {seed}")
        self._sort = _sort(row)
        self._told = dict[str, int]()  # the look at which each was told last
        self._looks = 0

    def look(self, things: Sequence[TrueThing], vessels: Sequence[Vessel]) -> list[console.Sight]:
        """What it tells now: those that it told of longest ago first, as long as the boat takes more."""
        self._looks += 1
        ghosts = self._sort.ghosts * LOOK_S
        seen = [(self._told.get(each.name, 0), i, each) for i, each in enumerate(things) if self._sees(each)]
        seen.sort(key=lambda each: each[:2])
        sights = [self._vessel(each) for each in vessels if each.row.transponder == "none" and self._sees(each)]
        sights += [self._ghost() for _ in range(int(ghosts) + (self._random.random() < ghosts % 1.0))]
        for _, _, each in seen[: max(TOLD - len(sights), 0)]:
            self._told[each.name] = self._looks
            sights.append(self._sight(str(each.number), each.north_m, each.east_m, each.row.radius_m, each.row.kind))
        return sights[:TOLD]

    def _sees(self, each: TrueThing | Vessel) -> bool:
        """Whether it sees it in this look. Nothing hides anything."""
        north_m, east_m = each.north_m - self._model.north_m, each.east_m - self._model.east_m
        if math.hypot(north_m, east_m) > self._sort.reach_m:
            return False
        off_rad = wrap(math.atan2(east_m, north_m) - self._model.heading_rad)
        return abs(off_rad) <= self._sort.half_rad and self._random.random() >= self._sort.missed

    def _place(self, north_m: float, east_m: float) -> tuple[tuple[float, float], float]:
        """Latitude and longitude, degrees, as it measures them, and how far they may be off, m."""
        model, sort, gauss = self._model, self._sort, self._random.gauss
        far_m = math.hypot(north_m - model.north_m, east_m - model.east_m)
        error_m = sort.error_m + sort.error_part * far_m
        told_m = max(far_m + gauss(0.0, error_m), 0.0)
        bearing_rad = math.atan2(east_m - model.east_m, north_m - model.north_m) + gauss(0.0, sort.error_rad)
        at = model.north_m + told_m * math.cos(bearing_rad), model.east_m + told_m * math.sin(bearing_rad)
        latitude_rad, longitude_rad = from_plane(model.origin, *at)
        return (math.degrees(latitude_rad), math.degrees(longitude_rad)), math.hypot(error_m, far_m * sort.error_rad)

    def _sight(self, name: str, north_m: float, east_m: float, radius_m: float, kind: str) -> console.Sight:
        place, error_m = self._place(north_m, east_m)
        is_person, told_m = kind == "person" and self._sort.knows_people, min(radius_m + error_m, 50.0)
        what: Literal["thing", "person"] = "person" if is_person else "thing"
        told = SeenVessel(name, *place, kind=what, radius_m=told_m, confidence=self._sort.confidence)
        return console.Sight(told)

    def _ghost(self) -> console.Sight:
        far_m = self._sort.reach_m * math.sqrt(self._random.random())
        bearing_rad = self._model.heading_rad + self._sort.half_rad * self._random.uniform(-1.0, 1.0)
        at = self._model.north_m + far_m * math.cos(bearing_rad), self._model.east_m + far_m * math.sin(bearing_rad)
        return self._sight(f"ghost {self._looks}", *at, 0.5, "thing")

    def _vessel(self, vessel: Vessel) -> console.Sight:
        place, _ = self._place(vessel.north_m, vessel.east_m)
        motion = math.degrees(vessel.course_rad) % 360.0, vessel.speed_mps
        name = vessel.row.name or f"vessel {vessel.mmsi}"
        row = vessel.row
        return console.Sight(SeenVessel(name, *place, *motion, length_m=row.length_m, beam_m=row.beam_m))


def _sort(row: SimulatedLookout) -> SensorSort:
    """What this one can do."""
    sort = SORTS[row.kind]
    return sort._replace(
        reach_m=sort.reach_m if row.reach_m is None else row.reach_m,
        missed=sort.missed if row.missed is None else row.missed,
        ghosts=sort.ghosts if row.ghosts is None else row.ghosts,
    )


class Surroundings:
    """All things, and all look-outs. Call `step` after the model was advanced."""

    def __init__(self, settings: config.Vehicle, model: Model, seed: int, vessels: Sequence[Vessel] = ()) -> None:
        """Raises ConfigError where a look-out has no program that may tell of obstacles, and no port."""
        here, self._model, self._vessels = settings.of(Simulation).things, model, vessels
        rows = [Standing(*(getattr(each, name) for name in Standing._fields)) for each in here.thing]
        rows += drawn(here.world, Random(f"things {here.world} {seed}"))
        self.things = [TrueThing(number, row) for number, row in enumerate(rows, 1)]
        self._half_m = settings.boat.length_m / 2.0, settings.boat.beam_m / 2.0
        self._lookouts, self.radars = list[PlayedSensor](), list[PlayedRadar]()
        for i, row in enumerate(here.lookout):
            if (why := _fault(settings, row, here.lookout[:i])) is not None:
                raise ConfigError("the vehicle's file", f"simulation.things.lookout[{i}].{why[0]}", why[1])
            if row.payload is not None:
                self._lookouts.append(PlayedSensor(i, row, row.payload, model, seed))
            elif row.port is not None:
                by = SeesBy(*(getattr(_sort(row), name) for name in SeesBy._fields))
                self.radars.append(PlayedRadar(row.port, by, model, seed, self.things, vessels))
        self._period, self._began_s = Period(LOOK_S), math.nan

    @property
    def due_s(self) -> float:
        """The time when a look-out looks next."""
        return self._period.due_s if self._lookouts else math.inf

    def step(self, now_s: float, *, counts: bool = False) -> list[tuple[str, console.Sight]]:
        """What is told now, each with the program that tells it; the things are where they are at this time. `counts`: the boat
        goes somewhere by itself, so that it counts how near it comes."""
        if math.isnan(self._began_s):
            self._began_s = now_s
        for each in self.things:
            each.drift(now_s - self._began_s, self._model)
            if counts and each.row.follows_m is None:
                each.measure(self._model, *self._half_m)
        if not self._lookouts or not self._period.passed(now_s):
            return []
        return [(each.payload, told) for each in self._lookouts for told in each.look(self.things, self._vessels)]


def _fault(settings: config.Vehicle, row: SimulatedLookout, before: Sequence[SimulatedLookout]) -> tuple[str, str] | None:
    """The key of a look-out that is wrong, and why; None: none is."""
    programs, payload, port = settings.table("payload"), row.payload, row.port
    if (payload is None) is (port is None):
        return "payload", "a look-out has a program, or a port of [nmea0183.ports], and not both"
    if (payload, port) in [(each.payload, each.port) for each in before]:
        return "payload" if port is None else "port", "it has a look-out already"
    if payload is not None and (payload not in programs or "obstacles" not in programs[payload].may):
        return "payload", f'no program of this name has the right "obstacles": [payload.{payload}]'
    if port is not None and row.kind != "radar":
        return "kind", "only a radar speaks on a port"
    if port is not None and (port not in settings.table("nmea0183").ports or not hears(settings)):
        return "port", f'no port of this name is read: [nmea0183.ports.{port}], and "nmea0183" in sensors.names'
    return None


def surroundings_of(settings: config.Vehicle, model: Model, seed: int, vessels: Sequence[Vessel] = ()) -> Surroundings | None:
    """What stands in the water of a vehicle's file; None: nothing, and nobody looks for it. Raises ConfigError."""
    here = settings.of(Simulation).things
    return Surroundings(settings, model, seed, vessels) if here.world or here.thing or here.lookout else None
