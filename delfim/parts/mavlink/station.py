"""The vehicle as a MAVLink system: frames in, due messages out.

No sockets and no waiting: datagrams come in by `receive` and are worked off a few frames at a `turn`; `begin` and `serve` hand
what is due to `send`. Every request is answered when it comes, unknown ones too.
"""

import math
from collections import deque
from collections.abc import Callable
from ipaddress import ip_address
from typing import Final

from delfim.base.errors import FormatError
from delfim.parts.mavlink import telemetry
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import FrameVerdict, Signing
from delfim.parts.mavlink.codec.wire import Address, Message, Speaker, dialect
from delfim.parts.mavlink.consoles import Consoles, Obey, Review
from delfim.parts.mavlink.peers import HEARD_S, Peer
from delfim.parts.mavlink.received.handlers import HANDLERS, ORDERS, answer_late
from delfim.parts.mavlink.telemetry import NEVER_S, TelemetryRow, TelemetryView
from delfim.vehicle.loop import VehicleLoop

FRAMES: Final = 2  # of a turn
PENDING: Final = 256  # frames that wait; beyond, they are dropped
ROWS_AT_ONCE: Final = 3  # messages that one peer is told in one call
_GROUPS: Final = range(0, len(telemetry.ROWS), ROWS_AT_ONCE)
SLOWLY: Final = 5  # ticks from one parameter to the next on a slow link


class Station:
    """`send` takes a datagram and its address. `signing` is None without a key. `obey`, `review` and `correct` are those of
    `Consoles`. `is_ready`: whether the line to an address has room for telemetry; a heartbeat and answers go all the same."""

    def __init__(
        self,
        boat: VehicleLoop,
        obey: Obey,
        send: Callable[[bytes, Address], object],
        signing: Signing | None,
        review: Review | None = None,
        is_ready: Callable[[Address], bool] = lambda address: True,
        correct: Callable[[bytes], bool] | None = None,
    ) -> None:
        self._is_ready = is_ready
        self.consoles = Consoles(boat, obey, send, signing, review, correct)
        self._clock, self._signing, self._command_age_s = boat.clock, signing, self.consoles.settings.command_age_s
        self._pending: deque[tuple[bytes, Address]] = deque()
        self._serving: list[tuple[Peer, int]] = []  # peers to serve, and the row where each continues
        self._ticks = 0

    # In.

    def receive(self, datagram: bytes, address: Address) -> None:
        """A datagram has come. Its frames wait for `turn`."""
        found, whole = wire.frames(datagram)
        if not whole:
            self.consoles.count("malformed")
        for frame in found:
            if len(self._pending) >= PENDING:
                self.consoles.count("dropped")
                return
            self._pending.append((frame, address))

    def turn(self) -> bool:
        """Handle some frames, and continue preparing plans. Returns whether there is more."""
        for _ in range(min(FRAMES, len(self._pending))):
            fault = self._frame(*self._pending.popleft())
            if fault:
                self.consoles.count(fault)
        more = self.consoles.missions.step()
        return more or bool(self._pending)

    def _frame(self, frame: bytes, address: Address) -> str:
        """Returns the fault of the frame, to be counted; empty if it was addressed to another system."""
        verdict = self._judged(frame, address)
        if verdict.fault:
            if verdict.words:
                self.consoles.doubt(f"console {frame[5]} {verdict.words}")
            return verdict.fault
        try:
            message = wire.decode(frame)
        except FormatError:
            return "malformed"
        consoles, now_s = self.consoles, self._clock.monotonic_s()
        source = Speaker(frame[5], frame[6], address if self._signing is None else wire.link_of(frame))
        if message is None or source.system == 0 or source.party == (consoles.system, telemetry.COMPONENT):
            return "unknown"
        peer = consoles.peers.at(address, consoles.commander)
        if peer is None:
            return ""
        peer.heard_s, peer.source = now_s, source
        handler = HANDLERS.get(message.get_msgId())
        if not _meant(message, consoles.system) or answer_late(consoles, peer, source, message) or handler is None:
            return ""
        if consoles.sequences.is_late(address, source, frame[4], now_s) or verdict.age_s > self._command_age_s:
            return "late"
        if message.get_msgId() in ORDERS and self._signing and consoles.sequences.is_overtaken(source, wire.stamp_of(frame)):
            return "overtaken"
        handler(consoles, peer, source, message)
        return ""

    def _judged(self, frame: bytes, address: Address) -> FrameVerdict:
        """Holders of the key may speak; without a key, programs on this computer. With a key they need it too: other programs
        and other users' shells run here."""
        if self._signing is not None:
            return self._signing.judge(frame, address)
        return FrameVerdict("" if _loopback(address[0]) else "unsigned")

    # Out.

    def tick(self) -> None:
        """Send all due messages to everybody, at once."""
        self.begin()
        while self.serve():
            pass

    def begin(self) -> None:
        """Queue the due messages for `serve`. Call it about twenty times a second."""
        self._ticks += 1
        self.consoles.tick(self._clock.monotonic_s())
        first = self._ticks % len(_GROUPS)  # another one each time: a slow line has room for some only
        groups = (*_GROUPS[first:], *_GROUPS[:first])
        self._serving = [(peer, rows) for peer in self.consoles.peers.known.values() for rows in groups]

    def serve(self) -> bool:
        """Tell one peer some of it. Returns whether there is more to tell."""
        while self._serving:
            peer, at = self._serving.pop()
            is_ready, view = self._is_ready(peer.address), self.consoles.view()
            rows = telemetry.ROWS[at : at + (ROWS_AT_ONCE if is_ready else at == 0)]
            due = [message for row in rows for message in _due(peer, row, view)]
            if messages := [*due, *(self._params(peer) if at == 0 and is_ready else ())]:
                self.consoles.peers.tell(peer, messages)
                return bool(self._serving)
        return False

    def _params(self, peer: Peer) -> list[Message]:
        """Tell parameters of the list that the peer requested: slowly on a slow link."""
        count = 5 if peer.profile == "wifi" else 1 if self._ticks % SLOWLY == 0 else 0
        return [self.consoles.param(peer, peer.params.popleft()) for _ in range(min(count, len(peer.params)))]


def _due(peer: Peer, row: TelemetryRow, view: TelemetryView) -> list[Message]:
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
    peer.turns[row.id] = turn = peer.turns.get(row.id, -1) + 1
    return list(row.make(view._replace(turn=turn)))


def _meant(message: Message, system: int) -> bool:
    """Whether a message is for this vehicle, or for all: handlers that change something check again."""
    return getattr(message, "target_system", 0) in (0, system) and getattr(message, "target_component", 0) in (0, 1)


def _loopback(host: str) -> bool:
    return ip_address(host.partition("%")[0]).is_loopback
