"""Linux SocketCAN as a transport of CanSocket: PF_CAN, SOCK_RAW, CAN_RAW, with filters, stamps and drop count of the kernel.

The kernel reports once, here as a BusError, that an interface went down or disappeared; `rebind` reopens it.
"""

import errno
import fcntl
import os
import socket
import struct
import sys
from collections.abc import Callable, Sequence
from copy import copy
from typing import Final

from delfim.base.errors import BusError
from delfim.base.frames import CAN_ERR, CAN_FRAME, CAN_IDE, CAN_RTR, Frame, from_can_id, to_can_frame, to_can_id
from delfim.canproxy import mmsg
from delfim.canproxy.socket import BATCH, REHEARSED, CanAddress, receive_each

# asm-generic/socket.h, linux/can/raw.h, linux/if_arp.h, linux/sockios.h: constants that Python 3.11 lacks
SO_RCVBUFFORCE: Final = 33
SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL = 40
_CAN_RAW_ERR_FILTER = 2
_ARPHRD_CAN = 280
_SIOCGIFFLAGS, _SIOCGIFHWADDR, _IFF_UP = 0x8913, 0x8927, 1

TIMESPEC: Final = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
_FILTER = struct.Struct("=II")  # struct can_filter
_INTERFACE = struct.Struct("=4xi16x")  # struct sockaddr_can
_CONTROL = struct.Struct("@16xqq16xI4x")  # two struct cmsghdr: struct timespec, drop count
_HEADER = struct.Struct("@40xQQ8x")  # struct mmsghdr: bytes of ancillary data, flags
_ANCILLARY_BYTES = socket.CMSG_SPACE(TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)
_STAMP_BYTES = socket.CMSG_SPACE(TIMESPEC.size)
_EFF, _RTR, _STANDARD = 1 << 31, 1 << 30, 0x7FF
_EXTENDED_BITS = 0x3FFFF << 3  # of the arbitration field, 0 in standard format frames


def set_receive_buffer(sock: socket.socket, size_bytes: int) -> None:
    """Set the buffer as large as asked for if permitted, else as net.core.rmem_max allows."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)


def kernel_filters(address: CanAddress) -> list[tuple[int, int]]:
    """The (can_id, can_mask) entries of CAN_RAW_FILTER that accept exactly what `address` does.

    Where the IDE bit is "don't care" there are two: the identifier sits elsewhere in a standard and an extended frame.
    """
    match = ~address.mask & 0xFFFFFFFF
    if match & CAN_ERR and address.arb & CAN_ERR:
        return []  # accepts error frames only, which no acceptance filter passes
    remote = _RTR if match & CAN_RTR else 0
    flags = remote if address.arb & CAN_RTR else 0
    standard = (address.arb >> 21 & match >> 21 & _STANDARD | flags, match >> 21 & _STANDARD | remote | _EFF)
    extended = (address.arb >> 3 & match >> 3 & 0x1FFFFFFF | flags | _EFF, match >> 3 & 0x1FFFFFFF | remote | _EFF)
    if match & CAN_IDE and address.arb & CAN_IDE:
        return [extended]
    possible = [] if address.arb & match & _EXTENDED_BITS else [standard]
    return possible if match & CAN_IDE else [*possible, extended]


class SocketCan:
    """One CAN_RAW socket, on one interface or on "any". Interfaces are known by name, so that a replugged adapter is found."""

    outlets: Callable[[], Sequence[int]] | None

    def __init__(self, name: str, receive_buffer_bytes: int, error_frames: bool, batch: int = BATCH) -> None:
        self.name, self.dropped, self.ifindex = name, 0, 0
        self.outlets = self._up_interfaces if name == "any" else None
        self._bound_name = "" if name == "any" else name
        self._filters: tuple[tuple[int, int], ...] = ()
        self._error_mask = 0x1FFFFFFF if error_frames else 0
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (AttributeError, OSError):
            raise BusError(f"{name}: no SocketCAN in this kernel (modprobe can-raw), or use canloop:NAME") from None
        self._recvmsg = self._socket.recvmsg
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            set_receive_buffer(self._socket, receive_buffer_bytes)
            self._bind()
            if self._bound_name and not self._interface(_SIOCGIFFLAGS, name) & _IFF_UP:
                raise OSError(errno.ENETDOWN, name)
        except OSError as error:
            failure = self._failure(error)
            self._socket.close()
            raise failure from None
        self._taken: mmsg.MessageBatch | None = mmsg.MessageBatch(
            self._socket, batch, CAN_FRAME.size, _INTERFACE.size, _CONTROL.size
        )
        self._given: mmsg.MessageBatch | None = mmsg.MessageBatch(self._socket, BATCH, CAN_FRAME.size)
        self._nothing: mmsg.MessageBatch | None = mmsg.MessageBatch(self._socket, BATCH, CAN_FRAME.size - 1)

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._taken = self._given = self._nothing = None  # their descriptor may soon be reused
        self._socket.close()

    def receive(self) -> Frame | None:
        try:
            raw, ancillary, flags, address = self._recvmsg(16, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._failure(error) from None
        can_id, length, data = CAN_FRAME.unpack(raw)
        seconds, nanoseconds = TIMESPEC.unpack(ancillary[0][2])
        if len(ancillary) > 1:
            self.dropped = _COUNT.unpack(ancillary[1][2])[0]
        return Frame(
            from_can_id(can_id),
            data[:length],
            seconds * 1_000_000_000 + nanoseconds,
            self.ifindex or _index(address[0]),
            flags & socket.MSG_DONTROUTE != 0,
        )

    def receive_many(self) -> list[Frame]:
        taken = self._taken
        if taken is None:
            return receive_each(self.receive)
        try:
            count = taken.receive()
        except OSError as error:
            raise self._failure(error) from None
        frames = []
        rows = (CAN_FRAME, taken.data), (_INTERFACE, taken.names), (_CONTROL, taken.controls), (_HEADER, taken.headers)
        each = zip(range(count), *(form.iter_unpack(into) for form, into in rows), strict=False)
        for _, (can_id, length, data), (ifindex,), (seconds, nanoseconds, dropped), (ancillary_bytes, flags) in each:
            if ancillary_bytes > _STAMP_BYTES:
                self.dropped = dropped
            t_ns = seconds * 1_000_000_000 + nanoseconds
            frames.append(Frame(from_can_id(can_id), data[:length], t_ns, ifindex, flags & socket.MSG_DONTROUTE != 0))
        return frames

    def send_many(self, messages: Sequence[tuple[int, bytes]]) -> int:
        at, given = 0, self._given
        if given is None:
            return len(messages)
        for arb, data in messages:
            CAN_FRAME.pack_into(given.data, at, to_can_id(arb), len(data), data)
            at += CAN_FRAME.size
        return given.send(len(messages))

    def send(self, arb: int, data: bytes, ifindex: int) -> None:
        raw = to_can_frame(arb, data)
        try:
            if ifindex == 0 or ifindex == self.ifindex:
                self._socket.send(raw)
            elif self.name == "any":
                self._socket.sendto(raw, (socket.if_indextoname(ifindex),))
            else:
                raise BusError(f"{self.name} has index {self.ifindex}: it does not send by interface {ifindex}")
        except BusError:
            raise
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ENOBUFS):  # the socket's or the interface's queue (txqueuelen) is full
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from None
            raise self._failure(error) from None

    def rehearse(self) -> None:
        """Send 15 bytes: the kernel looks up the interface, then refuses them because a frame has 16."""
        if self._nothing is not None:
            self._nothing.send(REHEARSED)

    def mirror(self) -> "SocketCan":
        """The mirror for the warm-up, which never sends: it has no socket."""
        mirror = copy(self)
        mirror._taken = mirror._given = mmsg.Mirror(self._socket, BATCH, CAN_FRAME.size, _INTERFACE.size, _CONTROL.size)
        del mirror._socket
        return mirror

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        indices = {address.ifindex for address in addresses} or {0}
        if len(indices) > 1:
            raise BusError(f"{self.name}: one bind names several interfaces: use one socket for each")
        wanted = indices.pop()
        if wanted not in (0, self.ifindex) and self.name != "any":
            raise BusError(f"{self.name} has index {self.ifindex}: it receives no frames of interface {wanted}")
        self._filters = tuple(dict.fromkeys(entry for address in addresses for entry in kernel_filters(address)))
        try:
            if self.name == "any":
                self._bound_name = socket.if_indextoname(wanted) if wanted else ""
            self._bind()
        except OSError as error:
            raise self._failure(error) from None

    def rebind(self) -> bool:
        try:
            self._bind()
            up = not self._bound_name or bool(self._interface(_SIOCGIFFLAGS, self._bound_name) & _IFF_UP)
        except OSError:
            return False
        self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # the error is known: do not report it again
        return up

    def _bind(self) -> None:
        """Set the filters again with every bind: the kernel forgets those of an interface that disappeared."""
        entries = b"".join(_FILTER.pack(*entry) for entry in self._filters)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, entries)
        self._socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, self._error_mask)
        self.ifindex = socket.if_nametoindex(self._bound_name) if self._bound_name else 0
        self._socket.bind((self._bound_name,))

    def _interface(self, request: int, name: str) -> int:
        """The 16-bit answer to an interface ioctl(2); 0 without such an interface."""
        try:
            answer: bytes = fcntl.ioctl(self._socket, request, struct.pack("16s24x", name.encode()))
        except OSError:
            return 0
        return int.from_bytes(answer[16:18], sys.byteorder)

    def _up_interfaces(self) -> list[int]:
        return [
            index
            for index, name in socket.if_nameindex()
            if self._interface(_SIOCGIFHWADDR, name) == _ARPHRD_CAN and self._interface(_SIOCGIFFLAGS, name) & _IFF_UP
        ]

    def _failure(self, error: OSError) -> BusError:
        name = self._bound_name or self.name
        if error.errno == errno.ENETDOWN:
            return BusError(f"{name} is down; it comes back when it is set up (ip link set {name} up)")
        if error.errno in (errno.ENODEV, errno.ENXIO, None):  # None: if_nametoindex
            kind = self._interface(_SIOCGIFHWADDR, name)
            if not kind:
                return BusError(f"there is no interface {name}: adapter unplugged, or its driver not loaded?")
            if kind != _ARPHRD_CAN:
                return BusError(f"{name} is not a CAN interface")
            return BusError(f"{name} was gone and is back: open it again")
        return BusError(f"{name}: {error.strerror or error}")


def _index(name: str) -> int:
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return 0  # the frame's interface is gone


_RESTART_REASONS: Final = {
    errno.EPERM: "may not be restarted by this user (CAP_NET_ADMIN is needed)",
    errno.EBUSY: "is not bus-off: nothing to restart",
    errno.EINVAL: "is down, or restarts by itself (restart-ms)",
    errno.EOPNOTSUPP: "has no controller to restart",
}


def restart(interface: str) -> None:
    """Restart a controller that went bus-off, as `ip link set can0 type can restart` does. Raises BusError with the reason."""
    try:
        index = socket.if_nametoindex(interface)
    except OSError:
        raise BusError(f"there is no interface {interface}") from None
    # rtnetlink(7): IFLA_LINKINFO { IFLA_INFO_KIND "can", IFLA_INFO_DATA { IFLA_CAN_RESTART 1 } }
    data = _attribute(2, _attribute(7, struct.pack("=I", 1)))
    body = struct.pack("=BxHiII", 0, 0, index, 0, 0) + _attribute(18, _attribute(1, b"can\0") + data)
    newlink, request_and_ack = 16, 5
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.send(struct.pack("=IHHII", 16 + len(body), newlink, request_and_ack, 1, 0) + body)
        code = -struct.unpack_from("=i", netlink.recv(4096), 16)[0]
    if code:
        raise BusError(f"{interface} {_RESTART_REASONS.get(code, os.strerror(code))}")


def _attribute(kind: int, payload: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(payload), kind) + payload + bytes(-len(payload) % 4)
