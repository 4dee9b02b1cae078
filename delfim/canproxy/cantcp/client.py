"""A client of cantcpd with its connection, protocol state and jobs; and all clients together."""

import asyncio
import logging
import socket
import struct
from collections import Counter, deque
from collections.abc import Mapping
from math import inf
from typing import Any, Final, cast

from delfim.base.errors import BusError
from delfim.canproxy import socketcand
from delfim.canproxy.cantcp import slcan
from delfim.canproxy.cantcp.access import Access
from delfim.canproxy.cantcp.bcm import JOBS_MAX, Cycles, Subscription
from delfim.canproxy.cantcp.outbox import Outbox, Timers
from delfim.canproxy.cantcp.sharedbus import FRAMES_A_CALL, Ear, SharedBus
from delfim.canproxy.tables import Cantcpd

INPUT_BYTES: Final = 512  # of a client's commands in one call: 40 frames to send
HOLD_S: Final = 0.02  # from the answer to `rawmode` to the first frame: clients compare what they read with "< ok >"
RETRY_S: Final = 0.001  # a client waits this long while the bus takes no frames ...
GIVE_UP_S: Final = 1.0  # ... and after this its frame is lost
WRITE_BYTES: Final = 1 << 14  # handed to the kernel ahead of a client
SEND_BUFFER_BYTES: Final = 1 << 16  # of the kernel: frames in it can no longer be dropped, and get old on a slow radio
STATISTICS_S_MIN: Final = 0.1
KEEPALIVE_S: Final = 10
ADDRESSES_MAX: Final = 64  # their counts are kept after their clients have left
_LOWDELAY: Final = 0x10  # IPTOS_LOWDELAY
_TCP_INFO_RTT: Final = 68  # offset of tcpi_rtt, microseconds (linux/tcp.h)

log = logging.getLogger(__name__)


class Client(asyncio.BufferedProtocol):
    """One connection with its state in the protocol and its jobs."""

    def __init__(
        self, clients: "Clients", buses: Mapping[str, SharedBus], session: socketcand.SocketcandSession | slcan.SlcanSession
    ) -> None:
        self.name = self.host = ""
        self.counts: Counter[str] = Counter()
        self.session = session
        self._clients, self._buses, self._loop = clients, buses, asyncio.get_running_loop()
        self._buffer = memoryview(bytearray(INPUT_BYTES))
        self._todo: deque[socketcand.Action] = deque()
        self._full_since_s = inf  # since when the bus has taken nothing
        self._bus: SharedBus | None = None
        self._why_unsent = "the bus did not take it"  # of the last frame that was not sent
        self._cycles = Cycles()
        self._statistics_s = inf  # between two reports
        self._timers = Timers()
        self._alive_s = self.since_s = self._loop.time()  # when it last took or said something; when it came

    # The connection.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self.host, port = transport.get_extra_info("peername")[:2]
        self.name = f"{self.host}:{port}"
        self._outbox = Outbox(self._transport, self._clients.settings.queue_bytes, self.counts, self._warn)
        self._ear = Ear(self.session.text, self._outbox.put, self._timers.at)
        refusal = self._clients.refusal(self.host)
        if refusal:
            self._warn(f"refused: {refusal}")
            self._transport.abort()
            return
        self._clients.inside.add(self)
        self._transport.set_write_buffer_limits(high=WRITE_BYTES, low=WRITE_BYTES // 4)
        peer = transport.get_extra_info("socket")
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # frees the place of a client whose radio failed
        for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL):
            peer.setsockopt(socket.IPPROTO_TCP, option, KEEPALIVE_S)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
        if peer.family == socket.AF_INET:
            peer.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, _LOWDELAY)
        else:
            peer.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS, _LOWDELAY)
        self._transport.write(self.session.greeting)

    def connection_lost(self, _: Exception | None) -> None:
        self._todo.clear()
        self._outbox.clear()
        self._close_bus()
        if self in self._clients.inside:
            self._clients.inside.remove(self)
            self._clients.keep(self)
            if self.counts or self.session.malformed:
                log.info("cantcpd: %s left: %s", self.name, self.report())

    def get_buffer(self, _: int) -> Any:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._alive_s = self._loop.time()
        self._todo.extend(self.session.feed(bytes(self._buffer[:nbytes])))
        self._work()

    def pause_writing(self) -> None:
        self._outbox.is_full = True

    def resume_writing(self) -> None:
        self._outbox.is_full = False
        self._alive_s = self._loop.time()
        self._outbox.flush()

    def stalled(self, now_s: float, stall_s: float) -> str:
        """The reason why this client is closed; empty: it is not."""
        if (self._outbox.is_full or self.is_leaving) and now_s - self._alive_s > stall_s:
            return f"took nothing for {stall_s:g} s"
        if self.is_idle and not self.session.opens_late and now_s - self.since_s > stall_s:
            return f"opened no bus for {stall_s:g} s"
        return ""

    @property
    def is_idle(self) -> bool:
        return self._bus is None

    @property
    def is_leaving(self) -> bool:
        return self._transport.is_closing()

    def abort(self) -> None:
        self._transport.abort()

    def report(self) -> dict[str, object]:
        """The client's report, JSON-ready: mode, bus, waiting frames, and counts of sent, dropped and refused ones."""
        return {
            "bus": self._bus.name if self._bus else "",
            "mode": self.session.mode,
            "queued_bytes": self._outbox.queued_bytes,
            "malformed": self.session.malformed,
            **self.counts,
        }

    def _warn(self, text: str) -> None:
        self._clients.warn(f"{self.name} {text}")

    # Its requests.

    def _work(self) -> None:
        """Carry out requests in order, until the bus is full. Answers share a write where they may: that is cheapest."""
        replies: list[bytes] = []
        while self._todo and not self._transport.is_closing():
            action = self._todo[0]
            if isinstance(action, socketcand.Reply):
                replies.append(action.text)
            elif not self._do(action, replies):
                self._transport.pause_reading()
                self._timers.at(self._on_work, self._loop.time() + RETRY_S)
                break
            self._todo.popleft()
        if replies:
            self._outbox.reply(b"".join(replies))

    def _do(self, action: socketcand.Action, replies: list[bytes]) -> bool:
        """Carry out one request; False when it must be tried again."""
        if isinstance(action, socketcand.Transmit):
            return self._transmit(action.arb, action.data)
        if isinstance(action, (socketcand.Open, socketcand.Enter, socketcand.Hangup)) and replies:
            self._outbox.reply(b"".join(replies))  # an ok has a write of its own
            replies.clear()
        match action:
            case socketcand.Open(name):
                self._open(name)
            case socketcand.Enter(mode):
                self._enter(mode)
            case socketcand.Hangup(text):
                self._hang_up(text)
            case socketcand.Close():
                self._close_bus()
            case socketcand.Cycle(arb, data, interval_s):
                if self._allowed(arb) and not self._cycles.add(arb, data, interval_s, self._loop.time()):
                    self.counts["refused"] += 1
                self._timers.at(self._on_cycle, self._cycles.due_s)
            case socketcand.Update(arb, data):
                self._cycles.update(arb, data)
            case socketcand.Delete(arb):
                self._cycles.delete(arb)
            case socketcand.Subscribe(arb, interval_s, masks):
                self._subscribe(arb, Subscription(interval_s, masks))
            case socketcand.Unsubscribe(arb) if self._bus:
                self._bus.unwatch(self._ear, arb)
            case socketcand.TellUnsent():
                unsent = self.counts["refused"] + self.counts["not transmitted"]
                replies.append(f"< unsent {unsent} {self._why_unsent} >".encode())
            case socketcand.TellTraffic(period_s):
                self._statistics_s = max(period_s, STATISTICS_S_MIN) if period_s else inf
                self._timers.cancel(self._on_statistics)
                self._timers.at(self._on_statistics, self._loop.time() + self._statistics_s)
        return True

    def _open(self, name: str) -> None:
        try:
            self._buses[name].join(self._ear)
        except BusError as error:
            self._warn(f"asked for {name}: {error}")
            self._hang_up(self.session.refused)
        else:
            self._bus = self._buses[name]
            self._outbox.reply(self.session.accepted)

    def _close_bus(self) -> None:
        self._end_jobs()
        if self._bus:
            self._bus.leave(self._ear)
            self._bus = None

    def _enter(self, mode: socketcand.Mode) -> None:
        self._end_jobs()
        if self._bus and mode == "raw":
            hold_s = max(HOLD_S, 2 * _round_trip_s(self._transport.get_extra_info("socket")))
            self._outbox.is_held = True
            self._timers.at(self._release, self._loop.time() + hold_s)
            self._bus.raw.append(self._ear)
        self._outbox.reply(self.session.accepted)

    def _release(self) -> None:
        self._outbox.is_held = False
        self._outbox.flush()

    def _hang_up(self, text: bytes) -> None:
        self._outbox.reply(text)
        self._transport.close()

    def _end_jobs(self) -> None:
        """End jobs, subscriptions and waiting frames: they belong to the mode before."""
        if self._bus:
            self._bus.quiet(self._ear)
        self._cycles.clear()
        self._timers.clear()
        self._release()

    def _subscribe(self, arb: int, watch: Subscription) -> None:
        if self._bus and (arb in self._ear.watches or len(self._ear.watches) < JOBS_MAX):
            self._bus.watch(self._ear, arb, watch)
        else:
            self.counts["refused"] += 1

    def _allowed(self, arb: int) -> bool:
        """Whether this client may send this identifier; a refusal is counted, and logged once."""
        why = self._clients.access.refusal(self.host, self._bus.interface if self._bus else "", arb)
        if why:
            if not self.counts["refused"]:
                self._warn(f"may not transmit: {why}")
            self.counts["refused"] += 1
            self._why_unsent = why
        return not why

    def _transmit(self, arb: int, data: bytes) -> bool:
        """Send a frame; False when the bus is full and there is time to try again."""
        if self._bus and self._allowed(arb):
            try:
                self._bus.transmit(arb, data, self._ear)
                self.counts["transmitted"] += 1
                self._full_since_s = inf
            except BlockingIOError:
                now_s = self._loop.time()
                self._full_since_s = min(self._full_since_s, now_s)
                if now_s - self._full_since_s < GIVE_UP_S:
                    return False
                self.counts["not transmitted"] += 1
            except BusError:
                self.counts["not transmitted"] += 1
        return True

    # Time.

    def _on_work(self) -> None:
        self._transport.resume_reading()
        self._work()

    def _on_cycle(self) -> None:
        for arb, data in self._cycles.take(self._loop.time(), FRAMES_A_CALL):
            try:
                if self._bus:
                    self._bus.transmit(arb, data, self._ear)
                    self.counts["transmitted"] += 1
            except (BlockingIOError, BusError):
                self.counts["not transmitted"] += 1
        self._timers.at(self._on_cycle, self._cycles.due_s)

    def _on_statistics(self) -> None:
        if self._bus:
            bus = self._bus
            numbers = f"{bus.received_bytes} {bus.received} {bus.transmitted_bytes} {bus.transmitted}"
            self._outbox.reply(f"< stat {numbers} >".encode())
            self._timers.at(self._on_statistics, self._loop.time() + self._statistics_s)


class Clients:
    """The connected clients, the limits for new ones, and the counts of those that left."""

    def __init__(self, settings: Cantcpd, access: Access) -> None:
        self.settings, self.access = settings, access
        self.inside: set[Client] = set()
        self.refused = 0  # connections
        self.left: dict[str, Counter[str]] = {}  # by address: counts of clients that have left
        self._is_warned = False

    def refusal(self, host: str) -> str:
        """The reason why a connection from there is refused; empty: it is not. Clients without an open bus give way, the oldest
        first."""
        why = "" if self.access.may_watch(host) else "not in cantcpd.watch"
        here = [client for client in self.inside if not client.is_leaving]
        beside = [client for client in here if client.host == host]
        limits = ((beside, self.settings.clients_per_address, " from there"), (here, self.settings.clients, ""))
        for clients, most, where in limits:
            if why or len(clients) < most:
                continue
            idle = min((client for client in clients if client.is_idle), key=lambda client: client.since_s, default=None)
            if idle is None:
                why = f"{most} clients{where} are connected"
            else:
                idle.abort()
                self.refused += 1
                break  # one place is free now
        self.refused += bool(why)
        return why

    def keep(self, client: Client) -> None:
        """Add the counts of a client that leaves."""
        kept = self.left.pop(client.host, Counter())
        self.left[client.host] = kept + client.counts + Counter(malformed=client.session.malformed, clients=1)
        if len(self.left) > ADDRESSES_MAX:
            del self.left[next(iter(self.left))]

    def warn(self, text: str) -> None:
        """Log an event that strangers can cause, only once between two polls: they must not fill the log."""
        if not self._is_warned:
            log.warning("cantcpd: %s", text)
        self._is_warned = True

    def poll(self, now_s: float) -> None:
        """Close clients that stalled."""
        self._is_warned = False
        for client in list(self.inside):
            if why := client.stalled(now_s, self.settings.stall_s):
                self.warn(f"{client.name} {why} and is closed")
                client.abort()


def _round_trip_s(peer: Any) -> float:
    """Round-trip time of a TCP connection, as measured by the kernel; 0: unknown."""
    try:
        info = peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 104)
        return float(struct.unpack_from("=I", info, _TCP_INFO_RTT)[0]) / 1e6
    except (OSError, AttributeError, struct.error):
        return 0.0
