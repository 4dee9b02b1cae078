"""Worlds of things that stand, which the guard has not seen before: fields of 5 to 50, walls with an entrance, and pockets.

    python -m bench.things --count 2000 [--first 0] [--workers 2] [--picture FILE.png]
    python -m bench.things --picture FILE.png --seeds 3 7 12        tracks of these alone

The decisions alone, before a point that turns and speeds up as a boat does: no hull, no sea. The boat sees what is within
REACH_M, 30 cm off at random each second, and goes 400 m to the north.
"""

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from multiprocessing import Pool
from pathlib import Path
from random import Random
from typing import Final, NamedTuple

from bench.encounters import LIMITS, OWN_MPS, moved
from delfim.base.cooperative import Sliced
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.pastthings import Passage, past
from delfim.parts.traffic.trialways import RouteAhead
from delfim.simulator.nodes.worlds import Standing, drawn
from delfim.vehicle.target import Target

GOAL: Final = (400.0, 0.0)
REACH_M: Final = 80.0
NOISE_M: Final = 0.3
SMOOTH: Final = 0.25  # part of a sighting that moves the place, as aboard
ARRIVED_M: Final = 8.0
STOPPED_S, END_S = 120, 1500
SORTS: Final = ("field", "moorings", "entrance", "pocket")


class Sailed(NamedTuple):
    """What came of a world."""

    seed: int
    sort: str
    end: str  # "arrived", "stopped" (it says that there is no way), "late"
    nearest_m: float  # from the boat's side or end to a thing
    long: float  # the way sailed, as a part of the straight one
    spent: int  # comparisons of the longest decision
    track: tuple[tuple[float, float, float], ...]  # north_m, east_m, speed_mps
    words: tuple[str, ...]


def world(seed: int) -> tuple[str, list[Standing]]:
    """The sort of a world, and its things."""
    sort = SORTS[seed % len(SORTS)]
    return sort, drawn(sort, Random(f"things {seed}"))


def thing(number: int, place: tuple[float, float, float]) -> Target:
    """A thing as the boat knows it."""
    name, size_m = f"lidar {number}", 2.0 * place[2]
    return Target(f"thing {number}", name, *place[:2], 0.0, 0.0, math.nan, size_m, size_m, True, 2.0, 0.0, False, "thing", 15)


def sail(seed: int) -> Sailed:
    """Sail a world, second by second."""
    sort, places = world(seed)
    random, known, own = Random(seed), dict[int, tuple[float, float, float]](), Own(0.0, 0.0, 0.0, OWN_MPS)
    was: Passage | None = None
    nearest_m, spent, track, words, stopped_s, end = math.inf, 0, list[tuple[float, float, float]](), list[str](), 0, "late"
    for t in range(END_S):
        for i, (n, e, radius_m, *_) in enumerate(places):
            away_m = math.hypot(n - own.north_m, e - own.east_m)
            nearest_m = min(nearest_m, away_m - radius_m - LIMITS.length_m / 2.0)
            if away_m < REACH_M:
                seen, part = (n + random.gauss(0.0, NOISE_M), e + random.gauss(0.0, NOISE_M)), SMOOTH if i in known else 1.0
                at = known.get(i, (*seen, radius_m))
                known[i] = at[0] + part * (seen[0] - at[0]), at[1] + part * (seen[1] - at[1]), radius_m
        things = sorted((thing(i, at) for i, at in known.items()), key=lambda each: math.dist(each[2:4], own[:2]))
        deciding = Sliced(past(LIMITS, own, RouteAhead((GOAL,), OWN_MPS), things, None, was))
        was = deciding.finish()
        order = None if was is None else was.order(own, OWN_MPS, float(t))
        course_rad = math.atan2(GOAL[1] - own.east_m, GOAL[0] - own.north_m) if order is None else order.course_rad
        speed_mps = OWN_MPS if order is None else order.speed_mps
        if order is not None and order.words not in words[-1:]:
            words.append(order.words)
        stopped_s = stopped_s + 1 if order is not None and order.speed_part == 0.0 else 0
        spent = max(spent, deciding.spent)
        own = moved(own, course_rad, speed_mps)
        track.append((round(own.north_m, 1), round(own.east_m, 1), speed_mps))
        if math.dist(own[:2], GOAL) < ARRIVED_M or stopped_s > STOPPED_S:
            end = "stopped" if stopped_s else "arrived"
            break
    way_m = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(track))
    return Sailed(seed, sort, end, nearest_m, way_m / GOAL[0], spent, tuple(track), tuple(words))


def tell(rows: Sequence[Sailed]) -> None:
    """Print a line for each sort of world, and one for each run that did not arrive, or came near."""
    for sort in dict.fromkeys(SORTS):
        these = [row for row in rows if row.sort == sort]
        if these:
            ends, far_m = Counter(row.end for row in these), sorted(row.nearest_m for row in these)
            long, spent = sorted(row.long for row in these), sorted(row.spent for row in these)
            tail = f"nearest {far_m[0]:.1f} m, struck {sum(each < 0.0 for each in far_m)}"
            ways = f"way {long[len(long) // 2]:.2f} in the middle, {long[-1]:.2f} at most"
            print(f"{sort}: {len(these)}, {dict(ends)}, {tail}, {ways}, comparisons {spent[len(spent) // 2]}, {spent[-1]}")
    for row in rows:
        if row.end != "arrived" or row.nearest_m < 3.0:
            print(f"  {row.seed}: {row.end}, {row.nearest_m:.1f} m, {'; '.join(row.words[-1:])}")


def draw(rows: Sequence[Sailed], file: Path) -> None:
    """Draw the tracks; red: slowly."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.patches import Circle

    columns = min(len(rows), 6)
    lines = -(-len(rows) // columns)
    figure, axes = pyplot.subplots(lines, columns, figsize=(2.6 * columns, 4.2 * lines), squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, row in zip(axes.flat, rows, strict=False):
        for n, e, radius_m, *_ in world(row.seed)[1]:
            axis.add_patch(Circle((e, n), radius_m, color="black"))
            keeps_m = radius_m + LIMITS.thing_clear_m + LIMITS.length_m / 2.0
            axis.add_patch(Circle((e, n), keeps_m, fill=False, color="0.8", linewidth=0.5))
        axis.plot([at[1] for at in row.track], [at[0] for at in row.track], linewidth=1.2)
        slow = [at for at in row.track if at[2] < OWN_MPS]
        axis.plot([at[1] for at in slow], [at[0] for at in slow], "r.", markersize=1.5)
        axis.set_aspect("equal")
        axis.set_title(f"{row.sort} {row.seed}: {row.nearest_m:.0f} m", fontsize=8)
    figure.tight_layout()
    figure.savefig(file, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seeds", type=int, nargs="*")
    parser.add_argument("--picture", type=Path, help="Draw the first dozen, or those of --seeds.")
    asked = parser.parse_args()
    with Pool(asked.workers) as pool:
        rows = pool.map(sail, asked.seeds or range(asked.first, asked.first + asked.count), chunksize=4)
    tell(rows)
    if asked.picture:
        draw(rows[:12], asked.picture)


if __name__ == "__main__":
    main()
