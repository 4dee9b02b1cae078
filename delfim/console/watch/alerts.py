"""Alerts: what a boat or the console warns of. One stands in the list while its cause lasts and until somebody has taken note
of it, on any page (`delfim.console.watch.alertstate`); then it is in the history.

A boat says its troubles in words, once each, and which of them are there now as bits (`TROUBLES`): an alert belongs to the bits
that came with its words. Where the link lost the words, the bit alone makes one. Of a boat that tells no such bits nobody hears
that a cause is over: its alerts last until they are acknowledged.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypedDict, cast

import msgspec

from delfim.base.modes import Mode
from delfim.console.watch.alertstate import UNSEEN, AlertState, Happening, Priority, after
from delfim.vehicle.failsafe.troubles import Trigger

OF_BOAT: Final = 25  # alerts of one boat; what is beyond is one more, which sends to the log of the watch
MORE: Final = "more alerts than are listed: see the log of the watch"
HISTORY_MAX: Final = 200
SILENCE_S: Final = 30.0
BITS: Final = 31  # of the boat's troubles
UNTOLD_S: Final = 6.0  # a trouble is there, and its words are not: the boat has said them twice meanwhile
TEXT_MAX: Final = 1000  # characters
GRAVE: Final = 3  # MAVLink's severities up to this one
WARNING: Final = 4  # the same
CAUTION: Final = 5
_DOES: Final = re.compile(r": (warn|hold|back|home|stop|disconnect)$")  # what the boat does about it
_MODES: Final = frozenset(mode.name.lower() for mode in Mode)
_FIGURES: Final = re.compile(r"[\d.]+")
_NAMES: Final = {each.value: each.name.lower().replace("_", " ") for each in Trigger}
Words = Annotated[str, msgspec.Meta(max_length=TEXT_MAX)]


@dataclass(slots=True)
class StandingAlert:
    id: int
    boat: int | None
    priority: Priority
    text: Words
    at_s: float  # since 1970, when it began
    state: AlertState = AlertState.NORMAL
    by: Words = ""  # who acknowledged or silenced it, or answers for it
    lasts: bool | None = None  # its cause is there now; None: nobody will tell when it is over
    bits: int | None = 0  # of the boat's troubles; None: they are told next
    quiet_s: float = 0.0  # since 1970: until then it was silenced

    def shown(self, now_s: float) -> dict[str, Any]:
        """For the page. `sounds`: until somebody has taken note of it, or silenced it."""
        names = "id", "boat", "text", "at_s", "by"
        sounds = self.priority <= Priority.ALARM and self.state in UNSEEN and now_s >= self.quiet_s
        of_state = {"priority": self.priority.name.lower(), "state": self.state.value, "sounds": sounds}
        return {name: getattr(self, name) for name in names} | of_state


class EndedAlert(TypedDict):
    """One of the history, as pages have it."""

    id: int
    boat: int | None
    text: Words
    at_s: float
    by: Words
    priority: Words
    state: Words
    sounds: bool
    until_s: float


class KeptAlerts(msgspec.Struct, frozen=True):
    """What outlives the console."""

    last: int  # of the numbers
    alerts: list[StandingAlert]
    bits: dict[int, int]
    history: Annotated[list[EndedAlert], msgspec.Meta(max_length=HISTORY_MAX)]


class AlertList:
    """Those that last or that nobody has seen. `utc_s` tells the time since 1970, `over` is told when a cause is over.

    `changed`: pages do not know of the last change. `ended`: those for the history that they do not know either."""

    def __init__(self, utc_s: Callable[[], float], over: Callable[[StandingAlert], None] = lambda alert: None) -> None:
        self.changed = False
        self.history = deque[EndedAlert](maxlen=HISTORY_MAX)  # the newest stands last
        self.ended = deque[EndedAlert](maxlen=HISTORY_MAX)
        self._utc_s, self._over = utc_s, over
        self._alerts: dict[tuple[int | None, str], StandingAlert] = {}  # by boat and cause
        self._bits: dict[int, int] = {}  # by boat, as it told them last
        self._untold: dict[tuple[int, int], float] = {}  # by boat and bits that no alert has: since when; inf: one was made
        self._last = 0

    def kept(self) -> KeptAlerts:
        return KeptAlerts(self._last, list(self._alerts.values()), self._bits, list(self.history))

    def restore(self, kept: KeptAlerts) -> None:
        """Goes on where the console before this one ended. Nobody commands yet, so nobody answers for anything; what that
        console warned of itself is over until this one finds it again."""
        self._last, self._bits = max([kept.last, *(each.id for each in kept.alerts)]), dict(kept.bits)
        self._alerts = {(each.boat, cause(each.text)): each for each in kept.alerts}
        self.history.extend(kept.history)
        self.changed = True
        for each in [each for each in kept.alerts if each.boat is None and each.lasts]:
            self._happen(each, Happening.ENDS)
        self.give_back()

    @property
    def standing(self) -> list[StandingAlert]:
        return list(self._alerts.values())

    def shown(self) -> list[dict[str, Any]]:
        """For the page: those that nobody has seen stand first, the gravest before others, then the newest."""
        order = sorted(self._alerts.values(), key=lambda each: (each.state not in UNSEEN, each.priority, -each.id))
        now_s = self._utc_s()
        return [each.shown(now_s) for each in order]

    def hear(self, boat: int | None, severity: int, text: str, *, is_boats: bool = False) -> None:
        """Something went wrong, or is told again in other words. `severity`: MAVLink's. `is_boats`: the boat says so itself."""
        if (boat, cause(text)) not in self._alerts and sum(each.boat == boat for each in self._alerts.values()) >= OF_BOAT:
            text, is_boats = MORE, False
        alert = self._begin(boat, severity, text[:TEXT_MAX])
        if is_boats and not alert.bits:
            alert.lasts, alert.bits = True if boat in self._bits else alert.lasts, None

    def hold(self, boat: int | None, severity: int, text: str, is_so: bool) -> bool:
        """An alert of the console's own, which lasts while this is so. Whether that has changed just now."""
        was = self._alerts.get((boat, cause(text)))
        if is_so == (was is not None and was.lasts is True):
            return False
        if is_so:
            self._begin(boat, severity, text).lasts = True
        elif was is not None:
            self._happen(was, Happening.ENDS)
        return True

    def troubles(self, boat: int, bits: int) -> None:
        """What is wrong aboard now."""
        new, self._bits[boat] = bits & ~self._bits.get(boat, 0), bits
        for each in [each for each in self._alerts.values() if each.boat == boat and each.bits != 0]:
            if each.bits is None:
                each.bits, each.lasts = new or bits, True
            if each.lasts != bool(each.bits & bits):
                self._happen(each, Happening.ENDS if each.lasts else Happening.BEGINS)
        self._look_for_untold(boat, bits)

    def _look_for_untold(self, boat: int, bits: int) -> None:
        """A trouble whose words the link lost is an alert as well: there are fewer alerts than troubles."""
        now_s, groups, before = self._utc_s(), _grouped(self._masks(boat, bits), bits), self._untold
        self._untold = {key: since_s for key, since_s in before.items() if key[0] != boat}
        for group, count in groups:
            if group.bit_count() <= count:
                continue
            since_s = self._untold[boat, group] = before.get((boat, group), now_s)
            if now_s - since_s >= UNTOLD_S:
                self._untold[boat, group] = math.inf
                names = (_NAMES.get(bit, f"trouble {bit}") for bit in range(BITS) if group >> bit & 1)
                text = f"{' or '.join(names)}: the boat's words were lost on the link"
                self.hear(boat, GRAVE, text)
                if (alert := self._alerts.get((boat, cause(text)))) is not None:
                    alert.lasts, alert.bits = True, group

    def _masks(self, boat: int, bits: int) -> list[int]:
        return [each.bits & bits for each in self._alerts.values() if each.boat == boat and each.bits and each.bits & bits]

    def forget(self, boat: int, who: str) -> None:
        """The operator has nothing to do with this boat any more."""
        self._bits.pop(boat, None)
        self._untold = {key: since_s for key, since_s in self._untold.items() if key[0] != boat}
        for each in [each for each in self._alerts.values() if each.boat == boat]:
            each.by = who
            self._end(each)

    def acknowledge(self, who: str, ids: Sequence[int]) -> list[StandingAlert]:
        """Somebody has taken note of these. Those that nobody had."""
        return [each for each in self._of(ids) if each.state in UNSEEN and self._happen(each, Happening.ACKNOWLEDGED, who)]

    def silence(self, who: str, ids: Sequence[int]) -> list[StandingAlert]:
        """No sound of these for SILENCE_S. Those that had one."""
        now_s = self._utc_s()
        loud = [each for each in self._of(ids) if each.shown(now_s)["sounds"] and each.priority is not Priority.EMERGENCY]
        for each in loud:
            each.quiet_s, self.changed = now_s + SILENCE_S, True
            self._happen(each, Happening.SILENCED, who)
        return loud

    def transfer(self, who: str) -> list[StandingAlert]:
        """Who took over the command answers for what lasts and was acknowledged. What that is."""
        seen = [each for each in self._alerts.values() if each.state is AlertState.ACKNOWLEDGED]
        return [each for each in seen if self._happen(each, Happening.TRANSFERRED, who)]

    def give_back(self) -> None:
        """Nobody commands: nobody answers for anything."""
        for each in list(self._alerts.values()):
            self._happen(each, Happening.RETURNED)

    def tick(self) -> None:
        """The time of a silence is over."""
        now_s = self._utc_s()
        for each in self._alerts.values():
            if each.quiet_s and now_s >= each.quiet_s:
                each.quiet_s, self.changed = 0.0, True
                self._happen(each, Happening.LOUD)

    def _of(self, ids: Sequence[int]) -> list[StandingAlert]:
        return [each for each in self._alerts.values() if each.id in ids]

    def _begin(self, boat: int | None, severity: int, text: str) -> StandingAlert:
        """The alert of this cause. One that is new, or graver than before, or comes again, nobody has seen yet."""
        key, priority = (boat, cause(text)), priority_of(severity)
        alert = self._alerts.get(key)
        if alert is None:
            alert = self._alerts[key] = StandingAlert(0, boat, priority, text, self._utc_s())
        alert.text, self.changed = text, True
        if not alert.id or priority < alert.priority or alert.lasts is False or text == MORE:
            alert.priority = min(priority, alert.priority)
            self._happen(alert, Happening.BEGINS)
        return alert

    def _happen(self, alert: StandingAlert, happening: Happening, who: str = "") -> bool:
        """Whether its state has changed."""
        before, alert.state = alert.state, after(alert.state, happening, alert.priority)
        if happening is Happening.BEGINS:
            self._last += 1
            alert.id, alert.at_s, alert.by, alert.quiet_s = self._last, self._utc_s(), "", 0.0
            alert.lasts = alert.lasts if alert.lasts is None else True
        elif happening is Happening.ENDS:
            alert.lasts = False
            self._over(alert)
        if alert.state is before:
            return False
        self.changed, alert.by = True, "" if happening in (Happening.LOUD, Happening.RETURNED) else who or alert.by
        ends_unheard = alert.lasts is None and alert.state not in UNSEEN and alert.priority is not Priority.CAUTION
        if alert.state is AlertState.NORMAL or ends_unheard:
            self._end(alert)
        return True

    def _end(self, alert: StandingAlert) -> None:
        self._alerts = {key: each for key, each in self._alerts.items() if each is not alert}
        line = cast(EndedAlert, alert.shown(0.0) | {"until_s": self._utc_s()})
        for kept in (self.history, self.ended):
            kept.append(line)
        self.changed = True


def _grouped(masks: list[int], bits: int) -> list[tuple[int, int]]:
    """Bits that the same alerts may be of, and how many alerts these are."""
    groups = [(1 << bit, 0) for bit in range(BITS) if bits >> bit & 1]
    for mask in masks:
        its = [each for each in groups if each[0] & mask]
        groups = [each for each in groups if not each[0] & mask]
        groups.append((sum(group for group, _ in its), 1 + sum(count for _, count in its)))
    return groups


def priority_of(severity: int) -> Priority:
    """Of MAVLink's severities, 0 emergency to 7 debug."""
    if severity <= GRAVE:
        return Priority.ALARM if severity else Priority.EMERGENCY
    return Priority.WARNING if severity == WARNING else Priority.CAUTION


def is_trouble(severity: int, text: str) -> bool:
    """Whether a boat's text is about what is wrong aboard; a warning of any other kind is why it refuses something."""
    return " refused: " not in text and (severity <= GRAVE or text.endswith(": warn"))


def cause(text: str) -> str:
    """The same for "idle: port propeller: no command for 1.0 s", and for "port propeller: no command for 2.0 s: stop"."""
    text = _DOES.sub("", text.partition(";")[0])
    first, _, rest = text.partition(": ")
    return _FIGURES.sub("#", rest if rest and first in _MODES else text)
