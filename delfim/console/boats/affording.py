"""Whether the mission aboard fits the energy that is left, asked of the boat before it is sailed: what it told by itself
may be of the mission before."""

from collections.abc import Callable
from typing import Any, Final

AGAIN_S: Final = 0.7  # an answer may be lost, or the boat has not reckoned the new mission yet
GIVE_UP_S: Final = 4.0

Answer = Callable[[bool, str], None]


def shortage(energy: dict[str, Any]) -> str:
    """What a mission lacks, in words; empty where it fits, or where that is not known."""
    left_wh, plan_wh, reserve_wh = (energy.get(key) for key in ("left_wh", "plan_wh", "reserve_wh"))
    if left_wh is None or plan_wh is None or left_wh - plan_wh >= (reserve_wh or 0.0):
        return ""
    return (
        f"takes {plan_wh:.0f} Wh with the way home, {left_wh:.0f} Wh are left, and {reserve_wh or 0.0:.0f} Wh are the reserve"
    )


class EnergyAsks:
    """Boats that were asked, and who waits for it. `ask` asks a boat for what it reckons."""

    def __init__(self, ask: Callable[[int], None]) -> None:
        self._ask = ask
        self._waiting: dict[int, tuple[float, float, list[Answer]]] = {}  # by boat: asked first and last, s

    def begin(self, number: int, answer: Answer, now_s: float) -> None:
        """Ask a boat; `answer` is called once: False with what lacks, or True."""
        first_s, _, answers = self._waiting.get(number, (now_s, now_s, []))
        self._waiting[number] = first_s, now_s, [*answers, answer]
        self._ask(number)

    def hear(self, number: int, energy: dict[str, Any]) -> None:
        """What a boat told; what it does not know yet is waited for."""
        if number in self._waiting and (energy.get("plan_wh") is not None or energy.get("left_wh") is None):
            self._end(number, shortage(energy))

    def tick(self, now_s: float) -> None:
        for number, (first_s, last_s, answers) in list(self._waiting.items()):
            if now_s - first_s >= GIVE_UP_S:
                self._end(number, "")
            elif now_s - last_s >= AGAIN_S:
                self._waiting[number] = first_s, now_s, answers
                self._ask(number)

    def _end(self, number: int, lacks: str) -> None:
        for answer in self._waiting.pop(number)[2]:
            answer(not lacks, lacks)
