"""The links' profiles: how much each boat sends, as it tells and as the operator chooses."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.console.boats.boat import Boat
from delfim.console.boats.requests import LIFE_S, REPEAT_S, Answer
from delfim.console.link.mavlink import mavlink

PROFILES: Final = ("lean", "radio", "wifi")  # values of the parameter that chooses
PROFILE: Final = b"LINK_PROFILE"


class AskedProfile(NamedTuple):
    """One that is requested and not yet confirmed."""

    name: str
    answer: Answer
    begun_s: float
    due_s: float


class Profiles:
    """`send` sends a message to a boat."""

    def __init__(self, send: Callable[[int, Any], None]) -> None:
        self._send = send
        self._asked: dict[int, AskedProfile] = {}

    def forget(self, number: int) -> None:
        self._asked.pop(number, None)

    def ask(self, number: int) -> None:
        """Asks which one it is."""
        self._send(number, mavlink.MAVLink_param_request_read_message(number, mavlink.MAV_COMP_ID_AUTOPILOT1, PROFILE, -1))

    def hear(self, boat: Boat, message: Any) -> None:
        """Takes a PARAM_VALUE."""
        if message.param_id != PROFILE.decode() or message.param_value not in range(len(PROFILES)):
            return
        boat.profile = PROFILES[int(message.param_value)]
        if (chosen := self._asked.pop(boat.number, None)) is not None:
            well = boat.profile == chosen.name
            chosen.answer(well, "" if well else f"the boat keeps profile {boat.profile}")

    def choose(self, number: int, profile: str, answer: Answer, now_s: float) -> None:
        """Raises FormatError."""
        if profile not in PROFILES:
            raise FormatError(f"no profile {profile!r}: there are {', '.join(PROFILES)}")
        before = self._asked.pop(number, None)
        if before is not None:
            before.answer(False, "replaced by a newer choice")
        self._asked[number] = AskedProfile(profile, answer, now_s, now_s)
        self.tick(now_s)

    def tick(self, now_s: float) -> None:
        """Sends the requests, repeats them, or gives them up."""
        for number, chosen in list(self._asked.items()):
            if now_s - chosen.begun_s > LIFE_S:
                del self._asked[number]
                chosen.answer(False, "no answer from the boat")
            elif now_s >= chosen.due_s:
                self._asked[number] = chosen._replace(due_s=now_s + REPEAT_S)
                to, value = (number, mavlink.MAV_COMP_ID_AUTOPILOT1), float(PROFILES.index(chosen.name))
                self._send(number, mavlink.MAVLink_param_set_message(*to, PROFILE, value, mavlink.MAV_PARAM_TYPE_REAL32))
