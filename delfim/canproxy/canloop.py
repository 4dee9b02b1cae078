"""canloop: a CAN bus without CAN hardware or kernel support (thesis 5.3.5), for any number of processes of one computer.

The bus is a UDP multicast group on the loopback interface; group and port follow from the name of the bus. Every socket of
the bus has a receiving socket bound to the group, on which a classic BPF program applies the acceptance filters before the
kernel delivers anything, and a sending socket, whose source port identifies the sender.

It does not simulate bit rate, arbitration, bus load, acknowledgement or errors. Every frame arrives at once, in order of
sending, at every other socket that accepts it and has room. A full receive queue loses frames, and `dropped` counts them.

    datagram, network byte order:  count u32 | arbitration field u32 | length u8 | data 8 bytes, zero padded

`count` numbers the frames of one sender and one arbitration field. (The kernel's own drop counter is no use: on UDP
sockets it also counts frames that the BPF program refuses.)
"""

import errno
import os
import socket
import struct
import sys
import time
import zlib
from array import array
from collections.abc import Callable, Sequence
from copy import copy
from random import Random

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, identifier
from delfim.canproxy import mmsg
from delfim.canproxy.socket import BATCH, REHEARSED, CanAddress, CanSocket, accepts, receive_each, send_each
from delfim.canproxy.socketcan import SO_TIMESTAMPNS, TIMESPEC, set_receive_buffer

_DATAGRAM = struct.Struct("!IIB8s")
_SENDER = struct.Struct("!2xH12x")  # struct sockaddr_in
_STAMP = struct.Struct("@16xqq")  # struct cmsghdr, struct timespec
_ANCILLARY_BYTES = socket.CMSG_SPACE(TIMESPEC.size)
_COUNTED_MAX = 4096  # arbitration fields whose numbering is kept
_LOOPBACK = socket.inet_aton("127.0.0.1")
_SO_ATTACH_FILTER, _IP_MULTICAST_ALL = 26, 49  # asm-generic/socket.h, linux/in.h
_UDP_HEADER_BYTES = 8
_LINGER_S = 1.0
_NO_FRAME = b"\xff" * _DATAGRAM.size  # its length is beyond 8

_pack_into, _BYTES = _DATAGRAM.pack_into, _DATAGRAM.size  # once: this is on the critical path
_new = tuple.__new__  # a third of the time of Frame(...)
_ports_of_this_process: set[int] = set()  # also those of closed sockets, for a while
_closed_ports: dict[int, float] = {}  # when each closed, s: its frames may still be queued


def stable_index(name: str) -> int:
    """A positive interface index for a name without one in the kernel, the same in every process; far from the kernel's own."""
    return zlib.crc32(name.encode()) & 0x3FFFFFFF | 0x40000000


def group_of(name: str) -> tuple[str, int]:
    """Multicast group and port of a bus: group from the IPv4 local scope (RFC 2365), port below the ephemeral ones."""
    digest = zlib.crc32(name.encode())
    return f"239.255.{digest >> 24}.{digest >> 16 & 0xFF}", 16384 + (digest & 0x3FFF)


def filter_program(addresses: Sequence[CanAddress], own_port: int, error_frames: bool) -> list[tuple[int, int, int, int]]:
    """The classic BPF program of a receiving socket, as rows of `struct sock_filter` (code, jt, jf, k); data starts at the
    UDP header. It returns 0 to refuse a datagram."""
    length, byte, half, word, equal, greater, bit, mask, give = 0x80, 0x30, 0x28, 0x20, 0x15, 0x25, 0x45, 0x54, 0x06
    accept, refuse = (give, 0, 0, 0xFFFFFFFF), (give, 0, 0, 0)
    load_arb = (word, 0, 0, _UDP_HEADER_BYTES + 4)
    program = [
        *((length, 0, 0, 0), (equal, 1, 0, _UDP_HEADER_BYTES + _DATAGRAM.size), refuse),
        *((byte, 0, 0, _UDP_HEADER_BYTES + 8), (greater, 0, 1, 8), refuse),
        *((half, 0, 0, 0), (equal, 0, 1, own_port), refuse),
        *(load_arb, (bit, 0, 1, CAN_ERR), accept if error_frames else refuse),
    ]
    wanted: dict[int, set[int]] = {}
    for address in addresses:
        wanted.setdefault(~address.mask & 0xFFFFFFFF, set()).add(address.arb & ~address.mask)
    for match, values in wanted.items():
        program += [load_arb, (mask, 0, 0, match)]
        for value in sorted(values):
            program += [(equal, 0, 1, value), accept]
    return [*program, refuse]


class CanLoop:
    """One socket of a canloop bus, as a transport of CanSocket.

    `droprate` is the share of sent frames that get lost, drawn from `seed`; `verbose` prints every sent frame to standard
    error in candump's format. Frames that another socket of *this process* sent are marked `sent_here`. Without
    `kernel_filter` (any system but Linux) the frames are filtered after they were received.
    """

    outlets: Callable[[], Sequence[int]] | None = None

    def __init__(
        self,
        name: str,
        receive_buffer_bytes: int = 1 << 20,
        error_frames: bool = False,
        droprate: float = 0.0,
        seed: int | None = None,
        verbose: bool = False,
        kernel_filter: bool = sys.platform == "linux",
        batch: int = BATCH,
    ) -> None:
        self.name, self.dropped, self.ifindex = f"canloop:{name}", 0, stable_index(name)
        self._error_frames, self._droprate, self._random, self._verbose = error_frames, droprate, Random(seed), verbose
        self._group = group_of(name)
        self._sent: dict[int, int] = {}
        self._seen: dict[int, int] = {}
        self._addresses: tuple[CanAddress, ...] = ()
        self._joined = False  # a send-only socket costs the other senders nothing
        self._input = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._output = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._recvmsg = self._input.recvmsg
        self._taken: mmsg.MessageBatch | None = None
        self._batch = batch
        self._given: mmsg.MessageBatch | None = None
        self._nothing: mmsg.MessageBatch | None = None
        self._kernel_filter = kernel_filter
        try:
            self._open(receive_buffer_bytes)
        except OSError as error:
            self.close()
            raise BusError(f"{self.name}: {error.strerror}; it needs the loopback interface (ip link set lo up)") from None

    def _open(self, receive_buffer_bytes: int) -> None:
        self._output.setblocking(False)
        self._output.bind(("127.0.0.1", 0))
        self._output.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, _LOOPBACK)
        self._output.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)  # never leaves this computer
        self._output.connect(self._group)
        self._port = self._output.getsockname()[1]
        _forget_ports(time.monotonic() - _LINGER_S)
        _ports_of_this_process.add(self._port)
        _closed_ports.pop(self._port, None)
        self._input.setblocking(False)
        self._input.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform == "linux":
            self._input.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._input.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # not the group's datagrams on other interfaces
        else:
            self._input.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        set_receive_buffer(self._input, receive_buffer_bytes)
        self.filter(())
        self._input.bind(self._group)
        if mmsg.AVAILABLE and self._kernel_filter:
            self._taken = mmsg.MessageBatch(self._input, self._batch, _DATAGRAM.size, _SENDER.size, _STAMP.size)
            try:
                self._given, self._nothing = (mmsg.SegmentBatch(self._output, BATCH, _DATAGRAM.size) for _ in range(2))
            except OSError:
                self._given, self._nothing = (mmsg.MessageBatch(self._output, BATCH, _DATAGRAM.size) for _ in range(2))
            self._nothing.data[:] = _NO_FRAME * BATCH

    def fileno(self) -> int:
        return self._input.fileno()

    def close(self) -> None:
        self._taken = self._given = self._nothing = None  # their descriptors may soon be reused
        self._input.close()
        self._output.close()
        if port := getattr(self, "_port", 0):
            _closed_ports[port] = time.monotonic()

    def rebind(self) -> bool:
        return True  # the loopback interface always keeps its memberships

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        for address in addresses:
            if address.ifindex not in (0, self.ifindex):
                raise BusError(f"{self.name} has index {self.ifindex}: it receives no frames of interface {address.ifindex}")
        if not self._kernel_filter and not self._addresses:
            self.receive()  # discards frames that came before the bind
        if self._kernel_filter:
            rows = filter_program(addresses, self._port, self._error_frames)
            code = array("B", b"".join(struct.pack("=HBBI", *row) for row in rows))
            program = struct.pack("@HP", len(rows), code.buffer_info()[0])  # struct sock_fprog
            try:
                self._input.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)
            except OSError as error:
                raise BusError(f"{self.name}: {len(addresses)} acceptance filters refused: {error.strerror}") from None
        if addresses and not self._joined:
            try:
                member = socket.inet_aton(self._group[0]) + _LOOPBACK
                self._input.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            except OSError as error:
                raise BusError(f"{self.name}: {error.strerror}; it needs the loopback interface (ip link set lo up)") from None
            self._joined = True
        self._addresses = addresses
        self._seen.clear()

    def receive(self) -> Frame | None:
        while True:
            try:
                raw, ancillary, _, address = self._recvmsg(_DATAGRAM.size + 1, _ANCILLARY_BYTES)
            except BlockingIOError:
                return None
            except OSError as error:
                raise BusError(f"{self.name}: {error.strerror}") from None
            port = address[1]
            if self._kernel_filter or self._accepted(raw, port):
                break
        count, arb, length, data = _DATAGRAM.unpack(raw)
        key = arb << 16 | port
        expected = self._seen.get(key)
        if expected != count:
            self._missed(key, expected, count)
        self._seen[key] = count + 1
        if ancillary:
            seconds, nanoseconds = TIMESPEC.unpack(ancillary[0][2])
            t_ns = seconds * 1_000_000_000 + nanoseconds
        else:
            t_ns = time.time_ns()
        return Frame(arb, data[:length], t_ns, self.ifindex, port in _ports_of_this_process)

    def receive_many(self) -> list[Frame]:
        taken = self._taken
        if taken is None:
            return receive_each(self.receive)
        try:
            count = taken.receive()
        except OSError as error:
            raise BusError(f"{self.name}: {error.strerror}") from None
        frames, seen, ifindex = [], self._seen, self.ifindex
        rows = _DATAGRAM.iter_unpack(taken.data), _SENDER.iter_unpack(taken.names), _STAMP.iter_unpack(taken.controls)
        for _, (number, arb, length, data), (port,), (seconds, nanoseconds) in zip(range(count), *rows, strict=False):
            key = arb << 16 | port
            expected = seen.get(key)
            if expected != number:
                self._missed(key, expected, number)
            seen[key] = number + 1
            t_ns = seconds * 1_000_000_000 + nanoseconds
            frames.append(_new(Frame, (arb, data[:length], t_ns, ifindex, port in _ports_of_this_process)))
        return frames

    def send(self, arb: int, data: bytes, ifindex: int = 0) -> None:
        length = len(data)
        if length > 8:
            raise FormatError(f"{length} bytes of data do not fit a CAN frame of 8")
        if ifindex not in (0, self.ifindex):
            raise BusError(f"{self.name} has index {self.ifindex}: it does not send by interface {ifindex}")
        if self._verbose:
            print(_candump(self.name, arb, data), file=sys.stderr)
        if self._droprate and self._random.random() < self._droprate:
            return
        count = self._sent.get(arb, 0)
        try:
            self._output.send(_DATAGRAM.pack(count, arb, length, data))
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ENOBUFS):
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from None
            raise BusError(f"{self.name}: {error.strerror}") from None
        if len(self._sent) >= _COUNTED_MAX and not count:
            self._sent.clear()
        self._sent[arb] = count + 1 & 0xFFFFFFFF

    def send_many(self, messages: Sequence[tuple[int, bytes]]) -> int:
        given, sent = self._given, self._sent
        if given is None or self._droprate or self._verbose or len(sent) >= _COUNTED_MAX:
            return send_each(self.send, messages)
        at, buffer = 0, given.data
        for arb, data in messages:
            number = sent.get(arb, 0)
            _pack_into(buffer, at, number, arb, len(data), data)
            sent[arb] = number + 1 & 0xFFFFFFFF
            at += _BYTES
        return given.send(len(messages))

    def rehearse(self) -> None:
        """Send datagrams that are no frames: they reach the sockets of the bus, and every filter refuses them."""
        if self._nothing is not None:
            self._nothing.send(REHEARSED)

    def mirror(self) -> "CanLoop | None":
        """The mirror for the warm-up, which never sends: it has no socket."""
        if self._taken is None or self._droprate or self._verbose:
            return None
        mirror = copy(self)
        mirror._taken = mirror._given = mmsg.Mirror(self._input, BATCH, _DATAGRAM.size, _SENDER.size, _STAMP.size)
        mirror._sent, mirror._seen = {}, {}
        del mirror._input, mirror._output
        return mirror

    def _missed(self, key: int, expected: int | None, count: int) -> None:
        """Count a gap in the numbering. A numbering never seen, or one that went back, begins anew."""
        if expected is None:
            if len(self._seen) >= _COUNTED_MAX:
                self._seen.clear()
            return
        missed = count - expected & 0xFFFFFFFF
        if missed < 0x80000000:
            self.dropped += missed

    def _accepted(self, raw: bytes, port: int) -> bool:
        """The Python equivalent of `filter_program`."""
        if len(raw) != _DATAGRAM.size or raw[8] > 8 or port == self._port:
            return False
        arb = int.from_bytes(raw[4:8], "big")
        return self._error_frames if arb & CAN_ERR else any(accepts(address, arb) for address in self._addresses)


def _forget_ports(closed_before_s: float) -> None:
    for port in [port for port, closed_s in _closed_ports.items() if closed_s < closed_before_s]:
        _ports_of_this_process.discard(port)
        del _closed_ports[port]


def _candump(name: str, arb: int, data: bytes) -> str:
    number = f"{identifier(arb):08X}" if arb & CAN_IDE else f"{identifier(arb):03X}"
    return f"({time.time():.6f}) {name} {number}#" + (f"R{len(data)}" if arb & CAN_RTR else data.hex().upper())


def open_canloop(
    name: str,
    *,
    droprate: float = 0.0,
    seed: int | None = None,
    verbose: bool = False,
    receive_buffer_bytes: int = 1 << 20,
    error_frames: bool = False,
    batch: int = BATCH,
) -> CanSocket:
    """Open a socket on the bus `name`, with the options of the thesis' driver (5.3.5): `droprate` 0..1 from `seed`,
    `verbose`."""
    return CanSocket(CanLoop(name, receive_buffer_bytes, error_frames, droprate, seed, verbose, batch=batch))
