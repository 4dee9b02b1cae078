"""Keeps the watch: its log and its alarms, and what pages hear of both."""

from collections.abc import Callable, Iterable
from typing import Any, Final

from delfim.console.boats.alarms import GRAVE, Alarms
from delfim.console.boats.boat import SILENT_S, Boat
from delfim.console.gateway import page_messages
from delfim.console.gateway.watchlog import WatchLine, WatchLog

GREETED: Final = 200  # lines for a page that opens
LOST: Final = "link lost: nothing is heard from it"
BACK: Final = "heard again"
DEEDS: Final = ("upload", "save")  # to a mission, that the log has
Answer = Callable[[bool, str], None]


class WatchKeeper:
    """`tell` informs the pages, `utc_s` is the time that they show, `name` that of a boat."""

    def __init__(self, tell: Callable[[dict[str, Any]], None], utc_s: Callable[[], float], name: Callable[[int], str]) -> None:
        self.alarms, self.log = Alarms(), WatchLog()
        self._tell, self._utc_s, self._name = tell, utc_s, name

    def greet(self, tell: Callable[[dict[str, Any]], None]) -> None:
        """What a page that opens has missed."""
        tell({"t": "log", "all": True, "lines": self.log.told(GREETED)})
        tell({"t": "alarms", "alarms": self.alarms.shown()})

    def hear(self, text: dict[str, Any]) -> None:
        """What pages were told in words."""
        boat, severity, words = text["boat"], text["severity"], text["text"]
        what = "alarm" if severity <= GRAVE else "warning" if severity == 4 else "notice"
        self.note(boat, "console" if boat is None else "boat", what, words)
        if whose := text.get("alarm"):
            self.alarms.hear(boat, severity, words, text["at_s"], is_boats=whose == "boat")

    def note(self, boat: int | None, who: str, what: str, text: str) -> None:
        """Puts a line into the log."""
        line = WatchLine(self._utc_s(), boat, "" if boat is None else self._name(boat), who, what, text)
        self.log.put(line)
        self._tell({"t": "log", "lines": [line._asdict()]})

    def acknowledge(self, who: str, ids: list[int]) -> None:
        for boat, text in self.alarms.note(ids):
            self.note(boat, who, "acknowledged", text)

    def ordered(self, who: str, asked: page_messages.Message, words: dict[str, Any], answer: Answer) -> Answer:
        """Keeps what a page asks of a boat, if that is an order, and its refusal, which the answer brings."""
        boat = getattr(asked, "boat", None)
        number = boat if isinstance(boat, int) else None
        match asked:
            case page_messages.Command(command=command):
                said = {key: value for key, value in words.items() if key not in page_messages.NO_NUMBERS}
                command = str(said.pop("mode", command)) if command == "mode" else command
                numbers = (f"{key}={value}" for key, value in said.items())
                order = " ".join((command, *numbers, *(["all boats"] if number is None else [])))[:200]
            case page_messages.Profile(profile=profile):
                order = f"link profile {profile}"[:200]
            case page_messages.Mission(do=deed) if deed in DEEDS:
                order = f"mission: {deed}"
            case page_messages.Depths(do=deed):
                order = f"depths: {deed}"
            case page_messages.Adopt(do=deed):
                order = f"adopt: {deed}"
            case _:
                return answer
        self.note(number, who, "order", order)

        def answered(well: bool, why: str) -> None:
            if not well:
                self.note(number, who, "refused", f"{order}: {why}")
            answer(well, why)

        return answered

    def tick(self, boats: Iterable[Boat], now_s: float) -> None:
        """Often: who is silent, and what has changed."""
        for boat in boats:
            silent = now_s - boat.heard_s > SILENT_S
            if self.alarms.hold(boat.number, 4, LOST, self._utc_s(), silent):
                self.note(boat.number, "console", "warning" if silent else "notice", LOST if silent else BACK)
                if not silent:
                    self._tell({"t": "text", "boat": boat.number, "severity": 6, "text": BACK, "at_s": self._utc_s()})
        if self.alarms.changed:
            self.alarms.changed = False
            self._tell({"t": "alarms", "alarms": self.alarms.shown()})
