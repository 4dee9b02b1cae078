"""The time when a node sends next, and whether a reset is addressed to it."""

import math
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.canproxy.dsor.messages import Node, unpack_reset

TOLERANCE_S: Final = 1e-6  # sums of tenths are never exact
RESTART_S: Final = 1.0  # duration of a node's restart, in which it is silent


def patience_s(silent_s: float, settings: config.Vehicle) -> float:
    """The time-out of a device that a boat in lock step speaks to once in a navigation cycle only."""
    return max(silent_s, 1.2 / settings.navigation.rate_hz)


class Period:
    """A period: due at once, then each `period_s`. Missed periods are skipped and the phase is kept."""

    __slots__ = ("_period_s", "due_s")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.due_s = -math.inf

    def reset(self, data: bytes, node: Node, now_s: float) -> None:
        """Be silent for the time of a restart, if a reset is addressed to this node. Other frames change nothing."""
        try:
            number = unpack_reset(data)
        except FormatError:
            return
        if number in (node, Node.BROADCAST):
            self.due_s = now_s + RESTART_S

    def passed(self, now_s: float) -> bool:
        late_s = now_s - self.due_s + TOLERANCE_S
        if late_s < 0.0:
            return False
        if late_s == math.inf:
            self.due_s = now_s + self._period_s
        else:
            self.due_s += (late_s // self._period_s + 1.0) * self._period_s
        return True
