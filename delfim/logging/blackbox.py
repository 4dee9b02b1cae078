"""canzlogd: the black box. Every frame of every bus, as it was on the bus, in candump's format, deflated (thesis 3.3).

One log a bus, `DIRECTORY/YYYYMMDD/can0/hhmmss.log.gz`, its id the name of the interface. All but frames goes to the sidecar:
a line of JSON for each start, loss of frames, change of the bus, step of the wall clock and trouble of the log itself.
"""

import logging
import re
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from delfim.base.clock import Clock
from delfim.base.errors import BusError
from delfim.base.frames import CAN_ERR, Frame
from delfim.config import LogTable as Limits
from delfim.logging.candump import format_line
from delfim.logging.liblog import event_line
from delfim.logging.openlog import open_log

FRAMES_A_CALL: Final = 64  # a fraction of a millisecond; the loop calls again while frames are queued
LAST_CALLS: Final = 100
STEP_S: Final = 0.5  # a wall clock that differs by more from where it should be has stepped

words = logging.getLogger(__name__)


class RecordedSocket(Protocol):
    """The interface of a CAN socket, as needed here; delfim.canproxy.socket.CanSocket has it."""

    name: str

    def receive_many(self) -> list[Frame]: ...  # raises BusError
    @property
    def dropped(self) -> int: ...
    def rebind(self) -> bool: ...


class ErrorState(Protocol):
    @property
    def state(self) -> str: ...


def device(interface: str) -> str:
    """The name of a bus in candump's text, and the id of its log."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", interface.rpartition(":")[2])


class RecordedBus:
    """The log of one bus, and the last notes in its sidecar."""

    def __init__(self, socket: RecordedSocket, limits: Limits, clock: Clock) -> None:
        self.socket, self.clock = socket, clock
        self.device = device(socket.name)
        self.log = open_log(limits, self.device, ".log", "zpipe", clock)
        self.lost = 0  # frames that the log did not take
        self.error = self.state = ""  # of the bus
        self.told: dict[str, object] = {}
        self.note("start")

    def note(self, event: str, **what: object) -> bool:
        return self.log.note(event_line(self.clock, event, **what))

    def tell(self, event: str, value: object, empty: object) -> None:
        """Note a value if it differs from the one noted last; `empty` needs no first note."""
        if value != self.told.get(event, empty) and self.note(event, value=value):
            self.told[event] = value
            words.warning("%s: %s: %s", self.device, event, "no more" if value == empty else value)


class BlackBox:
    """Logs the frames that the sockets receive. Sockets never block, and are bound to ANYTHING with error frames let through.

    `bus_state` returns the controller's state from an error frame, as delfim.canproxy.socket.bus_state does.
    """

    def __init__(
        self,
        sockets: Iterable[RecordedSocket],
        limits: Limits,
        clock: Clock,
        bus_state: Callable[[Frame], ErrorState | None] = lambda frame: None,
    ) -> None:
        self._buses = {id(socket): RecordedBus(socket, limits, clock) for socket in sockets}
        self._clock, self._bus_state = clock, bus_state
        self._offset_s = self._wall_offset_s()

    def on_readable(self, socket: RecordedSocket) -> int:
        """Log about FRAMES_A_CALL of the queued frames. Returns how many."""
        bus = self._buses[id(socket)]
        receive_many, device = socket.receive_many, bus.device
        lines: list[str] = []
        try:
            while len(lines) < FRAMES_A_CALL and (frames := receive_many()):
                for frame in frames:
                    lines.append(format_line(frame, device))
                    if frame.arb & CAN_ERR and (state := self._bus_state(frame)):
                        bus.state = state.state
        except BusError as error:
            bus.error = str(error)
        if lines and not bus.log.put("".join(lines).encode()):
            bus.lost += len(lines)
        return len(lines)

    def poll(self) -> None:
        """Keep the logs going, reopen buses that failed, and write the sidecars; call it about once a second."""
        offset_s = self._wall_offset_s()
        step_s, self._offset_s = offset_s - self._offset_s, offset_s
        if abs(step_s) > STEP_S:
            words.warning("the wall clock stepped by %+.3f s", step_s)
        for bus in self._buses.values():
            bus.log.poll()
            if bus.error and bus.socket.rebind():
                bus.error = ""
            if abs(step_s) > STEP_S:
                bus.note("clock step", value=step_s)
            status = bus.log.status()
            bus.tell("frames lost before the socket was read", bus.socket.dropped, 0)
            bus.tell("frames lost for want of room in the pipe", bus.lost, 0)
            bus.tell("blocks of frames lost by the log", status.dropped, 0)
            bus.tell("bus state", bus.state, "")
            bus.tell("bus error", bus.error, "")
            bus.tell("log not writable", status.reason, "")

    def figures(self) -> dict[str, object]:
        """Figures, JSON-ready: of each bus the bytes on disk, the frames lost, and its trouble where it has one."""
        shown: dict[str, object] = {}
        for name, bus in ((bus.device, bus) for bus in self._buses.values()):
            status = bus.log.status()
            shown[f"{name}_bytes"] = status.bytes
            shown[f"{name}_frames_lost"] = bus.socket.dropped + bus.lost
            if trouble := bus.error or status.reason or bus.state:
                shown[name] = trouble
        return shown

    def close(self) -> None:
        for bus in self._buses.values():
            for _ in range(LAST_CALLS):  # the last frames before the end are still queued
                if self.on_readable(bus.socket) < FRAMES_A_CALL:
                    break
            bus.note("end")
            bus.log.close()

    def _wall_offset_s(self) -> float:
        return self._clock.time_ns() / 1e9 - self._clock.monotonic_s()
