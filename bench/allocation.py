"""`python -m bench allocation`: the cost of one allocation, for boats with two to eight fixed thrusters and for some that turn.

Processor time of this thread. A saturated request is random, up to 80 % of the sum of all thrusters in each direction at once,
which most boats cannot give. The slowest requests are asked again, and count with the best of these repetitions: what disturbed
the first is not their own.
"""

import argparse
import gc
import heapq
import json
import math
import random
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from delfim.vehicle.control.allocation import Allocation, Thruster
from delfim.vehicle.control.pivot import Pivot
from delfim.vehicle.control.thrustcurve import Law

SLOWEST: Final = 40  # of a boat's requests, that are asked again ...
AGAIN: Final = 50  # ... this often
MILLION: Final = 1_000_000
D: Final = math.pi / 180.0

FOUR: Final = tuple(
    Thruster(x, y, a * D, Law(-100.0, 250.0))
    for x, y, a in ((-2.0, 1.0, -45), (-2.0, -1.0, 45), (2.0, 1.0, 45), (2.0, -1.0, -45))
)
EIGHT: Final = tuple(
    Thruster(x, y, a * D, Law(-40.0, 51.0))
    for x, y, a in (
        *((-1.0, 0.5, -45), (-1.0, -0.5, 45), (1.0, 0.5, 45), (1.0, -0.5, -45)),
        *((-1.0, 0.2, 0), (-1.0, -0.2, 0), (0.9, 0.0, 90), (-0.9, 0.0, 90)),
    )
)
BOATS: Final[dict[str, Sequence[Thruster]]] = {
    "two propellers": tuple(Thruster(-2.0, y, 0.0, Law(-319.0, 532.0)) for y in (1.029, -1.029)),
    "four at 45 degrees": FOUR,
    "eight": EIGHT,
    "steered outboard": (Thruster(-1.9, 0.0, 0.0, Law(-300.0, 800.0), Pivot(35 * D, 20 * D)),),
    "two azimuth thrusters": tuple(Thruster(x, 0.0, 0.0, Law(0.0, 100.0), Pivot(math.pi, 1.0)) for x in (2.0, -2.0)),
}


class Figure(NamedTuple):
    """One boat's cost, us."""

    name: str
    met_us: float  # of a request that is met: median
    saturated_us: float  # of a saturated one: median
    worst_us: float


def run(asked: argparse.Namespace) -> int:
    """The command."""
    gc.disable()  # as in the runtime, which collects when it has time
    figures = measured(2000 if asked.quick else MILLION)
    gc.enable()
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / "allocation.json").write_text(json.dumps([figure._asdict() for figure in figures], indent=1) + "\n")
    print(f"{'one allocation':24}   met: median   saturated: median     worst")
    for name, met_us, saturated_us, worst_us in figures:
        print(f"{name:24} {met_us:10.1f} us {saturated_us:16.1f} us {worst_us:7.1f} us")
    print(f"{output}/allocation.json")
    return 0


def measured(requests: int = MILLION) -> list[Figure]:
    """`requests`: random ones, in all; the boats share them."""
    return [_measured(name, boat, requests // len(BOATS)) for name, boat in BOATS.items()]


def _measured(name: str, boat: Sequence[Thruster], requests: int) -> Figure:
    allocation, angles, rnd = Allocation(boat), [0.0] * len(boat), random.Random(16)
    most_n = 0.8 * sum(t.curve.ahead_n for t in boat)
    most_nm = most_n * max(math.hypot(t.x_m, t.y_m) for t in boat)
    small = 0.1 * most_n, 0.0, 0.1 * allocation.yaw_nm
    all_us, slowest = [], list[tuple[float, tuple[float, float, float]]]()
    for _ in range(requests):
        request = rnd.uniform(-most_n, most_n), rnd.uniform(-most_n, most_n), rnd.uniform(-most_nm, most_nm)
        took_us = _us(allocation, request, angles)
        all_us.append(took_us)
        if len(slowest) < SLOWEST:
            heapq.heappush(slowest, (took_us, request))
        elif took_us > slowest[0][0]:
            heapq.heapreplace(slowest, (took_us, request))
    worst_us = max(min(_us(allocation, request, angles) for _ in range(AGAIN)) for _, request in slowest)
    return Figure(
        name, median(_us(allocation, small, angles) for _ in range(1000)), median(all_us), max(worst_us, median(all_us))
    )


def _us(allocation: Allocation, request: tuple[float, float, float], angles: Sequence[float]) -> float:
    began_ns = time.thread_time_ns()
    allocation.allocate(*request, angles, 0.2)
    return (time.thread_time_ns() - began_ns) / 1e3
