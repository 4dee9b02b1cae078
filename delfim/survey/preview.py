"""Surveys planned for a page, in a process of its own: Shapely is nothing for the gateway's loop, and an area may take long.

`python -m delfim.survey.preview FILE`, with the vehicle's file, answers each line of its standard input with a line of its
standard output, both JSON. `{"read": PATH}` is answered by the `areas` of that file, anything else is a `PreviewAsked` and
answered by a `PreviewTold`; both by `{"refused": WORDS}` where there is none. It has no limit of time: who asks ends it.
"""

import sys
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.base.errors import DelfimError, in_words
from delfim.survey.areafile import CORNERS, Corner, Ring, Shape, read_area

MEMORY_BYTES: Final = 2 << 30  # of addresses; numpy and Shapely take half a gigabyte of them
NICE: Final = 5
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
    run_in_m: float = 0.0
    speed_mps: float = 0.0
    fence: Ring = []  # of the mission, to stay in
    obstacles: list[tuple[float, float, float]] = []  # of the mission: latitude and longitude, degrees, and radius, m
    name: str = "survey"


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
    mission: Any  # the tables of its file


def told(asked: PreviewAsked, settings: config.Vehicle) -> dict[str, Any]:
    """The survey of these areas. Raises DelfimError, ImportError."""
    from delfim.survey import planning
    from delfim.survey.ground import in_degrees, laid

    if sum(len(ring) for shape in asked.areas for ring in (shape.outline, *shape.holes)) > CORNERS:
        raise DelfimError(f"more than {CORNERS} corners: simplify the areas")
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
        run_in_m=asked.run_in_m or None,
        speed_mps=asked.speed_mps or None,
    )
    plan = planning.planned(laid(asked.areas), wanted, _around(asked, settings.fence))
    mission = planning.mission(plan, asked.name)
    planning.check(mission, plan, settings)
    at = plan.ground.at

    def degrees(place: tuple[float, float]) -> Corner:
        latitude_deg, longitude_deg = in_degrees(at, *place)
        return round(latitude_deg, 7), round(longitude_deg, 7)

    return PreviewTold(
        [(degrees(begin), degrees(end)) for begin, end in plan.lines],
        plan.across,
        [degrees(place) for place in planning.drawn(plan)],
        plan.heading_deg,
        wanted.spacing_m,
        plan.line_m,
        plan.way_m,
        plan.time_s,
        plan.covered(),
        wanted.room_m,
        msgspec.to_builtins(mission),
    )._asdict()


def _around(asked: PreviewAsked, boats: config.Zones) -> config.Zones:
    """The fence for the lines: the boat's zones with those of the mission, and the mission's fence in place of the boat's."""
    circles = (config.Area(centre=((north, east),), radius_m=radius_m) for north, east, radius_m in asked.obstacles)
    keep_in = (config.Area(polygon=tuple(asked.fence)),) if asked.fence else boats.keep_in
    return config.Zones(keep_in=keep_in, keep_out=(*boats.keep_out, *circles))


def answered(line: bytes, settings: config.Vehicle) -> dict[str, Any]:
    """The answer to a line. Whatever stands in it, there is one."""
    try:
        asked = msgspec.json.decode(line)
        if isinstance(asked, dict) and "read" in asked:
            return {"areas": read_area(str(asked["read"]))}
        return told(msgspec.convert(asked, PreviewAsked), settings)
    except ModuleNotFoundError:
        return {"refused": NEEDS}
    except MemoryError:
        return {"refused": "the area takes too much memory: simplify it, or take a larger spacing"}
    except (DelfimError, OSError, msgspec.MsgspecError, ValueError) as error:
        return {"refused": in_words(error) if isinstance(error, DelfimError | OSError) else str(error)}


def main(vehicle: str) -> int:
    """The process."""
    if sys.platform != "win32":
        import os
        import resource

        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each thread would take addresses
        os.nice(NICE)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    settings = config.load(vehicle)
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(msgspec.json.encode(answered(line, settings)) + b"\n")
        sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
