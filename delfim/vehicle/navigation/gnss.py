"""Quality of satellite navigation: kind of fix, satellites in use, dilution of precision, stated accuracy, age of corrections;
in words, and against limits."""

from typing import Final, get_args

from delfim import config
from delfim.canproxy.dsor.messages import Navigation

FIXES: Final = {0: "no fix", 2: "2D", 3: "3D", 4: "differential", 5: "RTK", 6: "RTK float"}  # names of Navigation.fix
_ORDER: Final = (2, 3, 4, 6, 5)  # in the order of the limit's names
_LIMITS: Final = get_args(config.FixName)


def in_words(
    fix: int, satellites: int, hdop: float | None, accuracy_m: float | None = None, corrections_s: float | None = None
) -> str:
    """Where nobody tells the quality there are 0 satellites and no dilution."""
    if not satellites and hdop is None:
        return "quality of satellite navigation not told"
    dilution = f", HDOP {hdop:.1f}" if hdop is not None else ""
    accuracy = f", accuracy {metres(accuracy_m)}" if accuracy_m is not None else ""
    corrections = f", corrections {corrections_s:.0f} s old" if corrections_s is not None else ""
    return f"{FIXES.get(fix, 'unknown fix')}, {satellites} satellites{dilution}{accuracy}{corrections}"


def metres(accuracy_m: float) -> str:
    return f"{accuracy_m:.1f} m" if accuracy_m >= 1.0 else f"{accuracy_m:.2f} m"


def poor(limits: config.GnssPoor, n: Navigation | None) -> str | None:
    """In which way satellite navigation is worse than its limits. Not known is not bad, but for accuracy and corrections: who
    asks for them has a receiver that tells them."""
    if n is None or not n.fix:
        return None
    wrong = []
    if n.satellites or n.hdop is not None:
        if n.fix in _ORDER and _ORDER.index(n.fix) < _LIMITS.index(limits.fix):
            wrong.append(f"{FIXES[n.fix]} fix")
        if 0 < n.satellites < limits.satellites:
            wrong.append(f"{n.satellites} satellites")
        if n.hdop is not None and n.hdop > limits.hdop:
            wrong.append(f"HDOP {n.hdop:.1f}")
    if limits.accuracy_m and (n.accuracy_m is None or n.accuracy_m > limits.accuracy_m):
        wrong.append("accuracy not told" if n.accuracy_m is None else f"accuracy {metres(n.accuracy_m)}")
    if limits.corrections_s and (n.corrections_s is None or n.corrections_s > limits.corrections_s):
        wrong.append("no corrections" if n.corrections_s is None else f"corrections {n.corrections_s:.0f} s old")
    return f"satellite navigation poor: {', '.join(wrong)}" if wrong else None
