"""Alarms: what a boat or the console warns of. One stands in the list while its cause lasts and until somebody has taken note
of it, on any page.

A boat says its troubles in words, once each, and which of them are there now as bits (`TROUBLES`): an alarm belongs to the bits
that came with its words. A boat that tells no such bits has alarms without a lasting cause.
"""

import re
from dataclasses import dataclass
from typing import Any, Final

from delfim.base.modes import Mode

ALARMS_MAX: Final = 100
GRAVE: Final = 3  # MAVLink's severities up to this one
_DOES: Final = re.compile(r": (warn|hold|back|home|stop|disconnect)$")  # what the boat does about it
_MODES: Final = frozenset(mode.name.lower() for mode in Mode)
_FIGURES: Final = re.compile(r"[\d.]+")


@dataclass(slots=True)
class StandingAlarm:
    """`severity` is MAVLink's."""

    id: int
    boat: int | None
    severity: int
    text: str
    at_s: float  # since 1970, when it began
    lasts: bool = False  # its cause is there now
    seen: bool = False  # somebody has taken note of it
    bits: int | None = 0  # of the boat's troubles; None: they are told next


class Alarms:
    """Those that last or that nobody has seen."""

    def __init__(self) -> None:
        self.changed = False  # since the pages were told
        self._alarms: dict[tuple[int | None, str], StandingAlarm] = {}  # by boat and cause
        self._bits: dict[int, int] = {}  # by boat, as it told them last
        self._last = 0

    def shown(self) -> list[dict[str, Any]]:
        """For the page: those that nobody has seen stand first, the gravest before others, then the newest."""
        order = sorted(self._alarms.values(), key=lambda each: (each.seen, each.severity > GRAVE, -each.id))
        names = "id", "boat", "severity", "text", "at_s", "lasts", "seen"
        return [{name: getattr(each, name) for name in names} for each in order]

    def hear(self, boat: int | None, severity: int, text: str, at_s: float, *, is_boats: bool = False) -> None:
        """Something went wrong, or is told again in other words. `is_boats`: the boat says so itself."""
        alarm = self._begin(boat, severity, text, at_s)
        if is_boats and boat in self._bits and not alarm.bits:
            alarm.lasts, alarm.bits = True, None

    def hold(self, boat: int | None, severity: int, text: str, at_s: float, is_so: bool) -> bool:
        """An alarm of the console's own, which lasts while this is so. Whether that has changed just now."""
        was = self._alarms.get((boat, cause(text)))
        if is_so == (was is not None and was.lasts):
            return False
        alarm = self._begin(boat, severity, text, at_s) if was is None or is_so else was
        alarm.lasts = is_so
        self._drop()
        return True

    def troubles(self, boat: int, bits: int) -> None:
        """What is wrong aboard now."""
        new, self._bits[boat] = bits & ~self._bits.get(boat, 0), bits
        for each in [each for each in self._alarms.values() if each.boat == boat and each.bits != 0]:
            each.bits = (new or bits) if each.bits is None else each.bits
            if each.lasts != bool(each.bits & bits):
                each.lasts, self.changed = not each.lasts, True
        self._drop()

    def forget(self, boat: int) -> None:
        """The operator has nothing to do with this boat any more."""
        self._bits.pop(boat, None)
        self._alarms = {key: each for key, each in self._alarms.items() if each.boat != boat}
        self.changed = True

    def note(self, ids: list[int]) -> list[tuple[int | None, str]]:
        """Somebody has taken note of these. Their boats and words."""
        noted = [each for each in self._alarms.values() if each.id in ids and not each.seen]
        for each in noted:
            each.seen = self.changed = True
        self._drop()
        return [(each.boat, each.text) for each in noted]

    def _begin(self, boat: int | None, severity: int, text: str, at_s: float) -> StandingAlarm:
        """The alarm of this cause. One that is new, or graver than before, nobody has seen yet."""
        key = boat, cause(text)
        alarm = self._alarms.get(key)
        if alarm is None:
            alarm = self._alarms[key] = StandingAlarm(0, boat, severity, text, at_s)
        if not alarm.id or severity < alarm.severity:
            self._last += 1
            alarm.id, alarm.seen, alarm.at_s = self._last, False, at_s
        alarm.severity, alarm.text, self.changed = min(severity, alarm.severity), text, True
        if len(self._alarms) > ALARMS_MAX:
            del self._alarms[max(self._alarms, key=lambda each: (self._alarms[each].severity, -self._alarms[each].id))]
        return alarm

    def _drop(self) -> None:
        for key in [key for key, each in self._alarms.items() if each.seen and not each.lasts]:
            del self._alarms[key]
            self.changed = True


def is_trouble(severity: int, text: str) -> bool:
    """Whether a boat's text is about what is wrong aboard; a warning of any other kind is why it refuses something."""
    return " refused: " not in text and (severity <= GRAVE or text.endswith(": warn"))


def cause(text: str) -> str:
    """The same for "idle: port propeller: no command for 1.0 s", and for "port propeller: no command for 2.0 s: stop"."""
    text = _DOES.sub("", text.partition(";")[0])
    first, _, rest = text.partition(": ")
    return _FIGURES.sub("#", rest if rest and first in _MODES else text)
