"""Which boats can be adopted: those with a motor at each side, with one that steers, or with three or four that are fixed."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim.config import ThrusterTable

TURNED_DEG: Final = 60.0  # by which a motor that is found steers, at most
BY_HAND: Final = "try each motor by hand (docs/bench.md), and write [adopted] proven = true"  # for boats that are unfit
SEVERAL, MOST = 3, 4  # fixed thrusters that are found by what each does to the boat
AHEAD_LEAST: Final = 0.3  # of its push, that goes ahead or astern: with less it pushes aside alone
ARM_LEAST: Final = 0.25  # of the longest lever arm: who turns the boat less is not found by her turns
ASIDE_MOST: Final = 0.1  # of the push ahead of those at one side, that goes aside


class ThrusterPlace(NamedTuple):
    """What a thruster does to the boat where it stands: a newton of it, along its angle."""

    turn_m: float  # moment, positive to starboard
    ahead: float
    aside: float

    @property
    def way(self) -> int:
        """How it pushes ahead: 1 by a positive command, -1 by a negative one; 0: it does not."""
        return 0 if abs(self.ahead) < AHEAD_LEAST else 1 if self.ahead > 0.0 else -1

    @property
    def side(self) -> int:
        """1: it turns the boat to port as it pushes ahead (or, without that, along its angle), as one at starboard does; -1."""
        return -1 if self.turn_m * (self.way or 1) > 0.0 else 1


def place_of(row: ThrusterTable) -> ThrusterPlace:
    c, s = math.cos(math.radians(row.angle_deg)), math.sin(math.radians(row.angle_deg))
    return ThrusterPlace(row.x_m * s - row.y_m * c, c, s)


def is_several(rows: Sequence[ThrusterTable]) -> bool:
    """Whether the boat is one of three or more thrusters."""
    return len(rows) >= SEVERAL


def at_side(rows: Sequence[ThrusterTable], side: int) -> tuple[int, ...]:
    """The thrusters that push ahead at one side (1 starboard, -1 port), which a trial commands alike."""
    every = [place_of(row) for row in rows]
    return tuple(index for index, its in enumerate(every) if its.way and its.side == side)


def along_n(row: ThrusterTable) -> float:
    """Its push ahead at full command, N: less than all of it, where it points aside."""
    its, (low, high) = place_of(row), row.ends_n
    return abs(its.ahead) * (high if its.way > 0 else -low)


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
    if is_several(rows):
        return _several_unfit(rows)
    if any(row.steer is not None or row.angle_deg % 360.0 for row in rows):
        return "one of its thrusters turns or does not point ahead; two that push ahead are found, one at each side"
    return "" if rows[0].y_m * rows[1].y_m < 0.0 else "its two thrusters are not at two sides"


def hull_unfit(rows: Sequence[ThrusterTable]) -> str:
    """Why the hull of a boat whose motors are found cannot be, in words; empty: it can."""
    if is_several(rows) and any(its.way and abs(its.aside) > ASIDE_MOST for its in map(place_of, rows)):
        return "her thrusters push across, and unequal ones make leeway, which a fit would take for a compass that is off"
    return ""


def _several_unfit(rows: Sequence[ThrusterTable]) -> str:
    if len(rows) > MOST:
        return f"it has {len(rows)} thrusters; {MOST} are found at most"
    if turning := [row.name for row in rows if row.steer is not None]:
        return f"{turning[0]} turns; of {len(rows)} thrusters those are found that are fixed"
    arms_m = [abs(place_of(row).turn_m) for row in rows]
    if min(arms_m) < ARM_LEAST * max(arms_m):
        name = rows[arms_m.index(min(arms_m))].name
        return f"{name} hardly turns the boat by itself: of {len(rows)} thrusters those are found that do, by her turns"
    for side, words in ((1, "starboard"), (-1, "port")):
        its = at_side(rows, side)
        if not its:
            return f"none of its thrusters pushes ahead at {words}"
        aside = sum(
            along_n(rows[at]) * place_of(rows[at]).aside / abs(place_of(rows[at]).ahead) * place_of(rows[at]).way for at in its
        )
        if abs(aside) > ASIDE_MOST * sum(along_n(rows[at]) for at in its):
            return f"its thrusters at {words} push her aside as they push ahead"
    return ""
