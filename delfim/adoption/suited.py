"""Which boats can be adopted: those with a motor at each side, or with one that steers."""

from collections.abc import Sequence
from typing import Final

from delfim.config import ThrusterTable

TURNED_DEG: Final = 60.0  # by which a motor that is found steers, at most
BY_HAND: Final = "try each motor by hand (docs/bench.md), and write [adopted] proven = true"  # for boats that are unfit


def parts_told(rows: Sequence[ThrusterTable]) -> int:
    """How many numbers a boat is told in a trial: a part for each row, and one for each that turns."""
    return len(rows) + sum(row.steer is not None for row in rows)


def unfit(rows: Sequence[ThrusterTable]) -> str:
    """Why the motors of a boat cannot be found in this way, in words; empty: they can."""
    if len(rows) == 1:
        steer = rows[0].steer
        if steer is None or steer.angle_max_deg > TURNED_DEG or rows[0].angle_deg % 360.0 or not rows[0].x_m:
            return f"its thruster is not one before or behind the middle that turns by up to {TURNED_DEG:.0f} degrees"
        return ""
    if len(rows) != 2:
        return f"it has {len(rows)} thrusters; two that push ahead are found, one at each side, or one that steers"
    if any(row.steer is not None or row.angle_deg % 360.0 for row in rows):
        return "one of its thrusters turns or does not point ahead; two that push ahead are found, one at each side"
    return "" if rows[0].y_m * rows[1].y_m < 0.0 else "its two thrusters are not at two sides"
