"""The states of an alert, as IEC 62923-1 names them: a pure function of the state and of what happens.

An emergency, an alarm and a warning leave only once somebody has taken note of them; a caution comes and goes with its cause.
"""

from enum import Enum, IntEnum
from typing import Final


class Priority(IntEnum):
    """The gravest first."""

    EMERGENCY = 0  # its sound cannot be silenced: only to acknowledge it ends that
    ALARM = 1
    WARNING = 2
    CAUTION = 3  # to know, not to be acknowledged


class AlertState(Enum):
    NORMAL = "normal"  # over: it is in the history
    UNACKNOWLEDGED = "unacknowledged"
    SILENCED = "silenced"  # for a while; nobody has taken note of it
    ACKNOWLEDGED = "acknowledged"  # its cause lasts; a caution has no other state
    TRANSFERRED = "transferred"  # whoever took over the command answers for it; its cause lasts
    RECTIFIED = "rectified"  # its cause is over, and nobody has taken note of it


class Happening(Enum):
    BEGINS = "begins"  # for the first time, again, or graver
    ENDS = "ends"  # its cause
    ACKNOWLEDGED = "acknowledged"
    SILENCED = "silenced"
    LOUD = "loud"  # the time of its silence is over
    TRANSFERRED = "transferred"
    RETURNED = "returned"  # nobody answers for it any more


UNSEEN: Final = frozenset({AlertState.UNACKNOWLEDGED, AlertState.SILENCED, AlertState.RECTIFIED})
_LASTING: Final = frozenset({AlertState.UNACKNOWLEDGED, AlertState.SILENCED, AlertState.ACKNOWLEDGED})
_NEXT: Final = {
    **{(state, Happening.BEGINS): AlertState.UNACKNOWLEDGED for state in AlertState},
    (AlertState.UNACKNOWLEDGED, Happening.ENDS): AlertState.RECTIFIED,
    (AlertState.SILENCED, Happening.ENDS): AlertState.RECTIFIED,
    (AlertState.ACKNOWLEDGED, Happening.ENDS): AlertState.NORMAL,
    (AlertState.TRANSFERRED, Happening.ENDS): AlertState.NORMAL,
    (AlertState.UNACKNOWLEDGED, Happening.ACKNOWLEDGED): AlertState.ACKNOWLEDGED,
    (AlertState.SILENCED, Happening.ACKNOWLEDGED): AlertState.ACKNOWLEDGED,
    (AlertState.RECTIFIED, Happening.ACKNOWLEDGED): AlertState.NORMAL,
    (AlertState.UNACKNOWLEDGED, Happening.SILENCED): AlertState.SILENCED,
    (AlertState.SILENCED, Happening.LOUD): AlertState.UNACKNOWLEDGED,
    **{(state, Happening.TRANSFERRED): AlertState.TRANSFERRED for state in _LASTING},
    (AlertState.TRANSFERRED, Happening.RETURNED): AlertState.UNACKNOWLEDGED,
}


def after(state: AlertState, happening: Happening, priority: Priority) -> AlertState:
    """The next state; the same one where nothing follows from what happens."""
    if priority is Priority.CAUTION:
        ways = {Happening.BEGINS: AlertState.ACKNOWLEDGED, Happening.ENDS: AlertState.NORMAL}
        return ways.get(happening, state)
    if priority is Priority.EMERGENCY and happening is Happening.SILENCED:
        return state
    return _NEXT.get((state, happening), state)
