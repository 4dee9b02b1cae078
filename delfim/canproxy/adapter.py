"""Any bus of python-can as a transport of CanSocket: exotic adapters, and python-can's own virtual buses.

python-can cannot be waited on alike for all adapters, so a thread receives, filters, and hands each frame through a pair of
local sockets: readable like any socket, bounded by its buffer, and overflow is dropped and counted. Stamps are taken
as the frame leaves python-can: an adapter's own clock has an epoch of its own. Not for the critical loop.
"""

import contextlib
import errno
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import can

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_ID, CAN_IDE, CAN_RTR, Frame, extended, identifier, standard
from delfim.canproxy.canloop import stable_index
from delfim.canproxy.socket import CanAddress, accepts

_RECORD = struct.Struct("=qI?B8s")  # stamp, arbitration field, sent here, length, data
_STOP_CHECK_S = 0.1


def to_message(arb: int, data: bytes, t_ns: int = 0) -> can.Message:
    """Convert a frame to a python-can message. Raises FormatError beyond 8 bytes of data."""
    if len(data) > 8:
        raise FormatError(f"{len(data)} bytes of data do not fit a CAN frame of 8")
    return can.Message(
        timestamp=t_ns / 1e9,
        arbitration_id=identifier(arb),
        is_extended_id=bool(arb & CAN_IDE),
        is_remote_frame=bool(arb & CAN_RTR),
        is_error_frame=bool(arb & CAN_ERR),
        dlc=len(data),
        data=None if arb & CAN_RTR else data,
    )


def from_message(message: can.Message) -> tuple[int, bytes]:
    """Convert a message to arbitration field and data. Raises FormatError for CAN FD and for impossible frames."""
    if message.is_fd or message.dlc > 8:
        raise FormatError("a CAN FD frame")
    if message.is_error_frame:
        return message.arbitration_id << 3 & CAN_ID | CAN_IDE | CAN_ERR, bytes(message.data)
    arb = (extended if message.is_extended_id else standard)(message.arbitration_id, message.is_remote_frame)
    return arb, bytes(message.dlc) if message.is_remote_frame else bytes(message.data)


class PythonCan:
    """One bus of python-can, named "INTERFACE:CHANNEL[@BITRATE]", for example "pcan:PCAN_USBBUS1@500000"."""

    outlets: Callable[[], Sequence[int]] | None = None

    def __init__(self, name: str, receive_buffer_bytes: int, error_frames: bool) -> None:
        self.name, self.dropped, self.ifindex = f"python-can:{name}", 0, stable_index(f"python-can:{name}")
        self._options = _options(self.name, name)
        self._error_frames = error_frames
        self._addresses: tuple[CanAddress, ...] = ()
        self._start()
        self._output, self._input = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        for end, option in ((self._input, socket.SO_SNDBUF), (self._output, socket.SO_RCVBUF)):
            end.setblocking(False)
            end.setsockopt(socket.SOL_SOCKET, option, receive_buffer_bytes)

    def fileno(self) -> int:
        return self._output.fileno()

    def receive(self) -> Frame | None:
        try:
            record = self._output.recv(_RECORD.size)
        except BlockingIOError:
            record = b""
        except OSError as error:
            raise BusError(f"{self.name}: {error.strerror}") from None
        if record:
            t_ns, arb, sent_here, length, data = _RECORD.unpack(record)
            return Frame(arb, data[:length], t_ns, self.ifindex, sent_here)
        if self._failure:
            raise BusError(self._failure)
        return None

    def send(self, arb: int, data: bytes, ifindex: int) -> None:
        if ifindex not in (0, self.ifindex):
            raise BusError(f"{self.name} has index {self.ifindex}: it does not send by interface {ifindex}")
        if self._failure:
            raise BusError(self._failure)
        try:
            self._bus.send(to_message(arb, data))
        except (can.CanError, OSError) as error:
            code = getattr(error, "error_code", None) or getattr(error, "errno", None)
            if code in (errno.EAGAIN, errno.ENOBUFS):
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from None
            raise BusError(f"{self.name}: {error}") from None

    def rehearse(self) -> None:
        """Do nothing: python-can cannot send without a frame on the bus."""

    def filter(self, addresses: tuple[CanAddress, ...]) -> None:
        for address in addresses:
            if address.ifindex not in (0, self.ifindex):
                raise BusError(f"{self.name} has index {self.ifindex}: it receives no frames of interface {address.ifindex}")
        self._addresses = addresses

    def rebind(self) -> bool:
        """Reopen the adapter, which blocks: for some of them, for seconds."""
        if self._failure:
            self._thread.join()
            try:
                self._start()
            except BusError:
                return False
        return True

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._output.close()
        self._input.close()

    def _start(self) -> None:
        try:
            bus = can.Bus(ignore_config=True, **self._options)
        except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
            raise BusError(f"{self.name}: {error}") from None
        self._bus, self._failure, self._stop = bus, "", threading.Event()
        self._thread = threading.Thread(target=self._read, name=self.name, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            with self._bus:
                while not self._stop.is_set():
                    message = self._bus.recv(_STOP_CHECK_S)
                    if message is not None:
                        self._deliver(message)
        except Exception as error:  # vendors' libraries raise any exception, and a thread must not die unseen
            self._failure = f"{self.name}: {error or type(error).__name__}"
            with contextlib.suppress(OSError):  # only to wake the reader; if there is no room it is awake
                self._input.send(b"")

    def _deliver(self, message: can.Message) -> None:
        try:
            arb, data = from_message(message)
        except FormatError:
            return
        if not (self._error_frames if arb & CAN_ERR else any(accepts(address, arb) for address in self._addresses)):
            return
        try:
            self._input.send(_RECORD.pack(time.time_ns(), arb, not message.is_rx, len(data), data))
        except BlockingIOError:
            self.dropped += 1


def _options(name: str, text: str) -> dict[str, Any]:
    interface, _, rest = text.partition(":")
    channel, _, bitrate = rest.partition("@")
    if not interface or not channel or (bitrate and not bitrate.isdigit()):
        raise BusError(f"{name}: write python-can:INTERFACE:CHANNEL, and @BITRATE in bit/s where the adapter needs one")
    return {"interface": interface, "channel": channel} | ({"bitrate": int(bitrate)} if bitrate else {})
