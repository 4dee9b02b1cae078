"""Whether anybody could have stayed clear: ships of 90 m at 6 m/s that turn late, and all ways that a boat of 1.5 m/s has left.

    python -m bench.escapes [--seeds 2] [--lost] [--only 3]

From where the guard's boat is at a moment on, the places that some way reaches without a domain are kept as a grid, each
twelve seconds. The ways are those of a point that turns at once, a tenth faster than the boat, and a square is struck out only
where all of it is in a domain: where none is left, no boat could have stayed clear. Where one is left, it may be.
"""

import argparse
import math
from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped]

from delfim.simulator.nodes.other_vessels import axes_m
from tests.parts.traffic.encounters import LIMITS, ClassB, Instant, Ship, encounters, late, place, sail, turning

OWN_MPS: Final = 1.5
CELL_M: Final = 2.0
STEP_S: Final = 12.0  # in which the boat sails nine squares
AFTER_S: Final = 300.0
SMALL: Final = LIMITS._replace(stand_on="small")
Squares = NDArray[np.bool_]


class Sailing(Protocol):
    """A ship, at any time."""

    def at(self, t_s: float) -> Ship:
        """Where it is then."""


def escapes(begin: Instant, ships: Sequence[Sailing], own_mps: float = OWN_MPS) -> bool:
    """Whether some way from here stays out of all domains for five minutes."""
    squares_a_step = round(own_mps * STEP_S / CELL_M) + 1  # one more, because squares are coarse
    middle = squares_a_step * round(AFTER_S / STEP_S)
    squares = 2 * middle + 1
    steps = (np.arange(squares) - middle) * CELL_M
    north_m, east_m = np.meshgrid(begin.own.north_m + steps, begin.own.east_m + steps, indexing="ij")
    there = np.zeros((squares, squares), dtype=bool)
    there[middle, middle] = True
    for tick in range(1, round(AFTER_S / STEP_S) + 1):
        there = spread(there, squares_a_step)
        for ship in ships:
            there &= ~taken(ship, begin.t_s + tick * STEP_S, north_m, east_m)
        if not there.any():
            return False
    return True


def spread(there: Squares, squares: int) -> Squares:
    """All that is so many squares from these, or less."""
    found: Squares = distance_transform_edt(~there) <= squares
    return found


def taken(ship: Sailing, t_s: float, north_m: NDArray[np.float64], east_m: NDArray[np.float64]) -> Squares:
    """The squares of which all is in the domain of a ship then."""
    at = ship.at(t_s)
    along_m, across_m = axes_m(at.length_m)
    c, s = math.cos(at.course_rad), math.sin(at.course_rad)
    n, e = north_m - at.north_m, east_m - at.east_m
    inner = np.hypot((n * c + e * s) / (along_m - CELL_M), (e * c - n * s) / (across_m - CELL_M))
    inside: Squares = inner < 1.0
    return inside


def last_way_out_s(log: Sequence[Instant], ships: Sequence[Ship], entered_s: float) -> float:
    """The last time, within 5 s, at which a way out was left, before a domain was entered."""
    sure_s, lost_s = 0.0, entered_s
    while lost_s - sure_s > 5.0:
        at_s = (sure_s + lost_s) / 2.0
        sure_s, lost_s = (at_s, lost_s) if escapes(log[int(at_s)], ships) else (sure_s, at_s)
    return sure_s


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--lost", action="store_true", help="by class B, of which a fifth is lost, instead of perfect reports")
    parser.add_argument("--only", type=int, help="this encounter of the 22")
    asked = parser.parse_args()
    for manner in (late, turning):
        sailed = entered = lost = 0
        for seed in range(asked.seeds):
            for i, (title, kept) in enumerate(encounters("imazu22-real")):
                if asked.only not in (None, i + 1):
                    continue
                ships = manner(kept, i + 22 * seed)
                log = sail(ships, SMALL, see=ClassB(i + 22 * seed)) if asked.lost else sail(ships, SMALL)
                sailed += 1
                bad = [now.t_s for now in log if any(place(now.own, ship)[0] < 1.0 for ship in now.ships)]
                if not bad:
                    continue
                entered += 1
                turned_s = max(each.turns_s for each in ships if each.turns_s < bad[0])
                is_lost = bad[0] <= turned_s + 1.0 or not escapes(log[int(turned_s) + 1], ships)
                lost += is_lost
                out_s = last_way_out_s(log, ships, bad[0])
                words = "no way was left" if is_lost else "a way was left"
                told = f"{title}, seed {seed}: entered at {bad[0]:.0f} s, the last turn at {turned_s:.0f} s: {words}"
                print(f"{manner.__name__} {told}; the last way out at {out_s:.0f} s", flush=True)
        print(
            f"{manner.__name__}: {sailed} sailed, a domain entered in {entered}, in {lost} of these no way was left at the turn"
        )


if __name__ == "__main__":
    main()
