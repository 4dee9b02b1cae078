"""Missions to a boat and back: MAVLink's mission protocol, the console's half.

Both directions repeat what gets no answer; a boat that says nothing for TIMEOUT_S ends the transfer with a reason. Nothing that
arrives twice or out of order does any harm.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from delfim.console.link.mavlink import FENCE, ITEMS, MISSION, RALLY, Item, mavlink
from delfim.console.plans.plan import item_in

REPEAT_S: Final = 1.5
TIMEOUT_S: Final = 60.0
REFUSED: Final = "refused: "  # begins the reason of a transfer that the boat ended
ORDER: Final = (FENCE, RALLY, MISSION)  # the boat forgets a mission that a new fence cuts, so the mission comes last
SAILING: Final = (MISSION, FENCE, RALLY)  # it refuses a fence that cuts the mission it sails: that gets out of its way first


Ended = Callable[[str], None]  # with the reason; empty on success


class OutgoingItems:
    """Items of one type to one boat."""

    what = "upload"

    def __init__(self, boat: int, kind: int, items: Sequence[Item], send: Callable[[Any], None], ended: Ended) -> None:
        self.boat, self.kind = boat, kind
        self.part = 0.0  # of it done, 0..1
        self._items, self._send, self._ended = items, send, ended
        self._asked_for = -1
        self._heard_s: float | None = None
        self._due_s = 0.0

    def tick(self, now_s: float) -> None:
        """Announces the transfer, or repeats the last message without an answer."""
        if self._heard_s is None:
            self._heard_s = now_s
        if now_s - self._heard_s > TIMEOUT_S:
            self._ended("no answer from the boat")
        elif now_s >= self._due_s:
            self._say(now_s)

    def receive(self, message: Any, now_s: float) -> None:
        """MISSION_REQUEST, MISSION_REQUEST_INT or MISSION_ACK of this boat and type."""
        self._heard_s = now_s
        if message.get_type() == "MISSION_ACK":
            well = message.type == mavlink.MAV_MISSION_ACCEPTED
            if well and self._asked_for < len(self._items) - 1:
                return  # a late answer to an earlier upload
            self._ended("" if well else f"{REFUSED}{_result(message.type)}")
        elif 0 <= message.seq < len(self._items):
            self._asked_for = message.seq
            self.part = message.seq / len(self._items)
            self._say(now_s)

    def _say(self, now_s: float) -> None:
        self._due_s = now_s + REPEAT_S
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._asked_for < 0:
            self._send(mavlink.MAVLink_mission_count_message(self.boat, component, len(self._items), self.kind))
            return
        n, item = self._asked_for, self._items[self._asked_for]
        frame = mavlink.MAV_FRAME_GLOBAL_INT
        numbers = item.p1, item.p2, item.p3, item.p4, item.x, item.y, item.z
        to = self.boat, component
        self._send(mavlink.MAVLink_mission_item_int_message(*to, n, frame, item.command, int(n == 0), 1, *numbers, self.kind))


class Download:
    """Items of one type from one boat: `items` when it has ended well."""

    what = "download"

    def __init__(self, boat: int, kind: int, send: Callable[[Any], None], ended: Ended) -> None:
        self.boat, self.kind = boat, kind
        self.items: list[Item] = []
        self.part = 0.0
        self._send, self._ended = send, ended
        self._count = -1
        self._heard_s: float | None = None
        self._due_s = 0.0

    def tick(self, now_s: float) -> None:
        if self._heard_s is None:
            self._heard_s = now_s
        if now_s - self._heard_s > TIMEOUT_S:
            self._ended("no answer from the boat")
        elif now_s >= self._due_s:
            self._ask(now_s)

    def receive(self, message: Any, now_s: float) -> None:
        """MISSION_COUNT, MISSION_ITEM_INT or MISSION_ACK of this boat and type."""
        self._heard_s = now_s
        kind = message.get_type()
        if kind == "MISSION_ACK":
            if message.type != mavlink.MAV_MISSION_ACCEPTED:  # acceptance is a late answer to an upload
                self._ended(f"{REFUSED}{_result(message.type)}")
        elif kind == "MISSION_COUNT" and self._count < 0:
            if message.count > ITEMS:
                self._ended(f"the boat has {message.count} items, the console takes {ITEMS} at most")
                return
            self._count = message.count
            self._go_on(now_s)
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self.items) < self._count:
            self.items.append(item_in(message))
            self.part = len(self.items) / self._count
            self._go_on(now_s)

    def _go_on(self, now_s: float) -> None:
        if len(self.items) < self._count:
            self._ask(now_s)
            return
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        self._send(mavlink.MAVLink_mission_ack_message(self.boat, component, mavlink.MAV_MISSION_ACCEPTED, self.kind))
        self._ended("")

    def _ask(self, now_s: float) -> None:
        self._due_s = now_s + REPEAT_S
        component = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._count < 0:
            self._send(mavlink.MAVLink_mission_request_list_message(self.boat, component, self.kind))
        else:
            self._send(mavlink.MAVLink_mission_request_int_message(self.boat, component, len(self.items), self.kind))


def _result(number: int) -> str:
    entry = mavlink.enums["MAV_MISSION_RESULT"].get(number)
    return entry.name.removeprefix("MAV_MISSION_").lower().replace("_", " ") if entry else f"result {number}"
