"""What was asked of a boat and not yet answered: repeated until it answers, or until it is too old to be meant any more.

A stop is repeated five times a second for as long as it takes (a minute at most): it is right whenever it arrives.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from delfim.console.mavlink import mavlink

REPEAT_S: Final = 1.0
LIFE_S: Final = 4.0  # a command that arrives later than this is not what the operator means any more
STOP_REPEAT_S: Final = 0.2
STOP_LIFE_S: Final = 60.0

RESULTS: Final = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "not now",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "the boat does not know this command",
    mavlink.MAV_RESULT_FAILED: "failed",
}
Answer = Callable[[bool, str], None]


@dataclass(slots=True)
class Request:
    """One command on its way."""

    boat: int
    command: int  # MAV_CMD
    words: tuple[float, ...]
    place: tuple[int, int] | None  # latitude and longitude, 1e-7 degrees: too fine for the floats of `words`
    answer: Answer
    begun_s: float
    is_stop: bool = False
    due_s: float = 0.0
    sent: int = 0


class Requests:
    """All of them. `send` puts a message on the way to a boat."""

    def __init__(self, send: Callable[[int, Any], None]) -> None:
        self._send = send
        self._waiting: list[Request] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def begin(
        self,
        boat: int,
        command: int,
        words: tuple[float, ...],
        answer: Answer,
        now_s: float,
        *,
        place: tuple[int, int] | None = None,
        stop: bool = False,
    ) -> None:
        """A newer command of the same kind to the same boat replaces the older one. A stop replaces all of them."""
        for old in [each for each in self._waiting if each.boat == boat and (stop or _same(each, command, words))]:
            self._end(old, False, "replaced by a newer command")
        request = Request(boat, command, words, place, answer, now_s, stop)
        self._waiting.append(request)
        self._repeat(request, now_s)

    def acknowledged(self, boat: int, command: int, result: int, reason: str) -> None:
        """The boat answered. `reason` is what it said last, in words."""
        for request in [each for each in self._waiting if each.boat == boat and each.command == command]:
            if result == mavlink.MAV_RESULT_IN_PROGRESS:
                continue
            if result == mavlink.MAV_RESULT_ACCEPTED:
                self._end(request, True, "")
            else:
                self._end(request, False, reason or RESULTS.get(result, f"result {result}"))

    def tick(self, now_s: float) -> None:
        """Due often: repeats what was not answered, and gives up what is too old."""
        for request in list(self._waiting):
            if now_s - request.begun_s > (STOP_LIFE_S if request.is_stop else LIFE_S):
                self._end(request, False, "no answer from the boat")
            elif now_s >= request.due_s:
                self._repeat(request, now_s)

    def _repeat(self, request: Request, now_s: float) -> None:
        to, words = (request.boat, mavlink.MAV_COMP_ID_AUTOPILOT1), request.words
        if request.place is not None:
            four = (*words, *(0.0,) * (4 - len(words)))
            frame = mavlink.MAV_FRAME_GLOBAL_INT
            message = mavlink.MAVLink_command_int_message(*to, frame, request.command, 0, 0, *four, *request.place, 0.0)
        else:
            before = min(request.sent, 255)  # "confirmation": how often it was sent before
            seven = (*words, *(0.0,) * (7 - len(words)))
            message = mavlink.MAVLink_command_long_message(*to, request.command, before, *seven)
        self._send(request.boat, message)
        request.sent += 1
        request.due_s = now_s + (STOP_REPEAT_S if request.is_stop else REPEAT_S)

    def _end(self, request: Request, well: bool, reason: str) -> None:
        self._waiting.remove(request)
        request.answer(well, reason)


def _same(request: Request, command: int, words: tuple[float, ...]) -> bool:
    """Message intervals are asked for one by one."""
    return request.command == command and (command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL or request.words[0] == words[0])
