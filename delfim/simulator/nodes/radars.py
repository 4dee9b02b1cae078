"""A radar that plots by itself (ARPA), on a port of NMEA 0183: each turn of its aerial it measures what returns an echo,
follows what returned some, and tells of each target by TTM, and by TLL once it is sure of it (IEC 61162-1).

It sees vessels, with AIS or without, and things that stand. Echoes fail to come, and some are of nothing: clutter that stands
for some seconds. Sizes and names it does not know.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from random import Random
from typing import Final, NamedTuple, Protocol

from delfim.base.geodesy import from_plane
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.sentences import KNOT
from delfim.lines.nmea0183.speaking import clock, halves
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period

SECTORS: Final = 10  # of a turn of the aerial, one in each look
LOOK_S: Final = 0.25
TURN_S: Final = SECTORS * LOOK_S
MOST: Final = 40  # targets that it follows at once
SURE: Final = 3  # echoes
LOST_S: Final = 5.0 * TURN_S  # without an echo
CLUTTER_S: Final = (2.0 * TURN_S, 8.0 * TURN_S)  # for so long it stands
OF_PLACE, OF_VELOCITY = 0.4, 0.15  # parts of what an echo is off that its target takes
NAUTICAL_M: Final = 1852.0


class Echoing(Protocol):
    """A vessel, or a thing."""

    north_m: float
    east_m: float


class SeesBy(NamedTuple):
    """How well it sees."""

    reach_m: float
    error_m: float  # standard deviation of a distance
    error_rad: float  # and of a bearing
    missed: float  # part of the echoes that do not come
    ghosts: float  # that begin in a second


@dataclass(slots=True)
class Clutter:
    north_m: float
    east_m: float
    until_s: float


@dataclass(slots=True)
class Plot:
    """A target: where it is, and how it goes, as the radar has it. Lengths to north and east in m."""

    number: int
    north_m: float
    east_m: float
    at_s: float
    north_mps: float = 0.0
    east_mps: float = 0.0
    echoes: int = 1
    status: str = "Q"  # being acquired; T: followed; L: lost

    def take(self, north_m: float, east_m: float, now_s: float) -> None:
        """Take the next echo."""
        passed_s = max(now_s - self.at_s, LOOK_S)
        self.north_m, self.east_m = self.north_m + self.north_mps * passed_s, self.east_m + self.east_mps * passed_s
        off = north_m - self.north_m, east_m - self.east_m
        self.north_m, self.east_m = self.north_m + OF_PLACE * off[0], self.east_m + OF_PLACE * off[1]
        per_s = OF_VELOCITY / max(passed_s, TURN_S)
        self.north_mps, self.east_mps = self.north_mps + per_s * off[0], self.east_mps + per_s * off[1]
        self.at_s, self.echoes = now_s, self.echoes + 1
        self.status = "T" if self.echoes >= SURE else "Q"


class PlayedRadar:
    """One radar, and what is around it."""

    def __init__(
        self, port: str, by: SeesBy, model: Model, seed: int, things: Sequence[Echoing], vessels: Sequence[Echoing]
    ) -> None:
        self.port = port
        self._by, self._model, self._random = by, model, Random(f"radar {port} {seed}")
        self._around = [(f"thing {i}", each) for i, each in enumerate(things)]
        self._around += [(f"vessel {i}", each) for i, each in enumerate(vessels)]
        self._clutter = list[tuple[str, Clutter]]()
        self._plots = dict[str, Plot]()  # by what returns the echo
        self._period, self._looks = Period(LOOK_S), 0

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def step(self, now_s: float) -> list[Plot] | None:
        """The targets that it tells of now; None: it does not look, or has none in this direction."""
        if not self._period.passed(now_s):
            return None
        self._looks += 1
        self._clutter = [each for each in self._clutter if each[1].until_s > now_s]
        if self._random.random() < self._by.ghosts * LOOK_S:
            self._clutter.append((f"clutter {self._looks}", self._began(now_s)))
        told = [plot for each in (*self._around, *self._clutter) if (plot := self._echoed(*each, now_s)) is not None]
        for key, plot in tuple(self._plots.items()):
            if now_s - plot.at_s > LOST_S:
                plot.status = "L"
                told.append(self._plots.pop(key))
        return told or None

    def say(self, told: list[Plot], utc_ns: int) -> bytes:
        """The sentences of its targets."""
        return b"".join(line for each in told for line in self._sentences(each, clock(utc_ns)))

    def _echoed(self, key: str, echo: Echoing, now_s: float) -> Plot | None:
        """The target of what the aerial sweeps now; None: it does not, or no echo came, or it follows as many as it can."""
        model, by, random = self._model, self._by, self._random
        north_m, east_m = echo.north_m - model.north_m, echo.east_m - model.east_m
        far_m, bearing_rad = math.hypot(north_m, east_m), math.atan2(east_m, north_m) % math.tau
        is_swept = int(bearing_rad / math.tau * SECTORS) % SECTORS == self._looks % SECTORS
        if not is_swept or far_m > by.reach_m or random.random() < by.missed:
            return None
        far_m, bearing_rad = far_m + random.gauss(0.0, by.error_m), bearing_rad + random.gauss(0.0, by.error_rad)
        at = model.north_m + far_m * math.cos(bearing_rad), model.east_m + far_m * math.sin(bearing_rad)
        if (plot := self._plots.get(key)) is not None:
            plot.take(*at, now_s)
        elif len(self._plots) < MOST:
            taken = {each.number for each in self._plots.values()}
            number = next(each for each in range(1, MOST + 1) if each not in taken)
            plot = self._plots[key] = Plot(number, *at, now_s)
        return plot

    def _began(self, now_s: float) -> Clutter:
        far_m, bearing_rad = self._by.reach_m * math.sqrt(self._random.random()), self._random.uniform(0.0, math.tau)
        at = self._model.north_m + far_m * math.cos(bearing_rad), self._model.east_m + far_m * math.sin(bearing_rad)
        return Clutter(*at, now_s + self._random.uniform(*CLUTTER_S))

    def _sentences(self, plot: Plot, time: str) -> Iterator[bytes]:
        model = self._model
        north_m, east_m = plot.north_m - model.north_m, plot.east_m - model.east_m
        bearing, course = _degrees(north_m, east_m), _degrees(plot.north_mps, plot.east_mps)
        speed, far = math.hypot(plot.north_mps, plot.east_mps) / KNOT, math.hypot(north_m, east_m) / NAUTICAL_M
        yield framed(f"RATTM,{plot.number:02d},{far:.3f},{bearing},T,{speed:.1f},{course},T,,,N,,{plot.status},,{time},A")
        if plot.status == "T":
            yield framed(f"RATLL,{plot.number:02d},{halves(*from_plane(model.origin, plot.north_m, plot.east_m))},,{time},T,")


def _degrees(north: float, east: float) -> str:
    return f"{round(math.degrees(math.atan2(east, north)) * 10.0) % 3600 / 10.0:.1f}"
