"""A bus that clients share: one socket, open while there are clients and for a second or two after the last one, because to
open it takes longer than a callback may; each frame is made into text once for all of them."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from delfim.base.clock import Clock
from delfim.base.errors import BusError
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame
from delfim.canproxy import socketcand
from delfim.canproxy.cantcp.bcm import Subscription
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket

FRAMES_A_CALL: Final = 32
FORGOTTEN_CALLS: Final = 8
GATHER_S: Final = 0.005  # frames that follow others within this time share one write

TextOf = Callable[[Frame], bytes]

log = logging.getLogger(__name__)


class Readers(Protocol):
    """The part of the runtime used here: it calls back when a descriptor is readable, on this service's account."""

    def reader(self, fd: int, handler: Callable[[], object]) -> None: ...
    def remove_reader(self, fd: int) -> None: ...


class Ear:
    """The frames that one client gets of a bus: all as text, or those that it subscribed to."""

    def __init__(
        self, text_of: TextOf, put: Callable[[bytes, int], None], at: Callable[[Callable[[], None], float], None]
    ) -> None:
        self.text_of, self.put = text_of, put
        self.watches: dict[int, Subscription] = {}  # by arbitration field; kept by the bus
        self._at = at

    def offer(self, frame: Frame, text: bytes, now_s: float) -> None:
        """Offer a frame to which this client has subscribed."""
        watch = self.watches[frame.arb]
        told = watch.offer(text, frame.data, now_s)
        if told:
            self.put(told, 1)
        else:
            self._at(self._on_watch, watch.due_s)

    def _on_watch(self) -> None:
        now_s = asyncio.get_running_loop().time()
        for watch in self.watches.values():
            for text in watch.take(now_s):
                self.put(text, 1)
            self._at(self._on_watch, watch.due_s)


class SharedBus:
    """One bus: its socket, and the clients that opened it."""

    def __init__(self, name: str, interface: str, readers: Readers, clock: Clock, receive_buffer_bytes: int) -> None:
        self.name, self.interface = name, interface
        self._receive_buffer_bytes = receive_buffer_bytes
        self.failure = ""  # of the bus, in words
        self.received = self.received_bytes = self.transmitted = self.transmitted_bytes = 0
        self.raw: list[Ear] = []
        self.watchers: dict[int, set[Ear]] = {}  # by arbitration field
        self._readers, self._clock = readers, clock
        self._ears: set[Ear] = set()
        self._can: CanSocket | None = None
        self._sent: list[tuple[Frame, Ear]] = []  # not yet passed on to the others
        self._is_left = False  # at the last poll nobody was here
        self._later: asyncio.Handle | None = None  # the next look at a busy bus; None: woken by its first frame

    def join(self, ear: Ear) -> None:
        """Add a client's reception, and open the bus for the first one. Raises BusError if it cannot be opened."""
        if self._can and not self._ears:
            self._forget()
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
        self._is_left = False
        self._ears.add(ear)

    def _forget(self) -> None:
        """Drop the frames that came while there were no clients and were not read yet: those of some milliseconds."""
        self._sent.clear()
        for _ in range(FORGOTTEN_CALLS):
            if not self._receive():
                break
        if self.failure:  # whoever comes is told
            self.close()

    def leave(self, ear: Ear) -> None:
        self.quiet(ear)
        self._ears.discard(ear)
        if self.failure and not self._ears:  # the next client is told
            self.close()

    def quiet(self, ear: Ear) -> None:
        """Stop the frames to this client."""
        self.raw = [other for other in self.raw if other is not ear]
        for arb in list(ear.watches):
            self.unwatch(ear, arb)

    def watch(self, ear: Ear, arb: int, watch: Subscription) -> None:
        ear.watches[arb] = watch
        self.watchers.setdefault(arb, set()).add(ear)

    def unwatch(self, ear: Ear, arb: int) -> None:
        if ear.watches.pop(arb, None):
            self.watchers[arb].discard(ear)
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
        """Reopen a bus that failed, and close one that nobody opened since the last call; call it about once a second."""
        if self._can and not self._ears:
            if self._is_left:
                self.close()
            self._is_left = True
            return
        if self.failure and self._can and self._can.rebind():
            log.warning("cantcpd: %s is back", self.name)
            self.failure = ""

    @property
    def dropped(self) -> int:
        """The number of frames that the socket lost while it was open this time."""
        return self._can.dropped if self._can else 0

    def transmit(self, arb: int, data: bytes, ear: Ear) -> None:
        """Send a client's frame. Raises BlockingIOError when the transmit queue is full, BusError."""
        if self._can is None:
            raise BusError(f"{self.name} is closed")
        frame = Frame(arb, data, self._clock.time_ns())
        self._can.sendto(data, CanAddress(arb))
        self.transmitted += 1
        self.transmitted_bytes += len(data)
        self._sent.append((frame, ear))
        if self._later is None:
            self._readers.remove_reader(self._can.fileno())
            self._later = asyncio.get_running_loop().call_later(GATHER_S, self._look)
        elif len(self._sent) == FRAMES_A_CALL:
            self._later.cancel()
            self._later = asyncio.get_running_loop().call_soon(self._look)

    def _wake(self) -> None:
        """Pass on the first frame after a silence at once."""
        if self._can:
            self._readers.remove_reader(self._can.fileno())
            self._look()

    def _look(self) -> None:
        """Pass on waiting frames, and poll again soon while the bus is busy: a wake-up for every frame would cost more."""
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
        """Receive about FRAMES_A_CALL frames of all kinds."""
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
        told = [frame for frame in frames if not frame.arb & (CAN_RTR | CAN_ERR)]  # socketcand carries no others
        self.received += len(told)
        self.received_bytes += sum(len(frame.data) for frame in told)
        if self.raw and told:
            texts: dict[TextOf, bytes] = {}
            for ear in self.raw:
                text_of = ear.text_of
                if text_of not in texts:
                    texts[text_of] = b"".join(map(text_of, told))
                ear.put(texts[text_of], len(told))
        if self.watchers:
            self._tell_watchers(told, now_s)

    def _tell_sent(self, frames: list[Frame], now_s: float) -> None:
        """Hand out frames as `_tell` does, merged in order of time with the clients' own frames, which their senders do not
        get."""
        sent, self._sent = self._sent, []
        authors = {id(frame): ear for frame, ear in sent}
        everything = sorted([*frames, *(frame for frame, _ in sent)], key=lambda frame: frame.t_ns)
        told = [frame for frame in everything if not frame.arb & (CAN_RTR | CAN_ERR)]
        self.received += len(told) - len(sent)
        self.received_bytes += sum(len(frame.data) for frame in told if id(frame) not in authors)
        texts: dict[TextOf, list[tuple[bytes, Ear | None]]] = {}
        for ear in self.raw:
            text_of = ear.text_of
            if text_of not in texts:
                texts[text_of] = [(text_of(frame), authors.get(id(frame))) for frame in told]
            others = [text for text, author in texts[text_of] if author is not ear]
            if others:
                ear.put(b"".join(others), len(others))
        for frame in told:
            self._tell_watchers([frame], now_s, authors.get(id(frame)))

    def _tell_watchers(self, frames: Iterable[Frame], now_s: float, author: Ear | None = None) -> None:
        for frame in frames:
            if ears := self.watchers.get(frame.arb):
                text = socketcand.bcm_text(frame)
                for ear in ears:
                    if ear is not author:
                        ear.offer(frame, text, now_s)

    def _failed(self, error: BusError) -> None:
        if str(error) != self.failure:
            self.failure = str(error)
            log.warning("cantcpd: %s", error)
