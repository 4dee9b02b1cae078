"""recvmmsg(2) and sendmmsg(2), which Python does not have: many datagrams by one system call.

For the critical loop and for readers of whole buses. A call from Python to the kernel costs as much as what the kernel
does in it; six frames by one call take 5 us where six calls take 11 (docs/decisions/0002-warm-and-in-one-call.md). The calls
are made without releasing the interpreter's lock: they never wait, and releasing the lock may cost milliseconds.
"""

import ctypes
import errno
import socket
import sys
from typing import Final

AVAILABLE: Final = sys.platform == "linux"
_UDP_SEGMENT = 103  # linux/udp.h
_HEADER_BYTES = 64
_DONTWAIT = ctypes.c_int(0x40)  # MSG_DONTWAIT of Linux
_NO_TIMEOUT = ctypes.c_void_p(0)


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("bytes", ctypes.c_size_t))  # struct iovec


class _Header(ctypes.Structure):  # struct mmsghdr, the struct msghdr in it unfolded
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_bytes", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vectors_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_bytes", ctypes.c_size_t),
        ("flags", ctypes.c_uint64),  # an int and its padding
        ("bytes", ctypes.c_uint64),
    )


class MessageBatch:
    """Buffers for `count` datagrams of a socket, one row each, and the two system calls over them.

    data      `data_bytes` a row
    names     `name_bytes` a row: the sender's address
    controls  `control_bytes` a row: ancillary data, struct cmsghdr first
    headers   64 a row, struct mmsghdr: at 40 the bytes of ancillary data, at 48 the flags
    """

    def __init__(self, sock: socket.socket, count: int, data_bytes: int, name_bytes: int = 0, control_bytes: int = 0) -> None:
        self.count = count
        self.data = bytearray(count * data_bytes)
        self.names = bytearray(count * name_bytes)
        self.controls = bytearray(count * control_bytes)
        self.headers = bytearray(count * _HEADER_BYTES)
        data, names, controls = map(_address, (self.data, self.names, self.controls))
        self._vectors = (_Vector * count)(*(_Vector(data + i * data_bytes, data_bytes) for i in range(count)))
        rows = (_Header * count).from_buffer(self.headers)
        for i, row in enumerate(rows):
            row.name, row.name_bytes = names + i * name_bytes, name_bytes
            row.vectors, row.vectors_count = ctypes.addressof(self._vectors) + i * ctypes.sizeof(_Vector), 1
            row.control, row.control_bytes = controls + i * control_bytes, control_bytes
        self._fresh = bytes(self.headers)  # the kernel writes lengths into the headers; they are set again for each call
        self._fd, self._first = ctypes.c_int(sock.fileno()), ctypes.addressof(rows)
        self._at = [ctypes.c_void_p(self._first + i * _HEADER_BYTES) for i in range(count)]
        self._counts = [ctypes.c_uint(i) for i in range(count + 1)]
        library = ctypes.PyDLL(None, use_errno=True)
        self._recvmmsg, self._sendmmsg = library.recvmmsg, library.sendmmsg

    def receive(self) -> int:
        """Take what is queued, at most `count` datagrams, and return how many. Raises OSError."""
        self.headers[:] = self._fresh
        taken: int = self._recvmmsg(self._fd, self._at[0], self._counts[self.count], _DONTWAIT, _NO_TIMEOUT)
        if taken < 0:
            number = ctypes.get_errno()
            if number == errno.EAGAIN:
                return 0
            raise OSError(number, "recvmmsg")
        return taken

    def send(self, count: int) -> int:
        """Send the first rows without waiting; a failed one does not stop the rest. Returns how many failed."""
        first = unsent = 0
        while first < count:
            sent: int = self._sendmmsg(self._fd, self._at[first], self._counts[count - first], _DONTWAIT)
            if sent < 1:
                unsent, sent = unsent + 1, 1
            first += sent
        return unsent


class SegmentBatch(MessageBatch):
    """Datagrams of one size. The kernel takes all of them as one, and cuts it where a socket receives them (UDP_SEGMENT)."""

    def __init__(self, sock: socket.socket, count: int, data_bytes: int) -> None:
        """Make the buffers. Raises OSError where the kernel cannot do this: before Linux 4.18."""
        super().__init__(sock, count, data_bytes)
        sock.setsockopt(socket.IPPROTO_UDP, _UDP_SEGMENT, data_bytes)
        self._send, self._begin = ctypes.PyDLL(None).send, ctypes.c_void_p(_address(self.data))
        self._lengths = [ctypes.c_size_t(i * data_bytes) for i in range(count + 1)]

    def send(self, count: int) -> int:
        whole: int = self._send(self._fd, self._begin, self._lengths[count], _DONTWAIT)
        return 0 if whole >= 0 else super().send(count)


class Mirror(MessageBatch):
    """Messages without a system call: the last ones sent are the next ones received."""

    _waiting = 0

    def receive(self) -> int:
        waiting, self._waiting = self._waiting, 0
        return waiting

    def send(self, count: int) -> int:
        self._waiting = count
        return 0


def _address(buffer: bytearray) -> int:
    """The address of a buffer, which must not grow or be freed from then on; 0 for an empty one."""
    return ctypes.addressof(ctypes.c_char.from_buffer(buffer)) if buffer else 0
