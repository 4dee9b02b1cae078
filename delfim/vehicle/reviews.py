"""Plans that somebody sent, looked at in slices of the loop's time: one at a time, the newest. Nothing changes before all of it
was looked at; then the plan is obeyed, or refused, and whoever sent it hears which.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

from delfim.errors import DelfimError, Refused
from delfim.slices import Sliced
from delfim.vehicle import console
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.mission import Mission
from delfim.vehicle.missionreader import Reading, gathered

AGAIN = 3  # times that a plan is looked at anew because the boat's settings changed meanwhile
QUIET = console.Alive | console.TellState | console.Watch
Answer = Callable[[str | None], None]  # with the reason why not, or None
Obey = Callable[[console.Commands, str], str | None]
T = TypeVar("T")


class Review(NamedTuple):
    """A plan under way."""

    command: console.Plan
    operator: str
    answer: Answer


class Reviews:
    """`obey` carries a command out that was looked at, as any other."""

    def __init__(self, boat: VehicleLoop, obey: Obey, loop: asyncio.AbstractEventLoop) -> None:
        self._boat, self._obey, self._loop = boat, obey, loop
        self._now: Review | None = None
        self._reading: Reading | None = None
        self._written: tuple[console.Plan, bytes] | None = None

    def begin(self, operator: str, command: console.Plan, answer: Answer) -> None:
        """Look at this plan, in place of one that is being looked at. `answer` is called once, at the earliest at once."""
        self.cancel("a newer plan replaced it")
        self._now = review = Review(command, operator, answer)
        if not isinstance(command, console.LoadMission):
            self._work(review, Sliced(console.written(command)), partial(self._was_written, review))
            return
        try:
            text = self._boat.helm.plans.text(command)
        except Refused:  # the boat says so
            self._end(review)
            return
        self._reading = Reading(text)
        reading = self._loop.run_in_executor(None, self._reading.lines)
        reading.add_done_callback(lambda read: None if read.cancelled() else self._was_read(review, read.result()))

    def written(self, command: console.Commands) -> bytes | None:
        """The JSON of a plan that is being obeyed."""
        return self._written[1] if self._written is not None and self._written[0] is command else None

    def hear(self, command: console.Commands, operator: str) -> None:
        """A command was obeyed, or refused: a stop, or somebody else who commands, ends what is being looked at."""
        if isinstance(command, console.Stop | console.ShutDown):
            self.cancel("a stop was commanded")
        elif self._now is not None and operator != self._now.operator and not isinstance(command, QUIET):
            self.cancel(f"{operator} commands now")

    def cancel(self, reason: str) -> None:
        """Whatever is being looked at is not wanted any more."""
        if (review := self._now) is not None:
            self._now = None
            if self._reading is not None:
                self._reading.cancel()
            review.answer(f"refused: {reason}")

    def _was_read(self, review: Review, lines: list[bytes] | DelfimError) -> None:
        if review is not self._now:
            return
        self._reading = None
        if isinstance(lines, DelfimError):
            self._now = None
            review.answer(str(lines))
            return
        self._work(review, Sliced(gathered(lines)), lambda mission: self._loop.call_soon(self._look, review, mission))

    def _was_written(self, review: Review, line: bytes) -> None:
        self._written = review.command, line
        self._loop.call_soon(self._look, review, None)

    def _look(self, review: Review, mission: Mission | None, times: int = 1) -> None:
        work = Sliced(self._boat.helm.plans.look(review.command, mission))
        self._work(review, work, lambda _: self._was_looked_at(review, mission, times))

    def _was_looked_at(self, review: Review, mission: Mission | None, times: int) -> None:
        if self._boat.helm.plans.has_looked(review.command):
            self._end(review)
        elif times < AGAIN:
            self._loop.call_soon(self._look, review, mission, times + 1)
        else:
            self.cancel("the boat's settings kept changing meanwhile: send it again")

    def _work(self, review: Review, work: Sliced[T], then: Callable[[T], object]) -> None:
        """Slice by slice, as long as this plan is wanted."""
        if review is not self._now:
            return
        if work.step():
            then(work.result)
        else:
            self._loop.call_soon(self._work, review, work, then)

    def _end(self, review: Review) -> None:
        self._now = None
        refused = self._obey(review.command, review.operator)
        self._written = None
        review.answer(refused)
