"""A CAN bus inside one process for lock-step simulation: no kernel, no threads, and the same frames every time.

Not simulated: bit rate, arbitration, bus load, latency, errors other than bus-off. A frame is in the queues of all other
sockets that accept it when `sendto` returns, stamped with the clock that was handed in; sockets of the bus never become
readable for a selector (`fileno` is -1), so the simulation polls them at each step.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from delfim.base.clock import Clock
from delfim.base.errors import BusError, FormatError
from delfim.base.frames import Frame
from delfim.canproxy.socket import BATCH, CanAddress, CanSocket, Many, accepts

QUEUE_MAX: Final = 1024  # frames that a socket holds; more are dropped and counted, as by the kernel
_IFINDEX: Final = 1
_ROUTES_MAX: Final = 4096
_new = tuple.__new__  # a third of the time of Frame(...)


class LockstepBus:
    """The wire of the bus; `socket` opens one more end of it."""

    def __init__(self, clock: Clock, name: str = "lockstep", queue_max: int = QUEUE_MAX) -> None:
        self.clock, self.name, self.queue_max = clock, name, queue_max
        self.off = False  # bus-off, as after too many errors: nothing is sent or received
        self.queues: dict[CanSocket, deque[Frame]] = {}  # the frames that wait in each open socket
        self.changes = 0  # of its sockets and what they take
        self._ends: list[End] = []

    def socket(self, computer: str = "vehicle") -> CanSocket:
        """Open a socket, not bound and not blocking: waiting here would never end. Frames between sockets of the same
        `computer` are marked `sent_here`."""
        end = self.end(computer)
        socket = CanSocket(end)
        socket.setblocking(False)
        self.queues[socket] = end.queue
        return socket

    def end(self, computer: str, *filters: CanAddress) -> "End":
        """Open an end for simulated devices, which send whole frames."""
        end = End(self, computer)
        self._ends.append(end)
        if filters:
            end.filter(filters)
        return end

    def bound(self, *filters: CanAddress, computer: str = "vehicle") -> CanSocket:
        """Open a socket that receives what the filters accept; without filters, nothing."""
        socket = self.socket(computer)
        if filters:
            socket.bind(*filters)
        return socket

    def deliver(self, sender: "End", messages: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Deliver messages to all other ends that accept them. Raises FormatError for one that is no frame; those before it
        were sent."""
        routes, room, t_ns = sender.routes, self.queue_max, self.clock.time_ns()
        for message in messages:
            arb, data = message[0], message[1]
            if len(data) > 8:
                raise FormatError(f"{len(data)} bytes of data do not fit a CAN frame of 8")
            route = routes.get(arb)
            if route is None:
                route = self._route(sender, arb)
            for end, queue, sent_here in route:
                if len(queue) < room:
                    queue.append(_new(Frame, (arb, data, t_ns, _IFINDEX, sent_here)))
                else:
                    end.dropped += 1

    def _route(self, sender: "End", arb: int) -> "tuple[Way, ...]":
        routes = sender.routes
        if len(routes) >= _ROUTES_MAX:
            routes.clear()
        others = (end for end in self._ends if end is not sender and any(accepts(each, arb) for each in end.addresses))
        routes[arb] = tuple((end, end.queue, end.computer == sender.computer) for end in others)
        return routes[arb]

    def takes(self, frames: CanAddress) -> bool:
        """Whether any socket takes any of these frames."""
        taken = (address for end in self._ends for address in end.addresses)
        return any(not (frames.arb ^ each.arb) & ~frames.mask & ~each.mask for each in taken)

    def changed(self, closed: "End | None" = None) -> None:
        """Note that an end was bound or closed."""
        for end in self._ends:
            end.routes.clear()
        self.changes += 1
        if closed in self._ends:
            self._ends.remove(closed)
            self.queues = {socket: queue for socket, queue in self.queues.items() if queue is not closed.queue}


class End:
    """One socket's end of the bus, as a transport of CanSocket."""

    outlets: Callable[[], Sequence[int]] | None = None
    ifindex = _IFINDEX

    def __init__(self, bus: LockstepBus, computer: str) -> None:
        self.name, self.computer, self.dropped = bus.name, computer, 0
        self.addresses: tuple[CanAddress, ...] = ()
        self.queue: deque[Frame] = deque()
        self.routes: dict[int, tuple[Way, ...]] = {}  # by arbitration field: the other ends that accept it
        self._bus: LockstepBus | None = bus

    def fileno(self) -> int:
        return -1

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        for address in addresses:
            if address.ifindex not in (0, _IFINDEX):
                raise BusError(f"{self.name} has index {_IFINDEX}: it receives no frames of interface {address.ifindex}")
        self.addresses = addresses
        self._open().changed()

    def receive(self) -> Frame | None:
        return self.queue.popleft() if self.queue else None

    def receive_many(self) -> list[Frame]:
        queue = self.queue
        return [queue.popleft() for _ in range(min(len(queue), BATCH))] if queue else []

    def send_many(self, messages: Sequence[tuple[int, bytes] | Frame]) -> int:
        bus = self._bus
        if bus is None or bus.off:
            return len(messages)
        bus.deliver(self, messages)
        return 0

    def mirror(self) -> Many | None:
        return None

    def send(self, arb: int, data: bytes, ifindex: int = 0) -> None:
        if ifindex not in (0, _IFINDEX):
            raise BusError(f"{self.name} has index {_IFINDEX}: it does not send by interface {ifindex}")
        bus = self._open()
        if bus.off:
            raise BusError(f"{self.name}: bus-off")
        bus.deliver(self, ((arb, bytes(data)),))

    def rehearse(self) -> None:
        """Do nothing: there are no caches to warm."""

    def rebind(self) -> bool:
        return self._bus is not None

    def close(self) -> None:
        bus, self._bus = self._bus, None
        self.queue.clear()
        if bus is not None:
            bus.changed(closed=self)

    def _open(self) -> LockstepBus:
        if self._bus is None:
            raise BusError(f"{self.name}: this socket is closed")
        return self._bus


Way = tuple[End, deque[Frame], bool]  # to an end: its queue, and whether its computer is the sender's
