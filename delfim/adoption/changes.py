"""What is not as the vehicle's file says, and what a record did not show, in words for people."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from delfim.adoption.figures import SPEEDS, TOO_WINDY, Figure, quickest_turn_dps
from delfim.adoption.fitting import Fit
from delfim.adoption.model import plain
from delfim.adoption.suited import ASIDE_MOST

SURE: Final = 2.0  # deviations from what the file says, from which on something has changed ...
CHANGED: Final = 0.12  # ... by this part of it, or more
WEAKER: Final = 0.08  # of a motor against the other one
ALIKE: Final = 0.1  # thrust and drag that differ from the file by the same part, within this: it is the mass
ASKEW_DEG: Final = 3.0  # of what turns a motor: wind does some of it
LATER: Final = 0.05  # of full command, of a dead band
SLOW_MPS: Final = 0.5  # where drags are compared
SELDOM: Final = 0.005  # of the time


def changes(fit: Fit) -> Iterator[str]:
    """What is surely not as the file has it, each with what may be the reason."""
    was, now = plain(fit.prior.told), fit.values
    thrust = _differs(now["ahead"], was["ahead"], fit.relative("ahead"))
    drag_was, drag_now = (each["surge"] + each["surge2"] * SLOW_MPS for each in (was, now))
    unsure = math.hypot(now["surge"] * fit.relative("surge"), now["surge2"] * SLOW_MPS * fit.relative("surge2"))
    drag = _differs(drag_now, drag_was, unsure / drag_now)
    if thrust and drag and abs(thrust - drag) < ALIKE:
        by, kind = abs(1.0 / (1.0 + thrust) - 1.0), "heavier" if thrust < 0.0 else "lighter"
        yield f"about {by:.0%} {kind} than by the file, if motors and hull are the same: payload?"
    else:
        yield from _told("drag at 0.5 m/s", drag, "a fouled hull, or more draught?", "a cleaner hull, or less draught?")
        weak = "damaged propellers, weed, a low battery, or a heavier boat?"
        yield from _told("push of the motors", thrust, "stronger motors, or a lighter boat?", weak)
    uneven = now["ahead_uneven"] - was["ahead_uneven"]
    if abs(uneven) > max(WEAKER, SURE * fit.relative("ahead_uneven")):
        weaker, other = ("starboard", "port") if uneven < 0.0 else ("port", "starboard")
        by = 1.0 - math.exp(-abs(uneven))
        push, one = ("motors push", "ones") if fit.windows.has_pairs else ("motor pushes", "one")
        yield f"the {weaker} {push} {by:.0%} less against the {other} {one} than by the file: weed, or a damaged propeller?"
    if fit.windows.pushes_aside:
        across = _differs(now["across"], was["across"], fit.relative("across"))
        yield from _told("push of what pushes aside, against the other motors", across, "weed on the others?", "weed?")
    turning = _differs(was["arm"], now["arm"], fit.relative("arm"))
    yield from _told("inertia of a turn", turning, "weight at the ends?", "weight in the middle?")
    steers = fit.windows.gear is not None
    off_deg = math.degrees(now["straight"] - was["straight"])
    if steers and abs(off_deg) > max(ASKEW_DEG, SURE * math.degrees(fit.relative("straight"))):
        yield f"she goes straight with what turns the motor at {off_deg:+.0f} degrees"
    for side in ("starboard",) if steers else ("starboard", "port"):
        begins, told = now[f"dead_{side}"], was[f"dead_{side}"]
        if abs(begins - told) > max(LATER, SURE * fit.relative(f"dead_{side}")):
            motor = "motor" if steers else f"{side} motor"
            yield f"the {motor} begins to push at {begins:.0%} of command, not at {told:.0%}"


def _differs(found: float, told: float, relative: float) -> float:
    """The part by which something differs surely from what the file told; 0: it does not, or nobody knows."""
    by = found / told - 1.0
    return by if abs(by) > max(CHANGED, SURE * relative) else 0.0


def _told(what: str, by: float, more: str, less: str) -> Iterator[str]:
    if by:
        yield f"{what}: {abs(by):.0%} {'more' if by > 0.0 else 'less'} than by the file: {more if by > 0.0 else less}"


def unseen(fit: Fit, told: dict[str, Figure]) -> Iterator[str]:
    """What the record does not show, and why."""
    missing, commands = set(fit.unseen), fit.windows.sides[:, fit.windows.back :]
    if {"astern", "astern_uneven"} & missing:
        never = float((commands < 0.0).mean()) < SELDOM
        yield f"thrust astern: the motors {'never' if never else 'hardly'} ran astern"
    if {"surge", "surge2", "loss", "power"} & missing:
        yield "drag and thrust apart: the speed changed too little; sail slow, half and full, and let her coast"
    if fit.windows.has_pairs:
        yield "unequal thrust of the motors at one side: they are seen together, and each keeps its share by the file"
    if fit.windows.pushes_aside and "across" in missing:
        yield "what pushes aside alone: it hardly ran"
    if any(row.side and abs(row.aside) > ASIDE_MOST for row in fit.windows.rows):
        yield "compass: her thrusters push across, and unequal ones make leeway, which looks like a compass that is off"
    if {"sway", "sway2", "sway_ahead", "surge_turning", "sway_turning", "munk"} & missing:
        yield "leeway: she turned too little at speed"
    if {"yaw", "yaw2", "yaw_ahead", "arm"} & missing:
        yield "turning: the motors differed too little, or at one speed alone"
    if {"hard_ahead", "hard_aside", "soft_along", "soft_across", "compass_offset"} & missing:
        yield "compass: not all headings were sailed"
    if told["full_mps"].is_beyond:
        fastest = float(np.nanmax(np.abs(fit.windows.measured[..., :2])))
        yield f"full speed: she sailed {fastest:.1f} m/s at most; it is extrapolated"
    if told["turn_dps"].is_beyond or told["spin_dps"].is_beyond:
        yield f"quick turns: she turned by {quickest_turn_dps(fit):.0f} deg/s at most; quicker ones are extrapolated"
    windy = [each for name, each in told.items() if name in SPEEDS and each.spread > TOO_WINDY * each.found]
    if windy:
        slowest = min(windy, key=lambda each: each.found)
        yield f"{slowest.words}: too much wind or waves for slow speeds: fit a calm day"
    yield "wind: its areas are the file's guess, as leeway and current are one within minutes"
