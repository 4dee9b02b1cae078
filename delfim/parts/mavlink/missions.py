"""MAVLink's mission protocol, the vehicle's side: uploads item by item, downloads, checksums.

An upload changes nothing before its last item has come and the plan is valid. One of a part of a plan is the same with the
items aboard before and behind it. A download needs no memory: each item is requested by its number. Both survive lost frames:
the vehicle repeats its requests and its answers (mavlink.io/en/services/mission.html).
"""

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple, Protocol

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.parts.mavlink.codec import plans
from delfim.parts.mavlink.codec.plans import ALL, FENCE, ITEMS, MISSION, RALLY, Item
from delfim.parts.mavlink.codec.wire import Message, Speaker, dialect
from delfim.vehicle import console
from delfim.vehicle.loop import VehicleLoop

AGAIN_S: Final = 1.0  # after this silence the next item is requested again ...
GIVE_UP_S: Final = 20.0  # ... until nothing came for this long
KEPT: Final = 4  # items aboard that one slice puts into a plan of which a part comes
KINDS: Final = (MISSION, FENCE, RALLY)
OK: Final = int(dialect.MAV_MISSION_ACCEPTED)
INVALID: Final = int(dialect.MAV_MISSION_INVALID)
DENIED: Final = int(dialect.MAV_MISSION_DENIED)
UNSUPPORTED: Final = int(dialect.MAV_MISSION_UNSUPPORTED)


class ConsoleLine(Protocol):
    """The interface of the protocol to the station, for one console."""

    def tell(self, message: Message) -> None: ...
    def tell_all(self, message: Message) -> None: ...
    def ask(self, command: console.Commands, answer: Callable[[str | None], None]) -> None: ...
    def complain(self, text: str) -> None: ...


class IncomingItems:
    """An upload under way: the items from `came` up to `count` are still to come, and when the next one was requested."""

    def __init__(self, line: ConsoleLine, source: Speaker, kind: int, came: int, count: int, now_s: float) -> None:
        self.line, self.source, self.kind, self.count = line, source, kind, count
        self.first = self.came = came
        self.draft: plans.Draft = _DRAFTS[kind]()
        self.part_of: plans.Told | None = None  # the plan whose part comes; None: a whole one comes
        self.kept: list[Item] = []  # those of it that stay: so many `before` the ones that come, and the others behind them
        self.before = self.at = 0
        self.frame: int | None = None  # of its places
        self.heard_s = self.asked_s = now_s

    @property
    def keeps(self) -> bool:
        """Whether an item that stays is the next one of the plan."""
        return self.at < (len(self.kept) if self.came == self.count else self.before)

    def keep(self) -> tuple[int, Item]:
        """That item, and its number in the plan."""
        at, self.at = self.at, self.at + 1
        return at - self.before + (self.first if at < self.before else self.count), self.kept[at]


class Done(NamedTuple):
    """An upload that ended: its answer, kept in case it was lost."""

    source: Speaker
    kind: int
    last: int  # number of its last item
    result: int


class Missions:
    """`home_first`: item 0 is the home position, as with ArduPilot and its consoles."""

    def __init__(self, boat: VehicleLoop, home_first: bool) -> None:
        self._boat, self._home_first = boat, home_first
        self._upload: IncomingItems | None = None
        self._done: Done | None = None
        self._frames = dict.fromkeys(KINDS, plans.PLACED)  # of places: told in the frame in which they were sent
        self._told = dict.fromkeys(KINDS, plans.NOTHING)
        self._telling: tuple[int, Sliced[plans.Told]] | None = None  # the plan that is being prepared for download
        self._summing: Sliced[int] | None = None
        self._summed: tuple[tuple[plans.Told, ...], int | None] = (), None  # the plans that were summed up, and their checksum
        self._due: list[Callable[[], None]] = []  # jobs that wait until all plans are prepared

    # The plans aboard.

    def step(self) -> bool:
        """One slice of preparing the plans for download, or for an upload of a part. Returns whether there is more to do."""
        if self._keep():
            return True
        if self._telling is None and self._summing is None:
            kind = next((kind for kind in KINDS if self._told[kind].plan is not self._plan(kind)), None)
            if kind is not None:
                self._telling = kind, Sliced(plans.told(self._plan(kind), self._items(kind), self._frames[kind]))
            elif not self._is_summed():
                self._summing = Sliced(plans.checksum([self._told[each].packed for each in KINDS]))
                self._summed = tuple(self._told.values()), None
            else:
                due, self._due = self._due, []
                for tell in due:
                    tell()
                return False
        if self._telling is not None:
            kind, work = self._telling
            if work.step():
                self._boat.helm.plans.remains.add(self._told[kind].items)
                self._told[kind], self._telling = work.result, None
        elif self._summing is not None and self._summing.step():
            self._summed, self._summing = (self._summed[0], self._summing.result), None
        return True

    def _is_summed(self) -> bool:
        """Whether the checksum of all plans covers the present ones."""
        plans_summed, known = self._summed
        return known is not None and all(a is b for a, b in zip(plans_summed, self._told.values(), strict=True))

    def _plan(self, kind: int) -> object:
        boat = self._boat
        return boat.helm.plans.mission if kind == MISSION else boat.helm.plans.zones if kind == FENCE else boat.helm.plans.rally

    def _items(self, kind: int) -> Iterator[Item]:
        boat = self._boat
        if kind == FENCE:
            return plans.fence_items(boat.helm.plans.zones)
        if kind == RALLY:
            return plans.rally_items(boat.helm.plans.rally)
        return plans.mission_items(boat.helm.plans.mission) if boat.helm.plans.mission is not None else iter(())

    def own(self, kind: int) -> plans.Told | None:
        """The boat's plan of a type. None: it is still being prepared; the console asks again."""
        for _ in KINDS:  # small ones take a slice each
            if self._told[kind].plan is not self._plan(kind):
                self.step()
        return known if (known := self._told[kind]).plan is self._plan(kind) else None

    def checksum(self, kind: int) -> int | None:
        """The boat's plan of a type; None as with `own`."""
        known = [self.own(each) for each in (KINDS if kind == ALL else (kind,))]
        if None in known:
            return None
        if kind != ALL:
            return self._told[kind].checksum
        if not self._is_summed():
            self.step()  # a slice, which is enough for small ones
        return self._summed[1] if self._is_summed() else None

    def leg(self, number: int) -> int:
        """The leg that leads to an item. Raises FormatError."""
        if (known := self.own(MISSION)) is None:
            raise FormatError("the mission is still being prepared: ask again in a moment")
        return known.leg_of(max(number - self._home_first, 0))

    def number(self, leg: int) -> int:
        """The item that a leg leads to, if known yet."""
        known = self.own(MISSION)
        return (0 if known is None else known.item_of(leg)) + self._home_first

    # Download.

    def listed(self, line: ConsoleLine, source: Speaker, message: Message) -> None:
        """MISSION_REQUEST_LIST"""
        kind = message.mission_type
        if kind not in KINDS:
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, UNSUPPORTED, kind))
            return
        if (known := self.own(kind)) is not None:
            count = len(known.items) + self._homes(kind, known)
            line.tell(dialect.MAVLink_mission_count_message(*source.party, count, kind))

    def _homes(self, kind: int, known: plans.Told) -> int:
        """Whether item 0 is the home position."""
        return int(kind == MISSION and self._home_first and bool(known.items))

    def _home(self) -> Item:
        return plans.home_item(*(self._boat.helm.home() or (0.0, 0.0)))._replace(frame=self._frames[MISSION])

    def requested(self, line: ConsoleLine, source: Speaker, message: Message) -> None:
        """MISSION_REQUEST_INT, and the older MISSION_REQUEST."""
        kind, number = message.mission_type, message.seq
        known = self.own(kind) if kind in KINDS else self._told[MISSION]._replace(items=[])
        if known is None:
            return
        homes = self._homes(kind, known)
        if number >= len(known.items) + homes:
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, dialect.MAV_MISSION_INVALID_SEQUENCE, kind))
            return
        i = known.items[number - homes] if number >= homes else self._home()
        current = kind == MISSION and number == self.number(self._boat.state.setpoint.leg)
        rest = i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z, kind
        line.tell(dialect.MAVLink_mission_item_int_message(*source.party, number, i.frame, i.command, int(current), 1, *rest))

    # Upload.

    def counted(self, line: ConsoleLine, source: Speaker, message: Message, now_s: float) -> None:
        """MISSION_COUNT: an upload begins and replaces one under way."""
        kind, count = message.mission_type, message.count
        if kind not in KINDS or count > ITEMS:
            refused = UNSUPPORTED if kind not in KINDS else dialect.MAV_MISSION_NO_SPACE
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, refused, kind))
            return
        self._begin(IncomingItems(line, source, kind, 0, count, now_s))

    def rewritten(self, line: ConsoleLine, source: Speaker, message: Message, now_s: float) -> None:
        """MISSION_WRITE_PARTIAL_LIST: these items of the plan aboard come anew, or are appended; the others stay."""
        kind, first, last = message.mission_type, message.start_index, message.end_index
        if kind not in KINDS:
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, UNSUPPORTED, kind))
            return
        if (known := self.own(kind)) is None:
            self._answer(line, source, kind, "the plan is still being prepared: ask again in a moment", DENIED)
            return
        homes = self._homes(kind, known)
        count = len(known.items) + homes
        if not 0 <= first <= min(last, count) or last >= ITEMS:
            why = f"items {first} to {last} are no part of a plan of {count}: a part begins in it, or right behind it"
            self._answer(line, source, kind, why, dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        upload = IncomingItems(line, source, kind, first, last + 1, now_s)
        upload.part_of, upload.before = known, max(first - homes, 0)
        upload.kept = known.items[: upload.before] + known.items[last + 1 - homes :]
        self._begin(upload)

    def _begin(self, upload: IncomingItems) -> None:
        self._upload, self._done = upload, None
        self._next(upload, upload.heard_s)

    def item(self, line: ConsoleLine, source: Speaker, message: Message, now_s: float) -> None:
        """MISSION_ITEM_INT. An item that was not requested is a repeat, or late."""
        upload, done = self._upload, self._done
        if upload is None or (upload.source, upload.kind) != (source, message.mission_type):
            if done is not None and (source, message.mission_type, message.seq) == (done.source, done.kind, done.last):
                line.tell(dialect.MAVLink_mission_ack_message(*source.party, done.result, done.kind))
            return
        upload.heard_s, upload.line = now_s, line  # a console of two links may go on by the other one
        if message.seq != upload.came:
            return
        m, upload.came = message, upload.came + 1
        item = Item(m.command, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z, m.frame)
        if self._add(upload, m.seq, item):
            self._next(upload, now_s)

    def _add(self, upload: IncomingItems, number: int, item: Item) -> bool:
        """Put an item into the plan that comes. One that makes no sense ends the upload: False."""
        if upload.frame is None and item.frame in plans.GLOBAL:
            upload.frame = item.frame
        if upload.kind != MISSION or number or not self._home_first:
            try:
                upload.draft.add(number, item)
            except FormatError as error:
                self._end(upload, error)
                return False
        return True

    def _keep(self) -> bool:
        """A slice of the items that stay goes into the plan of which a part comes. Whether there was something to do."""
        upload = self._upload
        if upload is None or not upload.keeps:
            return False
        for _ in range(KEPT):
            if upload.keeps and not self._add(upload, *upload.keep()):
                return True
        self._next(upload, self._boat.clock.monotonic_s())
        return True

    def tick(self, now_s: float) -> None:
        """Ask again; or give up."""
        upload = self._upload
        if upload is None:
            return
        if now_s - upload.heard_s > GIVE_UP_S:
            self._upload = None
            cancelled = dialect.MAV_MISSION_OPERATION_CANCELLED
            upload.line.tell(dialect.MAVLink_mission_ack_message(*upload.source.party, cancelled, upload.kind))
        elif now_s - upload.asked_s > AGAIN_S:
            self._next(upload, now_s)

    def _next(self, upload: IncomingItems, now_s: float) -> None:
        """Ask for the next item, if it is the console's; after the last one, accept the plan."""
        upload.asked_s = now_s
        if upload.keeps:
            return
        if upload.came < upload.count:
            upload.line.tell(dialect.MAVLink_mission_request_int_message(*upload.source.party, upload.came, upload.kind))
            return
        try:
            self._upload, command = None, self._command(upload)
        except DelfimError as error:
            self._end(upload, error)
            return
        upload.line.ask(command, lambda refused: self._end(upload, None if refused is None else Refused(refused)))

    def clear(self, line: ConsoleLine, source: Speaker, message: Message) -> None:
        """MISSION_CLEAR_ALL"""
        kind = message.mission_type
        if kind not in (*KINDS, ALL):
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, UNSUPPORTED, kind))
            return
        self._clear(line, source, kind, KINDS if kind == ALL else (kind,), None)

    def _clear(self, line: ConsoleLine, source: Speaker, kind: int, left: tuple[int, ...], refused: str | None) -> None:
        """Clear one type after the other; the answer follows the last."""
        if left:
            line.ask(_CLEAR[left[0]], lambda why: self._clear(line, source, kind, left[1:], refused or why))
        else:
            self._answer(line, source, kind, refused, DENIED)

    def _end(self, upload: IncomingItems, fault: DelfimError | None) -> None:
        if self._upload is upload:
            self._upload = None
        if fault is None and upload.frame is not None:
            self._frames[upload.kind], self._told[upload.kind], self._telling = upload.frame, plans.NOTHING, None
        wrong = UNSUPPORTED if isinstance(fault, plans.Unsupported) else INVALID if isinstance(fault, FormatError) else DENIED
        self._done = Done(upload.source, upload.kind, upload.came - 1, OK if fault is None else wrong)
        self._answer(upload.line, upload.source, upload.kind, None if fault is None else str(fault), wrong)

    def _command(self, upload: IncomingItems) -> console.Commands:
        """Raises FormatError; Refused where the plan of a part is no longer the one aboard."""
        if upload.part_of is not None and upload.part_of.plan is not self._plan(upload.kind):
            raise Refused("the plan aboard changed while a part of it came: read it, and send the part again")
        if upload.part_of is None and upload.count <= (upload.kind == MISSION and self._home_first):
            return _CLEAR[upload.kind]
        match upload.draft:
            case plans.ZonesDraft():
                return console.SetFence(upload.draft.done())
            case plans.RallyDraft():
                return console.Rally(upload.draft.done())
            case plans.MissionDraft():
                return console.Upload(upload.draft.done("uploaded", self._boat.helm.plans.zones))

    def _answer(self, line: ConsoleLine, source: Speaker, kind: int, refused: str | None, result: int) -> None:
        if refused is not None:
            line.complain(refused)
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, result, kind))
            return

        def tell() -> None:
            for each in (*KINDS, ALL) if kind == ALL else (kind, ALL):  # before the answer, so that its reader knows
                if (known := self.checksum(each)) is not None:
                    line.tell_all(dialect.MAVLink_mission_checksum_message(each, known))
            line.tell(dialect.MAVLink_mission_ack_message(*source.party, OK, kind))

        self._due.append(tell)
        self.step()


_DRAFTS: Final[dict[int, type[plans.Draft]]] = {
    MISSION: plans.MissionDraft,
    FENCE: plans.ZonesDraft,
    RALLY: plans.RallyDraft,
}
_CLEAR: Final[dict[int, console.Commands]] = {
    MISSION: console.Unload(),
    FENCE: console.SetFence(config.Zones()),
    RALLY: console.Rally(()),
}
