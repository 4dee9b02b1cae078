"""The plans of all boats: those on the screen, those aboard, and the transfers between the two."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from delfim.base.errors import Refused
from delfim.console.boats.boat import SILENT_S, Boat
from delfim.console.boats.item_transfer import ORDER, SAILING, Download, OutgoingItems
from delfim.console.boats.requests import Answer
from delfim.console.link.mavlink import FENCE, MISSION, Item
from delfim.console.plans import plan

READ_AGAIN_S: Final = 10.0  # plans that could not be read
NO_MISSION: Final[dict[str, Any]] = {"name": "", "count": 0, "current": None, "state": "none", "digest": None}
NO_ZONES: Final[dict[str, Any]] = {"home": None, "fence": [], "obstacles": [], "zones": []}
ASKED: Final = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
SAILS: Final = ("play", "path")
SAID: Final = (*ASKED, "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK")  # by a boat, of its plans


def planned(boat: Boat, missions: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """A boat's missions for the page: the one that is "here", and the one that was read from "aboard"."""
    here, aboard = missions.get("here"), missions.get("aboard")
    shown = aboard or here
    if shown is None:
        return {"mission": NO_MISSION | {"state": "unknown"}, **NO_ZONES}
    same = here is not None and aboard is not None and here["digest"] == aboard["digest"]
    state = "unknown" if aboard is None else "same" if same or here is None else "differs"
    told = {"name": shown["name"], "count": len(shown["waypoints"]), "digest": shown["digest"], "state": state}
    item = boat.reference.get("leg")
    told["current"] = plan.waypoint_of(shown, item) if item is not None else None
    return {"mission": told, **{key: (aboard or NO_ZONES).get(key) for key in NO_ZONES}}  # zones of the plan are not aboard yet


class Exchange:
    """`send` sends a message to a boat; `tell` informs the pages."""

    def __init__(self, send: Callable[[int, Any], None], tell: Callable[[dict[str, Any]], None]) -> None:
        self.missions: dict[int, dict[str, dict[str, Any]]] = {}  # by boat: "here" and "aboard"
        self._send, self._tell = send, tell
        self._transfers: dict[int, OutgoingItems | Download] = {}
        self._reading = set[int]()  # boats whose plans are read without a request

    def forget(self, number: int) -> None:
        self.missions.pop(number, None)
        self._transfers.pop(number, None)
        self._reading.discard(number)

    def receive(self, boat: Boat, message: Any, now_s: float) -> None:
        """Takes one of the messages in SAID."""
        under_way = self._transfers.get(boat.number)
        if under_way is not None and message.mission_type == under_way.kind:
            wanted = ("MISSION_COUNT", "MISSION_ITEM_INT") if isinstance(under_way, Download) else ASKED
            if message.get_type() in (*wanted, "MISSION_ACK"):
                under_way.receive(message, now_s)

    def tick(self, now_s: float) -> None:
        for each in list(self._transfers.values()):
            each.tick(now_s)

    def read(self, boat: Boat, now_s: float) -> None:
        """Reads the plans aboard if they are unknown or have changed, so that pages can draw the mission that is sailed."""
        known = "aboard" in self.missions.get(boat.number, {}) and boat.read == boat.checksum
        if known or boat.number in self._transfers or now_s < boat.read_due_s or now_s - boat.heard_s > SILENT_S:
            return
        boat.read_due_s = now_s + READ_AGAIN_S
        self.download(boat, lambda well, why: self._reading.discard(boat.number))
        self._reading.add(boat.number)

    def put(self, number: int, mission: dict[str, Any]) -> None:
        """Takes the plan on the screen for a boat. Raises FormatError."""
        self.missions.setdefault(number, {})["here"] = plan.with_digest(mission)

    def upload(self, boat: Boat, answer: Answer) -> None:
        """Sends the plan on the screen to the boat, and reads it back to compare. To a boat that sails its mission and gets
        another fence, too: in the other order, if the first is refused. Raises Refused.
        """
        number = boat.number
        mission = self.missions.get(number, {}).get("here")
        if mission is None:
            raise Refused("the boat has no plan to send")
        self._begin(number)
        groups, aboard = plan.items_of(mission), self.missions[number].get("aboard")
        fenced = aboard is not None and plan.items_of(aboard)[FENCE] == groups[FENCE]
        orders = [ORDER] if fenced or boat.mode not in SAILS else [SAILING, ORDER]

        def next_kind(place: int) -> None:
            kind = orders[0][place]

            def ended(reason: str) -> None:
                self._transfers.pop(number, None)
                if reason and place == 0 and orders[1:]:
                    orders.pop(0)
                    next_kind(0)
                elif reason:
                    self._over(number, "upload")
                    answer(False, reason)
                elif place + 1 < len(ORDER):
                    next_kind(place + 1)
                else:
                    self.download(boat, lambda well, why: answer(*self._compared(number, well, why)))

            self._transfers[number] = OutgoingItems(number, kind, groups[kind], lambda m: self._send(number, m), ended)

        next_kind(0)

    def download(self, boat: Boat, answer: Answer) -> None:
        """Reads the mission aboard. Raises Refused."""
        number = boat.number
        self._begin(number)
        groups: list[Sequence[Item]] = []

        def next_kind(kind: int) -> None:
            def ended(reason: str) -> None:
                done = self._transfers.pop(number)
                assert isinstance(done, Download)
                if reason:
                    self._over(number, "download")
                    answer(False, reason)
                    return
                groups.append(done.items)
                if kind + 1 < len(ORDER):
                    next_kind(kind + 1)
                else:
                    self._over(number, "download")
                    self._aboard(boat, plan.mission_of("aboard", groups))
                    answer(True, "")

            self._transfers[number] = Download(number, kind, lambda m: self._send(number, m), ended)

        next_kind(MISSION)

    def progress(self) -> list[dict[str, Any]]:
        """The progress of the transfers."""
        return [
            {"t": "progress", "boat": n, "what": each.what, "part": round((_done(each) + each.part) / 3, 3)}
            for n, each in self._transfers.items()
        ]

    def _begin(self, number: int) -> None:
        if number in self._transfers and number not in self._reading:
            raise Refused("a mission is being sent or read: wait until that has ended")
        self._reading.discard(number)  # that reading begins again when this transfer is over

    def _over(self, number: int, what: str) -> None:
        """The transfer has ended, well or not."""
        self._tell({"t": "progress", "boat": number, "what": what, "part": 1.0})

    def _aboard(self, boat: Boat, mission: dict[str, Any]) -> None:
        known = self.missions.setdefault(boat.number, {})
        here = known.get("here")
        if here is not None and here["digest"] == mission["digest"]:
            mission["name"] = here["name"]
        known["aboard"] = mission
        boat.read = boat.checksum
        self._tell({"t": "mission", "boat": boat.number, "where": "aboard", "mission": mission})

    def _compared(self, number: int, well: bool, why: str) -> tuple[bool, str]:
        if not well:
            return False, f"sent, but it could not be read back: {why}"
        known = self.missions[number]
        same = known["here"]["digest"] == known["aboard"]["digest"]
        return same, "" if same else "the mission aboard differs from the plan: send it again"


def _done(each: OutgoingItems | Download) -> int:
    """The number of types of items before this one."""
    return ORDER.index(each.kind) if isinstance(each, OutgoingItems) else each.kind
