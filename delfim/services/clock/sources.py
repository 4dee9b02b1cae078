"""Keeps the computer's clock from the vehicle: reads the sources of time once a second, and sets the clock (docs/clock.md).

All of it takes a few tens of microseconds a second, beside the critical path, which hands nothing over: its newest navigation
message is in the state anyway, and time frames wait in their socket.
"""

import logging
from collections.abc import Callable
from typing import Protocol

from msgspec.structs import replace

from delfim.base.clock import MADE_NS, Clock
from delfim.base.errors import BusError
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import TIME, TIME_FRAME, Navigation
from delfim.canproxy.socket import CanSocket
from delfim.services.clock import discipline
from delfim.services.clock.discipline import HEARD_S, ClockKeeper, Correction
from delfim.services.clock.kernel import BATTERY
from delfim.vehicle.report import ClockStatus
from delfim.vehicle.state import State

FRAMES_A_LOOK = 16
BATTERY_S = 2.0  # a clock that is as near to the battery clock was set by it: it counts whole seconds
OURS = "kept by this program"

log = logging.getLogger(__name__)


class Settable(Protocol):
    """The kernel's clock; delfim.services.clock.kernel.KernelClock. Each method raises OSError or returns at once."""

    def disciplined(self) -> bool: ...
    def step(self, by_s: float) -> None: ...
    def slew(self, by_s: float) -> None: ...


class ClockKeeping:
    """The sources of time and the clock together. Call `look` about once a second.

    why_not: why this program must not set the clock, in words; empty: it may. time_frames: a socket bound to the boat's time
    frame, `arb`, which never blocks. stepped: gets the seconds and the source of a step, once it is done. battery_ns: the time
    of the battery clock at the start.
    """

    def __init__(
        self,
        kernel: Settable,
        clock: Clock,
        why_not: str,
        time_frames: CanSocket,
        stepped: Callable[[float, str], None],
        battery_ns: int | None = None,
        arb: int = TIME_FRAME,
    ) -> None:
        self._kernel, self._clock, self._time_frames, self._stepped = kernel, clock, time_frames, stepped
        self._why_not, self._arb = why_not, arb
        self._keeper = ClockKeeper(why_not or OURS)
        self._navigation: Navigation | None = None
        self._told_source, self._told_fault = "", ""
        log.info("clock: %s", why_not or OURS)
        time_ns = clock.time_ns()
        if battery_ns is not None and time_ns >= MADE_NS and abs(time_ns - battery_ns) / 1e9 <= BATTERY_S:
            self._keeper.status = replace(self._keeper.status, source=BATTERY)

    def look(self, state: State) -> ClockStatus:
        """Read the sources' times, correct the clock, and return what there is to log."""
        keeper = self._keeper
        if not self._why_not and self._kernel.disciplined():
            self._leave("kept by another program, which tunes the kernel's clock")
        self._hear_time_frames()
        self._hear_navigation(state)
        now_s = self._clock.monotonic_s()
        own_ns = self._clock.time_ns() - round(now_s * 1e9)
        idle = state.mode is Mode.IDLE and not state.armed and not state.actuation.run
        correction = keeper.look(own_ns, now_s, idle=idle, may_set=not self._why_not)
        if correction is not None:
            self._correct(correction)
        self._tell()
        return keeper.status

    def _correct(self, correction: Correction) -> None:
        try:
            if correction.do == "slew":
                self._kernel.slew(correction.by_s)
                return
            self._kernel.step(correction.by_s)
        except OSError as error:
            self._leave(f"not set: {error.strerror}")
            return
        log.info("clock: stepped by %+.3f s to the time of %s", correction.by_s, correction.source)
        self._stepped(correction.by_s, correction.source)

    def _hear_time_frames(self) -> None:
        """Read the time frames of other computers: this one's own would only confirm its clock."""
        for _ in range(FRAMES_A_LOOK):
            try:
                frame = self._time_frames.receive()
            except BusError:  # told and mended by those who live by this bus
                return
            if frame is None:
                return
            if frame.sent_here or frame.arb != self._arb or len(frame.data) != TIME.size:
                continue
            now_s, age_s = self._clock.monotonic_s(), (self._clock.time_ns() - frame.t_ns) / 1e9
            if 0.0 <= age_s <= HEARD_S:  # otherwise it is too old, or the clock was stepped after its stamp
                at_s = now_s - age_s
                self._keeper.tell(discipline.TIME_FRAME, TIME.unpack(frame.data)[0] - round(at_s * 1e9), at_s)

    def _hear_navigation(self, state: State) -> None:
        """Read the time of navigation. A receiver without a fix may send that of a clock of its own."""
        n = state.navigation
        if n is not None and n is not self._navigation and n.utc_ns and n.fix:
            name = f"navigation ({state.source})"
            self._keeper.tell(name, n.utc_ns - round(state.navigation_s * 1e9), state.navigation_s)
        self._navigation = n

    def _leave(self, why_not: str) -> None:
        self._why_not = why_not
        self._keeper.status = replace(self._keeper.status, kept=why_not)
        log.warning("clock: %s", why_not)

    def _tell(self) -> None:
        """Log a source that is new, and a kind of fault that is new: not the same words each second."""
        status, fault = self._keeper.status, self._keeper.fault
        if status.source != self._told_source and status.off_s is not None:
            log.info("clock: compared with %s from now on, %+.3f s off it", status.source, status.off_s)
            self._told_source = status.source
        if fault != self._told_fault:
            if fault:
                log.warning("clock: %s", status.fault)
            self._told_fault = fault
