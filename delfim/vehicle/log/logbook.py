"""The vehicle's state log: a record a cycle, and events in the sidecar beside it (docs/log-format.md)."""

import logging
import math
from collections.abc import Callable
from typing import Final

import msgspec

from delfim import __version__, config
from delfim.base import tables
from delfim.base.clock import Clock
from delfim.base.modes import Mode
from delfim.logging.liblog import event_line
from delfim.logging.openlog import open_log
from delfim.logging.statelog import Schema, StateWriter
from delfim.vehicle.console import Alive, Commands, Manual, TellState, Try, Watch
from delfim.vehicle.log import record
from delfim.vehicle.orders.entrusting import payload_of
from delfim.vehicle.state import Ping, State

COMMAND_MAX: Final = 160  # characters of a command in the system log; all of it is in the sidecar
VESSELS_S: Final = 10.0  # between two lists of other vessels ...
VESSELS_MAX: Final = 20  # ... the nearest of them
UNSOUNDED: Final = math.nan, -1e9
ORDERLY: Final = ("operator", "shutdown", "payload")  # begin the reasons of changes of mode that were meant to be


class Logbook:
    """The vehicle's state log: a record a cycle. `say` is told of commands, modes and troubles, too, as a logger's `log` is."""

    def __init__(self, settings: config.Vehicle, clock: Clock, say: Callable[..., object] = lambda *words: None) -> None:
        self._record = record.of(settings)
        schema = Schema(
            [(f.name, f.code, f.unit, f.description) for f in self._record.fields],
            boat=settings.boat.name,
            started_ns=clock.time_ns(),
        )
        self._clock = clock
        self._log = open_log(settings.log, "state", ".state", settings.log.state_method, clock, header=schema.header)
        self._writer = StateWriter(self._log.put, schema)
        self.status, self.poll = self._log.status, self._log.poll
        self._noted, self._jumped_s, self._vessels_s, self._sounding, self._sounded = False, -1e9, -1e9, UNSOUNDED, 0
        self._say, self._manual = say, ""  # why the last manual command, or one of a payload program, was refused
        self.event("start", version=__version__, settings=tables.shown(settings))

    def write(self, state: State, now_s: float) -> None:
        self._writer.put(record.values(self._record, state, now_s))

    def event(self, event: str, **what: object) -> None:
        """Write an event into the sidecar."""
        self._log.note(event_line(self._clock, event, **what))

    def _note(self, what: dict[str, object]) -> None:
        """The same, a tenth of its cost."""
        times = {"t_ns": self._clock.time_ns(), "monotonic_s": self._clock.monotonic_s()}
        self._log.note(msgspec.json.encode(times | what) + b"\n")

    def command(
        self, command: Commands, refused: str | None, state: State, operator: str = "", written: bytes | None = None
    ) -> None:
        """Log a command of an operator and its outcome; `written`: its JSON, where it exists already. Queries and signs of life
        are not kept."""
        if not isinstance(command, Alive | TellState | Watch):
            value = msgspec.json.encode(command) if written is None else written
            what: dict[str, object] = {
                "event": "command",
                "at_s": state.ordered_s,
                "value": msgspec.Raw(value),
                "refused": refused or "",
            }
            what["operator"] = operator
            self._note(what)
            level = logging.INFO
            if isinstance(command, Manual | Try) or payload_of(operator):  # several a second: only when the answer changes
                level = logging.INFO if refused and refused != self._manual else logging.DEBUG
                self._manual = refused or ""
            outcome = f"refused: {refused}" if refused else "done"
            self._say(level, "vehicle: command of %s: %s: %s", operator, value[:COMMAND_MAX].decode(errors="replace"), outcome)

    def note(self, text: str) -> None:
        """An event of the loop, in words; "hold: fence ahead" is a change of mode with its reason."""
        self._noted = True
        mode, _, reason = text.partition(": ")
        if mode.upper() in Mode.__members__:
            self.event("mode", value=mode, reason=reason)
            is_orderly = reason.startswith(ORDERLY) or reason.endswith(" done")
            self._say(logging.INFO if is_orderly else logging.WARNING, "vehicle: mode %s", text)
        else:
            self.event("note", value=text)
            self._say(logging.INFO if text.endswith(": over") else logging.WARNING, "vehicle: %s", text)

    def watch(self, state: State) -> None:
        """Called after each check of the watchdog: logs its time when something was noted or a position refused since the one
        before, now and then where other vessels are, and each new ping."""
        if state.jumped_s != self._jumped_s:  # it made no record, and a replay cannot know when it was read
            self._noted, self._jumped_s = False, state.jumped_s
            self.event("watchdog", at_s=state.watchdog_s, jumping_s=state.jumping_s, jumped_s=state.jumped_s)
        elif self._noted:
            self._noted = False
            self.event("watchdog", at_s=state.watchdog_s)
        elif state.traffic.told and state.watchdog_s - self._vessels_s >= VESSELS_S:
            self._vessels_s = state.watchdog_s
            self._note({"event": "vessels", "value": state.traffic.told[:VESSELS_MAX]})
        self._note_soundings(state)

    def _note_soundings(self, state: State) -> None:
        """Note what was heard since the last look. Records repeat the depth: a chart needs each ping once."""
        new, self._sounded = min(max(state.sounded - self._sounded, 0), len(state.soundings)), state.sounded
        pings = list(state.soundings)[len(state.soundings) - new :]
        (depth_m, at_s), before = state.measured.get("depth_m", UNSOUNDED), self._sounding
        self._sounding = depth_m, at_s
        if self._sounding != before and (not state.soundings or at_s != state.soundings[-1].heard_s) and not new:
            pings.append(Ping(at_s, depth_m, ""))  # of a laboratory's sensor
        for ping in pings:
            heard_s, depth_m, source, *more = ping
            told = zip(("source", "offset_m", "confidence", "number"), (source or None, *more), strict=True)
            known = {name: value for name, value in told if value is not None}
            self._note({"event": "sounding", "measured_s": heard_s, "depth_m": depth_m} | known)

    def reason(self) -> str:
        status = self._log.status()
        return self._writer.reason if status.writable else status.reason

    def close(self) -> None:
        self.event("end")
        self._log.close()
