"""Review of plans in slices of the loop's time: one plan at a time, the newest. Nothing changes before the review is complete;
then the plan is obeyed or refused, and its sender is told which.
"""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError, Refused
from delfim.vehicle import console
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.orders.entrusting import forbidden, payload_of, within
from delfim.vehicle.orders.returning import RESTART
from delfim.vehicle.plans.mission import Mission
from delfim.vehicle.plans.missionreader import Reading, gathered

AGAIN = 3  # times that a review is repeated because the boat's settings changed meanwhile
QUIET = console.Alive | console.TellState | console.Watch
Answer = Callable[[str | None], None]  # called with the reason of a refusal, or None
Obey = Callable[[console.Commands, str], str | None]
T = TypeVar("T")

log = logging.getLogger(__name__)


class Review(NamedTuple):
    """A plan under way."""

    command: console.Plan
    operator: str
    answer: Answer


class Reviews:
    """`obey` carries out a reviewed command as it does any other."""

    def __init__(self, boat: VehicleLoop, obey: Obey, loop: asyncio.AbstractEventLoop) -> None:
        self._boat, self._obey, self._loop = boat, obey, loop
        self._now: Review | None = None
        self._reading: Reading | None = None
        self._written: tuple[console.Plan, bytes] | None = None

    def begin(self, operator: str, command: console.Plan, answer: Answer) -> None:
        """Review this plan instead of the present one. `answer` is called once, possibly before this returns."""
        if name := payload_of(operator):
            try:
                command = self._of_payload(name, command)
            except Refused as refusal:
                self._refuse(Review(command, operator, answer), f"refused: {refusal}")
                return
        self.cancel("a newer plan replaced it")
        self._now = review = Review(command, operator, answer)
        if not isinstance(command, console.LoadMission):
            self._work(review, Sliced(console.written(command)), partial(self._was_written, review))
            return
        try:
            text = self._boat.helm.plans.text(command)
        except Refused:  # the vehicle gives the reason
            self._end(review)
            return
        self._reading = Reading(text)
        reading = self._loop.run_in_executor(None, self._reading.lines)
        reading.add_done_callback(lambda read: None if read.cancelled() else self._was_read(review, read.result()))

    def _of_payload(self, name: str, command: console.Plan) -> console.Plan:
        """What is reviewed of a payload program's plan, before any work. Raises Refused."""
        helm = self._boat.helm
        if why := forbidden(helm.settings, helm.state, name, command):
            raise Refused(why)
        if self._now is not None and not payload_of(self._now.operator):
            raise Refused(f"a plan of {self._now.operator} is being checked")
        return within(command, helm.plans.zones)

    def written(self, command: console.Commands) -> bytes | None:
        """The JSON of a plan that is being obeyed."""
        return self._written[1] if self._written is not None and self._written[0] is command else None

    def hear(self, command: console.Commands, operator: str) -> None:
        """A command was obeyed or refused: a stop, or a command of another operator, ends the review."""
        if self._now is not None and self._now.operator == RESTART:
            return  # what was aboard before is loaded whoever commands now; only a newer plan ends that
        if payload_of(operator):
            return
        if isinstance(command, console.Stop | console.ShutDown):
            self.cancel("a stop was commanded")
        elif self._now is not None and operator != self._now.operator and not isinstance(command, QUIET):
            self.cancel(f"{operator} commands now")

    def cancel(self, reason: str) -> None:
        """End the present review, if there is one."""
        if (review := self._now) is not None:
            self._now = None
            if self._reading is not None:
                self._reading.cancel()
            self._refuse(review, f"refused: {reason}")

    def _refuse(self, review: Review, reason: str) -> None:
        """A plan that never comes to be obeyed."""
        log.info("vehicle: plan of %s: %s", review.operator, reason)
        review.answer(reason)

    def _was_read(self, review: Review, lines: list[bytes] | DelfimError) -> None:
        if review is not self._now:
            return
        self._reading = None
        if isinstance(lines, DelfimError):
            self._now = None
            self._refuse(review, str(lines))
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
