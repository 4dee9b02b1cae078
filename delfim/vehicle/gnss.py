"""Quality of satellite navigation: kind of fix, satellites in use, dilution of precision; in words, and against limits."""

from typing import Final, get_args

from delfim import config
from delfim.messages import Navigation

FIXES: Final = {0: "no fix", 2: "2D", 3: "3D", 4: "differential", 5: "RTK", 6: "RTK float"}  # names of Navigation.fix
_ORDER: Final = (2, 3, 4, 6, 5)  # in the order of the limit's names
_LIMITS: Final = get_args(config.FixName)


def in_words(fix: int, satellites: int, hdop: float | None) -> str:
    """Where nobody tells the quality there are 0 satellites and no dilution."""
    if not satellites and hdop is None:
        return "quality of satellite navigation not told"
    dilution = f", HDOP {hdop:.1f}" if hdop is not None else ""
    return f"{FIXES.get(fix, 'unknown fix')}, {satellites} satellites{dilution}"


def poor(limits: config.GnssPoor, n: Navigation | None) -> str | None:
    """In which way satellite navigation is worse than its limits. Not known is not bad."""
    if n is None or not n.fix or not (n.satellites or n.hdop is not None):
        return None
    wrong = []
    if n.fix in _ORDER and _ORDER.index(n.fix) < _LIMITS.index(limits.fix):
        wrong.append(f"{FIXES[n.fix]} fix")
    if 0 < n.satellites < limits.satellites:
        wrong.append(f"{n.satellites} satellites")
    if n.hdop is not None and n.hdop > limits.hdop:
        wrong.append(f"HDOP {n.hdop:.1f}")
    return f"satellite navigation poor: {', '.join(wrong)}" if wrong else None
