"""slipd: the radio's serial line as a network interface, for as long as there is a radio (thesis 2.11, 3.3).

It opens the serial port, gives it the kernel's (C)SLIP line discipline, names and addresses the interface, watches the carrier,
and builds everything anew after any failure: carrier gone, hang-up, adapter unplugged, refusal of the kernel. Where the
kernel has no SLIP, a TUN device and the codecs of slip.py and vj.py stand behind the same interface, interactive traffic first.
A boat that shares its frequency with others speaks only when the shore polls it: polling.py.
Every event is logged with its reason. docs/slipd.md.
"""

import asyncio
import contextlib
import fcntl
import logging
import os
import socket
import struct
import termios
from collections.abc import Callable
from ipaddress import IPv4Address
from pathlib import Path
from typing import Final, Protocol

from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, PermanentFailure
from delfim.canproxy.canudp import open_tun
from delfim.lines.serialline import open_port
from delfim.services.radio.packetqueue import PacketQueue
from delfim.services.radio.polledline import PolledLine, Talker
from delfim.services.radio.polling import PolledBoat
from delfim.services.radio.slip import Deframer, framed
from delfim.services.radio.tunport import TunPort
from delfim.services.radio.vj import Compressor, Decompressor
from delfim.services.runtime import Runtime
from delfim.services.tables import Slipd

LOOK_S: Final = 0.25  # how often carrier and interface are looked at
RETRY_MAX_S: Final = 2.0
AHEAD_S: Final = 0.02  # given to the line before it has sent the data it has
_N_TTY, _N_SLIP = 0, 1
_SIOCGIFNAME, _SIOCSIFENCAP = 0x8910, 0x8926
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFDSTADDR, _SIOCSIFMTU = 0x8913, 0x8914, 0x8916, 0x8918, 0x8922
_IFF_UP = 1
_DEFAULT_QDISC: Final = Path("/proc/sys/net/core/default_qdisc")
_TCP_TIMESTAMPS: Final = Path("/proc/sys/net/ipv4/tcp_timestamps")

log = logging.getLogger(__name__)


class RadioLine(Protocol):
    """An interface that is up on an open port."""

    name: str

    def attend(self) -> None: ...  # once, on the service's own behalf, when it is up
    def trouble(self) -> str: ...  # why it is not up any more, in words; empty while it is
    def silence(self) -> str: ...  # why it is up and carries nothing, in words; empty where that is not known
    def close(self) -> None: ...


Carrier = Callable[[int], bool]  # whether there is one, told the open port; raises OSError for a port that is gone


def carrier_source(text: str) -> Carrier:
    """Parse a source of carrier detect: "none" always; "dcd" the modem's line; "file:PATH" a file that holds 1."""
    if text == "dcd":
        return lambda port: bool(struct.unpack("i", fcntl.ioctl(port, termios.TIOCMGET, bytes(4)))[0] & termios.TIOCM_CAR)
    if text.startswith("file:"):
        path = Path(text.removeprefix("file:"))
        return lambda port: path.read_text().strip() == "1" if path.exists() else False
    return lambda port: True


class SerialRadio:
    """The radio's link, reopened when it is lost. `open_line` attaches an interface to an open port."""

    def __init__(self, settings: Slipd, clock: Clock, open_line: Callable[[int], RadioLine]) -> None:
        self._settings, self._clock, self._open_line = settings, clock, open_line
        self._carrier = carrier_source(settings.carrier)
        self._port = -1
        self._line: RadioLine | None = None
        self.reason, self.since_s = "starting", clock.monotonic_s()
        self.losses = 0
        self._due_s, self._retry_s = 0.0, LOOK_S

    def is_due(self) -> bool:
        """Check whether the link is still there; True when it is not and `retry` is due. Called every LOOK_S."""
        now_s = self._clock.monotonic_s()
        if self._line is not None:
            trouble = self._line.trouble() or self._lost()
            if trouble:
                self.losses += 1
                self._down(f"lost: {trouble}", now_s)
            elif (said := self._line.silence() or "up") != self.reason:
                log.warning("slipd: %s: %s", self._settings.device, said)
                self.reason, self.since_s = said, now_s
        return self._line is None and now_s >= self._due_s

    def attend(self) -> None:
        """Attend to the new link after `retry`, in the service's own context."""
        if self._line is not None:
            self._line.attend()

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        line = self._line
        counts = _counters(line.name) if line is not None else {}
        state = {"state": "up" if line is not None else "down", "interface": line.name if line is not None else ""}
        return state | {
            "reason": self.reason,
            "for_s": round(self._clock.monotonic_s() - self.since_s, 1),
            "losses": self.losses,
            **counts,
        }

    def close(self) -> None:
        if self._line is not None:
            self._down("shutdown", self._clock.monotonic_s())
        elif self._port >= 0:
            self._close_port()

    def retry(self) -> None:
        """Try to open a link. May take as long as the kernel takes to attach a line: not for the loop's own thread."""
        now_s = self._clock.monotonic_s()
        try:
            if self._port < 0:
                self._port = open_port(self._settings.device, self._settings.baud, self._settings.carrier != "dcd")
            if not self._carrier(self._port):
                self._waits("no carrier", now_s)
                return
            self._line = self._open_line(self._port)
        except (OSError, DelfimError) as error:
            self._close_port()
            self._waits(error.strerror if isinstance(error, OSError) and error.strerror else str(error), now_s)
            return
        self.reason, self.since_s, self._retry_s = "up", now_s, LOOK_S
        log.warning("slipd: %s is up on %s", self._line.name, self._settings.device)

    def _waits(self, reason: str, now_s: float) -> None:
        if reason != self.reason:
            log.warning("slipd: %s: %s", self._settings.device, reason)
            self.reason, self.since_s = reason, now_s
        self._due_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, RETRY_MAX_S)

    def _lost(self) -> str:
        try:
            return "" if self._carrier(self._port) else "no carrier"
        except OSError as error:
            return error.strerror or str(error)

    def _down(self, reason: str, now_s: float) -> None:
        assert self._line is not None
        with contextlib.suppress(OSError):
            self._line.close()
        self._line = None
        self._close_port()
        self._due_s, self._retry_s = now_s + LOOK_S, LOOK_S
        self.reason, self.since_s = reason, now_s
        log.warning("slipd: %s %s", self._settings.device, reason)

    def _close_port(self) -> None:
        if self._port >= 0:
            with contextlib.suppress(OSError):
                os.close(self._port)
            self._port = -1


class KernelLine:
    """The kernel's SLIP on a port. Raises OSError with the kernel's refusal."""

    def __init__(self, port: int, settings: Slipd) -> None:
        self._port = port
        with contextlib.suppress(OSError):  # the queue that serves IPTOS_LOWDELAY first
            _DEFAULT_QDISC.write_text("pfifo_fast")
        fcntl.ioctl(port, termios.TIOCSETD, struct.pack("i", _N_SLIP))
        self.name = fcntl.ioctl(port, _SIOCGIFNAME, bytes(32)).split(b"\0")[0].decode()
        fcntl.ioctl(port, _SIOCSIFENCAP, struct.pack("i", int(settings.encapsulation == "cslip")))
        address_interface(self.name, settings)

    def attend(self) -> None:
        """Do nothing: the kernel serves the line."""

    def trouble(self) -> str:
        return "" if Path("/sys/class/net", self.name).exists() else "the line was hung up"

    def silence(self) -> str:
        return ""

    def close(self) -> None:
        fcntl.ioctl(self._port, termios.TIOCSETD, struct.pack("i", _N_TTY))


class TunLine:
    """SLIP in this program: packets of a TUN device to the port and back. Interactive packets overtake the others; a full queue
    takes no more."""

    def __init__(self, port: int, settings: Slipd, runtime: Runtime, loop: asyncio.AbstractEventLoop) -> None:
        self.name, self._loop = settings.interface, loop
        self._bytes_per_s, self._free_s = (settings.radio_bps or settings.baud) / 10.0, 0.0  # a byte has 10 bits: 8N1
        self._outbox = PacketQueue()
        compresses = settings.encapsulation == "cslip"
        self._compressor = Compressor() if compresses else None
        self._decompressor, self._deframer = Decompressor() if compresses else None, Deframer()
        self._rest = b""
        self._ends = TunPort(port, open_tun(settings.interface, "", settings.mtu), runtime, self._received, self._on_packet)
        address_interface(self.name, settings)

    def attend(self) -> None:
        self._ends.attend()

    def trouble(self) -> str:
        return self._ends.trouble

    def silence(self) -> str:
        return ""

    def close(self) -> None:
        self._ends.close()

    def _on_packet(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._outbox.put(self._ends.packet())
            if self._ends.timer is None:
                self._send()

    def _received(self, data: bytes) -> None:
        errors = self._deframer.errors
        for frame in self._deframer.feed(data):
            packet = self._decompressor.decompress(frame) if self._decompressor else frame
            if packet is not None:
                self._ends.deliver(packet)
        if self._decompressor and self._deframer.errors != errors:
            self._decompressor.damaged()

    def _send(self) -> None:
        """Send as much as the line takes now: data in the port's or the modem's buffer cannot be overtaken."""
        ends, now_s = self._ends, self._loop.time()
        ends.timer = None
        while self._rest or self._is_free(now_s):
            self._rest = self._rest or self._next(now_s)
            if not (sent := ends.write(self._rest)):
                break
            self._rest = self._rest[sent:]
        if not ends.trouble and (self._rest or self._outbox):
            ends.timer = self._loop.call_later(max(self._free_s - AHEAD_S - now_s, AHEAD_S / 4), self._send)

    def _is_free(self, now_s: float) -> bool:
        if self._free_s - now_s > AHEAD_S or not self._outbox:
            return False
        return self._ends.unsent() <= AHEAD_S * self._bytes_per_s

    def _next(self, now_s: float) -> bytes:
        packet = self._outbox.pop()
        data = framed(self._compressor.compress(packet) if self._compressor else packet)
        self._free_s = max(self._free_s, now_s) + len(data) / self._bytes_per_s
        return data


def address_interface(name: str, settings: Slipd) -> None:
    """Set address, peer and MTU of an interface, and set it up (netdevice(7)). Raises OSError."""
    device = name.encode()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inet:
        fcntl.ioctl(inet, _SIOCSIFMTU, struct.pack("16si20x", device, settings.mtu))
        for request, address in ((_SIOCSIFADDR, settings.address), (_SIOCSIFDSTADDR, settings.peer)):
            words = struct.pack("16sHH4s16x", device, socket.AF_INET, 0, IPv4Address(address).packed)
            fcntl.ioctl(inet, request, words)
        flags = struct.unpack("16xH22x", fcntl.ioctl(inet, _SIOCGIFFLAGS, struct.pack("40s", device)))[0]
        fcntl.ioctl(inet, _SIOCSIFFLAGS, struct.pack("16sH22x", device, flags | _IFF_UP))


def _counters(name: str) -> dict[str, object]:
    folder = Path("/sys/class/net", name, "statistics")
    try:
        return {key: int((folder / key).read_text()) for key in ("rx_bytes", "tx_bytes", "rx_errors", "tx_dropped")}
    except (OSError, ValueError):
        return {}


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled. Raises PermanentFailure without a device."""
    settings, loop = runtime.config.of(Slipd), asyncio.get_running_loop()
    if not settings.device:
        raise PermanentFailure("slipd.device is not set")

    def open_line(port: int) -> RadioLine:
        if settings.station:
            boat = PolledBoat(settings.station, settings.encapsulation == "cslip", loop.time())
            return polled(port, settings, boat, runtime, loop)
        if settings.mode != "user":
            try:
                return KernelLine(port, settings)
            except OSError:
                if settings.mode == "kernel":
                    raise
        return TunLine(port, settings, runtime, loop)

    await keep_up(runtime, settings, open_line)


def polled(
    port: int, settings: Slipd, talker: Talker, runtime: Runtime, loop: asyncio.AbstractEventLoop, network: str = ""
) -> PolledLine:
    """Open the line of several boats on an open port. `network`: address and prefix of the shore, for a boat has one peer
    only."""
    tun = open_tun(settings.interface, network, settings.mtu)
    try:
        if not network:
            address_interface(settings.interface, settings)
    except OSError:
        os.close(tun)
        raise
    return PolledLine(settings.interface, port, tun, talker, runtime, loop)


async def keep_up(runtime: Runtime, settings: Slipd, open_line: Callable[[int], RadioLine]) -> None:
    """Keep up the radio's interface, for as long as there is a radio, until it is cancelled."""
    if settings.encapsulation == "cslip":
        with contextlib.suppress(OSError):  # a header whose options change is not compressed (RFC 1144, 3.2.3)
            _TCP_TIMESTAMPS.write_text("0")
    radio = SerialRadio(settings, runtime.clock, open_line)
    with contextlib.closing(radio), runtime.publishing("slipd", radio.report):
        while True:
            if radio.is_due():
                await asyncio.get_running_loop().run_in_executor(None, radio.retry)  # the kernel may have to load a module
                radio.attend()
            await asyncio.sleep(LOOK_S)
