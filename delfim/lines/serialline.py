"""A serial line: raw, non-blocking, reopened when its adapter comes back; or a socket in the place of one."""

import array
import contextlib
import fcntl
import os
import select
import socket
import termios
import tty
from collections.abc import Callable
from typing import Final

from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.base.input.ratelimit import PIECE_BYTES, Allowance
from delfim.lines.forms import Form

TCGETS2, TCSETS2 = 0x802C542A, 0x402C542B  # asm-generic/ioctls.h: x86, ARM, RISC-V
BOTHER, RATES = 0o010000, 0o010017  # "the rate is the number itself"; the bits that name a rate (asm-generic/termbits.h)
OFF_MAX: Final = 0.03  # of a rate: beyond, a byte's last bit is read in its neighbour
SOCKETS: Final = ("tcp:", "unix:")
CONNECT_S: Final = 0.1  # that the first opening of a socket waits: a stop is sent right after it
SILENT_MS: Final = 3000  # of the other end of TCP, after which the connection is given up and made anew
KEEPALIVE_S: Final = 2  # between two questions whether the other end is still there
SYN_REPEATS: Final = 1  # 3 s until an attempt to connect has failed


class SerialLine:
    """A serial port that is open. Raises DelfimError if it cannot be opened; later `trouble` names its fault.

    `device` is a path as /dev/ttyUSB0, "tcp:ADDRESS:PORT", or "unix:PATH" for a local socket of records. Nobody has to listen
    at a socket when it is opened: that is a trouble, too.
    """

    def __init__(
        self,
        device: str,
        baud: int,
        clock: Clock,
        heard: Callable[[int, bytes], object] = lambda t_ns, data: None,
        may_lack: bool = False,
        form: Form = "8N1",
        allowance: Allowance | None = None,
    ) -> None:
        """`heard` is called with all data that is handed on, and its time. `may_lack`: the port is first opened by `rebind`.
        `allowance`: bounds what is read; without one there is no bound."""
        self.device, self.t_ns = device, 0
        self._baud, self._form, self._time_ns, self._heard = baud, form, clock.time_ns, heard
        self.trouble = "not open yet" if may_lack else ""
        self.allowance = allowance or Allowance()
        self._port = -1
        self._ready = select.epoll()  # to wait for: it stays the same when the port is reopened
        try:
            if device.startswith(SOCKETS):
                if self.rebind():
                    select.select([], [self._port], [], CONNECT_S)
            elif not may_lack:
                self._open()
        except OSError as error:
            self._ready.close()
            raise DelfimError(f"{device}: {error.strerror}") from None

    def fileno(self) -> int:
        """The descriptor, readable when there is something to read."""
        return self._ready.fileno()

    def read(self, most: int = PIECE_BYTES) -> bytes:
        """Read the next data, at most so many bytes, their time in `t_ns`; empty: there are none, or the sender exceeds its
        rate limit."""
        if self._port < 0:
            return b""
        try:
            data = os.read(self._port, self.allowance.at_once(most))
        except BlockingIOError:
            return b""
        except OSError as error:
            self._lost(str(error.strerror))
            return b""
        if not data:
            self._lost("hung up")
        elif data := self.allowance.of(data):
            self.t_ns = self._time_ns()
            self._heard(self.t_ns, data)
        return data

    def write(self, data: bytes) -> bool:
        """Write data; False where the line did not take all of it: it is not sent again."""
        return self.put(data) == len(data)

    def put(self, data: bytes) -> int:
        """Write bytes, and return how many the line took."""
        try:
            return os.write(self._port, data) if self._port >= 0 else 0
        except BlockingIOError:
            return 0
        except OSError as error:
            self._lost(str(error.strerror))
            return 0

    def rebind(self) -> bool:
        """Reopen a port that was lost; call it about once a second. True when the port can be used."""
        self.allowance.look()
        if self._port >= 0:
            self.trouble = self.allowance.words
        else:
            try:
                self._open()
            except OSError as error:
                self.trouble = str(error.strerror)
            except DelfimError as error:
                self.trouble = str(error)
        return self._port >= 0

    def close(self) -> None:
        self._lost("closed")
        self._ready.close()

    def _open(self) -> None:
        if self.device.startswith(SOCKETS):
            self._port = open_socket(self.device)
        else:
            self._port = open_port(self.device, self._baud, ignores_modem=True, form=self._form)
        self._ready.register(self._port, select.EPOLLIN)
        self.trouble = ""

    def _lost(self, why: str) -> None:
        """Close a lost port, which would be readable for ever."""
        self.trouble = why
        if self._port >= 0:
            self._ready.unregister(self._port)
            with contextlib.suppress(termios.error):  # closing a line that stalls would wait for its output, up to 30 s
                termios.tcflush(self._port, termios.TCOFLUSH)
            os.close(self._port)
            self._port = -1


def open_socket(device: str) -> int:
    """Open a socket that connects, or is connected, to "tcp:ADDRESS:PORT" or "unix:PATH". An address is of numbers: nothing
    waits for names. Raises OSError."""
    kind, _, place = device.partition(":")
    host, _, port = place.rpartition(":")
    address: str | tuple[str, int] = place
    if kind == "unix":
        opened = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    else:
        opened = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENT_MS)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # for a line on which nothing is sent
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE_S)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE_S)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_SYNCNT, SYN_REPEATS)
        address = (host.strip("[]"), int(port))
    try:
        opened.setblocking(False)
        with contextlib.suppress(BlockingIOError):  # it connects
            opened.connect(address)
    except OSError:
        opened.close()
        raise
    return opened.detach()


def open_port(device: str, baud: int, ignores_modem: bool, form: Form = "8N1") -> int:
    """Open a serial port, raw, at any speed that the port can make. Raises OSError, DelfimError for a speed that it cannot."""
    port = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        tty.setraw(port)
        attributes = termios.tcgetattr(port)
        left = attributes[2] & ~(termios.CLOCAL | termios.CSTOPB)  # the port's last user may have had two stop bits
        form_bits = termios.PARENB | termios.CSTOPB if form == "8E2" else 0
        attributes[2] = left | (termios.CLOCAL if ignores_modem else 0) | termios.CREAD | form_bits
        speed = getattr(termios, f"B{baud}", None)
        attributes[4] = attributes[5] = termios.B38400 if speed is None else speed
        termios.tcsetattr(port, termios.TCSANOW, attributes)
        made = baud if speed is not None else _set_rate(port, baud)
    except (OSError, termios.error) as error:
        os.close(port)
        raise OSError(*error.args) from None
    if abs(made - baud) > OFF_MAX * baud:
        os.close(port)
        raise DelfimError(f"{device} does not run at {baud} baud; the nearest rate that it can make is {made}")
    return port


def _set_rate(port: int, baud: int) -> int:
    """Set a rate that has no name in termios, by Linux' struct termios2; return the rate that the driver made of it."""
    settings = array.array("I", bytes(44))  # 4 words of flags, the line's discipline and 19 characters, input and output rate
    fcntl.ioctl(port, TCGETS2, settings)
    settings[2] = settings[2] & ~(RATES | RATES << 16) | BOTHER
    settings[9] = settings[10] = baud
    fcntl.ioctl(port, TCSETS2, settings)
    fcntl.ioctl(port, TCGETS2, settings)
    return settings[10]
