"""Random encounters with 1 to 5 vessels, sailed by the guard alone before a point that turns and speeds up as a boat does.

    python -m bench.encounters --count 100000 [--first 0] [--workers 2] [--output FOLDER] [--picture FILE.png]
    python -m bench.encounters etc/encounters/imazu22-real.json ...       those of files instead

This is a fast check of the decisions: no hull, no sea, perfect reports. `delfim campaign etc/campaigns/encounters-random.toml`
sails the same encounters through the whole program. With --output each block of a thousand is kept when it is complete, and
the same command goes on with those that are missing. A breach counts only where a solution exists: some constant course and
speed, kept from the start by a boat that knows all, stays out of every domain.
"""

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing import Pool
from pathlib import Path
from typing import Any, Final

from bench.record import draw
from delfim.base.geodesy import wrap
from delfim.campaign.colreg import Instant
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import Memory, decide
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.simulator.nodes.other_vessels import axes_m, within
from delfim.simulator.scenarios.encounters import Encounter, Ship, StraightWay, drawn, read_encounters
from delfim.vehicle.target import Target

OWN_MPS: Final = 1.5
LIMITS: Final = Caution(length_m=4.5, turn_radps=math.radians(15.0), ramp_mps2=0.4)
DECIDE_S: Final = 2
AFTER_S: Final = 300
TRIALS: Final = (*((math.radians(10.0 * i), part) for i in range(36) for part in (1.0, 0.5)), (0.0, 0.0))
FIGURES: Final = 3
BLOCK: Final = 1000  # encounters that are kept together
_new: Final = tuple.__new__  # of a named tuple, without its names


def sail(encounter: Encounter) -> tuple[list[float], list[float], list[tuple[float, float]]]:
    """The nearest to each vessel, in domains, with the guard and without it, where the boat goes on to the north; and the
    track with it, a point each 10 s."""
    ships = encounter.targets
    ways, axes = [ship.way for ship in ships], [axes_m(ship.length_m) for ship in ships]
    told = [_told(str(number), ship) for number, ship in enumerate(ships)]
    end_s = int(max(ship.tcpa_s for ship in ships)) + AFTER_S
    route = RouteAhead(((OWN_MPS * (end_s + 600.0), 0.0),), OWN_MPS)
    own, memory, order = Own(0.0, 0.0, 0.0, OWN_MPS), Memory(), None
    nearest, without, track = [math.inf] * len(ships), [math.inf] * len(ships), list[tuple[float, float]]()
    for t in range(end_s):
        if t % DECIDE_S == 0:
            places = [way.at(float(t)) for way in ways]
            targets = [_new(Target, (*head, *at, *tail)) for at, (head, tail) in zip(places, told, strict=True)]
            memory, order, _ = decide(LIMITS, memory, own, route, targets, None, float(t))
            _near(nearest, own.north_m, own.east_m, places, ways, axes)
            _near(without, OWN_MPS * t, 0.0, places, ways, axes)
        if t % 10 == 0:
            track.append((round(own.north_m, 1), round(own.east_m, 1)))
        course_rad = math.atan2(-own.east_m, route.points[0][0] - own.north_m) if order is None else order.course_rad
        own = moved(own, course_rad, OWN_MPS if order is None else order.speed_mps)
    return nearest, without, track


def _told(number: str, ship: Ship) -> tuple[tuple[object, ...], tuple[object, ...]]:
    """What a target tells before its place, and after it."""
    course_rad = math.radians(ship.course_deg)
    is_known = (ship.length_m, ship.beam_m, True, 0.0, 0.0, False)
    return (number, f"SHIP {number}"), (course_rad, ship.speed_mps, course_rad, *is_known, "A", 0)


def _near(
    nearest: list[float],
    north_m: float,
    east_m: float,
    places: Sequence[tuple[float, float]],
    ways: Sequence[StraightWay],
    axes: Sequence[tuple[float, float]],
) -> None:
    """Keeps how near each vessel came, with the boat here and the vessels at their places."""
    for i, (n, e) in enumerate(places):
        near = within(north_m - n, east_m - e, ways[i].c, ways[i].s, axes[i])
        if near < nearest[i]:
            nearest[i] = near


def moved(own: Own, course_rad: float, speed_mps: float) -> Own:
    """The boat a second later."""
    north_m, east_m, was_rad, was_mps = own
    most_rad, most_mps = LIMITS.turn_radps, LIMITS.ramp_mps2
    now_rad = wrap(was_rad + min(max(wrap(course_rad - was_rad), -most_rad), most_rad))
    now_mps = was_mps + min(max(speed_mps - was_mps, -most_mps), most_mps)
    return Own(north_m + now_mps * math.cos(now_rad), east_m + now_mps * math.sin(now_rad), now_rad, now_mps)


def solution(ships: Sequence[Ship]) -> tuple[float, float] | None:
    """A course, rad, and a part of the speed that stay clear of all from the start; None: none of the trials does."""
    end_s = max(ship.tcpa_s for ship in ships) + AFTER_S
    ways = [(ship.way, axes_m(ship.length_m)) for ship in ships]
    return next(((course, part) for course, part in TRIALS if _is_clear(course, part * OWN_MPS, ways, end_s)), None)


def _is_clear(
    course_rad: float, speed_mps: float, ways: Sequence[tuple[StraightWay, tuple[float, float]]], end_s: float
) -> bool:
    vn, ve, t_s = speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad), 0.0
    while t_s < end_s:
        for way, axes in ways:
            north_m, east_m = way.at(t_s)
            if within(vn * t_s - north_m, ve * t_s - east_m, way.c, way.s, axes) < 1.0:
                return False
        t_s += 5.0
    return True


def one(given: Encounter | int) -> dict[str, Any]:
    """What came of an encounter, or of the random one of a seed."""
    encounter = drawn(given, OWN_MPS) if isinstance(given, int) else given
    nearest, without, track = sail(encounter)
    row: dict[str, Any] = {"name": encounter.id, "vessels": len(nearest), "nearest": round(min(nearest), FIGURES)}
    row |= {
        "without": round(min(without), FIGURES),
        "entered": [sum(near < 1.0 for near in each) for each in (nearest, without)],
    }
    if min(nearest) < 1.0:
        found = solution(encounter.targets)
        row |= {"solved": found is not None, "track": track, "kinds": [ship.kind for ship in encounter.targets]}
    return row


def _there(ships: Sequence[Ship], courses: Sequence[float], t_s: float) -> tuple[tuple[float, float, float], ...]:
    return tuple((*ship.way.at(t_s), course_rad) for ship, course_rad in zip(ships, courses, strict=True))


def shown(row: dict[str, Any]) -> dict[str, Any]:
    """A random encounter that was sailed, as the record draws it."""
    ships = drawn(int(row["name"].partition("-")[2]), OWN_MPS).targets
    courses = [math.radians(ship.course_deg) for ship in ships]
    instants = [
        Instant(10.0 * i, place[0], place[1], 0.0, 0.0, _there(ships, courses, 10.0 * i))
        for i, place in enumerate(row["track"])
    ]
    vessels = [(ship.length_m, ship.beam_m, ship.kind, row["nearest"]) for ship in ships]
    return {"name": row["name"], "vessels": vessels, "instants": instants}


def blocks(first: int, count: int, workers: int, output: Path | None) -> Iterator[dict[str, Any]]:
    """Random encounters from this seed on, those that are kept already among them."""
    for begin in range(first, first + count, BLOCK):
        kept = None if output is None else output / f"{begin:07}.json"
        if kept is not None and kept.exists():
            yield from json.loads(kept.read_text())
            continue
        with Pool(workers) as pool:
            rows = pool.map(one, range(begin, min(begin + BLOCK, first + count)), chunksize=10)
        if kept is not None and len(rows) == BLOCK:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.with_suffix(".tmp").write_text(json.dumps(rows))
            kept.with_suffix(".tmp").rename(kept)
        yield from rows


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--picture", type=Path, help="Draw the breaches where a solution is known.")
    asked = parser.parse_args()
    found = blocks(asked.first, asked.count, asked.workers, asked.output)
    if asked.files:
        found = (one(each) for file in asked.files for each in read_encounters(file).encounters)
    tell(list(found), asked.picture)


def tell(rows: list[dict[str, Any]], picture: Path | None) -> None:
    sailed = Counter(row["vessels"] for row in rows)
    bad = [row for row in rows if row["nearest"] < 1.0]
    for vessels in sorted(sailed):
        entered = [row for row in bad if row["vessels"] == vessels]
        unsolved = sum(not row["solved"] for row in entered)
        words = f"{sailed[vessels]} sailed, a domain entered in {len(entered)}, no solution known for {unsolved} of these"
        without = sum(row["without"] < 1.0 for row in rows if row["vessels"] == vessels)
        print(f"{vessels} vessels: {words}; without the guard in {without}")
    worse = [row["name"] for row in rows if row["entered"][0] > row["entered"][1]]
    print(f"more domains entered than without the guard: {', '.join(worse) or 'nowhere'}")
    for row in bad:
        print(f"  {row['name']}: nearest {row['nearest']}, solved {row['solved']}, {', '.join(row['kinds'])}")
    if picture and bad:
        draw([shown(row) for row in bad if row["solved"]], picture, "Domains entered where a solution is known")


if __name__ == "__main__":
    main()
