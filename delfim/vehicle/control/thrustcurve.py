"""The force of a thruster to its command and back, for a boat at rest in the water.

A command is a fraction, -1 full astern to 1 full ahead. Its force is a law, which a motor's maker or a bollard pull gives, or a
table that somebody measured. Both are monotonic, and each has an end of its own ahead and astern.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

LEAST: Final = 1e-4  # of the largest force: less is no command, so that a motor with a deadband does not start for nothing


class Curve(Protocol):
    """The curve of a thruster. Neither method raises for any float; NaN stays NaN, and the last gate refuses it."""

    @property
    def astern_n(self) -> float: ...  # force of the command -1, zero or negative
    @property
    def ahead_n(self) -> float: ...  # force of the command 1, zero or positive
    def command(self, force_n: float) -> float: ...  # -1..1; a force beyond the ends is the end
    def force(self, command: float) -> float: ...  # N; a command beyond -1..1 is the end


class Law(NamedTuple):
    """force = end ((|c| - dead) / (1 - dead))^power. `power` is 2 where the motor keeps its revolutions (thrust goes with n|n|:
    thesis 2.13), about 1.5 where the command is a voltage or a duty, and 1 where it is a force. Commands within `dead` do
    nothing."""

    astern_n: float
    ahead_n: float
    power: float = 2.0
    dead: float = 0.0

    def command(self, force_n: float) -> float:
        astern_n, ahead_n, power, dead = self
        end_n = ahead_n if force_n > 0.0 else astern_n
        share = force_n / end_n if end_n else 0.0
        if share < LEAST:
            return 0.0
        if share > 1.0:
            share = 1.0
        size = dead + (1.0 - dead) * (math.sqrt(share) if power == 2.0 else math.pow(share, 1.0 / power))
        return size if force_n > 0.0 else -size

    def force(self, command: float) -> float:
        share = (abs(command) - self.dead) / (1.0 - self.dead)
        if share <= 0.0:
            return 0.0
        end_n = self.ahead_n if command > 0.0 else self.astern_n
        return end_n * math.pow(min(share, 1.0), self.power)


class Points:
    """A table of (command, N), rising, through (0, 0); straight lines between its points. Two points of one command are a step:
    the force that an engine in gear gives at least, its idle. Of the forces within that step the lower half is nothing."""

    __slots__ = ("_ahead", "_astern", "ahead_n", "astern_n")

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        """A table as `ThrusterTable.curve` of the vehicle's file allows it."""
        self._ahead = _branch([(c, f) for c, f in points if c >= 0.0])
        self._astern = _branch([(-c, -f) for c, f in reversed(points) if c <= 0.0])
        self.ahead_n, self.astern_n = self._ahead[1][-1], -self._astern[1][-1]

    def command(self, force_n: float) -> float:
        if force_n != force_n:
            return force_n
        return _command(*self._ahead, force_n) if force_n > 0.0 else -_command(*self._astern, -force_n)

    def force(self, command: float) -> float:
        if command != command:
            return command
        return _force(*self._ahead, command) if command > 0.0 else -_force(*self._astern, -command)


def _branch(points: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Commands and forces of one direction, from the last command that gives nothing to the first that gives most."""
    first = max(i for i, (_, f) in enumerate(points) if f == 0.0)
    last = min(i for i, (_, f) in enumerate(points) if f == points[-1][1])
    kept = points[first : last + 1] or points[first : first + 1]
    return [c for c, _ in kept], [f for _, f in kept]


def _command(commands: list[float], forces: list[float], force_n: float) -> float:
    if force_n < LEAST * forces[-1] or len(forces) == 1:
        return 0.0
    if force_n >= forces[-1]:
        return commands[-1]
    after = bisect_right(forces, force_n)
    low, high = commands[after - 1], commands[after]
    if low == high:
        return 0.0 if after == 1 and force_n < 0.5 * forces[1] else high
    return low + (high - low) * (force_n - forces[after - 1]) / (forces[after] - forces[after - 1])


def _force(commands: list[float], forces: list[float], command: float) -> float:
    after = bisect_right(commands, command)  # of a step the outer end
    if after == 0:
        return 0.0
    if after == len(commands):
        return forces[-1]
    low, high = commands[after - 1], commands[after]
    return forces[after - 1] + (forces[after] - forces[after - 1]) * (command - low) / (high - low)
