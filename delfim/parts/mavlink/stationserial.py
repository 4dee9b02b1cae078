"""The station's serial line: a radio as SiK's, beside the UDP socket (docs/mavlink.md, "A serial radio").

A radio stalls, is unplugged, and sends slower than its port takes. So the output is bounded, paced and never waited for, and
telemetry waits until the line has room (`is_ready`). No event loop here: `stationsocket.py` calls the methods.
"""

import logging
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from delfim.base.clock import Clock
from delfim.lines.serialline import SerialLine
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.wire import Address, dialect
from delfim.parts.mavlink.table import Mavlink

BITS_PER_BYTE: Final = 10  # 8N1
READ_BYTES: Final = 128  # in one callback: noise made of beginnings of frames takes 3 us a byte
QUEUE_BYTES: Final = 4096  # beyond, the newest are dropped
BURST_S: Final = 0.1  # of the line's rate: given to the kernel at once; and waiting here, before telemetry waits
STALE_S: Final = 1.0  # data that waited for longer are dropped: a console would take them for new
AGAIN_S: Final = 1.0
# Once a second the radio reports how much of its buffer is free. The rate falls below LOW_PERCENT and rises above HIGH_PERCENT.
LOW_PERCENT, HIGH_PERCENT, FALL, RISE = 75, 90, 0.8, 1.1
FULL_PERCENT, FALL_FAST = 40, 0.5
SLOWEST: Final = 1 / 16  # of the port's rate: a radio signs no reports, and a forged one must not silence the boat

log = logging.getLogger(__name__)


class StationSerial:
    """`receive` takes a frame and the line's address."""

    def __init__(self, settings: Mavlink, clock: Clock, receive: Callable[[bytes, Address], object]) -> None:
        self.address: Address = settings.serial, settings.baud
        self._line = SerialLine(settings.serial, settings.baud, clock, may_lack=True)
        self._now_s, self._receive = clock.monotonic_s, receive
        self._fastest = self._rate = settings.baud / BITS_PER_BYTE  # bytes a second
        self._cutter = wire.Cutter()
        self._waiting = deque[tuple[float, bytes]]()  # since when, and what is left of it
        self._queued, self._credit, self._at_s = 0, 0.0, clock.monotonic_s()  # bytes, bytes
        self._dropped = self._losses = 0
        self._heard: Any = None  # the radio's last report
        self._said, self._due_s = self._line.trouble, clock.monotonic_s()

    def fileno(self) -> int:
        """Readable when there is something to read; the same when the port is reopened."""
        return self._line.fileno()

    def report(self) -> dict[str, object]:
        """JSON-ready."""
        r = self._heard
        radio = {} if r is None else {"rssi": r.rssi, "remote_rssi": r.remrssi, "noise": r.noise, "free_percent": r.txbuf}
        figures = {"bytes_per_s": round(self._rate), "dropped": self._dropped, "losses": self._losses}
        return {"device": self.address[0], "trouble": self._line.trouble, **figures, **radio}

    def is_due(self) -> bool:
        """Write what the line may carry now. Whether `open` is due: it takes milliseconds with some adapters, so it is work for
        a worker. Called twenty times a second."""
        now_s, trouble = self._now_s(), self._line.trouble
        if trouble != self._said:
            log.warning("mavlink: %s: %s", self.address[0], trouble or "open")
            self._losses += bool(trouble and not self._said)
            self._said, self._rate, self._credit, self._heard = trouble, self._fastest, 0.0, None
        if not trouble:
            self._flush(now_s)
            return False
        self._drop()
        if now_s < self._due_s:
            return False
        self._due_s = now_s + AGAIN_S
        return True

    def open(self) -> None:
        self._line.rebind()

    def close(self) -> None:
        self._line.close()

    # In.

    def readable(self) -> None:
        for frame in self._cutter.cut(self._line.read(READ_BYTES)):
            if frame[0] == wire.MARKER and frame[2] & wire.SIGNED:
                self._receive(frame, self.address)
            else:
                self._heed(frame)

    def _heed(self, frame: bytes) -> None:
        """A frame without a signature: the radio's own report, or refused."""
        message = wire.decode(frame)
        if message is None or message.get_msgId() != dialect.MAVLINK_MSG_ID_RADIO_STATUS:
            self._receive(frame, self.address)
            return
        self._heard = message
        if message.txbuf < LOW_PERCENT:
            fall = FALL_FAST if message.txbuf < FULL_PERCENT else FALL
            self._rate = max(self._rate * fall, self._fastest * SLOWEST)
        elif message.txbuf > HIGH_PERCENT:
            self._rate = min(self._rate * RISE, self._fastest)

    # Out.

    def is_ready(self) -> bool:
        """Whether the line has room for more telemetry."""
        return not self._line.trouble and self._queued <= min(self._rate * BURST_S, QUEUE_BYTES / 2)

    def send(self, data: bytes) -> None:
        """Soon or never: requests are repeated until they are answered."""
        if self._line.trouble or self._queued + len(data) > QUEUE_BYTES:
            self._dropped += 1
            return
        now_s = self._now_s()
        self._waiting.append((now_s, data))
        self._queued += len(data)
        self._flush(now_s)

    def _flush(self, now_s: float) -> None:
        most = self._rate * BURST_S
        self._credit = min(self._credit + (now_s - self._at_s) * self._rate, most)
        self._at_s = now_s
        while self._waiting and now_s - self._waiting[0][0] > STALE_S:
            self._dropped += 1
            self._queued -= len(self._waiting.popleft()[1])
        while self._waiting and self._credit >= 1.0:
            since_s, data = self._waiting.popleft()
            taken = self._line.put(data[: int(self._credit)])
            self._credit -= taken
            self._queued -= taken
            if taken < len(data):
                self._waiting.appendleft((since_s, data[taken:]))
                return

    def _drop(self) -> None:
        """Nothing that waits for a port that is gone is of use when it comes back."""
        self._dropped += len(self._waiting)
        self._waiting.clear()
        self._queued = 0
