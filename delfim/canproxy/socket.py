"""CAN sockets as chapter 5.2 of the thesis proposes them: one class over Linux SocketCAN, canloop, python-can or TCP.

`opening.open_can` opens one by the name of its interface; `bind` sets the acceptance filters, `connect` the arbitration field
of `send`; `receive` is the way in for the critical loop. Each transport's file states its limits. CAN FD is not supported.
"""

import errno
import os
import select
import socket
import time
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Final, NamedTuple, Protocol, Self, runtime_checkable

from delfim.base.frames import CAN_ANY, CAN_ERR, Frame

MSG_DONTWAIT: Final[int] = getattr(
    socket, "MSG_DONTWAIT", 0x40
)  # Windows has no such word, and Linux' number is as good as any
BATCH: Final = 6  # frames of a navigation message
REHEARSED: Final = 4  # frames of a propulsion command
_FULL_RETRY_S: Final = 0.0005  # the kernel has no event for room in an interface's queue; a frame at 1 Mbit/s takes 0.13 ms


class CanAddress(NamedTuple):
    """`struct sockaddr_can` of thesis 5.2.2: the filter of `bind`, the identifier and interface of `connect` and `sendto`."""

    arb: int = 0  # arbitration field of thesis figure 5-5, see delfim.base.frames
    mask: int = 0  # of arb; set bits are "don't care" (5.2.4); ignored in sending
    ifindex: int = 0  # interface; 0: all those that the socket was opened on


ANYTHING: Final = CanAddress(mask=CAN_ANY)  # every data and remote frame, both formats


def accepts(address: CanAddress, arb: int) -> bool:
    """Whether an acceptance filter passes this field (thesis 5.2.4). Error frames were never on the bus and pass none."""
    return not (arb ^ address.arb) & ~address.mask and not arb & CAN_ERR


class Transport(Protocol):
    """The transport that carries the frames of a CanSocket. No method blocks."""

    name: str
    ifindex: int  # 0 where frames come by several interfaces
    dropped: int
    outlets: Callable[[], Sequence[int]] | None  # the interfaces that ifindex 0 sends to, if several

    def fileno(self) -> int: ...
    def filter(self, addresses: tuple[CanAddress, ...]) -> None: ...
    def receive(self) -> Frame | None: ...
    def send(self, arb: int, data: bytes, ifindex: int) -> None: ...  # BlockingIOError when the transmit queue is full
    def rehearse(self) -> None: ...
    def rebind(self) -> bool: ...
    def close(self) -> None: ...


@runtime_checkable
class Many(Protocol):
    """A transport that sends and receives many frames by one system call."""

    def receive_many(self) -> list[Frame]: ...
    def send_many(self, messages: Sequence[tuple[int, bytes]]) -> int: ...
    def mirror(self) -> "Many | None": ...


@runtime_checkable
class Answering(Protocol):
    """A transport whose other end may refuse to send, and reports it when it is asked."""

    def confirm(self) -> None: ...  # may wait; raises BusError


def receive_each(receive: Callable[[], Frame | None]) -> list[Frame]:
    """Receive one by one as `receive_many`, for a transport that has no such call."""
    frames: list[Frame] = []
    while len(frames) < BATCH and (frame := receive()) is not None:
        frames.append(frame)
    return frames


def send_each(send: Callable[[int, bytes], object], messages: Sequence[tuple[int, bytes]]) -> int:
    """Send one by one as `send_many`."""
    unsent = 0
    for arb, data in messages:
        try:
            send(arb, data)
        except OSError:
            unsent += 1
    return unsent


class CanSocket:
    """A CAN socket. It receives nothing before `bind`, and never the frames it sent itself.

    Sockets start blocking, as Python's do. MSG_DONTWAIT, `setblocking(False)` and timeouts mean the same as there:
    BlockingIOError (EAGAIN) when nothing is queued or the transmit queue is full, TimeoutError after a time-out. Other flags
    are not supported. A bus that fails raises BusError with a reason in words; after one, call `rebind` now and
    then until it returns True.
    """

    receive: Callable[[], Frame | None]
    """The hot path: the next frame, or None when nothing is queued. Never blocks, not even on a blocking socket. The frame
    carries the kernel's receive time, the interface and whether it was sent here. Raises BusError."""

    receive_many: Callable[[], list[Frame]]
    """The hot path for messages of several frames: up to a batch of those that are queued, at once. Raises BusError."""

    send_many: Callable[[Sequence[tuple[int, bytes]]], int]
    """The hot path for up to BATCH frames (arbitration field, data): queues them in their order without waiting, and a
    failed frame does not stop the rest. Returns how many the bus did not take."""

    rehearse: Callable[[], None]
    """Run the sending code as far as possible without a frame on the bus, so that its caches are warm."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._timeout_s: float | None = None
        self._peer: CanAddress | None = None
        self._send = transport.send
        self.name = transport.name
        self.receive = transport.receive
        self.rehearse = transport.rehearse
        if isinstance(transport, Many) and transport.outlets is None:
            self.receive_many, self.send_many = transport.receive_many, transport.send_many
        else:
            self.receive_many = partial(receive_each, transport.receive)
            self.send_many = partial(send_each, self._send_now)

    def confirm(self) -> None:
        """Wait until it is known that nothing that was sent was refused. Raises BusError, with the reason in words."""
        if isinstance(self._transport, Answering):
            self._transport.confirm()

    def mirror(self) -> Many | None:
        """Make a socket for the warm-up: the same code on buffers of its own, which receives its own frames and never reaches
        the bus. None for a transport that handles one frame at a time."""
        transport = self._transport
        return transport.mirror() if isinstance(transport, Many) and transport.outlets is None else None

    @property
    def dropped(self) -> int:
        """The number of frames for this socket that found its queue full, since it was opened."""
        return self._transport.dropped

    @property
    def ifindex(self) -> int:
        """The index of the interface, as if_nametoindex(3) has it; 0 for "any"."""
        return self._transport.ifindex

    def fileno(self) -> int:
        """The file descriptor to wait on for reading; -1 after close."""
        return self._transport.fileno()

    def bind(self, *addresses: CanAddress) -> None:
        """Accept the frames that any of `addresses` accepts, and no others (thesis 5.2.4). The kernel filters.

        Frames already queued stay. Raises BusError for an interface that is not this socket's.
        """
        self._transport.filter(addresses)

    def connect(self, address: CanAddress) -> None:
        """Set the arbitration field and interface of every later `send` (thesis 5.2.3)."""
        self._peer = address

    def send(self, data: bytes, flags: int = 0) -> int:
        """Send up to 8 bytes to the address of `connect`. Raises OSError (EDESTADDRREQ) without it."""
        if self._peer is None:
            raise OSError(errno.EDESTADDRREQ, os.strerror(errno.EDESTADDRREQ))
        return self.sendto(data, self._peer, flags)

    def sendto(self, data: bytes, address: CanAddress, flags: int = 0) -> int:
        """Queue one frame and return its data length (thesis 5.2.3).

        Raises FormatError beyond 8 bytes, BlockingIOError or TimeoutError when the transmit queue is full, BusError.
        """
        if address.ifindex == 0 and self._transport.outlets:
            for ifindex in self._transport.outlets():
                self.sendto(data, address._replace(ifindex=ifindex), flags)
            return len(data)
        try:
            self._send(address.arb, data, address.ifindex)
        except BlockingIOError:
            if flags & MSG_DONTWAIT or self._timeout_s == 0:
                raise
            self._send_late(address.arb, data, address.ifindex)
        return len(data)

    def sendmsg(self, frame: Frame, flags: int = 0) -> int:
        """Send a whole frame, by the interface that it names."""
        return self.sendto(frame.data, CanAddress(frame.arb, 0, frame.ifindex), flags)

    def recv(self, length: int, flags: int = 0) -> bytes:
        """Receive the next frame's data; bytes beyond `length` are lost for ever (thesis 5.2.5)."""
        return self.recvmsg(flags).data[:length]

    def recvfrom(self, length: int, flags: int = 0) -> tuple[bytes, CanAddress]:
        """Receive as `recv` does, with the arbitration field and the interface that the frame came by."""
        frame = self.recvmsg(flags)
        return frame.data[:length], CanAddress(frame.arb, 0, frame.ifindex)

    def recvmsg(self, flags: int = 0) -> Frame:
        """Receive the next frame, whole. Raises BlockingIOError, TimeoutError, BusError."""
        frame = self.receive()
        if frame is not None:
            return frame
        if flags & MSG_DONTWAIT or self._timeout_s == 0:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        deadline_s = self._deadline_s()
        poll = select.poll()
        poll.register(self.fileno(), select.POLLIN)
        while frame is None:
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0:
                raise TimeoutError("timed out")
            poll.poll(None if remaining_s == float("inf") else remaining_s * 1000)
            frame = self.receive()
        return frame

    def rebind(self) -> bool:
        """Reopen a bus that failed, on the same file descriptor and with the same filters; True when it can be used."""
        return self._transport.rebind()

    def setblocking(self, flag: bool) -> None:
        self._timeout_s = None if flag else 0.0

    def settimeout(self, timeout_s: float | None) -> None:
        """Set the time-out: None blocks, 0 does not; otherwise TimeoutError is raised after this many seconds."""
        self._timeout_s = timeout_s

    def close(self) -> None:
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _send_now(self, arb: int, data: bytes) -> None:
        self.sendto(data, CanAddress(arb), MSG_DONTWAIT)

    def _deadline_s(self) -> float:
        return float("inf") if self._timeout_s is None else time.monotonic() + self._timeout_s

    def _send_late(self, arb: int, data: bytes, ifindex: int) -> None:
        deadline_s = self._deadline_s()
        while True:
            time.sleep(_FULL_RETRY_S)
            try:
                return self._send(arb, data, ifindex)
            except BlockingIOError:
                if time.monotonic() >= deadline_s:
                    raise TimeoutError(f"{self.name}: the transmit queue stayed full") from None


class BusState(NamedTuple):
    """The state of a controller, from its error frame."""

    state: str  # "error active", "error warning", "error passive", "bus off" or "restarted"
    transmit_errors: int | None = None  # the controller's error counters, 0..255, if it reports them
    receive_errors: int | None = None


# linux/can/error.h: classes of error frames and the bits of data[1] in class CRTL
_CRTL, _BUSOFF, _RESTARTED, _COUNTERS = 0x004, 0x040, 0x100, 0x200
_CONTROLLER: Final = ((0x30, "error passive"), (0x0C, "error warning"), (0x40, "error active"))


def bus_state(frame: Frame) -> BusState | None:
    """The controller's state in an error frame; None for any other frame and for errors that did not change the state."""
    if not frame.error:
        return None
    kind, data = frame.identifier, frame.data.ljust(8, b"\0")
    state = "bus off" if kind & _BUSOFF else "restarted" if kind & _RESTARTED else None
    if state is None and kind & _CRTL:
        state = next((words for bits, words in _CONTROLLER if data[1] & bits), None)
    if state is None:
        return None
    return BusState(state, data[6], data[7]) if kind & _COUNTERS else BusState(state)
