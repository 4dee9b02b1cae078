"""Replay of a day at sea: the recorded frames and commands go through the real loop, at the recorded times. Its commands to the
motors are compared bit by bit with those of the day: on buses by the black box, by lines and pulses by the state log.

The logs hold all inputs of a cycle: frames in the black box; the times of each cycle, of the watchdog's last check and of
the last words of console and guest in the state log; commands and settings in its sidecar. A run is repeated from its start,
because the loop remembers: integrators, ramps, the driven track. The order of inputs within a few microseconds is not recorded.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.frames import Frame
from delfim.base.parts import OWN_NODES
from delfim.canproxy.dsor.messages import (
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
)
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.logging.ashore import tree
from delfim.logging.ashore.summary import utc
from delfim.logging.ashore.table import table
from delfim.logging.ashore.tree import ALWAYS, LogFile, Span
from delfim.logging.blackbox import device
from delfim.logging.linelog import line_id
from delfim.logging.reading import MOMENT_MAX_S
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.replay.comparing import STAMP_NS, Difference, Findings, MotorBus, has_bus
from delfim.simulator.replay.recorded import (
    NEVER_S,
    BusInput,
    Contact,
    Due,
    GuestReference,
    commands,
    cycles,
    first_ns,
    heard,
    looks,
    words_of,
)
from delfim.vehicle import console
from delfim.vehicle.build import build
from delfim.vehicle.failsafe.checks import STARTING
from delfim.vehicle.grex import Guest
from delfim.vehicle.links import Links
from delfim.vehicle.loop import LOCAL, REPEAT_S
from delfim.vehicle.state import NoLog, StartConditions, State

COMMANDS: Final = (PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT)
LATER_NS: Final = 50_000_000  # the black box may stamp a frame this much later than the vehicle
SHOWN: Final = 10  # differences shown
WAITING: Final = 1000  # messages of a source since its last cycle, of which a part might never come to an end
REFUSALS: Final = ("navigation_jumps", "navigation_repeated", "navigation_malformed")  # counts
MOMENTS: Final = ("monotonic_s", "watchdog_s", "console_s", "guest_s")  # columns

Group = tuple[tuple[int, bytes], ...]  # the frames of one command of the propellers


class RerunResult(NamedTuple):
    cycles: int
    frames: int  # compared
    commands: int  # in the state log, compared
    differences: list[Difference]
    refusals: list[str]  # commands refused then and not now, or the reverse

    @property
    def exact(self) -> bool:
        return not self.differences and not self.refusals

    def text(self) -> str:
        compared = f"{self.frames} propulsion frames" if self.frames or not self.commands else ""
        logged = f"{self.commands} commands in the state log" if self.commands else ""
        lines = [f"{self.cycles} cycles repeated, {' and '.join(filter(None, (compared, logged)))} compared: "]
        lines[0] += "all the same, bit by bit" if self.exact else f"{len(self.differences)} commands differ"
        for each in self.differences[:SHOWN]:
            words = f"{each.told}: recorded {each.recorded}  repeated {each.repeated}"
            lines.append(f"  {_time(each.t_ns)}  cycle {each.cycle}  {words}")
        return "\n".join([*lines, *(f"  {words}" for words in self.refusals[:SHOWN])])


class Recalled:
    """The clock of the recorded run, read back."""

    def __init__(self) -> None:
        self.now_s, self.now_ns = 0.0, 0

    def monotonic_s(self) -> float:
        return self.now_s

    def time_ns(self) -> int:
        return self.now_ns


class DeafGuest(Guest):
    """A guest that is not listened to: its set points are in the state log, and the line that it speaks on is not heard
    again."""

    def hear(self, line: bytes) -> None:
        pass


class Rerun:
    """The loop, its inputs on in-memory buses and lines, and its output. Output within `span` is compared."""

    def __init__(
        self,
        settings: config.Vehicle,
        recorded: Iterable[BusInput],
        start: Mapping[str, Any],
        first_ns: Mapping[int, int],
        span: Span,
    ) -> None:
        """`start` is the event of the start, `first_ns` the stamp of the first message that was used, by source."""
        self.clock, self.log, self.state = Recalled(), NoLog(), State()
        self.clock.now_s, self.clock.now_ns = start["monotonic_s"], start["t_ns"]  # the first inputs' stamps count from here
        self._interface = device(settings.can.interface)
        self._buses, self._world = dict[str, LockstepBus](), dict[str, CanSocket]()  # by the names of their logs
        self._lines = dict[str, LockstepLine]()
        self._heard = self._bus(self._interface).socket("onlooker")
        self._heard.bind(*(CanAddress(arb) for arb in COMMANDS))
        self._found, self.refusals = Findings(span), list[str]()
        self._motors = dict[str, MotorBus]()  # by the names of their logs
        for driver in filter(has_bus, settings.drivers):
            name = device(settings.table(driver).interface)
            self._motors[name] = MotorBus(driver, settings, self._bus(name).socket("onlooker"), self._found)
        links = Links(self._open_bus, self._open_line)
        self.vehicle, self._reports, *_ = build(settings, self.clock, self.state, links, self.log, DeafGuest)
        self._names = [row.name for row in settings.thrusters]
        self._size = 2 * len(settings.driven("nodes"))  # frames of one command
        before_ns = round(0.4e9 / settings.navigation.rate_hz)  # earlier messages came before it listened
        self._heard_ns = [(each, first_ns.get(i, 0) - before_ns) for i, each in enumerate(self.vehicle.sources)]
        self._inputs = deque[BusInput]()
        self.recorded = deque[tuple[int, Group]]()
        self._split(recorded)

    def _bus(self, name: str) -> LockstepBus:
        if name not in self._buses:
            bus = self._buses[name] = LockstepBus(self.clock, name)
            self._world[name] = bus.socket("nodes")
        return self._buses[name]

    def _open_bus(self, interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        return self._bus(device(interface)).bound(*filters)

    def _open_line(self, name: str, baud: int, form: Form = "8N1") -> LockstepLine:
        return self._lines.setdefault(line_id(name), LockstepLine(self.clock))

    def _split(self, recorded: Iterable[BusInput]) -> None:
        """Sort the vehicle's frames into groups; all others are its input."""
        group: list[tuple[int, bytes]] = []
        for each in recorded:
            frame = each.what
            if isinstance(frame, Frame) and each.name in self._motors and self._motors[each.name].keep(frame):
                continue
            if isinstance(frame, bytes) or each.name != self._interface or frame.arb not in COMMANDS:
                self._inputs.append(each)
                continue
            if not group or frame.data[-1:] != group[-1][1][-1:]:  # the counter
                group = []
                self.recorded.append((frame.t_ns, ()))
            group.append((frame.arb, frame.data))
            self.recorded[-1] = self.recorded[-1][0], tuple(group)

    def cut(self, last_ns: int) -> None:
        """Note that the power failed after this last logged cycle: frames that only one log still has are not compared."""
        whole_ns = [t_ns for t_ns, group in self.recorded if len(group) == self._size]
        ends_ns, span = [motors.last_ns for motors in self._motors.values()], self._found.span
        self._found.span = span._replace(to_ns=min(span.to_ns, last_ns, *whole_ns[-1:], *ends_ns))

    def feed(self, until_ns: int) -> None:
        """Feed the frames that had arrived by then."""
        while self._inputs and self._inputs[0].t_ns <= until_ns:
            self._deliver(self._inputs.popleft())

    def _deliver(self, heard: BusInput) -> None:
        name, t_ns, what = heard
        self.clock.now_s += (t_ns - self.clock.now_ns) / 1e9
        self.clock.now_ns = t_ns
        if isinstance(what, bytes):
            if name in self._lines:
                self._lines[name].put(what)
        elif name in self._world and not what.error:
            self._world[name].sendto(what.data, CanAddress(what.arb))
        for each in self._reports:
            self.vehicle.on_sensor(each)
        for source, heard_ns in self._heard_ns:
            if t_ns < heard_ns:
                source.read(self.clock.now_s)
                source.heard_s = NEVER_S

    def step(self, due: Due) -> None:
        """Replay one event, after the vehicle's earlier frames whose cause was not recorded."""
        while self.recorded and self.recorded[0][0] < due.t_ns:
            self._unexplained()
        for motors in self._motors.values():
            motors.hear(due.t_ns - STAMP_NS)
        self.feed(due.t_ns)
        self._at(due.t_ns, due.at_s)
        if due.kind == "navigation":
            self._navigate(due)
        elif due.kind == "command":
            self._command(due)
        elif due.kind == "watchdog" or due.at_s - self.state.navigation_s <= REPEAT_S:  # beyond, it sends, which is recorded
            if due.kind == "watchdog" and due.what and "jumped_s" in due.what:
                self._refuse(due.what["jumping_s"], due.what["jumped_s"])
            self.vehicle.on_watchdog()
        self._compare(due.t_ns)
        sent = self.state.actuation
        for row, what, then in due.sent:
            now = (sent.thrust if what == "command" else sent.angle_rad)[row]
            self._found.logged(due.t_ns, f"{self._names[row]} {what}", then, now)

    def _at(self, t_ns: int, at_s: float) -> None:
        self.clock.now_ns, self.clock.now_s = t_ns, at_s

    def _unexplained(self) -> None:
        """Replay a propulsion command outside a cycle: a check of the watchdog in idle, or the end. It looked before its frames
        were stamped; when, is known only of a look that noted something, and that is no look that notes nothing later."""
        t_ns, group = self.recorded[0]
        self.feed(t_ns)
        at_s = self.clock.now_s + (t_ns - self.clock.now_ns) / 1e9
        sends_s = self.state.navigation_s + REPEAT_S + 1e-6  # before, it would send nothing
        self._at(t_ns, min(at_s, max(at_s - LATER_NS / 1e9, self.clock.now_s, sends_s)))
        self.vehicle.on_watchdog()
        self._at(t_ns, at_s)
        if not self._compare(t_ns):
            self.recorded.popleft()
            self._judge(t_ns, group, ())

    def _refuse(self, jumping_s: float, jumped_s: float) -> None:
        """Set the positions that were refused since the last look of the watchdog; they made no record."""
        self.state.jumping_s, self.state.jumped_s = jumping_s, jumped_s
        for source in self.vehicle.sources:
            for _ in range(WAITING):
                if source.read(jumped_s) is None:
                    break

    def _navigate(self, due: Due) -> None:
        """Replay the cycle of a record. The black box may have stamped its last frame after the vehicle read it."""
        self._ask(due.what)
        refused, waiting, until_ns = self._refused(), WAITING, max(due.t_ns + LATER_NS, due.heard_ns)
        while not any(self.vehicle.on_navigation(source) for source in self.vehicle.sources[due.source :]):
            if waiting and (again := self._refused()) != refused:  # the message of the record comes after it
                refused, waiting = again, waiting - 1
                continue
            if not self._inputs or self._inputs[0].t_ns > until_ns:
                break
            self._deliver(self._inputs.popleft())
            self._at(due.t_ns, due.at_s)

    def _refused(self) -> int:
        """The number of navigation messages that were read, and made no cycle."""
        return sum(self.state.counts.get(name, 0) for name in REFUSALS)

    def hear(self, word: Contact) -> None:
        """Replay a message of the console, the guest, or a payload program."""
        if name := word.key.removeprefix("payload_") if word.key.startswith("payload_") else "":
            self.state.payloads_s[name.removesuffix("_s")] = word.at_s
        else:
            setattr(self.state, word.key, word.at_s)
        if word.asked:
            self._ask(word.asked)

    def _ask(self, asked: GuestReference) -> None:
        """Set the guest's set point; NaN: it has none."""
        heading = None if asked.heading_rad != asked.heading_rad else asked.heading_rad
        self.state.setpoint = self.state.setpoint._replace(guest_heading_rad=heading, guest_speed_mps=asked.speed_mps)

    def _command(self, due: Due) -> None:
        event = due.what
        self.log.why = event["refused"]
        self.state.computer = StartConditions(is_starting=event["refused"].endswith(STARTING))
        command = console.parse(msgspec.json.encode(event["value"]))
        refused = self.vehicle.on_command(command, event.get("operator", LOCAL)) or ""
        self.log.why = ""
        if bool(refused) != bool(event["refused"]) and self._found.span.has(due.t_ns):
            name = event["value"]["command"]
            then, now = (f"refused ({words})" if words else "obeyed" for words in (event["refused"], refused))
            self.refusals.append(f"{_time(due.t_ns)}  {name}: {then} then, {now} now")

    def _compare(self, t_ns: int) -> bool:
        """Compare the frames just sent with the recorded ones. False if none were sent to the propellers of DelfimX."""
        self._found.cycle = self.state.cycles
        for motors in self._motors.values():
            motors.make(t_ns)
        made = list[tuple[int, bytes]]()
        while (frame := self._heard.receive()) is not None:
            made.append((frame.arb, frame.data))
        groups = [tuple(made[i : i + self._size]) for i in range(0, len(made), self._size or 1)]
        for group in groups:
            then = self.recorded[0][1] if self.recorded else ()
            if self.recorded and not _ahead(then, group):
                self.recorded.popleft()
            else:
                then = ()
            self._judge(t_ns, then, group)
        return bool(groups)

    def _judge(self, t_ns: int, then: Group, now: Group) -> None:
        if self._found.span.has(t_ns):
            self._found.frames += len(then)
            if then != now:
                self._found.differ(t_ns, OWN_NODES, _words(then), _words(now))

    def finish(self, ended: bool) -> None:
        """Compare the frames after the last record; a program that ended in order sent a stop last."""
        while len(self.recorded) > ended:
            self._unexplained()
        if self.recorded:
            self._at(self.recorded[0][0], self.clock.now_s)
        if self.recorded or (ended and self._motors):
            self.vehicle.helm.stop("shutdown")
            self._compare(self.clock.now_ns)
        for motors in self._motors.values():
            motors.finish()

    def result(self) -> RerunResult:
        found = self._found
        return RerunResult(self.state.cycles, found.frames, found.commands, found.differences, self.refusals)


def rerun(files: Sequence[LogFile], vehicle_file: str | None, span: Span = ALWAYS) -> RerunResult:
    """Replay a whole run and compare its output in this time. Raises DelfimError if the logs are incomplete or have nothing
    to compare."""
    state_files = [file for file in files if file.id == "state"]
    told = [event for event in tree.events(state_files) if "monotonic_s" in event]
    told = [event for event in told if "at_s" in event or event["event"] in ("start", "end")]
    starts = [event for event in told if event["event"] == "start"]
    if len(starts) != 1:
        raise DelfimError(f"a replay needs the logs of one run, with one start; these hold {len(starts)} starts")
    recorded = starts[0].get("settings", {})
    settings = config.load(vehicle_file) if vehicle_file else config.read(recorded, "the log")
    columns, _ = table(state_files)
    if not all(bool((abs(columns[name]) < MOMENT_MAX_S).all()) for name in MOMENTS):
        raise DelfimError("this state log is damaged: some of its times are not numbers")
    boxes = [file for file in files if file.suffix.startswith(".log")]
    needed = {device(settings.table(driver).interface) for driver in filter(has_bus, settings.drivers)}
    needed |= {device(settings.can.interface)} if OWN_NODES in (*settings.drivers, *settings.navigation.sources) else set()
    if missing := needed.difference(file.id for file in boxes):
        raise DelfimError(f"no black box of {', '.join(sorted(missing))} beside this state log")
    run = Rerun(settings, heard(boxes, files), starts[0], first_ns(columns), span)
    unheard = [(i, row.name) for i, row in enumerate(settings.thrusters) if row.driver != OWN_NODES and not has_bus(row.driver)]
    # By the monotonic clock: the wall clock of what is no cycle is reckoned from both, and a busy machine reads them apart.
    due = sorted([*cycles(columns, unheard), *commands(told), *looks(columns, told)], key=lambda each: each.at_s)
    ended = any(event["event"] == "end" for event in told)
    if not ended:
        run.cut(int(columns["t1"][-1]))
    spoken = deque(sorted(words_of(columns), key=lambda word: word.at_s))
    for each in due:
        while spoken and spoken[0].at_s <= each.at_s:
            run.hear(spoken.popleft())
        run.step(each)
    run.finish(ended)
    result = run.result()
    if not result.cycles and columns["cycle"].max() > 0:
        raise DelfimError("what the boat heard is not beside this state log: the black boxes of its lines and buses")
    if not (result.frames or result.commands or result.differences):
        raise DelfimError("the boat commanded nothing in this time")
    return result


def _ahead(then: Group, now: Group) -> bool:
    """Whether the recorded command is later than this one, so that the black box lacks one between."""
    return bool(then) and 0 < then[0][1][-1] - now[0][1][-1] & 0xFF < 0x80


def _words(group: Group) -> str:
    return " ".join(data.hex() for _, data in group) or "nothing"


def _time(t_ns: int) -> str:
    return f"{utc(t_ns)}.{t_ns // 1000 % 1_000_000:06}"
