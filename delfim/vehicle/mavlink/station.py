"""The vehicle as a MAVLink system: who is listening, who commands, what is asked and answered.

No sockets and no waiting: datagrams come in by `receive`, are worked off a few frames at a `turn`, `tick` says what is due;
what goes out is handed to `send`. Whatever changes anything goes through `obey`, in the console's words, and so into the log. A
request is answered when it comes, and so is one that nobody understands.
"""

import math
from collections import deque
from collections.abc import Callable
from ipaddress import ip_address
from typing import Final, NamedTuple

from delfim.errors import FormatError
from delfim.vehicle import console
from delfim.vehicle.loop import Vehicle
from delfim.vehicle.mavlink import params, telemetry, wire
from delfim.vehicle.mavlink.desk import HANDLERS
from delfim.vehicle.mavlink.missions import Missions
from delfim.vehicle.mavlink.signing import Signing
from delfim.vehicle.mavlink.telemetry import NEVER_S, Profile, Row, View
from delfim.vehicle.mavlink.wire import Message, Sender, dialect
from delfim.vehicle.state import Mode

Address = tuple[str, int]

PEERS: Final = 16  # at once
HEARD_S: Final = 15.0  # a peer silent for longer is told only that the boat exists; one that came by itself is forgotten
FRAMES: Final = 8  # of a turn
PENDING: Final = 256  # frames that wait; beyond, they are dropped
PACKED_BYTES: Final = 1200  # several messages share a datagram up to this size
LATE_FRAMES, LATE_S = 16, 3.0  # a frame so far behind the newest of its sender, within this time, came late or twice
SOURCES: Final = 64  # senders whose frames are counted
TEXT_BYTES: Final = 50
SLOWLY: Final = 5  # ticks from one parameter to the next where the link is slow


class Source(NamedTuple):
    """Who sent a frame."""

    system: int
    component: int

    @property
    def name(self) -> str:
        return f"console {self.system}"


class Peer:
    """An address that listens, and what it has been told."""

    def __init__(self, address: Address, sender: Sender, profile: Profile, configured: bool) -> None:
        self.address, self.sender, self.profile, self.configured = address, sender, profile, configured
        self.heard_s = -math.inf
        self.asked_s: dict[int, float] = {}  # intervals that it asked for, by message
        self.due_s: dict[int, float] = {}
        self.told: dict[int, object] = {}  # what it knows already, by message
        self.params: deque[str] = deque(maxlen=len(params.NAMES))  # to be told, a few a tick
        self.answered: tuple[str, float, Message] | None = None  # the last command, when, and its answer

    def interval_s(self, row: Row) -> float:
        return self.asked_s.get(row.id, row.interval_s(self.profile))


class Station:
    """All consoles of one vehicle. `obey` carries out a command of a console that is named, and returns why not, or None.
    `send` takes a datagram and its address. `signing` is None where there is no key."""

    def __init__(
        self,
        boat: Vehicle,
        obey: Callable[[console.Commands, str], str | None],
        send: Callable[[bytes, Address], object],
        signing: Signing | None,
    ) -> None:
        self.boat, self.clock, self.settings = boat, boat.clock, boat.settings.mavlink
        self.system = boat.settings.boat.id
        self.owner = 0  # system of the console that commands
        self.counts: dict[str, int] = {}
        self.peers: dict[Address, Peer] = {}
        self._obey, self._send, self._signing = obey, send, signing
        self._pending: deque[tuple[bytes, Address]] = deque()
        self._newest: dict[tuple[Address, Source], tuple[int, float]] = {}  # number of the last frame, and when
        self._owner_s = -math.inf
        self._said: tuple[object, ...] = ()
        self._text_id = self._ticks = 0
        self._leg_now: tuple[object, int] = None, 0
        self.missions = Missions(boat, self.settings.autopilot == "ardurover")
        for listen in self.settings.peers:
            host, _, port = listen.rpartition(":")
            self._peer((host.strip("[]"), int(port)), configured=True)

    # In.

    def receive(self, datagram: bytes, address: Address) -> None:
        """A datagram has come. Its frames wait for `turn`."""
        found, whole = wire.frames(datagram)
        if not whole:
            self.count("malformed")
        for frame in found:
            if len(self._pending) >= PENDING:
                self.count("dropped")
                return
            self._pending.append((frame, address))

    def turn(self) -> bool:
        """Work off some frames. Returns whether more wait."""
        for _ in range(min(FRAMES, len(self._pending))):
            self._frame(*self._pending.popleft())
        return bool(self._pending)

    def _frame(self, frame: bytes, address: Address) -> None:
        age_s = 0.0
        if self.settings.sign == "all" or not _loopback(address[0]):
            if self._signing is None:
                self.count("unsigned")
                return
            fault, age_s = self._signing.judge(frame)
            if fault:
                self.count(fault)
                return
        try:
            message = wire.decode(frame)
        except FormatError:
            self.count("malformed")
            return
        source = Source(frame[5], frame[6])
        if message is None or source.system == 0 or source == (self.system, telemetry.COMPONENT):
            self.count("unknown")
            return
        peer = self._peer(address)
        if peer is None:
            return
        peer.heard_s = self.clock.monotonic_s()
        handler = HANDLERS.get(message.get_msgId())
        if handler is None or not _meant(message, self.system):
            return
        if self._late(address, source, frame[4]) or age_s > self.settings.command_age_s:
            self.count("late")
            return
        handler(self, peer, source, message)

    def _late(self, address: Address, source: Source, number: int) -> bool:
        """Whether a frame came twice, or after one that was sent later."""
        now_s, key = self.clock.monotonic_s(), (address, source)
        newest, at_s = self._newest.get(key, (number - 1 & 0xFF, -math.inf))
        if -number + newest & 0xFF < LATE_FRAMES and now_s - at_s < LATE_S:
            return True
        if key not in self._newest and len(self._newest) >= SOURCES:
            del self._newest[min(self._newest, key=lambda each: self._newest[each][1])]
        self._newest[key] = number, now_s
        return False

    def _peer(self, address: Address, configured: bool = False) -> Peer | None:
        """None where there are too many."""
        if address not in self.peers:
            if len(self.peers) >= PEERS:
                self.count("peers_full")
                return None
            key, stamp = (None, _no_stamp) if self._signing is None else (self._signing.key, self._signing.stamp)
            sender = Sender(self.system, telemetry.COMPONENT, key, stamp)
            self.peers[address] = Peer(address, sender, self.settings.profile, configured)
        return self.peers[address]

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    # Out.

    def tick(self) -> None:
        """What is due now. Call it some twenty times a second."""
        now_s = self.clock.monotonic_s()
        self._ticks += 1
        self.news()
        self.missions.tick(now_s)
        view = self.view()
        for peer in [peer for peer in self.peers.values() if not peer.configured and now_s - peer.heard_s > HEARD_S]:
            del self.peers[peer.address]
        for peer in self.peers.values():
            due = [message for row in telemetry.ROWS for message in self._due(peer, row, view)]
            self.tell(peer, [*due, *self._params(peer)])

    def _due(self, peer: Peer, row: Row, view: View) -> list[Message]:
        interval_s, now_s = peer.interval_s(row), view.now_s
        hello = row.id == dialect.MAVLINK_MSG_ID_HEARTBEAT
        if interval_s == NEVER_S or now_s < peer.due_s.get(row.id, -math.inf) or (now_s - peer.heard_s > HEARD_S and not hello):
            return []
        if row.fresh is not None:
            news = row.fresh(view)
            if peer.told.get(row.id) == news:
                return []
            peer.told[row.id] = news
        due_s = peer.due_s.get(row.id, -math.inf) + interval_s
        peer.due_s[row.id] = due_s if due_s > now_s - interval_s else now_s + interval_s
        return list(row.make(view))

    def _params(self, peer: Peer) -> list[Message]:
        """Of the list that it asked for: slowly, where the link is slow."""
        count = 5 if peer.profile == "wifi" else 1 if self._ticks % SLOWLY == 0 else 0
        return [self.param(peer, peer.params.popleft()) for _ in range(min(count, len(peer.params)))]

    def tell(self, peer: Peer, messages: list[Message]) -> None:
        packed = b""
        for message in messages:
            frame = peer.sender.pack(message)
            if packed and len(packed) + len(frame) > PACKED_BYTES:
                self._send(packed, peer.address)
                packed = b""
            packed += frame
        if packed:
            self._send(packed, peer.address)

    def say(self, severity: int, text: str) -> None:
        """Words to every console that is there."""
        self._text_id = self._text_id % 0xFFFF + 1
        data = text.encode("ascii", "replace")
        chunks = [data[at : at + TEXT_BYTES] for at in range(0, max(len(data), 1), TEXT_BYTES)]
        number = self._text_id if len(chunks) > 1 else 0
        self.tell_all([dialect.MAVLink_statustext_message(severity, chunk, number, i) for i, chunk in enumerate(chunks)])

    def news(self) -> None:
        """Changes of mode and troubles, in words, and a heartbeat at once where the mode is another one."""
        self._reached()
        state = self.boat.state
        said = state.mode, state.reason, state.notices, self.owner
        if said == self._said:
            return
        was, self._said = self._said, said
        if not was:
            return
        if was[:2] != said[:2]:
            calm = state.reason == "operator" or state.reason.endswith(" done")
            self.say(
                dialect.MAV_SEVERITY_NOTICE if calm else dialect.MAV_SEVERITY_ALERT,
                f"{state.mode.name.lower()}: {state.reason}",
            )
        known = {(notice.name, notice.action) for notice in was[2]}  # type: ignore[attr-defined]
        for notice in state.notices:
            if (notice.name, notice.action) not in known:
                severity = dialect.MAV_SEVERITY_WARNING if notice.action == "warn" else dialect.MAV_SEVERITY_CRITICAL
                self.say(severity, f"{notice.reason}: {notice.action}")
        if was[3] != self.owner:
            self.say(dialect.MAV_SEVERITY_NOTICE, f"console {self.owner} commands" if self.owner else "no console commands")
        self._at_once(dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT)

    def _reached(self) -> None:
        """A waypoint of the mission is behind the boat: its item, to everybody."""
        state = self.boat.state
        plan, leg = (state.setpoint.plan, state.reference.leg) if state.mode is Mode.PLAY else (None, 0)
        was, self._leg_now = self._leg_now, (plan, leg)
        done = state.mode is Mode.HOLD and state.reason == "play done" and was[0] is not None
        if done or (plan is not None and plan is was[0] and leg > was[1]):
            self.tell_all([dialect.MAVLink_mission_item_reached_message(self.missions.number(was[1]))])

    def tell_all(self, messages: list[Message]) -> None:
        """To every console that is there."""
        now_s = self.clock.monotonic_s()
        for peer in self.peers.values():
            if now_s - peer.heard_s <= HEARD_S:
                self.tell(peer, messages)

    def _at_once(self, *ids: int) -> None:
        for peer in self.peers.values():
            for each in ids:
                peer.due_s.pop(each, None)

    # Who commands.

    def ask(self, source: Source, command: console.Commands) -> str | None:
        """A command of a console that must be the one that commands. Whoever asks first commands; so does the next one when the
        one before was silent for long. Anybody may stop the boat. Returns why not, or None."""
        try:
            command = console.checked(command)
        except FormatError as error:
            return str(error)
        if self.owner != source.system and not isinstance(command, console.Stop):
            if not isinstance(command, console.Take) and (reason := self.refusal(source)) is not None:
                return reason
            self.owner = source.system
        if self.owner == source.system:
            self._owner_s = self.clock.monotonic_s()
        refused = self._obey(command, source.name)
        self.news()
        return refused

    def refusal(self, source: Source) -> str | None:
        """Why this console may not command, in words."""
        lost = self.clock.monotonic_s() - self._owner_s > self.boat.settings.failsafe.console_silent.after_s
        if self.owner in (0, source.system) or lost:
            return None
        self.count("not_owner")
        return f"console {self.owner} commands; take over first"

    def alive(self, source: Source) -> None:
        """A console was heard that may be the one that commands."""
        if source.system == self.owner:
            self._owner_s = self.clock.monotonic_s()
            self._obey(console.Alive(), source.name)

    def give_up(self, source: Source) -> None:
        """This console commands no longer."""
        if self.owner == source.system:
            self.owner = 0
            self.news()

    def param(self, peer: Peer, name: str) -> Message:
        """PARAM_VALUE, with what is in force for this peer."""
        if name == params.PROFILE:
            return params.message(name, float(telemetry.PROFILES.index(peer.profile)))
        return params.message(name, params.value(self.boat.settings, params.BY_NAME[name]))

    def view(self) -> View:
        return View(self.boat, self.settings, self.owner, self.missions.number, self.clock.monotonic_s())


def _meant(message: Message, system: int) -> bool:
    """Whether a message is for this vehicle, or for all: those that change something look again."""
    return getattr(message, "target_system", 0) in (0, system) and getattr(message, "target_component", 0) in (0, 1)


def _loopback(host: str) -> bool:
    return ip_address(host.partition("%")[0]).is_loopback


def _no_stamp() -> int:
    return 0
