"""The addresses of boats. One number is one boat: if two boats use one number, the first one is shown, the other one is
refused and reported, and a stop goes to both.

Two addresses are one boat if they report the same run (PARAM_EXT `BOAT_RUN`): it may have a wireless network and a radio.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from delfim.base.modes import Mode
from delfim.console.boats.boat import SILENT_S
from delfim.console.link.mavlink import BOAT_RUN

Address = Any  # of a link; hashable
DOUBT_S: Final = 2.0  # the time for an address to show that it is the same boat
ANOTHER_S: Final = 15.0  # after this silence of the boat another one may have its number
STOP_S: Final = 60.0  # an address that was heard within this time is told to stop
ASK_S: Final = 1.0
WAYS_MAX: Final = 8  # of one number


@dataclass(slots=True)
class Way:
    """An address that uses a number."""

    since_s: float
    heard_s: float
    mode: int = -1
    run: str = ""
    asked_s: float = -math.inf


class Ways:
    """The addresses of all numbers. `routes` has the address of each boat."""

    def __init__(self) -> None:
        self.routes: dict[int, Address] = {}
        self._ways: dict[int, dict[Address, Way]] = {}

    def hear(self, number: int, address: Address, message: Any, now_s: float) -> bool:
        """Whether the address is the boat, or another one with its number."""
        way = self._way(number, address, now_s)
        if message.get_type() in ("HEARTBEAT", "HIGH_LATENCY2"):
            way.mode = message.custom_mode
        elif message.get_type() == "PARAM_EXT_VALUE" and message.param_id == BOAT_RUN:
            way.run = message.param_value
        boat = self._ways[number].get(self.routes.get(number))
        if boat is None or boat is way or boat.run == way.run != "" or now_s - boat.heard_s > _patience_s(boat, way):
            self.routes[number] = address
            return True
        return False

    def twins(self, number: int, now_s: float) -> list[Address]:
        """The addresses of all boats that use this number now, the one that is shown first; empty if there is only one."""
        ways, route = self._ways[number], self.routes[number]
        boat = ways[route]
        others = [
            address
            for address, way in ways.items()
            if way is not boat
            and now_s - way.heard_s < SILENT_S
            and min(way.heard_s, boat.heard_s) - way.since_s > DOUBT_S
            and not boat.run == way.run != ""
        ]
        return [route, *others] if others and now_s - boat.heard_s < ANOTHER_S else []

    def to_ask(self, now_s: float) -> Iterator[tuple[int, Address]]:
        """Numbers and addresses to ask for their run, each once in a while."""
        for number, ways in self._ways.items():
            for address, way in ways.items() if len(ways) > 1 else ():
                if not way.run and now_s - way.heard_s < SILENT_S and now_s - way.asked_s >= ASK_S:
                    way.asked_s = now_s
                    yield number, address

    def to_stop(self, number: int, now_s: float) -> list[Address]:
        """Every address that may be this boat."""
        ways, route = self._ways.get(number, {}), self.routes.get(number)
        return [address for address, way in ways.items() if address == route or now_s - way.heard_s < STOP_S]

    def are_idle(self, number: int, now_s: float) -> bool:
        """Whether all of them report idle."""
        return all(self._ways[number][address].mode == Mode.IDLE for address in self.to_stop(number, now_s))

    def forget(self, number: int) -> None:
        del self.routes[number], self._ways[number]

    def _way(self, number: int, address: Address, now_s: float) -> Way:
        ways = self._ways.setdefault(number, {})
        way = ways.get(address)
        if way is None or now_s - way.heard_s > SILENT_S:
            way = ways[address] = Way(now_s, now_s) if way is None else Way(now_s, now_s, way.mode, way.run)
        if len(ways) > WAYS_MAX:
            del ways[min(ways.keys() - {self.routes.get(number), address}, key=lambda each: ways[each].heard_s)]
        way.heard_s = now_s
        return way


def _patience_s(boat: Way, other: Way) -> float:
    """How long a boat may be silent before another address is taken for it."""
    return ANOTHER_S if boat.run and other.run else SILENT_S


def in_words(address: Address) -> str:
    """The name of a link, as an operator knows it."""
    return ":".join(map(str, address[1:])) if isinstance(address, tuple) else str(address)
