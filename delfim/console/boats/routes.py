"""The addresses of boats. One number is one boat: if two boats use one number, the first one is shown, the other one is
refused and reported, and a stop goes to both.

Two addresses are one boat if they report the same run (PARAM_EXT `BOAT_RUN`): it may have a wireless network and a radio. Then
each is a link to it, and is asked for the time again and again: the better one is that on which no answer is overdue, and the
last one took less time. What the boat tells counts on that link, answers on any.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from delfim.base.modes import Mode
from delfim.console.boats.boat import SILENT_S
from delfim.console.link.mavlink import BOAT_RUN
from delfim.console.link.reception import Reception

Address = Any  # of a link; hashable
DOUBT_S: Final = 2.0  # the time for an address to show that it is the same boat
ANOTHER_S: Final = 15.0  # after this silence of the boat another one may have its number
STOP_S: Final = 60.0  # an address that was heard within this time is told to stop
ASK_S: Final = 1.0
WAYS_MAX: Final = 8  # of one number
SYNC_S: Final = 5.0  # between two questions for the time, on the one link
USED_S, SPARE_S = 0.2, 1.0  # the same where there are several: on the one in use or that owes an answer, and on the others
OVERDUE_S, LOST_S = 0.15, 1.2  # so much later than the last one came an answer is overdue: on the link in use, and on others
LONGEST_S: Final = 0.7  # for an answer on the link in use, however long the last one took
BETTER_S: Final = 0.1  # by less than this another link is no better


@dataclass(slots=True)
class Way:
    """An address that uses a number."""

    since_s: float
    heard_s: float
    reception: Reception
    mode: int = -1
    run: str = ""
    asked_s: float = -math.inf
    synced_s: float = -math.inf  # the last question for the time
    rtt_s: float = math.inf  # of the last answer
    waits_s: float = math.inf  # since when an answer is waited for

    @property
    def rtt_ms(self) -> float | None:
        return round(1e3 * self.rtt_s, 1) if self.rtt_s < math.inf else None

    def delay_s(self, now_s: float, patience_s: float) -> float:
        """How long an answer takes; infinity where one is waited for longer than this."""
        return math.inf if now_s - self.waits_s > patience_s else self.rtt_s


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
        elif message.get_type() == "TIMESYNC" and message.tc1:
            way.rtt_s, way.waits_s = max(now_s - message.ts1 / 1e9, 0.0), math.inf
        way.reception.count(message, now_s)
        boat = self._ways[number].get(self.routes.get(number))
        if boat is None or now_s - boat.heard_s > _patience_s(boat, way):
            self.routes[number] = address
            return True
        return boat is way or boat.run == way.run != ""

    def links(self, number: int, now_s: float) -> dict[Address, Way]:
        """The links to one boat, the one in use among them: those on which it was heard lately."""
        ways, route = self._ways.get(number, {}), self.routes.get(number)
        boat = ways.get(route)
        return {
            address: way
            for address, way in ways.items()
            if way is boat or (boat is not None and boat.run == way.run != "" and now_s - way.heard_s < ANOTHER_S)
        }

    def used(self, number: int) -> tuple[Address, Way]:
        """The link in use."""
        return self.routes[number], self._ways[number][self.routes[number]]

    def shown(self, number: int, now_s: float) -> list[dict[str, Any]]:
        """All links to a boat, for the page."""
        return [
            {
                "kind": address_kind(address),
                "place": in_words(address),
                "used": address == self.routes[number],
                "rtt_ms": way.rtt_ms,
                "loss_pct": way.reception.loss_pct(now_s),
                "age_s": round(now_s - way.heard_s, 2),
            }
            for address, way in self.links(number, now_s).items()
        ]

    def choose(self, number: int, now_s: float) -> bool:
        """The best of the links is the one in use from now on. Whether it is another one than before."""
        links = self.links(number, now_s)
        if len(links) < 2:
            return False
        delays_s = {each: way.delay_s(now_s, way.rtt_s + LOST_S) for each, way in links.items() if each != self.routes[number]}
        best = min(delays_s, key=lambda each: delays_s[each])
        used = links[self.routes[number]]
        is_better = delays_s[best] < used.delay_s(now_s, min(used.rtt_s + OVERDUE_S, LONGEST_S)) - BETTER_S
        if is_better:
            self.routes[number] = best
        return is_better

    def to_sync(self, number: int, now_s: float) -> Iterator[Address]:
        """The addresses of one boat that are asked for the time now."""
        links = self.links(number, now_s)
        for address, way in links.items():
            is_urgent = address == self.routes[number] or way.waits_s < now_s
            every_s = SYNC_S if len(links) < 2 else USED_S if is_urgent else SPARE_S
            if now_s - way.synced_s >= every_s:
                way.synced_s, way.waits_s = now_s, min(way.waits_s, now_s)
                yield address

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

    def are_idle(self, number: int, address: Address, now_s: float) -> bool:
        """Whether all of them report idle; of one boat on several links, by the one on which it was heard now."""
        ways = self._ways[number]
        others = [each for each in self.to_stop(number, now_s) if not ways[each].run == ways[address].run != ""]
        return all(ways[each].mode == Mode.IDLE for each in (address, *others))

    def forget(self, number: int) -> None:
        del self.routes[number], self._ways[number]

    def _way(self, number: int, address: Address, now_s: float) -> Way:
        ways = self._ways.setdefault(number, {})
        way = ways.get(address)
        if way is None or now_s - way.heard_s > SILENT_S:
            reception = Reception(now_s) if way is None else way.reception
            way = ways[address] = Way(now_s, now_s, reception, *((way.mode, way.run) if way is not None else ()))
        if len(ways) > WAYS_MAX:
            del ways[min(ways.keys() - {self.routes.get(number), address}, key=lambda each: ways[each].heard_s)]
        way.heard_s = now_s
        return way


def _patience_s(boat: Way, other: Way) -> float:
    """How long a boat may be silent before another address is taken for it."""
    return ANOTHER_S if boat.run and other.run and boat.run != other.run else SILENT_S


def in_words(address: Address) -> str:
    """The name of a link, as an operator knows it."""
    return ":".join(map(str, address[1:])) if isinstance(address, tuple) else str(address)


def address_kind(address: Address) -> str:
    """The kind of a link: the first word of its addresses."""
    return address[0] if isinstance(address, tuple) else "udp"
