"""Thrust by hand. One page at a time drives a boat: the one that asked for manual last, or that gave thrust first. What any
other page gives is left out, and each page is told who drives.

The page's input is passed on as it comes and never repeated; when none came for INPUT_S the boat gets zero once, then nothing.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from delfim.console.boats.boat import Boat
from delfim.console.link.mavlink import mavlink

INPUT_S: Final = 0.6
UNUSED: Final = 32767  # of an axis in MANUAL_CONTROL


class Drivers:
    """`send` sends a message to a boat, `say` tells the pages something about one, with its severity."""

    def __init__(self, send: Callable[[int, Any], None], say: Callable[[int, int, str], None]) -> None:
        self._send, self._say = send, say
        self._pages: dict[int, int] = {}  # by boat: the number of the page that drives it
        self._inputs: dict[int, tuple[int, float]] = {}  # by boat in manual: number and time of the last input

    def page_of(self, number: int) -> int:
        """The page that drives a boat; 0: none."""
        return self._pages.get(number, 0)

    def begin(self, boat: Boat, page: int) -> None:
        """A page asked for manual: it drives from now on."""
        if self.page_of(boat.number) not in (0, page):
            self.release(boat, "another page drives")
        self._pages[boat.number] = page

    def end(self, number: int) -> None:
        """The boat was told to do something else."""
        self._pages.pop(number, None)
        self._inputs.pop(number, None)

    def input(self, boat: Boat, page: int, count: int, port_pct: float, starboard_pct: float, now_s: float) -> None:
        """Sends thrust at once. An input older than the last one is left out."""
        last, _ = self._inputs.get(boat.number, (-1, 0.0))
        if self._pages.setdefault(boat.number, page) != page or count <= last:
            return
        if math.isfinite(port_pct) and math.isfinite(starboard_pct):
            self._inputs[boat.number] = count, now_s
            boat.released = False
            self._thrust(boat.number, port_pct, starboard_pct)

    def late(self, now_s: float) -> list[int]:
        """The boats whose page fell silent."""
        return [number for number, (_, heard_s) in self._inputs.items() if now_s - heard_s > INPUT_S]

    def driven(self) -> list[int]:
        return list(self._pages)

    def release(self, boat: Boat, why: str) -> None:
        """Zero once, then silence."""
        was_driven = boat.number in self._inputs
        self.end(boat.number)
        if was_driven:
            self._thrust(boat.number, 0.0, 0.0)
            boat.released = True
            self._say(boat.number, 4, f"manual thrust set to 0: {why}")

    def _thrust(self, number: int, port_pct: float, starboard_pct: float) -> None:
        port, starboard = (max(-100.0, min(100.0, each)) for each in (port_pct, starboard_pct))
        x, r = round(5.0 * (port + starboard)), round(5.0 * (port - starboard))
        self._send(number, mavlink.MAVLink_manual_control_message(number, x, UNUSED, UNUSED, r, 0))
