"""What an inertial navigation system tells, whatever its protocol."""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from delfim.lines.binaryframes import Framing

RECKONED: Final = 2  # as `Navigation.fix`, of a position without a fix of the receiver: the system reckons on for a while

# By kind, None where the device says that it does not know: position (latitude, longitude; rad), accuracy (of the position in
# the plane, m), velocity (north, east; m/s), heading (true, rad), deviation (of the heading, rad), rate (to starboard, rad/s),
# attitude (roll, pitch; rad), receiver (fix as in `Navigation`, satellites), time (UTC since 1970, ns).
Readings = dict[str, tuple[float, ...] | None]


class InsState(NamedTuple):
    """All that a played device tells at one instant, in the units of `Readings`."""

    utc_ns: int
    position: tuple[float, float]
    accuracy_m: float
    velocity: tuple[float, float]
    heading_rad: float
    deviation_rad: float
    rate_radps: float
    attitude: tuple[float, float]
    fix: int  # of its receiver, as in `Navigation`
    satellites: int


class Language(NamedTuple):
    """A maker's protocol."""

    framing: Framing
    read: Callable[[bytes], Readings]  # of a whole frame; empty: it is of something else. Raises FormatError
    told: Callable[[InsState], bytes]  # as the device tells it


def degrees(*angles_rad: float) -> tuple[float, ...]:
    return tuple(map(math.degrees, angles_rad))


def radians(*angles_deg: float) -> tuple[float, ...]:
    return tuple(map(math.radians, angles_deg))
