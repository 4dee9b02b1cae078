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
from delfim.vehicle.mavlink import commands, params, telemetry, wire
from delfim.vehicle.mavlink.answers import ANSWERS
from delfim.vehicle.mavlink.commands import ACCEPTED, DENIED, LATER, UNSUPPORTED
from delfim.vehicle.mavlink.missions import KINDS, Missions
from delfim.vehicle.mavlink.plans import ALL
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
AGAIN_S: Final = 10.0  # a command that is repeated within this time for want of an answer gets the one it had
SOURCES: Final = 64  # senders whose frames are counted
TEXT_BYTES: Final = 50
GUEST: Final = 191  # component of the guest computer, of this system
FREQUENCY_MAX_HZ: Final = 10.0
SLOWLY: Final = 5  # ticks from one parameter to the next where the link is slow
NAK, UNKNOWN_COMMAND = 129, 7  # of MAVLink FTP


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
        self.answered: tuple[bytes, float, Message] | None = None  # the last command, when, and its answer

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
            self._count("malformed")
        for frame in found:
            if len(self._pending) >= PENDING:
                self._count("dropped")
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
                self._count("unsigned")
                return
            fault, age_s = self._signing.judge(frame)
            if fault:
                self._count(fault)
                return
        try:
            message = wire.decode(frame)
        except FormatError:
            self._count("malformed")
            return
        source = Source(frame[5], frame[6])
        if message is None or source.system == 0 or source == (self.system, telemetry.COMPONENT):
            self._count("unknown")
            return
        peer = self._peer(address)
        if peer is None:
            return
        peer.heard_s = self.clock.monotonic_s()
        handler = _HANDLERS.get(message.get_msgId())
        if handler is None or not _meant(message, self.system):
            return
        if self._late(address, source, frame[4]) or age_s > self.settings.command_age_s:
            self._count("late")
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
                self._count("peers_full")
                return None
            key, stamp = (None, _no_stamp) if self._signing is None else (self._signing.key, self._signing.stamp)
            sender = Sender(self.system, telemetry.COMPONENT, key, stamp)
            self.peers[address] = Peer(address, sender, self.settings.profile, configured)
        return self.peers[address]

    def _count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    # Out.

    def tick(self) -> None:
        """What is due now. Call it some twenty times a second."""
        now_s = self.clock.monotonic_s()
        self._ticks += 1
        self._news()
        self.missions.tick(now_s)
        view = self._view()
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
        return [self._param(peer, peer.params.popleft()) for _ in range(min(count, len(peer.params)))]

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

    def _news(self) -> None:
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
            if not isinstance(command, console.Take) and (reason := self._refusal(source)) is not None:
                return reason
            self.owner = source.system
        if self.owner == source.system:
            self._owner_s = self.clock.monotonic_s()
        refused = self._obey(command, source.name)
        self._news()
        return refused

    def _refusal(self, source: Source) -> str | None:
        """Why this console may not command, in words."""
        lost = self.clock.monotonic_s() - self._owner_s > self.boat.settings.failsafe.console_silent.after_s
        if self.owner in (0, source.system) or lost:
            return None
        self._count("not_owner")
        return f"console {self.owner} commands; take over first"

    def _heartbeat(self, peer: Peer, source: Source, message: Message) -> None:
        if source.system == self.owner:
            self._owner_s = self.clock.monotonic_s()
            self._obey(console.Alive(), source.name)

    # What is asked.

    def _command(self, peer: Peer, source: Source, message: Message) -> None:
        """COMMAND_LONG, COMMAND_INT: answered always; one that is repeated is not carried out again."""
        now_s, order = self.clock.monotonic_s(), commands.order(message)
        same = repr((source, order.command, order.p)).encode()
        if order.confirmation and peer.answered and peer.answered[0] == same and now_s - peer.answered[1] < AGAIN_S:
            self.tell(peer, [peer.answered[2]])
            return
        result, reason = self._ordered(peer, source, order)
        answer = dialect.MAVLink_command_ack_message(order.command, result, 0xFF, 0, *source)
        peer.answered = same, now_s, answer
        if reason:  # before the answer, so that whoever hears that knows why
            self.say(dialect.MAV_SEVERITY_WARNING, reason)
        self.tell(peer, [answer])

    def _ordered(self, peer: Peer, source: Source, order: commands.Order) -> tuple[int, str | None]:
        """(MAV_RESULT, why not)"""
        own = _REQUESTS.get(order.command)
        if own is not None:
            return own(self, peer, source, order), None
        make = commands.COMMANDS.get(order.command)
        if make is None:
            return UNSUPPORTED, None
        if order.target_system != self.system:
            return DENIED, "a command must name its vehicle"
        try:
            command = make(order, commands.Terms(self.missions.leg, self.boat.settings.control.speed.max_mps))
        except FormatError as error:
            return DENIED, str(error)
        refused = self.ask(source, command)
        return (ACCEPTED, None) if refused is None else (LATER, refused)

    def _set_mode(self, peer: Peer, source: Source, message: Message) -> None:
        """SET_MODE, of old programs: no answer exists but the heartbeat."""
        if message.target_system == self.system:
            order = commands.Order(dialect.MAV_CMD_DO_SET_MODE, (message.base_mode, message.custom_mode, 0.0), self.system, 0)
            _, reason = self._ordered(peer, source, order)
            if reason:
                self.say(dialect.MAV_SEVERITY_WARNING, reason)

    def _manual(self, peer: Peer, source: Source, message: Message) -> None:
        """Thrust in manual mode, and nowhere else: a stream that did not end must not change a mode."""
        if message.target != self.system or self.boat.state.mode is not Mode.MANUAL or source.system != self.owner:
            self._count("manual_ignored")
            return
        ahead, turn = (message.z, message.y) if self.settings.autopilot == "ardurover" else (message.x, message.r)
        if not (-1000 <= ahead <= 1000 and -1000 <= turn <= 1000):
            self._count("manual_ignored")
            return
        port, starboard = (max(min((ahead + side * turn) / 1000.0, 1.0), -1.0) for side in (1, -1))
        refused = self.ask(source, console.Manual(starboard, port))
        if refused:
            self._count("manual_refused")

    def _guest(self, peer: Peer, source: Source, message: Message) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT of the guest computer: a course and a speed, obeyed in GREX mode only."""
        if source != (self.system, GUEST) or not math.isfinite(message.vx + message.vy):
            self._count("unknown")
            return
        heading_deg = math.degrees(math.atan2(message.vy, message.vx)) % 360.0
        speed_mps = math.hypot(message.vx, message.vy)
        self.boat.on_guest(b'{"heading_deg": %.3f, "speed_mps": %.3f}' % (heading_deg, speed_mps))

    def _set_current(self, peer: Peer, source: Source, message: Message) -> None:
        """MISSION_SET_CURRENT: the answer is MISSION_CURRENT."""
        order = commands.Order(dialect.MAV_CMD_DO_SET_MISSION_CURRENT, (float(message.seq),), message.target_system, 0)
        _, reason = self._ordered(peer, source, order)
        self.tell(peer, list(telemetry.current(self._view())))
        if reason:
            self.say(dialect.MAV_SEVERITY_WARNING, reason)

    # Plans.

    def _listed(self, peer: Peer, source: Source, message: Message) -> None:
        self.missions.listed(_Line(self, peer, source), source, message)

    def _requested(self, peer: Peer, source: Source, message: Message) -> None:
        self.missions.requested(_Line(self, peer, source), source, message)

    def _counted(self, peer: Peer, source: Source, message: Message) -> None:
        if self._may(peer, source, message):
            self.missions.counted(_Line(self, peer, source), source, message, self.clock.monotonic_s())

    def _item(self, peer: Peer, source: Source, message: Message) -> None:
        self.missions.item(_Line(self, peer, source), source, message, self.clock.monotonic_s())

    def _clear(self, peer: Peer, source: Source, message: Message) -> None:
        if self._may(peer, source, message):
            self.missions.clear(_Line(self, peer, source), source, message)

    def _old_item(self, peer: Peer, source: Source, message: Message) -> None:
        """MISSION_ITEM, MISSION_WRITE_PARTIAL_LIST: there is a better way to say it."""
        self.tell(peer, [dialect.MAVLink_mission_ack_message(*source, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)])

    def _may(self, peer: Peer, source: Source, message: Message) -> bool:
        """Whether this console may change a plan; it is told why not."""
        reason = self._refusal(source) if message.target_system == self.system else "a plan must name its vehicle"
        if reason:
            self.say(dialect.MAV_SEVERITY_WARNING, reason)
            self.tell(peer, [dialect.MAVLink_mission_ack_message(*source, dialect.MAV_MISSION_DENIED, message.mission_type)])
        return reason is None

    # Parameters.

    def _param(self, peer: Peer, name: str) -> Message:
        if name == params.PROFILE:
            return params.message(name, float(telemetry.PROFILES.index(peer.profile)))
        return params.message(name, params.value(self.boat.settings, params.BY_NAME[name]))

    def _param_list(self, peer: Peer, source: Source, message: Message) -> None:
        peer.params.clear()
        peer.params.extend(params.NAMES)

    def _param_read(self, peer: Peer, source: Source, message: Message) -> None:
        index = message.param_index
        name = params.named(message.param_id) if index < 0 else params.NAMES[index] if index < len(params.NAMES) else ""
        known = name in params.NAMES
        missing = dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
        self.tell(peer, [self._param(peer, name) if known else params.error(source, name, index, missing)])

    def _param_set(self, peer: Peer, source: Source, message: Message) -> None:
        """The answer is the value that is in force; where that is not the one asked for, a text says why."""
        name, number = params.named(message.param_id), message.param_value
        if name not in params.NAMES:
            self.tell(peer, [params.error(source, name, -1, dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST)])
            return
        reason: str | None = None
        if name == params.PROFILE:
            if number in range(len(telemetry.PROFILES)):
                peer.profile = telemetry.PROFILES[int(number)]
                peer.asked_s.clear()
        elif message.target_system != self.system:
            reason = "a parameter must name its vehicle"
        else:
            try:
                reason = self.ask(source, params.command(name, number))
            except FormatError as error:
                reason = str(error)
        self.tell(peer, [self._param(peer, name)])
        if reason:
            self.tell(peer, [params.error(source, name, -1, dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)])
            self.say(dialect.MAV_SEVERITY_WARNING, reason)

    # Questions.

    def _ftp(self, peer: Peer, source: Source, message: Message) -> None:
        """FILE_TRANSFER_PROTOCOL: not here; `delfim log fetch` is."""
        payload = [*message.payload]
        number = payload[0] + 256 * payload[1] + 1
        nak = [number & 0xFF, number >> 8 & 0xFF, 0, NAK, 1, payload[3], 0, 0, 0, 0, 0, 0, UNKNOWN_COMMAND]
        answer = dialect.MAVLink_file_transfer_protocol_message(0, *source, nak + [0] * (len(payload) - len(nak)))
        self.tell(peer, [answer])

    def _logs(self, peer: Peer, source: Source, message: Message) -> None:
        self.tell(peer, [dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)])

    def _ping(self, peer: Peer, source: Source, message: Message) -> None:
        if message.target_system == 0:
            self.tell(peer, [dialect.MAVLink_ping_message(message.time_usec, message.seq, *source)])

    def _request(self, peer: Peer, source: Source, order: commands.Order) -> int:
        """REQUEST_MESSAGE: once, after the answer."""
        number, index = (int(value) if math.isfinite(value) else -1 for value in order.p[:2])
        view = self._view()
        rows = [row for row in telemetry.ROWS if row.id == number]
        if number == dialect.MAVLINK_MSG_ID_MISSION_CHECKSUM and index in (*KINDS, ALL):
            found = [dialect.MAVLink_mission_checksum_message(index, self.missions.checksum(index))]
        elif number == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            found = [self._interval_of(peer, index)]
        elif rows:
            found = list(rows[0].make(view))
        elif number in ANSWERS:
            found = list(ANSWERS[number](view, index))
        else:
            return UNSUPPORTED
        self.tell(peer, found)
        return ACCEPTED if found else LATER

    def _interval_of(self, peer: Peer, number: int) -> Message:
        """MESSAGE_INTERVAL: -1 is not sent, 0 not known."""
        rows = [row for row in telemetry.ROWS if row.id == number]
        interval_us = round(peer.interval_s(rows[0]) * 1e6) or -1 if rows else 0
        return dialect.MAVLink_message_interval_message(number & 0xFFFF, interval_us)

    def _timesync(self, peer: Peer, source: Source, message: Message) -> None:
        if message.tc1 == 0:
            self.tell(peer, [dialect.MAVLink_timesync_message(self.clock.time_ns(), message.ts1)])

    def _take(self, peer: Peer, source: Source, order: commands.Order) -> int:
        if order.target_system != self.system:
            return DENIED
        if order.p[1]:
            return ACCEPTED if self.ask(source, console.Take()) is None else LATER
        if self.owner == source.system:
            self.owner = 0
            self._news()
        return ACCEPTED

    def _interval(self, peer: Peer, source: Source, order: commands.Order) -> int:
        """SET_MESSAGE_INTERVAL: of what this peer gets. 0: as its profile says; below: not at all."""
        number, interval_us = order.p[:2]
        if number not in [row.id for row in telemetry.ROWS] or not math.isfinite(interval_us):
            return UNSUPPORTED
        if number == dialect.MAVLINK_MSG_ID_HEARTBEAT and not 0.0 <= interval_us <= 1e6:
            return DENIED
        if interval_us == 0.0:
            peer.asked_s.pop(int(number), None)
        else:
            peer.asked_s[int(number)] = NEVER_S if interval_us < 0.0 else max(interval_us / 1e6, 1.0 / FREQUENCY_MAX_HZ)
        peer.due_s.pop(int(number), None)
        return ACCEPTED

    def _high_latency(self, peer: Peer, source: Source, order: commands.Order) -> int:
        if order.p[0] not in (0.0, 1.0):
            return DENIED
        peer.profile = "lean" if order.p[0] else "wifi" if self.settings.profile == "lean" else self.settings.profile
        return ACCEPTED

    def _view(self) -> View:
        return View(self.boat, self.settings, self.owner, self.missions.number, self.clock.monotonic_s())


MAV_CMD_REQUEST_OPERATOR_CONTROL: Final = 32100

_Request = Callable[[Station, Peer, Source, commands.Order], int]
_REQUESTS: Final[dict[int, _Request]] = {
    MAV_CMD_REQUEST_OPERATOR_CONTROL: Station._take,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: Station._interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: Station._request,
    dialect.MAV_CMD_CONTROL_HIGH_LATENCY: Station._high_latency,
}
_HANDLERS: Final[dict[int, Callable[[Station, Peer, Source, Message], None]]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: Station._heartbeat,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: Station._command,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: Station._command,
    dialect.MAVLINK_MSG_ID_SET_MODE: Station._set_mode,
    dialect.MAVLINK_MSG_ID_MANUAL_CONTROL: Station._manual,
    dialect.MAVLINK_MSG_ID_TIMESYNC: Station._timesync,
    dialect.MAVLINK_MSG_ID_PING: Station._ping,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: Station._guest,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: Station._listed,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT: Station._requested,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST: Station._requested,
    dialect.MAVLINK_MSG_ID_MISSION_COUNT: Station._counted,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT: Station._item,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM: Station._old_item,
    dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: Station._old_item,
    dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: Station._clear,
    dialect.MAVLINK_MSG_ID_MISSION_SET_CURRENT: Station._set_current,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: Station._param_list,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: Station._param_read,
    dialect.MAVLINK_MSG_ID_PARAM_SET: Station._param_set,
    dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: Station._ftp,
    dialect.MAVLINK_MSG_ID_LOG_REQUEST_LIST: Station._logs,
}


class _Line(NamedTuple):
    """One console, as the mission protocol sees it."""

    station: Station
    peer: Peer
    source: Source

    def tell(self, message: Message) -> None:
        self.station.tell(self.peer, [message])

    def tell_all(self, message: Message) -> None:
        self.station.tell_all([message])

    def ask(self, command: console.Commands) -> str | None:
        return self.station.ask(self.source, command)

    def complain(self, text: str) -> None:
        self.station.say(dialect.MAV_SEVERITY_WARNING, text)


def _meant(message: Message, system: int) -> bool:
    """Whether a message is for this vehicle, or for all: those that change something look again."""
    return getattr(message, "target_system", 0) in (0, system) and getattr(message, "target_component", 0) in (0, 1)


def _loopback(host: str) -> bool:
    return ip_address(host.partition("%")[0]).is_loopback


def _no_stamp() -> int:
    return 0
