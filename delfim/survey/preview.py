"""Surveys planned for a page, in a process of its own: Shapely is nothing for the gateway's loop, and an area may take long.

`python -m delfim.survey.preview FILE`, with the vehicle's file, answers each line of its standard input with a line of its
standard output, both JSON: a `PreviewAsked` by a `PreviewTold`, or by `{"refused": WORDS}` where there is none. It has no limit
of time: who asks ends it.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any, Final, Literal, NamedTuple

import msgspec

from delfim import config
from delfim.base.errors import DelfimError, in_words
from delfim.base.geodesy import Origin
from delfim.base.input.bounded import bounded
from delfim.survey.areafile import CORNERS, Corner, Ring, Shape

MEMORY_BYTES: Final = 2 << 30  # of addresses; numpy and Shapely take half a gigabyte of them
SHARE: Final = "lines", "way", "time_s", "mission"  # of a boat's share
NEEDS: Final = "a survey needs the package shapely, which is not installed: pip install 'delfim[ground]'"


class PreviewAsked(msgspec.Struct, forbid_unknown_fields=True):
    """Lines wanted of areas. Lengths are metres, 0: what suits the boat, or none where that is sensible."""

    areas: list[Shape]
    spacing_m: float = 0.0  # 0: by swath and overlap
    swath_m: float = 0.0
    overlap_pct: float = 20.0
    heading_deg: float | None = None  # None: the quickest
    cross_m: float = 0.0
    start: str = ""
    inside: bool = False
    side: Literal["", "port", "starboard"] = ""  # that the sensor looks to; empty: both
    run_in_m: float = 0.0
    speed_mps: float = 0.0
    fence: Ring = []  # of the mission, to stay in
    obstacles: list[tuple[float, float, float]] = []  # of the mission: latitude and longitude, degrees, and radius, m
    closed: list[Ring] = []  # zones of the mission to stay out of
    name: str = "survey"
    lines: list[tuple[Corner, Corner]] = []  # as they were planned: what is left of them is asked for
    across: int = 0  # so many of them, the last ones, lie across
    at: Corner | None = None  # where the boat is
    others: list[Corner | None] = []  # where other boats are, among whom and this one what is left is divided
    heard: list[str] = []  # files of soundings, by which it is known what is left
    sailed: bool = False  # time and energy by a few lines that the simulated boat sails: they take half a second to two


class PreviewTold(NamedTuple):
    """A survey for a page: places are latitude and longitude, degrees."""

    lines: list[tuple[Corner, Corner]]  # in their order and direction, the cross lines last
    across: int
    way: list[Corner]  # the whole of it, with turns
    heading_deg: float
    spacing_m: float
    line_m: float
    way_m: float
    time_s: float
    covered: tuple[float, float]  # parts: of what may be sailed, and of the area
    room_m: float
    rough: int  # lines with a short run-in, beside a hole
    mission: Any  # the tables of its file
    done: Sequence[tuple[Corner, Corner]] = ()  # parts of lines that are done ...
    counts: str = ""  # ... in words
    known: Sequence[tuple[Corner, Corner]] = ()  # all lines of the survey, whose rest these are ...
    known_across: int = 0  # ... the last ones across
    shares: Sequence[
        dict[str, Any] | None
    ] = ()  # of each boat where there are several: its mission, lines, way, and time_s; ...
    # ... None: no line is left for it
    energy_wh: float | None = None  # in usual weather; None: not asked for, or this boat's devices are not simulated


def told(asked: PreviewAsked, settings: config.Vehicle) -> dict[str, Any]:
    """The survey of these areas. Raises DelfimError, ImportError."""
    from delfim.survey import planning
    from delfim.survey.ground import in_plane, laid

    if sum(len(ring) for shape in asked.areas for ring in (shape.outline, *shape.holes)) > CORNERS:
        raise DelfimError(f"more than {CORNERS} corners: simplify the areas")
    if asked.lines:
        return _rest(asked, settings)
    if not asked.areas:
        raise DelfimError("there is no area: draw one, or load a file")
    if not (asked.spacing_m or asked.swath_m):
        raise DelfimError("say a spacing, or a swath")
    wanted = planning.wanted_of(
        settings,
        spacing_m=asked.spacing_m or asked.swath_m * (1.0 - asked.overlap_pct / 100.0),
        swath_m=asked.swath_m,
        heading_deg=asked.heading_deg,
        edges=not asked.inside,
        cross_m=asked.cross_m,
        start=asked.start,
        side=asked.side,
        run_in_m=asked.run_in_m or None,
        speed_mps=asked.speed_mps or None,
    )
    ground = laid(asked.areas)
    come = in_plane(ground.at, *asked.at) if asked.at is not None else None
    plan = planning.planned(ground, wanted, _around(asked, settings.fence), come)
    return _as_told(plan, asked, settings)._asdict()


def _as_told(plan: Any, asked: PreviewAsked, settings: config.Vehicle) -> PreviewTold:
    """A plan for the page. Raises DelfimError where the boat would not take its mission."""
    from delfim.survey import planning, trialsail

    mission = planning.mission(plan, asked.name)
    planning.check(mission, plan, settings)
    time_s, energy_wh = trialsail.foretold(settings, plan) if asked.sailed else (plan.time_s, None)
    return PreviewTold(
        _ends(plan.ground.at, plan.lines),
        plan.across,
        [_degrees(plan.ground.at, place) for place in planning.drawn(plan)],
        plan.heading_deg % 180.0,
        plan.wanted.spacing_m,
        plan.line_m,
        plan.way_m,
        time_s,
        plan.covered(),
        plan.wanted.room_m,
        len(plan.rough),
        msgspec.to_builtins(mission),
        energy_wh=energy_wh,
    )


def _degrees(at: Origin, place: tuple[float, float]) -> Corner:
    from delfim.survey.ground import in_degrees

    latitude_deg, longitude_deg = in_degrees(at, *place)
    return round(latitude_deg, 7), round(longitude_deg, 7)


def _ends(at: Origin, lines: Iterable[tuple[Corner, Corner]]) -> list[tuple[Corner, Corner]]:
    return [(_degrees(at, begin), _degrees(at, end)) for begin, end in lines]


def _rest(asked: PreviewAsked, settings: config.Vehicle) -> dict[str, Any]:
    """The lines of what is left of a survey, from where the boat is, or the boats are among whom they are divided. Raises
    DelfimError, also where nothing is left."""
    from delfim.survey import missions, progress
    from delfim.survey.ground import in_plane, laid, swaths

    survey = _known(asked)
    missions.go_on(survey, asked.heard)
    ground, fence = laid(survey.areas), _around(asked, settings.fence)
    lines = survey.segments(ground)
    counts = progress.told(survey, lines)[0].partition(": ")[2]
    fenced = msgspec.structs.replace(settings.fence, keep_in=fence.keep_in, keep_out=fence.keep_out)
    boat = missions.SurveyBoat("boat", msgspec.structs.replace(settings, fence=fenced))
    starts = [in_plane(ground.at, *each) if each is not None else None for each in (asked.at, *asked.others)]
    plans = missions.rest(survey, [boat] * len(starts), starts)
    sailing = [plan for plan in plans if plan is not None]
    if not sailing:
        raise DelfimError(f"nothing is left: {counts}")
    done = [part for each in zip(lines, survey.done, strict=True) for part in progress.parts(*each)]
    plan, each_told = sailing[0], [plan and _as_told(plan, asked, settings) for plan in plans]
    both = swaths([*done, *(line for plan in sailing for line in plan.lines)], plan.wanted.cut.wide_m, plan.wanted.cut.side)
    its = _together([told for told in each_told if told is not None])._replace(
        covered=(both.intersection(plan.free).area / plan.free.area, both.intersection(ground.area).area / ground.area.area),
        done=_ends(ground.at, done),
        counts=counts,
        known=survey.lines,
        known_across=survey.across,
        shares=[told and {key: getattr(told, key) for key in SHARE} for told in each_told] if asked.others else (),
    )
    return its._asdict()


def _together(each: list[PreviewTold]) -> PreviewTold:
    """What several boats sail at the same time, as if it were of one."""
    first, energies = each[0], [told.energy_wh for told in each]
    along, crossing = ([line for told in each for line in told.lines[part(told)]] for part in (_along, _crossing))
    return first._replace(
        lines=along + crossing,
        across=len(crossing),
        rough=sum(told.rough for told in each),
        line_m=sum(told.line_m for told in each),
        way_m=sum(told.way_m for told in each),
        time_s=max(told.time_s for told in each),
        energy_wh=None if None in energies else sum(filter(None, energies)),
    )


def _along(told: PreviewTold) -> slice:
    return slice(len(told.lines) - told.across)


def _crossing(told: PreviewTold) -> slice:
    return slice(len(told.lines) - told.across, None)


def _known(asked: PreviewAsked) -> Any:
    """The survey whose lines these are, of which nothing is known to be done. Without areas, as for a mission that was read
    from a boat, it has what its lines cover; without a spacing, that of its lines."""
    from delfim.survey import progress

    if not asked.areas:
        return progress.by_lines(asked.name, asked.lines, asked.spacing_m, asked.speed_mps or None)
    wishes = progress.SurveyWishes(
        spacing_m=asked.spacing_m or asked.swath_m * (1.0 - asked.overlap_pct / 100.0),
        swath_m=asked.swath_m,
        cross_m=asked.cross_m,
        side=asked.side,
        run_in_m=asked.run_in_m or None,
        speed_mps=asked.speed_mps or None,
    )
    heading_deg = progress.by_lines(asked.name, asked.lines).heading_deg
    done: list[list[tuple[float, float]]] = [[] for _ in asked.lines]
    return progress.KeptSurvey(progress.VERSION, asked.name, asked.areas, wishes, heading_deg, asked.across, asked.lines, done)


def _around(asked: PreviewAsked, boats: config.Zones) -> config.Zones:
    """The fence for the lines: the boat's zones with those of the mission, and the mission's fence in place of the boat's."""
    circles = (config.Area(centre=((north, east),), radius_m=radius_m) for north, east, radius_m in asked.obstacles)
    closed = (config.Area(polygon=tuple(ring)) for ring in asked.closed)
    keep_in = (config.Area(polygon=tuple(asked.fence)),) if asked.fence else boats.keep_in
    return config.Zones(keep_in=keep_in, keep_out=(*boats.keep_out, *circles, *closed))


def answered(line: bytes, settings: config.Vehicle) -> dict[str, Any]:
    """The answer to a line. Whatever stands in it, there is one."""
    try:
        return told(msgspec.json.decode(line, type=PreviewAsked), settings)
    except ModuleNotFoundError:
        return {"refused": NEEDS}
    except MemoryError:
        return {"refused": "the area takes too much memory: simplify it, or take a larger spacing"}
    except (DelfimError, OSError, msgspec.MsgspecError, ValueError) as error:
        return {"refused": in_words(error) if isinstance(error, DelfimError | OSError) else str(error)}


def main(vehicle: str) -> int:
    """The process."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each thread would take addresses
    bounded(MEMORY_BYTES)
    settings = config.load(vehicle)
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(msgspec.json.encode(answered(line, settings)) + b"\n")
        sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
