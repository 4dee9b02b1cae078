"""Routing of DSOR messages between CAN buses (thesis 5.2.6), frame by frame, by a table of which node is on which bus.

A frame goes on only from the bus where its source is to the bus where its destination is. So a message that goes on is heard on
a bus where its source is not, and goes no further: there are no loops. Ends acknowledge to each other through the router,
which keeps no state. docs/dsor.md says what travels.
"""

import contextlib
from collections.abc import Mapping
from typing import Final

from delfim.base.clock import Clock
from delfim.base.errors import BusError
from delfim.base.frames import CAN_IDE, Frame
from delfim.canproxy.dsor.protocol import (
    ACK_FRAME,
    BROADCAST,
    DESTINATION_AT,
    FRAME_TYPE,
    KIND_AT,
    PRIORITY_AT,
    SEQUENCE_AT,
    SOURCE_AT,
    Kind,
    ack_filter,
    message_filter,
)
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.canproxy.tables import Routing

FRAMES_A_CALL: Final = 8
_ROUTED: Final = frozenset(kind << KIND_AT | CAN_IDE for kind in Kind if kind is not Kind.PLAIN)


class Router:
    """Routes between the sockets of all buses, by their names. `home` is the bus of the nodes that the table does not name."""

    def __init__(self, table: Routing, home: str, sockets: Mapping[str, CanSocket], clock: Clock) -> None:
        """Binds the sockets, which stay the caller's to close. Raises BusError, FormatError."""
        self._sockets, self._home, self._clock = dict(sockets), home, clock
        self._bus_of = {node: bus.interface for bus in table.buses.values() for node in bus.nodes}
        self._everybody = frozenset(table.everybody)
        self._per_s, self._left, self._at_s = table.frames_per_s, float(table.frames_per_s), clock.monotonic_s()
        self._failed = set[str]()
        self.counts = {name: {"from": 0, "to": 0, "lost": 0, "astray": 0} for name in self._sockets}
        for name, can in self._sockets.items():
            can.setblocking(False)
            can.bind(*self._filters(name))

    def on_readable(self, name: str) -> None:
        """Route a few of the frames that wait on a bus."""
        try:
            for _ in range(FRAMES_A_CALL):
                frame = self._sockets[name].receive()
                if frame is None:
                    return
                for to in self._ways(name, frame.arb):
                    self._send(to, frame)
        except BusError:
            self._failed.add(name)

    def poll(self) -> None:
        """Reopen buses that failed; call it about once a second."""
        self._failed = {name for name in self._failed if not self._sockets[name].rebind()}

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: for each bus the frames that were taken from it and put on it; lost for want of room or
        beyond the limit; astray, of a source that the table has on another bus."""
        return {"buses": self.counts}

    def _ways(self, name: str, arb: int) -> list[str]:
        """The buses to which a frame from this bus goes."""
        if arb & FRAME_TYPE not in _ROUTED:
            return []
        source, destination = arb >> SOURCE_AT & 0x7F, arb >> DESTINATION_AT & 0x7F
        if destination == BROADCAST:
            ways = [each for each in self._sockets if each != name] if source in self._everybody else []
        else:
            to = self._bus_of.get(destination, self._home)
            ways = [to] if to != name else []
        if ways and self._bus_of.get(source, self._home) != name:
            self.counts[name]["astray"] += 1
            return []
        self.counts[name]["from"] += bool(ways)
        return ways

    def _send(self, to: str, frame: Frame) -> None:
        now_s = self._clock.monotonic_s()
        self._left = min(self._left + (now_s - self._at_s) * self._per_s, self._per_s)
        self._at_s = now_s
        if self._left >= 1.0:
            self._left -= 1.0
            with contextlib.suppress(BlockingIOError):
                try:
                    self._sockets[to].sendto(frame.data, CanAddress(frame.arb))  # by its own interface
                    self.counts[to]["to"] += 1
                    return
                except BusError:
                    self._failed.add(to)
        self.counts[to]["lost"] += 1  # an end that waits for it repeats its frame

    def _filters(self, name: str) -> list[CanAddress]:
        """The filters of a bus: from the nodes that the table has there; at home, to nodes that are not there."""
        if name == self._home:
            there = [each for node in self._bus_of for each in (message_filter(destination=node), ack_filter(node))]
            everybody = [message_filter(node, BROADCAST) for node in self._everybody if node not in self._bus_of]
            return [CanAddress(*each) for each in (*there, *everybody)]
        nodes = [node for node, bus in self._bus_of.items() if bus == name]
        return [CanAddress(*each) for node in nodes for each in (message_filter(source=node), _acks_from(node))]


def _acks_from(node: int) -> tuple[int, int]:
    mask = 0xFF << PRIORITY_AT | 0x7F << DESTINATION_AT | 31 << SEQUENCE_AT
    return node << SOURCE_AT | ACK_FRAME, mask
