"""The operator's desk: missions are sent, saved, loaded, checked and tried here, with a boat or without one.

Long work is done beside the loop: files and dry runs in a few workers, checks in slices of the loop's time.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError, FormatError, Refused, in_words
from delfim.base.wholefile import replace_file
from delfim.console.boats.fleet import Fleet
from delfim.console.charts.charts import Charts
from delfim.console.gateway import page_messages
from delfim.console.plans.dry_run import dry_run
from delfim.console.plans.library import Library
from delfim.console.plans.plan_check import Crossed, chart_of, verdict
from delfim.console.tapes.replay import TapePlayer

JOBS_MAX: Final = 4  # files and dry runs under way, of all pages
CHECKS_MAX: Final = 8  # as many as pages: each asks for the next when it has an answer
SLICE: Final = 2000  # comparisons of a check in one turn of the loop: two milliseconds

Answer = Callable[[bool, str], None]
Tell = Callable[[dict[str, Any]], None]


class Desk:
    """`vehicle` is the boat's file, for checks and dry runs. Raises ConfigError if it is wrong."""

    def __init__(self, fleet: Fleet | TapePlayer, missions: Path, vehicle: Path | None, charts: Charts) -> None:
        self._fleet, self._library, self._vehicle, self._charts = fleet, Library(missions), vehicle, charts
        self._settings = config.load(vehicle) if vehicle is not None else None
        self._chart = chart_of(self._settings, charts.path) if self._settings is not None else None
        self._jobs = self._checks = 0

    def ask(self, asked: page_messages.Mission, plan: dict[str, Any] | None, tell: Tell, answer: Answer) -> None:
        """Does what a page asks, and answers it now or later; `tell` sends to that page. Raises DelfimError."""
        fleet, number = self._fleet, asked.boat
        if plan is None and asked.do in ("put", "check", "dryrun", "save"):
            raise FormatError(f"{asked.do} needs a mission")
        match asked.do:
            case "put":
                fleet.put(number, plan or {})
                answer(True, "")
            case "upload":
                if plan is not None:
                    fleet.put(number, plan)
                fleet.upload(number, answer)
            case "download" | "compare":
                fleet.download(number, answer)
            case "check":
                self._check(number, plan or {}, tell, answer)
            case "dryrun":
                self._dry_run(number, plan or {}, asked.seq, tell, answer)
            case "save":
                self._aside(partial(self._library.save, plan or {}), lambda _: answer(True, ""), answer)
            case "load":
                self._aside(partial(self._library.load, asked.name), partial(self._loaded, number, tell, answer), answer)
            case "list":
                tell({"t": "missions", "names": self._library.names()})
                answer(True, "")

    def renew(self, field: Path, answer: Answer) -> None:
        """The boat has this chart now: plans are checked by it, also by the next console."""
        settings, folder = self._settings, self._charts.path
        assert settings is not None
        assert folder is not None
        ashore = folder / Path(settings.fence.chart).name

        def work() -> Any:
            if ashore != field:
                replace_file(ashore, field.read_bytes())
            return chart_of(settings, folder)

        def then(chart: Any) -> None:
            self._chart = chart
            answer(True, "")

        self._aside(work, then, answer)

    def _loaded(self, number: int, tell: Tell, answer: Answer, mission: dict[str, Any]) -> None:
        if number:  # 0: a plan made before a boat is heard
            self._fleet.put(number, mission)
        tell({"t": "mission", "boat": number, "where": "here", "mission": mission})
        answer(True, "")

    def _check(self, number: int, plan: dict[str, Any], tell: Tell, answer: Answer) -> None:
        if self._checks >= CHECKS_MAX:
            raise Refused("other checks are under way: wait until one has ended")
        self._checks += 1
        tell({"t": "crossed", "boat": number, "place": None})
        asked = verdict(plan, self._place(number), self._settings, self._charts.backgrounds, self._chart and self._chart[1])
        self._go_on(Sliced(asked), number, tell, answer)

    def _go_on(self, work: Sliced[str], number: int, tell: Tell, answer: Answer) -> None:
        """A slice of a check in each turn of the loop. Where the chart forbids the plan, the page is told the place, too."""
        try:
            if not work.step(SLICE):
                asyncio.get_running_loop().call_soon(self._go_on, work, number, tell, answer)
                return
            well, words = True, work.result
        except DelfimError as error:
            well, words = False, str(error)
            if isinstance(error, Crossed):
                tell({"t": "crossed", "boat": number, "place": error.place})
        self._checks -= 1
        answer(well, words)

    def _dry_run(self, number: int, plan: dict[str, Any], sequence: int | None, tell: Tell, answer: Answer) -> None:
        if self._vehicle is None:
            raise Refused("a dry run needs the vehicle's file: start delfim console with --vehicle FILE")

        def ended(result: dict[str, Any]) -> None:
            tell({"t": "dryrun", "boat": number, "seq": sequence, **result})
            answer(result["well"], "" if result["well"] else result["end"])

        self._aside(partial(dry_run, self._vehicle, plan, self._place(number), self._chart and self._chart[0]), ended, answer)

    def _place(self, number: int) -> tuple[float, float] | None:
        """Of the boat, degrees, as far as it is known."""
        boat = self._fleet.boats.get(number)
        if boat is None or boat.values.get("latitude_deg") is None:
            return None
        return boat.values["latitude_deg"], boat.values["longitude_deg"]

    def _aside(self, work: Callable[[], Any], then: Callable[[Any], None], answer: Answer) -> None:
        """In a worker; what it returns goes to `then`, and what it raises is the answer."""
        if self._jobs >= JOBS_MAX:
            raise Refused("other missions are being read, saved or tried: wait until one is done")
        self._jobs += 1

        def ended(future: "asyncio.Future[Any]") -> None:
            self._jobs -= 1
            if future.cancelled():
                return
            try:
                then(future.result())
            except (DelfimError, OSError) as error:
                answer(False, in_words(error))

        asyncio.get_running_loop().run_in_executor(None, work).add_done_callback(ended)
