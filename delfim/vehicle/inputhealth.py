"""The estimator's inputs, each judged by itself: silent, frozen, jumping. Its output hides all three (docs/estimator.md).

The times are monotonic. An input that was never heard is nobody's trouble: a mode that needs it is refused. Position alone must
be there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

NEVER_S: Final = -1e9
MOVING_MPS: Final = 0.5  # a receiver may hold its position still while it says that it moves slower than this
TURNING_RADPS: Final = math.radians(2.0)  # the same for a compass, by its gyro
POSITION, VELOCITY, HEADING, RATE = KINDS = "position", "velocity", "heading", "rate"


@dataclass(slots=True)
class InputHealth:
    """An input of the estimator."""

    name: str  # of KINDS
    heard_s: float = NEVER_S  # its last value
    changed_s: float = NEVER_S  # the last one that differed from the one before
    used_s: float = NEVER_S  # the last one that the estimator used
    jumping_s: float = NEVER_S  # the first of the present run of jumps ...
    jumped_s: float = NEVER_S  # ... and the last one
    jump: float = 0.0  # how far that was from the estimate, in m, m/s or rad
    heard: int = 0  # values
    refused: int = 0  # of these
    value: tuple[float, ...] = ()  # the last one: (latitude, longitude), (north, east), (heading,) or (rate,), rad and m/s

    def hear(self, value: tuple[float, ...], at_s: float) -> None:
        """Note a value that came."""
        if value != self.value:
            self.changed_s, self.value = at_s, value
        self.heard_s = at_s
        self.heard += 1

    def jumped(self, by: float, at_s: float, stale_s: float) -> None:
        """Note a value that is too far from the estimate; the first one after `stale_s` without begins a run."""
        if at_s - self.jumped_s > stale_s:
            self.jumping_s = at_s
        self.jumped_s, self.jump = at_s, by

    def is_dead(self, now_s: float, limit_s: float) -> bool:
        """Silent or frozen."""
        return now_s - self.changed_s > limit_s


def silent(inputs: Sequence[InputHealth], now_s: float, after_s: float) -> str | None:
    """Which of position and heading is silent for longer than `after_s`, in words."""
    for each in inputs:
        age_s = now_s - each.heard_s
        if age_s > after_s and (each.name == POSITION or (each.name == HEADING and each.heard)):
            return f"{each.name} silent for {age_s:.1f} s" if each.heard else f"no {each.name} yet"
    return None


def frozen(inputs: Sequence[InputHealth], now_s: float, after_s: float) -> str | None:
    """Which of position and heading repeats its value for longer than `after_s` while the boat moves, in words. Their partners
    velocity and rate say whether it does; one that is dead itself is no witness, and the propellers turn."""
    if not inputs:
        return None
    position, velocity, heading, rate = inputs
    for each, partner, moving in ((position, velocity, MOVING_MPS), (heading, rate, TURNING_RADPS)):
        age_s = now_s - each.changed_s
        if not each.heard or now_s - each.heard_s > after_s or age_s <= after_s:
            continue
        if partner.is_dead(now_s, after_s) or math.hypot(*partner.value) > moving:
            return f"{each.name} frozen for {age_s:.1f} s"
    return None


def jumping(inputs: Sequence[InputHealth], now_s: float, after_s: float, stale_s: float) -> str | None:
    """Which of position and heading has jumped for at least `after_s`, in words."""
    for each in inputs:
        lasts = each.jumped_s - each.jumping_s >= after_s and now_s - each.jumped_s <= stale_s
        if lasts and each.name in (POSITION, HEADING):
            by = f"{each.jump:.0f} m" if each.name == POSITION else f"{math.degrees(each.jump):.0f} degrees"
            return f"{each.name} jumped by {by}"
    return None


def in_words(inputs: Sequence[InputHealth], now_s: float, stale_s: float, frozen_s: float) -> str:
    """The inputs that are not used now although they once were heard, and why; empty: all is well."""
    told = []
    for each in inputs:
        if each.heard and now_s - each.heard_s > stale_s:
            told.append(f"{each.name} silent for {now_s - each.heard_s:.0f} s")
        elif each.heard and each.name in (VELOCITY, RATE) and now_s - each.changed_s > frozen_s:
            told.append(f"{each.name} frozen for {now_s - each.changed_s:.0f} s")
        elif each.heard and now_s - each.used_s > stale_s:
            told.append(f"{each.name} refused for {now_s - max(each.used_s, 0.0):.0f} s")
    return ", ".join(told)
