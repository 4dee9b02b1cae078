"""MAVLink's mission protocol, the vehicle's side: uploads item by item, downloads, checksums.

An upload changes nothing before its last item has come and all of it makes sense. A download needs no memory: each item is
asked for by its number. Both get through any loss: the vehicle asks again, and answers again what was answered
(mavlink.io/en/services/mission.html).
"""

from typing import Final, NamedTuple, Protocol

from delfim import config
from delfim.errors import FormatError
from delfim.vehicle import console
from delfim.vehicle.loop import Vehicle
from delfim.vehicle.mavlink import plans
from delfim.vehicle.mavlink.plans import ALL, FENCE, ITEMS, MISSION, RALLY, Item
from delfim.vehicle.mavlink.wire import Message, dialect

AGAIN_S: Final = 1.0  # after this silence the next item is asked for again ...
GIVE_UP_S: Final = 20.0  # ... until nothing came for so long
KINDS: Final = (MISSION, FENCE, RALLY)
OK: Final = int(dialect.MAV_MISSION_ACCEPTED)
INVALID: Final = int(dialect.MAV_MISSION_INVALID)
DENIED: Final = int(dialect.MAV_MISSION_DENIED)
UNSUPPORTED: Final = int(dialect.MAV_MISSION_UNSUPPORTED)

Party = tuple[int, int]  # system, component


class Line(Protocol):
    """What the protocol needs of the station, for one console."""

    def tell(self, message: Message) -> None: ...
    def tell_all(self, message: Message) -> None: ...
    def ask(self, command: console.Commands) -> str | None: ...
    def complain(self, text: str) -> None: ...


class Upload:
    """One that is under way: the items so far, and when the next one was asked for."""

    def __init__(self, line: Line, party: Party, kind: int, count: int, now_s: float) -> None:
        self.line, self.party, self.kind, self.count = line, party, kind, count
        self.items: list[Item] = []
        self.heard_s = self.asked_s = now_s


class Done(NamedTuple):
    """An upload that ended: what was said, in case that it was not heard."""

    party: Party
    kind: int
    last: int  # number of its last item
    result: int


class Missions:
    """`home_first`: item 0 is the home position, as ArduPilot and its consoles have it."""

    def __init__(self, boat: Vehicle, home_first: bool) -> None:
        self._boat, self._home_first = boat, home_first
        self._upload: Upload | None = None
        self._done: Done | None = None
        self._known: tuple[object, list[Item]] = None, []

    # What is on board.

    def items(self, kind: int) -> list[Item]:
        """As they are told: with the home position first where that is the custom."""
        items = self.own(kind)
        if kind == MISSION and self._home_first and items:
            home = self._boat.home()
            latitude_rad, longitude_rad = home if home is not None else (0.0, 0.0)
            return [plans.home_item(latitude_rad, longitude_rad), *items]
        return items

    def own(self, kind: int) -> list[Item]:
        boat = self._boat
        if kind == FENCE:
            return plans.fence_items(boat.zones)
        if kind == RALLY:
            return plans.rally_items(boat.rally)
        if self._known[0] is not boat.mission:
            self._known = boat.mission, plans.mission_items(boat.mission) if boat.mission is not None else []
        return self._known[1]

    def checksum(self, kind: int) -> int:
        return plans.checksum(item for each in (KINDS if kind == ALL else (kind,)) for item in self.own(each))

    def leg(self, number: int) -> int:
        """The leg that leads to an item. Raises FormatError."""
        return plans.leg_of(self.own(MISSION), max(number - self._home_first, 0))

    def number(self, leg: int) -> int:
        """The item that a leg leads to."""
        return plans.item_of(self.own(MISSION), leg) + self._home_first

    # Down.

    def listed(self, line: Line, party: Party, message: Message) -> None:
        """MISSION_REQUEST_LIST"""
        kind = message.mission_type
        if kind not in KINDS:
            line.tell(dialect.MAVLink_mission_ack_message(*party, UNSUPPORTED, kind))
            return
        line.tell(dialect.MAVLink_mission_count_message(*party, len(self.items(kind)), kind))

    def requested(self, line: Line, party: Party, message: Message) -> None:
        """MISSION_REQUEST_INT, and the older MISSION_REQUEST."""
        kind, number = message.mission_type, message.seq
        items = self.items(kind) if kind in KINDS else []
        if number >= len(items):
            line.tell(dialect.MAVLink_mission_ack_message(*party, dialect.MAV_MISSION_INVALID_SEQUENCE, kind))
            return
        i = items[number]
        current = kind == MISSION and number == self.number(self._boat.state.setpoint.leg)
        rest = i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z, kind
        line.tell(dialect.MAVLink_mission_item_int_message(*party, number, i.frame, i.command, int(current), 1, *rest))

    # Up.

    def counted(self, line: Line, party: Party, message: Message, now_s: float) -> None:
        """MISSION_COUNT: an upload begins, in place of one that was under way."""
        kind, count = message.mission_type, message.count
        if kind not in KINDS or count > ITEMS:
            refused = UNSUPPORTED if kind not in KINDS else dialect.MAV_MISSION_NO_SPACE
            line.tell(dialect.MAVLink_mission_ack_message(*party, refused, kind))
            return
        self._upload = Upload(line, party, kind, count, now_s)
        self._done = None
        self._next(self._upload, now_s)

    def item(self, line: Line, party: Party, message: Message, now_s: float) -> None:
        """MISSION_ITEM_INT. What was not asked for is heard a second time, or too late."""
        upload, done = self._upload, self._done
        if upload is None or (upload.party, upload.kind) != (party, message.mission_type):
            if done is not None and (party, message.mission_type, message.seq) == (done.party, done.kind, done.last):
                line.tell(dialect.MAVLink_mission_ack_message(*party, done.result, done.kind))
            return
        upload.heard_s = now_s
        if message.seq != len(upload.items):
            return
        m = message
        upload.items.append(Item(m.command, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z, m.frame))
        self._next(upload, now_s)

    def tick(self, now_s: float) -> None:
        """Ask again; or give up."""
        upload = self._upload
        if upload is None:
            return
        if now_s - upload.heard_s > GIVE_UP_S:
            self._upload = None
            cancelled = dialect.MAV_MISSION_OPERATION_CANCELLED
            upload.line.tell(dialect.MAVLink_mission_ack_message(*upload.party, cancelled, upload.kind))
        elif now_s - upload.asked_s > AGAIN_S:
            self._next(upload, now_s)

    def _next(self, upload: Upload, now_s: float) -> None:
        """Ask for the next item; when there is none, take what came."""
        upload.asked_s = now_s
        if len(upload.items) < upload.count:
            upload.line.tell(dialect.MAVLink_mission_request_int_message(*upload.party, len(upload.items), upload.kind))
            return
        self._upload = None
        self._finish(upload.line, upload.party, upload.kind, upload.items)

    def clear(self, line: Line, party: Party, message: Message) -> None:
        """MISSION_CLEAR_ALL"""
        kind = message.mission_type
        if kind not in (*KINDS, ALL):
            line.tell(dialect.MAVLink_mission_ack_message(*party, UNSUPPORTED, kind))
            return
        refusals = [line.ask(_CLEAR[each]) for each in (KINDS if kind == ALL else (kind,))]
        self._answer(line, party, kind, next(filter(None, refusals), None), DENIED)

    def _finish(self, line: Line, party: Party, kind: int, items: list[Item]) -> None:
        try:
            command = self._command(kind, items)
            refused, result = line.ask(command), DENIED
        except FormatError as error:
            refused, result = str(error), UNSUPPORTED if isinstance(error, plans.Unsupported) else INVALID
        self._done = Done(party, kind, len(items) - 1, OK if refused is None else result)
        self._answer(line, party, kind, refused, result)

    def _command(self, kind: int, items: list[Item]) -> console.Commands:
        """Raises FormatError."""
        first = int(kind == MISSION and self._home_first)
        items = items[first:]
        if not items:
            return _CLEAR[kind]
        if kind == FENCE:
            return console.Fence(plans.zones(items))
        if kind == RALLY:
            return console.Rally(plans.harbours(items))
        return console.Upload(plans.mission(items, "uploaded", self._boat.zones, first))

    def _answer(self, line: Line, party: Party, kind: int, refused: str | None, result: int) -> None:
        if refused is not None:
            line.complain(refused)
            line.tell(dialect.MAVLink_mission_ack_message(*party, result, kind))
            return
        line.tell(dialect.MAVLink_mission_ack_message(*party, OK, kind))
        for each in KINDS if kind == ALL else (kind,):
            line.tell_all(dialect.MAVLink_mission_checksum_message(each, self.checksum(each)))


_CLEAR: Final[dict[int, console.Commands]] = {
    MISSION: console.Unload(),
    FENCE: console.Fence(config.Zones()),
    RALLY: console.Rally(()),
}
