"""Keeps the watch: its log and its alerts, and what pages hear of both."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from aiohttp import web

from delfim.base.errors import Refused
from delfim.console.boats.boat import SILENT_S, Boat
from delfim.console.boats.fleet import NOTE_MAX
from delfim.console.gateway import page_messages
from delfim.console.gateway.watchlog import WatchLine, WatchLog, table
from delfim.console.tapes.replay import TapePlayer
from delfim.console.watch.alerts import CAUTION, WARNING, AlertList, StandingAlert, priority_of
from delfim.console.watch.alertsfile import AlertsFile

GREETED: Final = 200  # lines for a page that opens
INFO: Final = 6  # MAVLink's severity of a mark
LOST: Final = "link lost: nothing is heard from it"
BACK: Final = "heard again"
WEAK: Final = "link weak: a stop may come late"
NOTE: Final = "note"  # of an operator
LATE_S: Final = 900.0  # it may be written so long after what it tells of
ABOARD: Final = (
    "acknowledged",
    "command",
    NOTE,
)  # lines that are in the boat's log, too: of its orders it keeps the console alone
DEEDS: Final = ("upload", "save")  # to a mission, that the log has
Answer = Callable[[bool, str], None]


class WatchKeeper:
    """`tell` informs the pages, `utc_s` is the time that they show, `name` that of a boat. The watch goes on where that of the
    console before ended, whose files are in `sessions`."""

    def __init__(
        self,
        tell: Callable[[dict[str, Any]], None],
        utc_s: Callable[[], float],
        name: Callable[[int], str],
        sessions: Path | None = None,
    ) -> None:
        self.alerts, self.log = AlertList(utc_s, self._over), WatchLog()
        self._tell, self._utc_s, self._name = tell, utc_s, name
        self.aboard: Callable[[int | None, str], None] = lambda boat, words: None  # the boats' own logs
        self._replayed: Path | None = None  # the table of the notes on a replay
        self._sessions, self.file = sessions, AlertsFile(sessions) if sessions is not None else None

    def resume(self) -> None:
        """Goes on where the console before this one ended, once this one can tell the time: some alerts are over by that."""
        if self.file is not None and self._sessions is not None:
            self.log.resume(self._sessions)
            self.file.restore(self.alerts)

    def greet(self, tell: Callable[[dict[str, Any]], None]) -> None:
        """What a page that opens has missed."""
        tell({"t": "log", "all": True, "lines": self.log.told(GREETED)})
        tell({"t": "ended", "all": True, "alerts": list(self.alerts.history)})
        tell({"t": "alerts", "alerts": self.alerts.shown()})

    def hear(self, text: dict[str, Any]) -> None:
        """What pages were told in words."""
        boat, severity, words = text["boat"], text["severity"], text["text"]
        what = priority_of(severity).name.lower() if severity <= WARNING else "notice"
        self.note(boat, "console" if boat is None else "boat", what, words)
        if whose := text.get("alarm"):
            self.alerts.hear(boat, severity, words, is_boats=whose == "boat")

    def recall(self, replay: TapePlayer, sessions: Path, now_s: float) -> None:
        """The log is that of the time of a replay, and has no more lines but notes, in a table of their own. Raises OSError."""
        self._replayed = sessions / time.strftime("%Y%m%d-%H%M%S.csv", time.localtime(now_s))
        self.log.recall(sessions, replay.from_s, replay.to_s)

    def time_line(self, replay: TapePlayer) -> dict[str, Any]:
        """Of a replay, with the notes of the log as marks; the boat's own log has them, too."""
        notes = [line for line in self.log.lines if line.what == NOTE]
        known = {_aboard(line.who, NOTE, line.text) for line in notes}
        marks = [
            {"at_s": max(n.at_s, replay.from_s), "boat": n.boat, "severity": INFO, "text": f"{n.who}: {n.text}", NOTE: True}
            for n in notes
        ]
        events = [each for each in replay.events() if each["text"] not in known]
        return {"from_s": replay.from_s, "to_s": replay.to_s, "events": sorted([*events, *marks], key=itemgetter("at_s"))}

    def remark(self, who: str, asked: page_messages.Note) -> None:
        """Keeps what an operator notes. Raises Refused."""
        now_s = self._utc_s()
        at_s = now_s if asked.at_s is None or not math.isfinite(asked.at_s) else asked.at_s
        self.note(asked.boat or None, who, NOTE, asked.text, min(max(at_s, now_s - LATE_S), now_s))
        if self._replayed is not None:
            self.log.write(self._replayed)
            if self.log.reason:
                raise Refused(f"the note is not kept: {self.log.reason}")

    def note(self, boat: int | None, who: str, what: str, text: str, at_s: float | None = None) -> None:
        """Puts a line into the log."""
        if self._replayed is not None and what != NOTE:
            return
        at_s = self._utc_s() if at_s is None else at_s
        line = WatchLine(at_s, boat, "" if boat is None else self._name(boat), who, what, text)
        self.log.put(line)
        self._tell({"t": "log", "lines": [line._asdict()]})
        if what in ABOARD:
            self.aboard(boat, _aboard(who, what, text))

    async def serve(self, request: web.Request) -> web.Response:
        """The log of the watch as a table."""
        named = {"Content-Disposition": 'attachment; filename="watch.csv"'}
        return web.Response(text=table(self.log.lines), content_type="text/csv", headers=named)

    def ask(self, who: str, asked: page_messages.Acknowledge | page_messages.Quiet | page_messages.Note) -> None:
        """Does what a page asks of the watch. Raises Refused."""
        match asked:
            case page_messages.Acknowledge(ids=ids):
                self.acknowledge(who, ids)
            case page_messages.Quiet(ids=ids):
                self.silence(who, ids)
            case page_messages.Note():
                self.remark(who, asked)

    def acknowledge(self, who: str, ids: Sequence[int]) -> None:
        for each in self.alerts.acknowledge(who, ids):
            self.note(each.boat, who, "acknowledged", each.text)

    def silence(self, who: str, ids: Sequence[int]) -> None:
        for each in self.alerts.silence(who, ids):
            self.note(each.boat, who, "silenced", each.text)

    def _over(self, alert: StandingAlert) -> None:
        self.note(alert.boat, "boat" if alert.bits else "console", "over", alert.text)

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
            case page_messages.Itself(do="change", key=key, value=value):
                order = f"change {key} = {value}"[:200]
            case page_messages.Logs(do="chart", chart=name):
                order = f"send chart {name}"
            case page_messages.Forget():
                order = "forget the boat"
            case _:
                return answer
        self.note(number, who, "order", order)

        def answered(well: bool, why: str) -> None:
            if not well:
                self.note(number, who, "refused", f"{order}: {why}")
            answer(well, why)

        return answered

    def close(self) -> None:
        if self.file is not None:
            self.file.close()

    def tick(self, boats: Iterable[Boat], now_s: float) -> None:
        """Often: who is silent, whose link is weak, and what has changed."""
        for boat in boats:
            silent = now_s - boat.heard_s > SILENT_S
            if self.alerts.hold(boat.number, WARNING, LOST, silent):
                self.note(boat.number, "console", "warning" if silent else "notice", LOST if silent else BACK)
                if not silent:
                    self._tell({"t": "text", "boat": boat.number, "severity": 6, "text": BACK, "at_s": self._utc_s()})
            weak = not silent and boat.has_weak_link(now_s)
            if self.alerts.hold(boat.number, CAUTION, WEAK, weak) and weak:
                self.note(boat.number, "console", "caution", WEAK)
        self.alerts.tick()
        if self.alerts.ended:
            self._tell({"t": "ended", "alerts": list(self.alerts.ended)})
            self.alerts.ended.clear()
        if self.alerts.changed:
            self.alerts.changed = False
            self._tell({"t": "alerts", "alerts": self.alerts.shown()})
            if self.file is not None:
                self.file.put(self.alerts)
        if self.file is not None:
            self.file.tick()


def _aboard(who: str, what: str, text: str) -> str:
    """A line, as boats have it in their logs."""
    return f"{who}: {what}: {text}"[:NOTE_MAX]
