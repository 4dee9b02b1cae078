"""Commands without an answer yet: repeated until the boat answers, or until they are too old.

A stop is repeated five times a second for as long as it takes (a minute at most): it is right whenever it arrives. It ends
when the boat has answered and then reports idle: the answer alone may belong to an earlier request for a mode.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from delfim.console.mavlink import mavlink
from delfim.console.orders import CommandLong

REPEAT_S: Final = 1.0
LIFE_S: Final = 4.0  # the operator no longer means a command that arrives later
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
    order: CommandLong
    answer: Answer
    begun_s: float
    is_stop: bool = False
    answered: int | None = None  # number of the frame by which a boat took a stop
    due_s: float = 0.0
    sent: int = 0


class Requests:
    """All requests. `send` sends a message to a boat, `send_all` to every address that uses its number."""

    def __init__(self, send: Callable[[int, Any], None], send_all: Callable[[int, Any], None]) -> None:
        self._send, self._send_all = send, send_all
        self._waiting: list[Request] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def wait_for(self, boat: int) -> bool:
        """Whether a command to this boat is under way."""
        return any(each.boat == boat for each in self._waiting)

    def begin(
        self,
        boat: int,
        order: CommandLong,
        answer: Answer,
        now_s: float,
        *,
        stop: bool = False,
    ) -> None:
        """A newer command of the same kind to the same boat replaces the older one. A stop replaces all of them."""
        for old in [each for each in self._waiting if each.boat == boat and (stop or each.order.command == order.command)]:
            self._end(old, False, "replaced by a newer command")
        request = Request(boat, order, answer, now_s, stop)
        self._waiting.append(request)
        self._repeat(request, now_s)

    def acknowledged(self, boat: int, command: int, result: int, reason: str, frame: int) -> None:
        """The boat answered by the frame of this number. `reason` is its last text."""
        for request in [each for each in self._waiting if each.boat == boat and each.order.command == command]:
            if result == mavlink.MAV_RESULT_IN_PROGRESS:
                continue
            if result == mavlink.MAV_RESULT_ACCEPTED and request.is_stop:
                request.answered = frame
            elif result == mavlink.MAV_RESULT_ACCEPTED:
                self._end(request, True, "")
            else:
                self._end(request, False, reason or RESULTS.get(result, f"result {result}"))

    def idle(self, boat: int, frame: int) -> None:
        """The boat said by the frame of this number that it is idle."""
        for request in [each for each in self._waiting if each.boat == boat and each.answered is not None]:
            if (frame - (request.answered or 0)) & 0xFF < 128:
                self._end(request, True, "")

    def tick(self, now_s: float) -> None:
        """Called often: repeats requests without an answer, and gives up old ones."""
        for request in list(self._waiting):
            if now_s - request.begun_s > (STOP_LIFE_S if request.is_stop else LIFE_S):
                said = "no answer from the boat" if request.answered is None else "the boat took the stop but is not idle"
                self._end(request, False, said)
            elif now_s >= request.due_s:
                self._repeat(request, now_s)

    def _repeat(self, request: Request, now_s: float) -> None:
        to, order = (request.boat, mavlink.MAV_COMP_ID_AUTOPILOT1), request.order
        numbers = (*order.numbers, *(0.0,) * (7 - len(order.numbers)))
        if order.place is not None:
            frame = mavlink.MAV_FRAME_GLOBAL_INT
            message = mavlink.MAVLink_command_int_message(*to, frame, order.command, 0, 0, *numbers[:4], *order.place, 0.0)
        else:
            before = min(request.sent, 255)  # "confirmation": how often it was sent before
            message = mavlink.MAVLink_command_long_message(*to, order.command, before, *numbers)
        (self._send_all if request.is_stop else self._send)(request.boat, message)
        request.sent += 1
        request.due_s = now_s + (STOP_REPEAT_S if request.is_stop else REPEAT_S)

    def _end(self, request: Request, well: bool, reason: str) -> None:
        self._waiting.remove(request)
        request.answer(well, reason)
