"""What the console asks boats about themselves, and what it has them note: one question at a time to each, behind its orders.

A question is repeated until the boat answers or it is too old; boats of other makers and versions do not answer.
"""

import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from delfim.base.errors import FormatError, Refused
from delfim.console.link.mavlink import BoatQuestion, ToldRow, mavlink, questions

REPEAT_S: Final = 1.0
LIFE_S: Final = 20.0  # with 3 of 10 frames lost each way, 4 of 100,000 lists are given up
WAITING_MAX: Final = 50  # for one boat
NO_ANSWER: Final = "the boat does not answer: it is out of reach, or of another version"
Answered = Callable[[ToldRow], None]


@dataclass(slots=True)
class AskedQuestion:
    question: BoatQuestion
    answer: Answered
    number: int = 0
    begun_s: float | None = None
    due_s: float = 0.0


class Questions:
    """`send` sends a message to a boat, `is_busy` says that an order to it is under way, which goes first."""

    def __init__(self, send: Callable[[int, Any], None], is_busy: Callable[[int], bool]) -> None:
        self._send, self._is_busy = send, is_busy
        self._waiting = dict[int, deque[AskedQuestion]]()
        self._number = secrets.randbits(32)

    def ask(self, boat: int, question: BoatQuestion, answer: Answered) -> None:
        """`answer` is called once. Raises Refused."""
        waiting = self._waiting.setdefault(boat, deque())
        if len(waiting) >= WAITING_MAX:
            raise Refused("many questions to the boat wait already")
        waiting.append(AskedQuestion(question, answer))

    def read(self, boat: int, of: Any, ended: Callable[[list[ToldRow], str], None]) -> None:
        """A whole list, row by row; `ended` gets the rows, or why there are none. Raises Refused."""
        rows = list[ToldRow]()

        def told(row: ToldRow) -> None:
            if row.key:
                rows.append(row)
            if not row.count or not row.key or len(rows) >= row.count:
                ended(rows, "" if row.count or row.key else row.refused)
            else:
                self._waiting.setdefault(boat, deque()).appendleft(AskedQuestion(BoatQuestion(of, at=len(rows)), told))

        self.ask(boat, BoatQuestion(of), told)

    def hear(self, boat: int, message: Any) -> None:
        """An answer. Raises FormatError."""
        number, row = questions.heard(message)
        waiting = self._waiting.get(boat)
        if waiting and waiting[0].begun_s is not None and waiting[0].number == number:
            waiting.popleft().answer(row)

    def forget(self, boat: int) -> None:
        for each in self._waiting.pop(boat, ()):
            each.answer(ToldRow(refused="the boat was forgotten"))

    def tick(self, now_s: float) -> None:
        """Called often."""
        for boat, waiting in list(self._waiting.items()):
            if not waiting:
                del self._waiting[boat]
                continue
            first = waiting[0]
            if first.begun_s is None:
                self._number = (self._number + 1) & 0xFFFFFFFF
                first.number, first.begun_s = self._number, now_s
            if now_s - first.begun_s > LIFE_S:
                waiting.popleft().answer(ToldRow(refused=NO_ANSWER))
            elif now_s >= first.due_s and not self._is_busy(boat):
                first.due_s = now_s + REPEAT_S
                self._put(boat, first)

    def _put(self, boat: int, each: AskedQuestion) -> None:
        try:
            message = questions.ask((boat, mavlink.MAV_COMP_ID_AUTOPILOT1), each.number, each.question)
        except FormatError as error:
            self._waiting[boat].popleft()
            each.answer(ToldRow(refused=str(error)))
        else:
            self._send(boat, message)
