"""How long surveys are in the order of lines that OR-tools' routing finds, for `tests/data/survey-orders.json`.

python -m bench.orders [SECONDS]    of search for each area, 4 without; it needs the package ortools, which nothing else does

Each line is sailed once, either way, from anywhere to anywhere, by the shortest ways round holes. The search begins with our
order.
"""

import json
import math
import sys
from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

from delfim import config
from delfim.survey.ground import Place, Segment
from delfim.survey.planning import LinesWanted, SurveyPlan, planned
from tests.survey.drawn import drawn

SEEDS: Final = range(24)
KEPT: Final = Path(__file__).parents[1] / "tests/data/survey-orders.json"
CM: Final = 100  # the search counts in whole numbers
SEARCH_S: Final = 4


def survey_of(seed: int) -> SurveyPlan:
    ground, spacing_m = drawn(seed)
    return planned(ground, LinesWanted(spacing_m, 1.5, room_m=0.0, run_in_m=0.01), config.Zones())


def between_m(plan: SurveyPlan, a: Place, b: Place) -> float:
    places = [a, *plan.ways.between(a, b), b]
    return sum(math.dist(*pair) for pair in pairwise(places))


def whole_m(plan: SurveyPlan, lines: Sequence[Segment]) -> float:
    """Lines and the ways between, in this order."""
    return sum(math.dist(*line) for line in lines) + sum(between_m(plan, a[1], b[0]) for a, b in pairwise(lines))


def found(plan: SurveyPlan, seconds: int) -> list[Segment]:
    """The order of OR-tools."""
    routing = cast(Any, import_module("ortools.constraint_solver.pywrapcp"))
    kinds = cast(Any, import_module("ortools.constraint_solver.routing_enums_pb2"))
    both = [way for line in plan.lines for way in (line, line[::-1])]  # node 2 i is line i as we sail it, 2 i + 1 the other way
    nowhere = len(both)
    far_cm = [[round(CM * between_m(plan, a[1], b[0])) for b in both] for a in both]
    nodes = routing.RoutingIndexManager(nowhere + 1, 1, nowhere)
    model = routing.RoutingModel(nodes)

    def cost(a: int, b: int) -> int:
        here, there = nodes.IndexToNode(a), nodes.IndexToNode(b)
        return 0 if nowhere in (here, there) else far_cm[here][there]

    model.SetArcCostEvaluatorOfAllVehicles(model.RegisterTransitCallback(cost))
    for line in range(len(plan.lines)):
        model.AddDisjunction([nodes.NodeToIndex(2 * line), nodes.NodeToIndex(2 * line + 1)], CM * 10**6, 1)
    search = routing.DefaultRoutingSearchParameters()
    search.local_search_metaheuristic = kinds.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    search.time_limit.seconds = seconds
    model.CloseModelWithParameters(search)
    ours = model.ReadAssignmentFromRoutes([[2 * line for line in range(len(plan.lines))]], True)
    best, at, order = model.SolveFromAssignmentWithParameters(ours, search), model.Start(0), list[Segment]()
    while not model.IsEnd(at := best.Value(model.NextVar(at))):
        order.append(both[nodes.IndexToNode(at)])
    return order


def main(seconds: int) -> None:
    kept = dict[str, float]()
    for seed in SEEDS:
        plan = survey_of(seed)
        order = found(plan, seconds)
        if len(order) != len(plan.lines):
            raise SystemExit(f"area {seed}: {len(order)} of {len(plan.lines)} lines")
        kept[str(seed)] = round(whole_m(plan, order), 1)
        print(f"area {seed}: {len(order)} lines, ours {whole_m(plan, plan.lines) / kept[str(seed)]:.4f}", flush=True)
    KEPT.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else SEARCH_S)
