"""A serial radio: MAVLink on a stream of bytes, without datagrams. The codec finds the frames in it, each time at a 0xFD.

A thread waits for bytes, because that is the one way that works on Linux, macOS and Windows; it only reads and hands over, and
reads on when the loop has taken them: bytes faster than that are lost in the port, whose room is bounded. The port may go and
come back: it is opened again every two seconds.
"""

import asyncio
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from delfim.base.errors import ConfigError

if TYPE_CHECKING:  # a boat's computer has it not, and no such radio
    import serial

BAUD: Final = 57_600
BITS_PER_BYTE: Final = 10  # 8N1
BACKLOG_S: Final = 0.5  # of bytes on their way to the air; what would wait behind them is stale when it leaves
AGAIN_S: Final = 2.0
READ_S: Final = 0.2
READ_BYTES: Final = 2048  # in one turn of the loop: noise made of beginnings of frames takes up to 17 us a byte


class Radio:
    """One port. `reason` says why it is not open, in words; empty while it is. `dropped` counts frames that were not sent."""

    def __init__(self, device: str, baud: int, receive: Callable[[Any, bytes], None]) -> None:
        self.device, self.reason, self.dropped = device, "not open yet", 0
        self._baud, self._receive = baud, receive
        self._port: serial.Serial | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended, self._taken = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"radio {device}", daemon=True)

    def start(self) -> None:
        """Starts on the loop that gets the bytes."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(AGAIN_S)

    def send(self, data: bytes) -> None:
        """Sends at once or never: a frame that does not fit is dropped, and requests are repeated until they are answered."""
        port = self._port
        try:
            if port is None or port.out_waiting * BITS_PER_BYTE > self._baud * BACKLOG_S or (port.write(data) or 0) < len(data):
                self.dropped += 1
        except (OSError, TypeError):  # pyserial says TypeError of a port that was closed meanwhile
            self.dropped += 1

    def _run(self) -> None:
        import serial

        while not self._ended.is_set():
            try:
                with serial.Serial(self.device, self._baud, timeout=READ_S, write_timeout=0) as port:
                    self._port, self.reason = port, ""
                    self._read(port)
            except (OSError, ValueError) as error:  # pyserial's own are of these
                self.reason = str(error)
            self._port = None
            self._ended.wait(AGAIN_S)

    def _read(self, port: "serial.Serial") -> None:
        while not self._ended.is_set():
            data = port.read(1)
            if data:
                self._hand_over(data + port.read(min(port.in_waiting, READ_BYTES)))

    def _hand_over(self, data: bytes) -> None:
        assert self._loop is not None
        self._taken.clear()
        try:
            self._loop.call_soon_threadsafe(self._take, data)
        except RuntimeError:  # the loop has ended
            self._ended.set()
        while not self._ended.is_set() and not self._taken.wait(READ_S):
            pass

    def _take(self, data: bytes) -> None:
        try:
            self._receive(("serial", self.device), data)
        finally:
            self._taken.set()


def radio(words: str, receive: Callable[[Any, bytes], None]) -> Radio:
    """The radio of `/dev/ttyUSB0:57600`, `COM3:57600` or `/dev/ttyUSB0`. Raises ConfigError."""
    device, colon, baud = words.rpartition(":")
    if not colon:
        device, baud = words, str(BAUD)
    if not device or not baud.isdecimal() or not 300 <= int(baud) <= 4_000_000:
        raise ConfigError("--radio", words, "no serial port", "DEVICE or DEVICE:BAUD, as /dev/ttyUSB0:57600 or COM3:9600")
    return Radio(device, int(baud), receive)
