"""Orders without an answer yet: repeated until the boat answers, or until they are too old.

An order goes to the boat as the page said it, in the boat's own words, with a number by which it is obeyed once however often
it comes. A stop or a kill is a command of MAVLink, which boats of other versions obey, too, and is repeated five times a second
for as long as it takes (a minute at most): it is right whenever it arrives. It ends when the boat has answered and then
reports idle. On a quick link an order goes twice at once.
"""

import json
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.console.link.mavlink import mavlink, ownorders
from delfim.vehicle import console

REPEAT_S: Final = 0.5  # with a third of all tries lost, one order in 6,000 is given up; with 1.0 it is one in 80
QUICK_S: Final = 0.1  # of a round trip: where it is no longer, ...
SOON_S: Final = 0.01  # ... the second try comes with the next tick: with 5 % lost each way one order in ten needs it
LIFE_S: Final = 4.0  # the operator no longer means a command that arrives later
STOP_REPEAT_S: Final = 0.2
STOP_LIFE_S: Final = 60.0
AUTOPILOT: Final = mavlink.MAV_COMP_ID_AUTOPILOT1
HALTS: Final[dict[str, tuple[int, tuple[float, ...]]]] = {  # MAVLink's command, and its numbers
    "stop": (mavlink.MAV_CMD_DO_SET_MODE, (1.0, float(Mode.IDLE))),
    "kill": (mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (1.0,)),
}
NO_ANSWER: Final = "no answer from the boat"
DECIMALS: Final = 7  # of a number: a centimetre on Earth
Answer = Callable[[bool, str], None]


def entered(word: str, words: Mapping[str, Any]) -> str:
    """The mode that the boat enters by this order; empty: none, or this console does not know the order."""
    kind = console.KINDS.get(word)
    return str(words.get("mode", "")) if kind is console.SetMode else kind.ENTERS if kind is not None else ""


def line(word: str, words: Mapping[str, Any]) -> bytes:
    """The order as the boat reads it. Raises FormatError for infinity, which is no JSON and which others read as null."""
    try:
        rounded = json.loads(json.dumps(words, allow_nan=False), parse_float=lambda text: round(float(text), DECIMALS))
    except ValueError:
        raise FormatError(f"{word}: infinity is no number") from None
    return json.dumps({"command": word} | rounded, separators=(",", ":")).encode()


@dataclass(slots=True)
class Request:
    """One order on its way."""

    boat: int
    word: str
    mode: str  # that the boat enters by it
    number: int
    line: bytes
    answer: Answer
    begun_s: float
    answered: dict[Any, int] = field(default_factory=dict)  # by link: the number of the frame by which a boat took a stop
    due_s: float = 0.0
    sent: int = 0

    @property
    def is_stop(self) -> bool:
        return self.word in HALTS

    def replaces(self, old: "Request") -> bool:
        """A newer order replaces the older one of its kind, one for another mode, too; a stop replaces all."""
        return old.boat == self.boat and (self.is_stop or old.word == self.word or bool(old.mode and self.mode))


class Requests:
    """All requests. `send` sends a message to a boat, `send_all` to every address that uses its number; `rtt_s` is the round
    trip to a boat, s, infinite where it is not known."""

    def __init__(
        self, send: Callable[[int, Any], None], send_all: Callable[[int, Any], None], rtt_s: Callable[[int], float]
    ) -> None:
        self._send, self._send_all, self._rtt_s = send, send_all, rtt_s
        self._waiting: list[Request] = []
        self._number = secrets.randbits(32)  # no boat takes it for an order of the run before

    def wait_for(self, boat: int) -> bool:
        """Whether an order to this boat is under way."""
        return any(each.boat == boat for each in self._waiting)

    def begin(self, boat: int, word: str, words: Mapping[str, Any], answer: Answer, now_s: float) -> None:
        """Raises FormatError for an order that cannot be sent."""
        if word in HALTS and words:
            raise FormatError(f"{word} takes nothing")
        number = (self._number + 1) & 0xFFFFFFFF
        request = Request(boat, word, entered(word, words), number, line(word, words), answer, now_s)
        message = self._message(request)
        for old in [each for each in self._waiting if request.replaces(each)]:
            self._end(old, False, "replaced by a newer command")
        self._number = number
        self._waiting.append(request)
        self._repeat(request, message, now_s)

    def answered(self, boat: int, number: int, refused: str) -> None:
        """The boat answered the order of this number."""
        for request in [each for each in self._waiting if (each.boat, each.number) == (boat, number)]:
            self._end(request, not refused, refused)

    def acknowledged(self, boat: int, command: int, accepted: bool, link: Any, frame: int) -> None:
        """The boat answered a command of MAVLink by the frame of this number."""
        for request in [each for each in self._waiting if each.boat == boat and HALTS.get(each.word, (0,))[0] == command]:
            if accepted:
                request.answered[link] = frame
            else:
                self._end(request, False, "the boat does not take it")

    def idle(self, boat: int, link: Any, frame: int) -> None:
        """The boat said by the frame of this number that it is idle."""
        for request in [each for each in self._waiting if each.boat == boat and link in each.answered]:
            if (frame - request.answered[link]) & 0xFF < 128:
                self._end(request, True, "")

    def tick(self, now_s: float) -> None:
        """Called often: repeats requests without an answer, and gives up old ones."""
        for request in list(self._waiting):
            if now_s - request.begun_s > (STOP_LIFE_S if request.is_stop else LIFE_S):
                said = NO_ANSWER if not request.answered else "the boat took the stop but is not idle"
                self._end(request, False, said)
            elif now_s >= request.due_s:
                self._repeat(request, self._message(request), now_s)

    def _message(self, request: Request) -> Any:
        if not request.is_stop:
            return ownorders.order((request.boat, AUTOPILOT), request.number, request.line)
        command, numbers = HALTS[request.word]
        before = min(request.sent, 255)  # "confirmation": how often it was sent before
        numbers = (*numbers, *(0.0,) * (7 - len(numbers)))
        return mavlink.MAVLink_command_long_message(request.boat, AUTOPILOT, command, before, *numbers)

    def _repeat(self, request: Request, message: Any, now_s: float) -> None:
        (self._send_all if request.is_stop else self._send)(request.boat, message)
        request.sent += 1
        is_soon = request.sent == 1 and self._rtt_s(request.boat) <= QUICK_S
        request.due_s = now_s + (STOP_REPEAT_S if request.is_stop else SOON_S if is_soon else REPEAT_S)

    def _end(self, request: Request, well: bool, reason: str) -> None:
        self._waiting.remove(request)
        request.answer(well, reason)
