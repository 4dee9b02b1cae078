"""Whether anybody could have stayed clear: the runs of etc/campaigns/encounters-harder.toml whose ships turn late or without a
reason, through the whole program.

    python -m bench.breaches [--first 1] [--seeds 20] [--output FILE]   sails, and judges; goes on where it was ended
    python -m bench.breaches --tell                                     judges what is there

Of a run in which a domain is entered, or a ship struck, two moments count: when the last ship began to turn before that, which
nobody can know sooner; and when the boat heard the first report of its new course, which is when it can be known aboard. From
either all places are followed that some way reaches without a domain (`bench.escapes`): where none is left, no boat of that
speed could have stayed clear. And courses at full and half speed and stopped are tried, kept by a boat that turns and speeds up
as this one: where one of these stays clear a way was left, for sure.
"""

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from bench.escapes import OWN_MPS, SMALL, escapes
from delfim.base.vessels import VesselPosition
from delfim.campaign.runplan import Plan, read
from delfim.campaign.sailing import sailed_run
from delfim.parts.traffic.encounter import Own
from delfim.simulator.nodes.other_vessels import FIRST_MMSI, Transponder, axes_m
from tests.parts.traffic.encounters import Instant, Ship, place

CAMPAIGN: Final = Path(__file__).parents[1] / "etc/campaigns/encounters-harder.toml"
MANNER, HEARD = "simulation.traffic.manner", "simulation.traffic.heard"
MANNERS: Final = ("late", "turn")
FASTEST_MPS: Final = 2.2  # control.speed.max_mps, which no mission exceeds
TURNS_RAD: Final = 1e-4  # in a second: a ship turns
NEAR_RAD: Final = math.radians(3.0)  # of its new course, when the turn is as good as over
KEPT_S: Final = 300
COURSES, PARTS = range(0, 360, 5), (1.0, 0.5, 0.0)


class Breach(NamedTuple):
    """What came of one run."""

    entered_s: float
    turned_s: float
    told_s: float  # when the turn was heard of; infinite: never before the domain was entered
    left: str  # "none at the turn", "none when told", "a course", "perhaps"
    hurrying: bool  # at the highest speed of the file some way may have been left when it was told
    foreseen: bool  # from the first report of the turn on a course was left, for who knew where it would end
    best: float  # domains: the least of the best course that is kept from when it was told
    missed: str  # of a run with a collision: whether a course that would have struck nobody was left when it was told


class Followed(NamedTuple):
    """A ship as it sailed: its places at these times."""

    length_m: float
    times_s: Sequence[float]
    places: Sequence[tuple[float, float, float]]

    def at(self, t_s: float) -> Ship:
        """Where it is then; it goes on as it did at the end."""
        i = min(max(int(t_s - self.times_s[0]), 0), len(self.times_s) - 1)
        north_m, east_m, course_rad = self.places[i]
        here = Ship(north_m, east_m, course_rad, self._speed_mps(i), self.length_m, "", 0.0)
        return here.at(t_s - self.times_s[i])

    def _speed_mps(self, i: int) -> float:
        j = max(min(i, len(self.times_s) - 2), 0)
        passed_s = self.times_s[j + 1] - self.times_s[j]
        return math.dist(self.places[j][:2], self.places[j + 1][:2]) / passed_s


def sail(plan: Plan, first: int, last: int, output: Path) -> None:
    """Sail what is not there yet, seed by seed."""
    there = {_run(each) for each in rows(output)}
    heard = _listening()
    with output.open("a") as file:
        for seed in range(first, last + 1):
            for point, (story, values) in enumerate(plan.points):
                name = plan.stories[story].name, values[MANNER], values[HEARD], seed
                if values[MANNER] not in MANNERS or name in there:
                    continue
                heard.clear()
                sailed, _ = sailed_run(plan, point, seed)
                vessels = sailed.run.nodes.vessels
                row = dict(zip(("story", "manner", "heard", "seed"), name, strict=True))
                row |= {"nearest": [each.nearest for each in vessels], "nearest_m": [each.nearest_m for each in vessels]}
                row |= {"lengths": [each.row.length_m for each in vessels]}
                if min(row["nearest"]) < 1.0:
                    row |= {"reports": list(heard), "instants": sailed.truth.rules.instants}
                print(json.dumps(row), file=file, flush=True)
            print(f"seed {seed}", flush=True)


def _listening() -> list[tuple[float, int]]:
    """The positions that a receiver hears from now on: time and number of the vessel."""
    heard, speak = list[tuple[float, int]](), Transponder.speak

    def spoken(self: Transponder, t_s: float, second: int, frozen: bool, wrong_m: float) -> Iterator[Any]:
        for each in speak(self, t_s, second, frozen, wrong_m):
            if isinstance(each.told, VesselPosition):
                heard.append((t_s, each.told.mmsi - FIRST_MMSI))
            yield each

    Transponder.speak = spoken  # type: ignore[method-assign]
    return heard


def rows(output: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.open()] if output.exists() else []


def _run(row: dict[str, Any]) -> tuple[str, str, str, int]:
    return row["story"], row["manner"], row["heard"], row["seed"]


def struck(row: dict[str, Any]) -> list[bool]:
    """Of each ship whether it was struck."""
    lengths = zip(row["nearest_m"], row["lengths"], strict=True)
    return [near_m < (length_m + SMALL.length_m) / 2.0 for near_m, length_m in lengths]


def judged(row: dict[str, Any]) -> Breach:
    """Judge a run in which a domain was entered."""
    instants = row["instants"]
    times_s = [each[0] for each in instants]
    ships = [Followed(length, times_s, [each[5][i] for each in instants]) for i, length in enumerate(row["lengths"])]
    bad = [place(_own(each), ship.at(each[0]))[0] < 1.0 for each in instants for ship in ships]
    entered_s = times_s[bad.index(True) // len(ships)]
    turned_s, ship = max(((_turned_s(each, entered_s), i) for i, each in enumerate(ships)), default=(times_s[0], 0))
    heard_s = [t_s for t_s, number in row["reports"] if number == ship]
    told_s, begun_s = _told_s(ships[ship], turned_s, heard_s), _begun_s(ships[ship], turned_s, heard_s)
    is_told, begin = told_s < entered_s, _begin(instants, min(told_s, times_s[-1]))
    best, _ = kept(begin.own, begin.t_s, ships)
    if not escapes(_begin(instants, turned_s), ships):
        left = "none at the turn"
    elif not is_told or not escapes(begin, ships):
        left = "none when told"
    else:
        left = "a course" if best >= 1.0 else "perhaps"
    hurrying = is_told and (left in ("a course", "perhaps") or escapes(begin, ships, FASTEST_MPS))
    early = _begin(instants, min(begun_s, times_s[-1]))
    foreseen = begun_s < entered_s and kept(early.own, early.t_s, ships)[0] >= 1.0
    missed = _missed(row, ships)
    return Breach(entered_s, turned_s, told_s, left, hurrying, foreseen, best, missed)


def _missed(row: dict[str, Any], ships: Sequence[Followed]) -> str:
    """Whether a course that was kept would have struck nobody, from when the last turn of the ship that was struck was told;
    empty where none was struck."""
    words = list[str]()
    for i, is_struck in enumerate(struck(row)):
        if is_struck:
            struck_s = min((math.dist(each[1:3], each[5][i][:2]), each[0]) for each in row["instants"])[1]
            turned_s = _turned_s(ships[i], struck_s)
            told_s = _told_s(ships[i], turned_s, [t_s for t_s, number in row["reports"] if number == i])
            begin = _begin(row["instants"], told_s)
            found = "no course" if told_s >= struck_s or kept(begin.own, told_s, ships)[1] <= 0.0 else "a course"
            words.append(
                f"ship {i + 1} turned at {turned_s:.0f} s, told at {told_s:.0f} s, struck at {struck_s:.0f} s: {found}"
            )
    return "; ".join(words)


def _own(instant: Sequence[Any]) -> Own:
    return Own(instant[1], instant[2], instant[3], instant[4])


def _begin(instants: Sequence[Any], t_s: float) -> Instant:
    """Where the boat was then."""
    at = min(instants, key=lambda each: abs(each[0] - t_s))
    return Instant(at[0], _own(at), (), 0.0, 0.0)


def _turned_s(ship: Followed, before_s: float) -> float:
    """When it began to turn last before this time; the beginning of the run, if it did not."""
    found = ship.times_s[0]
    turns = [abs(ship.places[i + 1][2] - ship.places[i][2]) > TURNS_RAD for i in range(len(ship.places) - 1)]
    for i in range(1, len(turns)):
        if turns[i] and not turns[i - 1] and ship.times_s[i] < before_s:
            found = ship.times_s[i]
    return found


def _told_s(ship: Followed, turned_s: float, heard_s: Sequence[float]) -> float:
    """When the first report of the course to which it turned then was heard."""
    i = ship.times_s.index(turned_s) if turned_s in ship.times_s else 0
    last = len(ship.places) - 1
    while i < last and abs(ship.places[i + 1][2] - ship.places[i][2]) > TURNS_RAD:
        i += 1
    new_rad = ship.places[i][2]
    after = (t_s for t_s in heard_s if t_s > turned_s and abs(ship.at(t_s).course_rad - new_rad) <= NEAR_RAD)
    return min(after, default=math.inf)


def _begun_s(ship: Followed, turned_s: float, heard_s: Sequence[float]) -> float:
    """When the first report was heard by which it turned then."""
    was_rad = ship.at(turned_s).course_rad
    return min(
        (t_s for t_s in heard_s if t_s > turned_s and abs(ship.at(t_s).course_rad - was_rad) >= NEAR_RAD), default=math.inf
    )


def kept(own: Own, from_s: float, ships: Sequence[Followed]) -> tuple[float, float]:
    """The best of all courses that are kept: the least nearness in domains of that which has most; and the most m that one
    stays off the hull of each."""
    trials = np.array([(math.radians(course), OWN_MPS * part) for course in COURSES for part in PARTS])
    wanted_rad, wanted_mps = trials.T
    north_m, east_m, course_rad, speed_mps = (np.full(len(trials), each) for each in own)
    near, near_m = np.full(len(trials), math.inf), np.full(len(trials), math.inf)
    for t in range(KEPT_S):
        for ship in (each.at(from_s + t) for each in ships):
            n, e, axes = north_m - ship.north_m, east_m - ship.east_m, axes_m(ship.length_m)
            c, s = math.cos(ship.course_rad), math.sin(ship.course_rad)
            near = np.minimum(near, np.hypot((n * c + e * s) / axes[0], (e * c - n * s) / axes[1]))
            near_m = np.minimum(near_m, np.hypot(n, e) - (ship.length_m + SMALL.length_m) / 2.0)
        left_rad = (wanted_rad - course_rad + math.pi) % (2.0 * math.pi) - math.pi
        course_rad += np.clip(left_rad, -SMALL.turn_radps, SMALL.turn_radps)
        speed_mps += np.clip(wanted_mps - speed_mps, -SMALL.ramp_mps2, SMALL.ramp_mps2)
        north_m, east_m = north_m + speed_mps * np.cos(course_rad), east_m + speed_mps * np.sin(course_rad)
    return float(near.max()), float(near_m.max())


def tell(output: Path) -> None:
    """The table, and a line for each collision."""
    all_rows, counts = rows(output), Counter[tuple[str, ...]]()
    for row in all_rows:
        kind = row["manner"], row["heard"]
        counts[*kind, "runs"] += 1
        if "instants" not in row:
            continue
        found = judged(row)
        counts[*kind, "entered"] += 1
        counts[*kind, found.left] += 1
        counts[*kind, "hurrying"] += found.hurrying
        counts[*kind, "foreseen"] += found.foreseen
        if found.missed or found.left in ("a course", "perhaps"):
            told = f"turned at {found.turned_s:.0f} s, told at {found.told_s:.0f} s, entered at {found.entered_s:.0f} s"
            near = ", ".join(f"{each:.2f}" for each in row["nearest"])
            print(
                *_run(row),
                f"{near}: {told}: {found.left} ({found.best:.2f})",
                found.missed,
                flush=True,
            )
        counts[*kind, "struck"] += bool(found.missed)
    columns = ("runs", "struck", "entered", "none at the turn", "none when told", "perhaps", "a course", "hurrying", "foreseen")
    print("| | AIS |", *(f"{each} |" for each in columns))
    for manner, heard in sorted({key[:2] for key in counts}):
        print(f"| {manner} | {heard} |", *(f"{counts[manner, heard, each]} |" for each in columns))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=20, help="The last seed.")
    parser.add_argument("--output", type=Path, default=Path("run/breaches.jsonl"))
    parser.add_argument("--tell", action="store_true", help="Sail nothing.")
    asked = parser.parse_args()
    if not asked.tell:
        asked.output.parent.mkdir(parents=True, exist_ok=True)
        _, plan = read(CAMPAIGN)
        sail(plan, asked.first, asked.seeds, asked.output)
    tell(asked.output)


if __name__ == "__main__":
    main()
