"""logd: logs the DSOR segmented log messages of the bus's nodes, a log for each node (thesis 3.3).

A message is a line of JSON in `DIRECTORY/YYYYMMDD/gps/hhmmss.jsonl.gz`: when its last frame came, and its bytes as text, or in
hexadecimal if they are not text.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, Protocol

import msgspec

from delfim.base.clock import Clock
from delfim.base.errors import BusError
from delfim.base.frames import Frame
from delfim.config import LogTable as Limits
from delfim.logging.liblog import LogStatus, event_line
from delfim.logging.openlog import open_log

FRAMES_A_CALL: Final = 64

_encode = msgspec.json.Encoder().encode  # a twentieth of the time of the json module: lines of a flood are written in the loop


class NodeMessage(Protocol):
    @property
    def source(self) -> int: ...
    @property
    def data(self) -> bytes: ...
    @property
    def t_ns(self) -> int: ...


class NodeReceiver(Protocol):
    """Assembles frames; delfim.canproxy.dsor.receiver.Receiver is one."""

    replies: deque[Frame]

    def feed(self, frame: Frame, now_s: float) -> NodeMessage | None: ...
    def expire(self, now_s: float) -> None: ...


class NodeSocket(Protocol):
    """The interface of a CAN socket, as needed here; delfim.canproxy.socket.CanSocket has it."""

    receive: Callable[[], Frame | None]  # raises BusError

    def sendmsg(self, frame: Frame) -> object: ...  # raises OSError
    def rebind(self) -> bool: ...


class LogMessages:
    """Logs the messages of the named nodes; those of others are not acknowledged. The socket never blocks."""

    def __init__(
        self, socket: NodeSocket, receiver: NodeReceiver, names: Mapping[int, str], limits: Limits, clock: Clock
    ) -> None:
        self._socket, self._receiver, self._clock = socket, receiver, clock
        self._failed = False  # the bus
        self.messages = self.lost = self.unanswered = 0
        self._logs = {node: open_log(limits, name, ".jsonl", "zpipe", clock) for node, name in names.items()}
        self._names = dict(names)
        self._note("start")

    def on_readable(self) -> None:
        """Take up to FRAMES_A_CALL queued frames, and acknowledge them."""
        now_s, replies = self._clock.monotonic_s(), self._receiver.replies
        try:
            for _ in range(FRAMES_A_CALL):
                frame = self._socket.receive()
                if frame is None:
                    break
                message = self._receiver.feed(frame, now_s)
                if message is not None:
                    self._write(message)
        except BusError:
            self._failed = True
        while replies:
            try:
                self._socket.sendmsg(replies.popleft())
            except OSError:  # the node repeats its frame
                self.unanswered += 1

    def poll(self) -> None:
        """Keep the logs going, and drop messages that were never finished; call it about once a second."""
        self._receiver.expire(self._clock.monotonic_s())
        if self._failed and self._socket.rebind():
            self._failed = False
        for log in self._logs.values():
            log.poll()

    def status(self) -> dict[str, LogStatus]:
        """The status of each node's log."""
        return {self._names[node]: log.status() for node, log in self._logs.items()}

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: messages logged and lost, frames that could not be answered, why a log is not written."""
        reasons = {name: status.reason for name, status in self.status().items() if status.reason}
        return {"messages": self.messages, "lost": self.lost, "unanswered": self.unanswered, "not_writable": reasons}

    def close(self) -> None:
        self._note("end")
        for log in self._logs.values():
            log.close()

    def _write(self, message: NodeMessage) -> None:
        log = self._logs.get(message.source)
        if log is not None:
            self.messages += 1
            self.lost += not log.put(line(message.t_ns, message.data))

    def _note(self, event: str) -> None:
        for log in self._logs.values():
            log.note(event_line(self._clock, event))


def line(t_ns: int, data: bytes) -> bytes:
    """Format a message as a line of JSON."""
    try:
        what = {"text": data.decode()}
    except UnicodeDecodeError:
        what = {"hex": data.hex()}
    return _encode({"t_ns": t_ns} | what) + b"\n"
