"""The lines of one survey divided among boats, so that all are done at about the same time: each gets lines side by side."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.base.errors import DelfimError
from delfim.survey.ground import Ground, Place, Segment
from delfim.survey.planning import LinesWanted, SurveyPlan, plan_of

ROUNDS: Final = 4  # shares are planned, and made anew by what the plans take
BOATS: Final = 8


class BoatShare(NamedTuple):
    """A boat that takes part."""

    wanted: LinesWanted
    fence: config.Zones
    start: Place | None = None  # where it is


def shared(
    ground: Ground, heading_deg: float, main: Sequence[Segment], across: Sequence[Segment], boats: Sequence[BoatShare]
) -> list[SurveyPlan | None]:
    """A plan for each boat; None for one that has no line, because there are fewer. Raises DelfimError in words."""
    if not 0 < len(boats) <= BOATS:
        raise DelfimError(f"1 to {BOATS} boats share a survey, and these are {len(boats)}")
    both = _side_by_side(main, heading_deg), _side_by_side(across, heading_deg + 90.0)
    order = _along(boats, both[0], heading_deg)
    factors, best, least_s = [1.0] * len(boats), list[SurveyPlan | None](), math.inf
    for _ in range(ROUNDS if len(boats) > 1 else 1):
        costs = [[_cost(line, boats[k].wanted, factors[k]) for k in order] for line in both[0]]
        cross_costs = [[_cost(line, boats[k].wanted, factors[k]) for k in order] for line in both[1]]
        parts = _parted(costs, [0.0] * len(boats))
        busy = [sum(row[place] for row in costs[slice(*part)]) for place, part in enumerate(parts)]
        crossing = _parted(cross_costs, busy)
        plans: list[SurveyPlan | None] = [None] * len(boats)
        for place, k in enumerate(order):
            its, over = (both[0][slice(*parts[place])], both[1][slice(*crossing[place])])
            if its or over:
                plans[k] = plan_of(ground, boats[k].wanted, boats[k].fence, heading_deg, its, over, boats[k].start)
                rough_s = sum(_cost(line, boats[k].wanted, 1.0) for line in (*its, *over))
                factors[k] = plans[k].time_s / rough_s  # type: ignore[union-attr]
        longest_s = max(plan.time_s for plan in plans if plan is not None)
        if longest_s < least_s:
            best, least_s = plans, longest_s
    return best


def _side_by_side(lines: Sequence[Segment], heading_deg: float) -> list[Segment]:
    """The lines in the order in which they lie beside each other, to starboard of the heading."""
    s, c = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return sorted(lines, key=lambda line: ((line[0][0] + line[1][0]) * c - (line[0][1] + line[1][1]) * s, line))


def _along(boats: Sequence[BoatShare], lines: Sequence[Segment], heading_deg: float) -> list[int]:
    """The boats' numbers in the order in which they lie across the lines, as far as it is known where they are."""
    s, c = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    if any(boat.start is None for boat in boats):
        return list(range(len(boats)))
    return sorted(range(len(boats)), key=lambda k: boats[k].start[0] * c - boats[k].start[1] * s)  # type: ignore[index]


def _cost(line: Segment, wanted: LinesWanted, factor: float) -> float:
    """About the time of a line with its turn, s."""
    return factor * ((math.dist(*line) + 2.0 * wanted.run_in_m + wanted.spacing_m) / wanted.speed_mps + wanted.turn_s)


def _parted(costs: Sequence[Sequence[float]], busy: Sequence[float]) -> list[tuple[int, int]]:
    """From which line to which each boat sails, so that the longest takes as short as may be: by halving that time. `costs`: of
    each line, what each boat needs for it; `busy`: what else each does."""
    low, high = 0.0, sum(max(row) for row in costs) + max(busy) + 1.0
    found = [(0, 0)] * len(busy)
    for _ in range(40):
        middle, at, parts = (low + high) / 2.0, 0, list[tuple[int, int]]()
        for boat, load in enumerate(busy):
            begin, total = at, load
            while at < len(costs) and total + costs[at][boat] <= middle:
                total += costs[at][boat]
                at += 1
            parts.append((begin, at))
        if at == len(costs):
            high, found = middle, parts
        else:
            low = middle
    return found
