"""The vehicle as a MAVLink system: who is listening, who commands, what is asked and answered.

No sockets and no waiting: datagrams come in by `receive`, are worked off a few frames at a `turn`, `tick` says what is due;
what goes out is handed to `send`. Whatever changes anything goes through `obey`, in the console's words, and so into the log. A
request is answered when it comes, and so is one that nobody understands.
"""

import math
import secrets
from collections import deque
from collections.abc import Callable
from ipaddress import ip_address
from typing import Final, NamedTuple

from delfim import config
from delfim.errors import FormatError
from delfim.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.loop import Vehicle
from delfim.vehicle.mavlink import params, telemetry, wire
from delfim.vehicle.mavlink.desk import HANDLERS
from delfim.vehicle.mavlink.missions import Missions
from delfim.vehicle.mavlink.signing import Signing, Verdict
from delfim.vehicle.mavlink.telemetry import NEVER_S, Profile, Row, View
from delfim.vehicle.mavlink.wire import GUEST, Address, Message, Sender, Source, dialect

PEERS: Final = 16  # at once
HEARD_S: Final = 15.0  # a peer silent for longer is told only that the boat exists; one that came by itself is forgotten
FRAMES: Final = 2  # of a turn
PENDING: Final = 256  # frames that wait; beyond, they are dropped
PACKED_BYTES: Final = 1200  # several messages share a datagram up to this size
LATE_FRAMES, LATE_S = 16, 3.0  # a frame so far behind the newest of its sender, within this time, came late or twice
SOURCES: Final = 64  # senders whose frames are counted
TOLD_AGAIN_S: Final = 2.0  # a trouble that lasts, at the earliest
NAMESAKES_S: Final = 3.0  # two consoles of one number that were both heard within this time are two, and not one that moved
TEXT_BYTES: Final = 50
SAID_BYTES: Final = 4 * TEXT_BYTES  # of a reason, however long it is
ROWS_AT_ONCE: Final = 3  # messages that one peer is told in one call
SLOWLY: Final = 5  # ticks from one parameter to the next where the link is slow


class Heard(NamedTuple):
    """The newest frame of a sender: its number, when it came, and since when the sender is heard."""

    number: int
    at_s: float
    since_s: float


class Peer:
    """An address that listens, and what it has been told."""

    def __init__(self, address: Address, sender: Sender, profile: Profile, configured: bool) -> None:
        self.address, self.sender, self.profile, self.configured = address, sender, profile, configured
        self.source: Source | None = None  # who speaks from there
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
    `send` takes a datagram and its address. `signing` is None where there is no key.
    `review` has a plan obeyed once it was looked at; without it that is done at once."""

    def __init__(
        self,
        boat: Vehicle,
        obey: Callable[[console.Commands, str], str | None],
        send: Callable[[bytes, Address], object],
        signing: Signing | None,
        review: Callable[[str, console.Plan, Callable[[str | None], None]], None] | None = None,
    ) -> None:
        self.boat, self.clock, self.settings = boat, boat.clock, boat.helm.settings.mavlink
        self.system = boat.helm.settings.boat.id
        self.commander: Source | None = None  # the console that commands
        self.counts: dict[str, int] = {}
        self.peers: dict[Address, Peer] = {}
        self._obey, self._send, self._signing = obey, send, signing
        self._review = review or (lambda operator, command, answer: answer(obey(command, operator)))
        self._pending: deque[tuple[bytes, Address]] = deque()
        self._serving: list[tuple[Peer, int]] = []  # whom to tell what is due, and from which row on
        self._newest: dict[tuple[Address, Source], Heard] = {}
        self._owner_s = self._namesakes_s = -math.inf
        self._said: tuple[Mode, str, tuple[tuple[str, str], ...], Source | None, str] | None = None
        self._told: dict[tuple[str, str], tuple[str, float]] = {}  # by trouble and action: the last words, and when
        self._text_id = self._ticks = 0
        self._leg_now: tuple[object, int] = None, 0
        self._run = secrets.token_hex(8)
        self.missions = Missions(boat, self.settings.autopilot == "ardurover")
        for listen in self.settings.peers:
            self._peer(config.address(listen), configured=True)

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
        """Work off some frames, and go on with what is to be told of plans. Returns whether there is more."""
        for _ in range(min(FRAMES, len(self._pending))):
            self._frame(*self._pending.popleft())
        more = self.missions.step()
        return more or bool(self._pending)

    def _frame(self, frame: bytes, address: Address) -> None:
        fault, age_s = self._judged(frame, address)
        if fault:
            self.count(fault)
            return
        try:
            message = wire.decode(frame)
        except FormatError:
            self.count("malformed")
            return
        source = Source(frame[5], frame[6], address if self._signing is None else wire.link_of(frame))
        if message is None or source.system == 0 or source.party == (self.system, telemetry.COMPONENT):
            self.count("unknown")
            return
        peer = self._peer(address)
        if peer is None:
            return
        peer.heard_s, peer.source = self.clock.monotonic_s(), source
        handler = HANDLERS.get(message.get_msgId())
        if handler is None or not _meant(message, self.system):
            return
        if self._late(address, source, frame[4]) or age_s > self.settings.command_age_s:
            self.count("late")
            return
        handler(self, peer, source, message)

    def _judged(self, frame: bytes, address: Address) -> Verdict:
        """Whoever has a key may speak; where there is none, whoever is on this computer. A key binds this computer, too: other
        programs run on it, and a shell of somebody else."""
        if self._signing is not None:
            return self._signing.judge(frame)
        return Verdict("" if _loopback(address[0]) else "unsigned")

    def _late(self, address: Address, source: Source, number: int) -> bool:
        """Whether a frame came twice, or after one that was sent later."""
        now_s, key = self.clock.monotonic_s(), (address, source)
        newest, at_s, since_s = self._newest.get(key, Heard(number - 1 & 0xFF, -math.inf, now_s))
        if -number + newest & 0xFF < LATE_FRAMES and now_s - at_s < LATE_S:
            return True
        if key not in self._newest and len(self._newest) >= SOURCES:
            del self._newest[min(self._newest, key=lambda each: self._newest[each].at_s)]
        self._newest[key] = Heard(number, now_s, since_s if now_s - at_s < NAMESAKES_S else now_s)
        return False

    def _peer(self, address: Address, configured: bool = False) -> Peer | None:
        """The peer at an address; None where there are too many and none gives way."""
        if address not in self.peers:
            if len(self.peers) >= PEERS and not self._makes_room():
                self.count("peers_full")
                return None
            key, stamp = (None, _no_stamp) if self._signing is None else (self._signing.key, self._signing.stamp)
            sender = Sender(self.system, telemetry.COMPONENT, key, stamp)
            self.peers[address] = Peer(address, sender, self.settings.profile, configured)
        return self.peers[address]

    def _makes_room(self) -> bool:
        """The peer that was silent for longest is forgotten; none of the vehicle's file, and not the one that commands."""
        others = [peer for peer in self.peers.values() if not peer.configured and peer.source != self.commander]
        if not others:
            return False
        del self.peers[min(others, key=lambda peer: peer.heard_s).address]
        self.count("peers_replaced")
        return True

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    # Out.

    def tick(self) -> None:
        """What is due now, to everybody, at once."""
        self.begin()
        while self.serve():
            pass

    def begin(self) -> None:
        """What is due now is to be told by `serve`. Call it some twenty times a second."""
        now_s = self.clock.monotonic_s()
        self._ticks += 1
        self.news()
        self.missions.tick(now_s)
        if self.boat.state.namesakes and now_s - self._namesakes_s > HEARD_S:
            self.boat.on_namesakes("")
        for peer in [peer for peer in self.peers.values() if not peer.configured and now_s - peer.heard_s > HEARD_S]:
            del self.peers[peer.address]
        self._serving = [(peer, rows) for peer in self.peers.values() for rows in range(0, len(telemetry.ROWS), ROWS_AT_ONCE)]

    def serve(self) -> bool:
        """Tell one peer some of it. Returns whether there is more to tell."""
        while self._serving:
            peer, at = self._serving.pop()
            view = self.view()
            due = [message for row in telemetry.ROWS[at : at + ROWS_AT_ONCE] for message in self._due(peer, row, view)]
            if messages := [*due, *(self._params(peer) if at == 0 else ())]:
                self.tell(peer, messages)
                return bool(self._serving)
        return False

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
        data = text.encode("ascii", "replace")[:SAID_BYTES]
        chunks = [data[at : at + TEXT_BYTES] for at in range(0, max(len(data), 1), TEXT_BYTES)]
        number = self._text_id if len(chunks) > 1 else 0
        self.tell_all([dialect.MAVLink_statustext_message(severity, chunk, number, i) for i, chunk in enumerate(chunks)])

    def news(self) -> None:
        """Changes of mode and troubles, in words, and a heartbeat at once where the mode is another one."""
        self._reached()
        state = self.boat.state
        troubles = tuple((notice.name, notice.action) for notice in state.notices)
        said = state.mode, state.reason, troubles, self.commander, state.namesakes
        was, self._said = self._said or said, said
        if was[:2] != said[:2]:
            calm = state.reason.startswith("operator") or state.reason.endswith(" done")
            self.say(
                dialect.MAV_SEVERITY_NOTICE if calm else dialect.MAV_SEVERITY_ALERT,
                f"{state.mode.name.lower()}: {state.reason}",
            )
        self._tell_troubles()
        if was[3] != self.commander:
            who = self.commander.name if self.commander is not None else "no console"
            self.say(dialect.MAV_SEVERITY_NOTICE, f"{who} commands")
        if state.namesakes and was[4] != state.namesakes:
            self.say(dialect.MAV_SEVERITY_ALERT, state.namesakes)
        if was != said:
            self._at_once(dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT)

    def _tell_troubles(self) -> None:
        """Each when it begins or is answered in another way, and again when it has lasted twice as long: "for 1.0 s" does
        not stand on a screen while it is a minute."""
        now_s, told, self._told = self.clock.monotonic_s(), self._told, {}
        for notice in self.boat.state.notices:
            trouble = notice.name, notice.action
            words, at_s = told.get(trouble, ("", -math.inf))
            if notice.reason != words and now_s - at_s >= max(at_s - notice.since_s, TOLD_AGAIN_S):
                severity = dialect.MAV_SEVERITY_WARNING if notice.action == "warn" else dialect.MAV_SEVERITY_CRITICAL
                self.say(severity, f"{notice.reason}: {notice.action}")
                words, at_s = notice.reason, now_s
            self._told[trouble] = words, at_s

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
        one before was silent for long. Anybody may stop the boat. Returns why not, or None. Raises FormatError for what
        cannot be asked of any boat."""
        command = console.checked(command)
        if (reason := self._own(source, command)) is not None:
            return reason
        refused = self._obey(command, source.name)
        self.news()
        return refused

    def propose(self, source: Source, command: console.Commands, answer: Callable[[str | None], None]) -> None:
        """The same for a plan, which takes a while to be looked at: `answer` gets what came of it."""

        def done(refused: str | None) -> None:
            self.news()
            answer(refused)

        if not isinstance(command, console.Plan):
            answer(self.ask(source, command))
        elif (reason := self._own(source, command)) is not None:
            answer(reason)
        else:
            self._review(source.name, command, done)

    def _own(self, source: Source, command: console.Commands) -> str | None:
        """Whoever commands is the owner from now on. Returns why this console may not command."""
        if self.commander != source and not isinstance(command, console.Stop):
            if (reason := self.refusal(source, isinstance(command, console.Take))) is not None:
                return reason
            self.commander = source
        if self.commander == source:
            self._owner_s = self.clock.monotonic_s()
        return None

    def refusal(self, source: Source, takes: bool = False) -> str | None:
        """Why this console may not command, in words. `takes`: it says that it takes over."""
        if source.component == GUEST:
            return "the guest computer does not command"
        lost = self.clock.monotonic_s() - self._owner_s > self.boat.helm.settings.failsafe.console_silent.after_s
        if takes or self.commander in (None, source) or lost:
            return None
        self.count("not_owner")
        same = "another " if self.owner == source.system else ""
        return f"{same}console {self.owner} commands; take over first"

    @property
    def owner(self) -> int:
        """The system of the console that commands; 0: none."""
        return self.commander.system if self.commander is not None else 0

    def alive(self, source: Source, address: Address) -> None:
        """A console was heard that may be the one that commands, or have the number of another one."""
        now_s = self.clock.monotonic_s()
        if source == self.commander:
            self._owner_s = now_s
            self._obey(console.Alive(), source.name)
        since_s = self._newest[address, source].since_s
        for (where, who), heard in self._newest.items():
            if who.party == source.party and where != address and now_s - heard.at_s < NAMESAKES_S and heard.at_s > since_s:
                self._namesakes_s = now_s
                places = " and ".join(f"{host}:{port}" for host, port in sorted((address, where)))
                words = f"two consoles are number {source.system}: {places}; give one of them another number"
                self.boat.on_namesakes(self.boat.state.namesakes or words)

    def give_up(self, source: Source) -> None:
        """This console commands no longer."""
        if self.commander == source:
            self.commander = None
            self.news()

    def param(self, peer: Peer, name: str) -> Message:
        """PARAM_VALUE, with what is in force for this peer."""
        if name == params.PROFILE:
            return params.message(name, float(telemetry.PROFILES.index(peer.profile)))
        return params.message(name, params.value(self.boat.helm.settings, params.BY_NAME[name]))

    def text(self, name: str) -> str:
        """Of one of `params.TEXTS`."""
        return {params.BOAT_NAME: self.boat.helm.settings.boat.name, params.BOAT_RUN: self._run}[name]

    def view(self) -> View:
        return View(
            self.boat, self.settings, self.owner, self.missions.number, self.missions.checksum, self.clock.monotonic_s()
        )


def _meant(message: Message, system: int) -> bool:
    """Whether a message is for this vehicle, or for all: those that change something look again."""
    return getattr(message, "target_system", 0) in (0, system) and getattr(message, "target_component", 0) in (0, 1)


def _loopback(host: str) -> bool:
    return ip_address(host.partition("%")[0]).is_loopback


def _no_stamp() -> int:
    return 0
