"""cantcpd: CAN over TCP, the socketcand protocol and slcan (thesis 3.3). Watches the buses for any number of clients,
and sends for them.

A bus has one socket for all its clients, open while there are any. A frame becomes text once. Every client has a bounded queue
of its own: what it does not take in time is lost for it alone, oldest first, and counted. No callback takes longer for a slow
client, for one that floods, or for a full bus.

Who transmits is decided by address and identifier (the vehicle's file); what is refused is counted and logged, without an
answer, for python-can's reader ends at one. What was sent is on the bus, and so in the black box. The protocol itself:
delfim.canproxy.socketcand; how to connect the usual programs: docs/cantcpd.md.
"""

import asyncio
import ipaddress
import logging
import re
import socket
import struct
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from math import inf
from typing import Any, Final, Protocol, cast

from delfim import config
from delfim.canproxy import slcan, socketcand
from delfim.canproxy.bcm import JOBS_MAX, Cycles, Watch
from delfim.canproxy.beacon import announce
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.clock import Clock
from delfim.errors import BusError
from delfim.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, extended, identifier, standard

FRAMES_A_CALL: Final = 32
INPUT_BYTES: Final = 512  # of a client's commands in one call: 40 frames to send
GATHER_S: Final = 0.005  # frames that come so soon after others travel together: one write, not one each
HOLD_S: Final = 0.02  # from the answer to `rawmode` to the first frame: clients compare what they read with "< ok >"
RETRY_S: Final = 0.001  # that a client waits while the bus takes no frames ...
GIVE_UP_S: Final = 1.0  # ... and after which its frame is lost
WRITE_BYTES: Final = 1 << 14  # handed to the kernel ahead of a client
SEND_BUFFER_BYTES: Final = 1 << 16  # of the kernel: what waits here cannot be dropped any more, and gets old on a slow radio
STATISTICS_S_MIN: Final = 0.1
KEEPALIVE_S: Final = 10
ADDRESSES_MAX: Final = 64  # whose counts are kept when their clients have left
BEACON_EVERY: Final = 3  # polls
_LOWDELAY: Final = 0x10  # IPTOS_LOWDELAY
_TCP_INFO_RTT: Final = 68  # offset of tcpi_rtt, microseconds (linux/tcp.h)

TextOf = Callable[[Frame], bytes]

log = logging.getLogger(__name__)


class Readers(Protocol):
    """What is needed of the runtime: to be called when a descriptor is readable, on this service's account."""

    def reader(self, fd: int, handler: Callable[[], object]) -> None: ...
    def remove_reader(self, fd: int) -> None: ...


class Access:
    """Who may watch, who may transmit, and what nobody may."""

    def __init__(self, settings: config.Cantcpd) -> None:
        self._watch = [ipaddress.ip_network(network) for network in settings.watch]
        self._transmit = [ipaddress.ip_network(network) for network in settings.transmit]
        self._barred = [_range(text) for text in settings.barred]

    def may_watch(self, host: str) -> bool:
        address = _address(host)
        return any(address in network for network in self._watch)

    def may_transmit(self, host: str) -> bool:
        address = _address(host)
        return any(address in network for network in self._transmit)

    def is_barred(self, arb: int) -> bool:
        return any(low <= arb <= high and not (arb ^ low) & CAN_IDE for low, high in self._barred)


def _range(text: str) -> tuple[int, int]:
    """First and last arbitration field of "040", "040-043" or "00000040-00000043"."""
    low, _, high = text.partition("-")
    arb = extended if len(low) == 8 else standard
    return arb(int(low, 16)), arb(int(high or low, 16))


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    address = ipaddress.ip_address(host.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


class Bus:
    """One bus: its socket, and the clients that opened it."""

    def __init__(self, name: str, interface: str, readers: Readers, clock: Clock, receive_buffer_bytes: int) -> None:
        self.name, self.interface = name, interface
        self._receive_buffer_bytes = receive_buffer_bytes
        self.failure = ""  # of the bus, in words
        self.received = self.received_bytes = self.transmitted = self.transmitted_bytes = 0
        self.raw: list[Client] = []
        self.watchers: dict[int, set[Client]] = {}  # by arbitration field
        self._readers, self._clock = readers, clock
        self._clients: set[Client] = set()
        self._can: CanSocket | None = None
        self._sent: list[tuple[Frame, Client]] = []  # not yet told to the other clients
        self._later: asyncio.Handle | None = None  # the next look at a busy bus; None: woken by its first frame

    def join(self, client: "Client") -> None:
        """Raises BusError where the bus cannot be opened."""
        if self._can is None:
            can = open_can(self.interface, receive_buffer_bytes=self._receive_buffer_bytes, batch=FRAMES_A_CALL)
            try:
                can.bind(ANYTHING)
            except BusError:
                can.close()
                raise
            can.setblocking(False)
            self._can = can
            self._readers.reader(self._can.fileno(), self._wake)
        self._clients.add(client)

    def leave(self, client: "Client") -> None:
        self.quiet(client)
        self._clients.discard(client)
        if not self._clients:
            self.close()

    def quiet(self, client: "Client") -> None:
        """No frames any more for this client."""
        self.raw = [other for other in self.raw if other is not client]
        for arb in list(client.watches):
            self.unwatch(client, arb)

    def watch(self, client: "Client", arb: int, watch: Watch) -> None:
        client.watches[arb] = watch
        self.watchers.setdefault(arb, set()).add(client)

    def unwatch(self, client: "Client", arb: int) -> None:
        if client.watches.pop(arb, None):
            self.watchers[arb].discard(client)
            if not self.watchers[arb]:
                del self.watchers[arb]

    def close(self) -> None:
        if self._can:
            if self._later:
                self._later.cancel()
                self._later = None
            else:
                self._readers.remove_reader(self._can.fileno())
            self._can.close()
            self._can = None
            self._sent.clear()

    def poll(self) -> None:
        """Call about once a second: takes up a bus that failed."""
        if self.failure and self._can and self._can.rebind():
            log.warning("cantcpd: %s is back", self.name)
            self.failure = ""

    @property
    def dropped(self) -> int:
        """Frames that the socket lost while it was open this time."""
        return self._can.dropped if self._can else 0

    def transmit(self, arb: int, data: bytes, client: "Client") -> None:
        """Raises BlockingIOError when the transmit queue is full, BusError."""
        if self._can is None:
            raise BusError(f"{self.name} is closed")
        frame = Frame(arb, data, self._clock.time_ns())
        self._can.sendto(data, CanAddress(arb))
        self.transmitted += 1
        self.transmitted_bytes += len(data)
        self._sent.append((frame, client))
        if self._later is None:
            self._readers.remove_reader(self._can.fileno())
            self._later = asyncio.get_running_loop().call_later(GATHER_S, self._look)
        elif len(self._sent) == FRAMES_A_CALL:
            self._later.cancel()
            self._later = asyncio.get_running_loop().call_soon(self._look)

    def _wake(self) -> None:
        """The first frame after a silence is told at once."""
        if self._can:
            self._readers.remove_reader(self._can.fileno())
            self._look()

    def _look(self) -> None:
        """Tell what came, and look again soon while it is busy: a wake-up for every frame would cost more than the frames."""
        loop = asyncio.get_running_loop()
        frames = self._receive()
        if self._sent:
            self._tell_sent(frames, loop.time())
        elif frames:
            self._tell(frames, loop.time())
        if self._can is None:  # its last client was closed just now
            return
        if len(frames) >= FRAMES_A_CALL:
            self._later = loop.call_soon(self._look)
        elif frames:
            self._later = loop.call_later(GATHER_S, self._look)
        else:
            self._later = None
            self._readers.reader(self._can.fileno(), self._wake)

    def _receive(self) -> list[Frame]:
        """About FRAMES_A_CALL frames of all kinds."""
        frames: list[Frame] = []
        if self._can is None:
            return frames
        try:
            while len(frames) < FRAMES_A_CALL and (more := self._can.receive_many()):
                frames += more
        except BusError as error:
            self._failed(error)
        return frames

    def _tell(self, frames: list[Frame], now_s: float) -> None:
        told = [frame for frame in frames if not frame.arb & (CAN_RTR | CAN_ERR)]  # socketcand has no others
        self.received += len(told)
        self.received_bytes += sum(len(frame.data) for frame in told)
        if self.raw and told:
            texts: dict[TextOf, bytes] = {}
            for client in self.raw:
                text_of = client.session.text
                if text_of not in texts:
                    texts[text_of] = b"".join(map(text_of, told))
                client.put(texts[text_of], len(told))
        if self.watchers:
            self._tell_watchers(told, now_s)

    def _tell_sent(self, frames: list[Frame], now_s: float) -> None:
        """As `_tell`, with what clients sent, in order of time; nobody hears his own."""
        sent, self._sent = self._sent, []
        authors = {id(frame): client for frame, client in sent}
        everything = sorted([*frames, *(frame for frame, _ in sent)], key=lambda frame: frame.t_ns)
        told = [frame for frame in everything if not frame.arb & (CAN_RTR | CAN_ERR)]
        self.received += len(told) - len(sent)
        self.received_bytes += sum(len(frame.data) for frame in told if id(frame) not in authors)
        texts: dict[TextOf, list[tuple[bytes, Client | None]]] = {}
        for client in self.raw:
            text_of = client.session.text
            if text_of not in texts:
                texts[text_of] = [(text_of(frame), authors.get(id(frame))) for frame in told]
            others = [text for text, author in texts[text_of] if author is not client]
            if others:
                client.put(b"".join(others), len(others))
        for frame in told:
            self._tell_watchers([frame], now_s, authors.get(id(frame)))

    def _tell_watchers(self, frames: Iterable[Frame], now_s: float, author: "Client | None" = None) -> None:
        for frame in frames:
            if clients := self.watchers.get(frame.arb):
                text = socketcand.bcm_text(frame)
                for client in clients:
                    if client is not author:
                        client.offer(frame, text, now_s)

    def _failed(self, error: BusError) -> None:
        if str(error) != self.failure:
            self.failure = str(error)
            log.warning("cantcpd: %s", error)


class Client(asyncio.BufferedProtocol):
    """One connection: its place in the protocol, its queue and its jobs."""

    def __init__(self, server: "Cantcpd", session: socketcand.Session | slcan.Session) -> None:
        self.name = self.host = ""
        self.counts: Counter[str] = Counter()
        self.session = session
        self._server, self._loop = server, asyncio.get_running_loop()
        self._buffer = memoryview(bytearray(INPUT_BYTES))
        self._queue: deque[tuple[bytes, int]] = deque()  # text, and the number of frames in it
        self._queued_bytes = 0
        self._todo: deque[socketcand.Action] = deque()
        self._full_since_s = inf  # since when the bus has taken nothing
        self._bus: Bus | None = None
        self._may_transmit = False
        self._is_full = False  # the kernel and the transport take no more
        self._held: asyncio.TimerHandle | None = None  # frames wait until this is over
        self._soon: asyncio.Handle | None = None  # they are written then
        self.watches: dict[int, Watch] = {}  # the bus sees to it
        self._cycles = Cycles()
        self._statistics_s = inf  # between two tellings
        self._timers: dict[Callable[[], None], asyncio.TimerHandle] = {}
        self._alive_s = self.since_s = self._loop.time()  # when it last took or said something; when it came

    # The connection.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self.host, port = transport.get_extra_info("peername")[:2]
        self.name = f"{self.host}:{port}"
        refusal = self._server.refusal(self.host)
        if refusal:
            self._server.warn(f"{self.name} refused: {refusal}")
            self._transport.abort()
            return
        self._may_transmit = self._server.access.may_transmit(self.host)
        self._server.clients.add(self)
        self._transport.set_write_buffer_limits(high=WRITE_BYTES, low=WRITE_BYTES // 4)
        peer = transport.get_extra_info("socket")
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # who vanished with the radio gives his place free
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
        self._queue.clear()
        self._queued_bytes = 0
        self._close_bus()
        if self in self._server.clients:
            self._server.clients.remove(self)
            self._server.keep(self)
            if self.counts or self.session.malformed:
                log.info("cantcpd: %s left: %s", self.name, self.report())

    def get_buffer(self, _: int) -> Any:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._alive_s = self._loop.time()
        self._todo.extend(self.session.feed(bytes(self._buffer[:nbytes])))
        self._work()

    def pause_writing(self) -> None:
        self._is_full = True

    def resume_writing(self) -> None:
        self._is_full = False
        self._alive_s = self._loop.time()
        self._flush()

    def stalled(self, now_s: float, stall_s: float) -> str:
        """Why this client is closed; empty where it is not."""
        if (self._is_full or self.is_leaving) and now_s - self._alive_s > stall_s:
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
        """JSON-ready: mode, bus, what waits, and counts of what was sent, dropped and refused."""
        return {
            "bus": self._bus.name if self._bus else "",
            "mode": self.session.mode,
            "queued_bytes": self._queued_bytes,
            "malformed": self.session.malformed,
            **self.counts,
        }

    # Towards the client.

    def put(self, text: bytes, frames: int) -> None:
        """Frames for this client: soon written, or lost. Soon, because so many writes at once would make a long callback."""
        self._queue.append((text, frames))
        self._queued_bytes += len(text)
        while self._queued_bytes > self._server.settings.queue_bytes:
            lost, count = self._queue.popleft()
            self._queued_bytes -= len(lost)
            if not self.counts["dropped"]:
                self._server.warn(f"{self.name} is too slow: frames are dropped for it")
            self.counts["dropped"] += count
        if not (self._soon or self._is_full or self._held):
            self._soon = self._loop.call_soon(self._flush)

    def offer(self, frame: Frame, text: bytes, now_s: float) -> None:
        """A frame to which this client has subscribed."""
        watch = self.watches[frame.arb]
        told = watch.offer(text, frame.data, now_s)
        if told:
            self.put(told, 1)
        else:
            self._at(self._on_watch, watch.due_s)

    def _flush(self) -> None:
        self._soon = None
        while self._queue and not self._is_full and not self._held:
            text, frames = self._queue.popleft()
            self._queued_bytes -= len(text)
            self.counts["frames"] += frames
            self._transport.write(text)

    def _reply(self, text: bytes) -> None:
        """After the frames that came before, unless these are held."""
        if self._is_full:
            self.put(text, 0)
        else:
            self._flush()
            self._transport.write(text)

    # What it asks for.

    def _work(self) -> None:
        """Do what is asked for, in order, until the bus is full. Answers that may share a write do: nothing is cheaper."""
        replies: list[bytes] = []
        while self._todo and not self._transport.is_closing():
            action = self._todo[0]
            if isinstance(action, socketcand.Reply):
                replies.append(action.text)
            elif not self._do(action, replies):
                self._transport.pause_reading()
                self._at(self._on_work, self._loop.time() + RETRY_S)
                break
            self._todo.popleft()
        if replies:
            self._reply(b"".join(replies))

    def _do(self, action: socketcand.Action, replies: list[bytes]) -> bool:
        """False where it has to be tried again."""
        if isinstance(action, socketcand.Transmit):
            return self._transmit(action.arb, action.data)
        if isinstance(action, (socketcand.Open, socketcand.Enter, socketcand.Hangup)) and replies:
            self._reply(b"".join(replies))  # an ok has a write of its own
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
                self._at(self._on_cycle, self._cycles.due_s)
            case socketcand.Update(arb, data):
                self._cycles.update(arb, data)
            case socketcand.Delete(arb):
                self._cycles.delete(arb)
            case socketcand.Subscribe(arb, interval_s, masks):
                self._subscribe(arb, Watch(interval_s, masks))
            case socketcand.Unsubscribe(arb) if self._bus:
                self._bus.unwatch(self, arb)
            case socketcand.Statistics(period_s):
                self._statistics_s = max(period_s, STATISTICS_S_MIN) if period_s else inf
                if timer := self._timers.pop(self._on_statistics, None):
                    timer.cancel()
                self._at(self._on_statistics, self._loop.time() + self._statistics_s)
        return True

    def _open(self, name: str) -> None:
        try:
            self._server.buses[name].join(self)
        except BusError as error:
            self._server.warn(f"{self.name} asked for {name}: {error}")
            self._hang_up(self.session.refused)
        else:
            self._bus = self._server.buses[name]
            self._reply(self.session.accepted)

    def _close_bus(self) -> None:
        self._end_jobs()
        if self._bus:
            self._bus.leave(self)
            self._bus = None

    def _enter(self, mode: socketcand.Mode) -> None:
        self._end_jobs()
        if self._bus and mode == "raw":
            hold_s = max(HOLD_S, 2 * _round_trip_s(self._transport.get_extra_info("socket")))
            self._held = self._loop.call_later(hold_s, self._release)
            self._bus.raw.append(self)
        self._reply(self.session.accepted)

    def _release(self) -> None:
        self._held = None
        self._flush()

    def _hang_up(self, text: bytes) -> None:
        self._reply(text)
        self._transport.close()

    def _end_jobs(self) -> None:
        """Jobs and subscriptions belong to a mode, and frames that still wait to the one before."""
        if self._bus:
            self._bus.quiet(self)
        self._cycles.clear()
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        if self._held:
            self._held.cancel()
            self._held = None
        self._flush()

    def _subscribe(self, arb: int, watch: Watch) -> None:
        if self._bus and (arb in self.watches or len(self.watches) < JOBS_MAX):
            self._bus.watch(self, arb, watch)
        else:
            self.counts["refused"] += 1

    def _allowed(self, arb: int) -> bool:
        """Whether this client may send this identifier; where not, that is counted, and logged once."""
        if self._may_transmit and not self._server.access.is_barred(arb):
            return True
        why = f"{identifier(arb):X} is barred" if self._may_transmit else "this network may watch only"
        if not self.counts["refused"]:
            self._server.warn(f"{self.name} may not transmit: {why}")
        self.counts["refused"] += 1
        return False

    def _transmit(self, arb: int, data: bytes) -> bool:
        """False where the bus is full and there is still time."""
        if self._bus and self._allowed(arb):
            try:
                self._bus.transmit(arb, data, self)
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

    def _at(self, job: Callable[[], None], when_s: float) -> None:
        """See to a job then, or earlier where that was said before; infinite: as said before."""
        timer = self._timers.get(job)
        if when_s < inf and (timer is None or timer.when() > when_s):
            if timer:
                timer.cancel()
            self._timers[job] = self._loop.call_at(when_s, self._due, job)

    def _due(self, job: Callable[[], None]) -> None:
        del self._timers[job]
        job()

    def _on_work(self) -> None:
        self._transport.resume_reading()
        self._work()

    def _on_cycle(self) -> None:
        for arb, data in self._cycles.take(self._loop.time(), FRAMES_A_CALL):
            try:
                if self._bus:
                    self._bus.transmit(arb, data, self)
                    self.counts["transmitted"] += 1
            except (BlockingIOError, BusError):
                self.counts["not transmitted"] += 1
        self._at(self._on_cycle, self._cycles.due_s)

    def _on_watch(self) -> None:
        now_s = self._loop.time()
        for watch in self.watches.values():
            for text in watch.take(now_s):
                self.put(text, 1)
            self._at(self._on_watch, watch.due_s)

    def _on_statistics(self) -> None:
        if self._bus:
            bus = self._bus
            numbers = f"{bus.received_bytes} {bus.received} {bus.transmitted_bytes} {bus.transmitted}"
            self._reply(f"< stat {numbers} >".encode())
            self._at(self._on_statistics, self._loop.time() + self._statistics_s)


class Cantcpd:
    """The service: `connection` and `slcan_connection` make the protocol of one connection, `poll` is called once a second."""

    def __init__(
        self,
        settings: config.Cantcpd,
        interfaces: Iterable[str],
        readers: Readers,
        clock: Clock,
        receive_buffer_bytes: int = 1 << 20,
    ) -> None:
        self.settings, self.access = settings, Access(settings)
        self.buses: Mapping[str, Bus] = {
            bus_name(interface): Bus(bus_name(interface), interface, readers, clock, receive_buffer_bytes)
            for interface in interfaces
        }
        self.clients: set[Client] = set()
        self.refused = 0  # connections
        self.left: dict[str, Counter[str]] = {}  # by address: counts of clients that have left
        self._polls = 0
        self._is_warned = False
        self._silent: set[str] = set()  # interfaces on which announcing failed

    def connection(self) -> Client:
        return Client(self, socketcand.Session(self.buses))

    def slcan_connection(self) -> Client:
        """For the first of the buses: slcan has no word for others."""
        return Client(self, slcan.Session(next(iter(self.buses))))

    def refusal(self, host: str) -> str:
        """Why a connection from there is refused; empty where it is not. Who has opened no bus gives way, the oldest first."""
        why = "" if self.access.may_watch(host) else "not in cantcpd.watch"
        inside = [client for client in self.clients if not client.is_leaving]
        beside = [client for client in inside if client.host == host]
        limits = ((beside, self.settings.clients_per_address, " from there"), (inside, self.settings.clients, ""))
        for clients, most, where in limits:
            if why or len(clients) < most:
                continue
            idle = min((client for client in clients if client.is_idle), key=lambda client: client.since_s, default=None)
            if idle is None:
                why = f"{most} clients{where} are connected"
            else:
                idle.abort()
                self.refused += 1
                break  # and a place is free
        self.refused += bool(why)
        return why

    def keep(self, client: Client) -> None:
        """The counts of one who leaves."""
        kept = self.left.pop(client.host, Counter())
        self.left[client.host] = kept + client.counts + Counter(malformed=client.session.malformed, clients=1)
        if len(self.left) > ADDRESSES_MAX:
            del self.left[next(iter(self.left))]

    def warn(self, text: str) -> None:
        """Log what strangers can cause: once between two polls, or they would fill the log."""
        if not self._is_warned:
            log.warning("cantcpd: %s", text)
        self._is_warned = True

    def poll(self, port: int) -> None:
        """Take up buses that failed, close clients that stalled, announce `port` on the LAN."""
        self._is_warned = False
        now_s = asyncio.get_running_loop().time()
        for bus in self.buses.values():
            bus.poll()
        for client in list(self.clients):
            if why := client.stalled(now_s, self.settings.stall_s):
                self.warn(f"{client.name} {why} and is closed")
                client.abort()
        if self.settings.beacon and self._polls % BEACON_EVERY == 0:
            for interface in self.settings.beacon:
                self._announce(interface, port)
        self._polls += 1

    def _announce(self, interface: str, port: int) -> None:
        try:
            announce(interface, port, list(self.buses))
            self._silent.discard(interface)
        except OSError as error:  # down, without address, no LAN
            if interface not in self._silent:
                log.warning("cantcpd: no beacon on %s: %s", interface, error)
            self._silent.add(interface)

    def report(self) -> dict[str, object]:
        """JSON-ready: every bus and every client."""
        return {
            "refused": self.refused,
            "buses": {
                bus.name: {
                    "received": bus.received,
                    "transmitted": bus.transmitted,
                    "dropped": bus.dropped,
                    "failure": bus.failure,
                }
                for bus in self.buses.values()
            },
            "clients": {client.name: client.report() for client in self.clients},
            "left": {host: dict(counts) for host, counts in self.left.items()},
        }

    def close(self) -> None:
        """Close every connection and bus."""
        for client in list(self.clients):
            client.abort()
        for bus in self.buses.values():
            bus.close()


def bus_name(interface: str) -> str:
    """By which clients open an interface: what follows its last colon, 16 characters at most."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", interface.rpartition(":")[2])[:16]


def _round_trip_s(peer: Any) -> float:
    """Of a TCP connection, as the kernel measures it; 0 where it does not tell."""
    try:
        info = peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 104)
        return float(struct.unpack_from("=I", info, _TCP_INFO_RTT)[0]) / 1e6
    except (OSError, AttributeError, struct.error):
        return 0.0
