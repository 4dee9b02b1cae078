"""Finding out which way a motor that steers pushes, and which way it turns the boat, by a rudder or as a whole. Pure.

With what turns it in the middle the motor goes ahead and astern: the speed along the keel says which way it pushes. Then it
pushes ahead, with its angle to one side and to the other: the rate of turn says to which side that turns the boat. Where two
tries do not agree there is no clear answer. To prove it she is steered to headings on both sides by what was found.
"""

from typing import Final

from delfim.adoption.trial.motors import (
    AHEAD_MPS,
    AHEAD_NOISES,
    LEAST_PART,
    LEVELS,
    TURN_NOISES,
    TURN_RADPS,
    Doublet,
    DriftNoise,
    Finding,
    MotorsFound,
    agreeing,
    beyond,
    hold_s,
)

SHARE: Final = 0.7  # of the greatest angle, to find out what it does
PUSH: Final = 0.25  # of full command: without it nothing turns the boat


def finding(length_m: float, quiet: DriftNoise) -> Finding:
    """Ask for one doublet after the other, and take its answer; returns what was found."""
    held_s = hold_s(length_m) + 0.5
    ahead_mps = max(AHEAD_MPS, AHEAD_NOISES * quiet.ahead_mps)
    pushes = yield from agreeing(lambda level: Doublet((level, 0.0), held_s, (-level, 0.0)), 1, ahead_mps, LEVELS)
    if isinstance(pushes, str):
        return f"the motor: {pushes}"
    levels = tuple(level for level in LEVELS if level >= max(pushes.level, PUSH))
    turn_radps, sign = max(TURN_RADPS, TURN_NOISES * quiet.turn_radps), pushes.sign
    turns = yield from agreeing(
        lambda level: Doublet((sign * level, SHARE), held_s, (sign * level, -SHARE)), 0, turn_radps, levels
    )
    if isinstance(turns, str):
        return f"what turns the motor: {turns}"
    return MotorsFound((turns.sign,), (sign,), (pushes.level,))


def mix(found: MotorsFound, surge: float, turn: float) -> tuple[float, float]:
    """The parts of motor and angle for a push ahead and a turn to starboard: without a push there is none."""
    turn = max(-1.0, min(1.0, turn))
    part = surge if abs(turn) < LEAST_PART else max(surge, PUSH * min(2.0 * abs(turn), 1.0))
    return found.signs[0] * beyond(max(-1.0, min(1.0, part)), found.least[0]), found.sides[0] * turn
