"""Lock-step simulation: the real loop, control, orders and state log, a modelled world, and a clock that jumps.

Nothing waits and nothing runs beside: navigation is due, the nodes speak, the handlers are called, the clock is advanced. The
same seed gives the same bytes. It leaves out event loop, sockets and processes, which exist only in real time.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple, Protocol, Self, runtime_checkable

import msgspec

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.base.pulses import STATES, PulseAnswer, pack_answer, socket_path, unpack_head
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.simulator.faults import Breakage, Faults, FaultyLog
from delfim.simulator.handset import HandsetAt, SimulatedReceiver
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.model import Model
from delfim.simulator.nodes import nodes_of
from delfim.simulator.nodes.navigation import MESSAGES
from delfim.simulator.nodes.talkers import port_devices
from delfim.vehicle import console
from delfim.vehicle.build import build
from delfim.vehicle.links import Links
from delfim.vehicle.orders import voyage
from delfim.vehicle.orders.entrusting import PAYLOAD, payload_of
from delfim.vehicle.orders.returning import RESTART
from delfim.vehicle.state import State, StateLog

CONSOLE_S: Final = 1.0  # the operator's console speaks this often
WATCHDOG_S: Final = 0.1
STAYS: Final = frozenset({Mode.IDLE, Mode.MANUAL, Mode.HOLD})  # who comes near then does so by itself, or the operator does
BURST: Final = 16  # times that an input which stays readable is read again: navigation after a delay, a bus with much to say


@runtime_checkable
class OrderLog(Protocol):
    """A log that keeps orders, as the Logbook does."""

    def command(self, command: console.Commands, refused: str | None, state: State, operator: str) -> None: ...
    def watch(self, state: State) -> None: ...


class Ordered(NamedTuple):
    """An order that the operator gave."""

    mode: Mode  # in which the boat was when it came
    name: str
    refused: str  # why, in words; empty: it was obeyed


@contextmanager
def uncollected() -> Iterator[None]:
    """Look for no garbage meanwhile, as the boat does not in its loop: a cycle leaves none, and looking costs a twelfth."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class Lockstep:
    """A boat and its world, stepped by navigation cycles. `log` is made for the clock of the simulation, as the loop's is.
    Without a `model` the vehicle's file describes it. Without rows for its hand-set the boat has none."""

    def __init__(
        self,
        settings: config.Vehicle,
        seed: int,
        make_log: Callable[[ManualClock], StateLog],
        model: Model | None = None,
        handset: tuple[HandsetAt, ...] = (),
    ) -> None:
        self.settings = settings
        self.clock = ManualClock()
        bus = self.bus = LockstepBus(self.clock)
        self.nodes = nodes_of(settings, seed, model)
        buses = self.buses = {settings.can.interface: bus}  # by the interfaces of the vehicle's file
        for each in self.nodes.beside:
            buses.setdefault(each.interface, LockstepBus(self.clock, each.interface))
        self._beside = [(each, buses[each.interface].end("devices", *each.hears)) for each in self.nodes.beside]
        self._world = bus.end("nodes", *self.nodes.hears)
        self.faults = Faults(self.nodes, seed)
        self.log = make_log(self.clock)
        self._logbook = self.log if isinstance(self.log, OrderLog) else None
        self.lines = dict[str, LockstepLine]()  # by device
        self._aboard = settings if handset else msgspec.structs.replace(settings, handset=config.HandsetTable())
        if model is None:  # its motors are those of the file
            self._aboard = msgspec.structs.replace(self._aboard, adopted=config.AdoptedTable())
        self._opened = list[CanSocket]()
        self._start()
        self._ports = {name: self.lines[device] for name, device in port_devices(settings).items() if device in self.lines}
        line = self.lines.get(settings.handset.device)
        self._receiver = SimulatedReceiver(settings.handset, handset, line) if handset and line else None
        self._others = settings.driven("played", False)
        self._outlet = self.lines.get(f"unix:{socket_path(settings.runtime.run_directory)}")
        self.faults.is_outlet = self._outlet is not None
        self._cycle_s = 1.0 / settings.navigation.rate_hz
        self._watchdog_s = self._console_s = 0.0
        self._changes = -1  # of the bus, when it was looked at last
        self._told = b""  # of the voyage before the last restart
        self.ordered: Ordered | None = None  # the last one

    def _start(self) -> None:
        """Start the boat's program from its beginning."""
        self.state, self.started_s = State(), self.elapsed_s
        links = Links(self._bus, self._line)
        record_to = FaultyLog(self.log, self.faults)
        self.noted = record_to.noted
        self.vehicle, self._inputs, self._hands, _ = build(self._aboard, self.clock, self.state, links, record_to)
        queues = dict(item for each in self.buses.values() for item in each.queues.items())
        self._sources = [
            (each, queues[each.input] if isinstance(each.input, CanSocket) else None) for each in self.vehicle.sources
        ]
        self._queued = [(each, queues[each.input]) for each in self._inputs if isinstance(each.input, CanSocket)]
        self.guest = self.vehicle.guest

    def kept(self, boot: str = "a boot") -> bytes:
        """The voyage as the boat keeps it now: that of before, while it does not go on with it yet."""
        if self.vehicle.returning.is_pending:
            return self._told
        plan = voyage.plan_command(self.vehicle.helm)
        line = Sliced(console.written(plan)).finish() if plan is not None else b""
        return voyage.text(self._own(boot), self.vehicle.helm, self.state, line)

    def _own(self, boot: str) -> voyage.KeptHead:
        return voyage.KeptHead(self.settings.boat.name, "", boot, self.clock.time_ns(), self.clock.monotonic_s())

    def restart(self, off_s: float, kept: bytes | None = None, boot: str = "a boot") -> None:
        """Let the boat's program die, and start again after this time with the voyage that it had kept, or with this one.
        Another `boot`: the computer was off."""
        self._told = self.kept() if kept is None else kept
        for end in self._opened:
            end.close()
        self._opened.clear()
        for name in self.nodes.model.drives:
            self.nodes.model.push(name, 0.0, 0.0, False)
        until_s = self.elapsed_s + off_s
        while self.elapsed_s < until_s:
            self._drift()
        self._start()
        found = voyage.read(self._told, self.settings, self._own(boot))
        for command in (found.back, *found.sent):
            self.vehicle.on_command(command, RESTART)

    def _drift(self) -> None:
        """Let one navigation period pass without the boat's program."""
        now_s, nodes = self.elapsed_s, self.faults if self.faults.busy else self.nodes
        self._world.send_many(nodes.step(now_s, self.clock.time_ns()))
        for devices, end in self._beside:
            end.send_many(devices.step(now_s, self.clock.time_ns()))
        if self.nodes.instruments is not None:
            for _ in self.nodes.instruments.step(now_s, self.clock.time_ns()):
                pass  # they measure on, and nobody listens
        if self.nodes.surroundings is not None:
            self.nodes.surroundings.step(now_s)
        self._world.queue.clear()
        for _, end in self._beside:
            end.queue.clear()
        self.clock.advance(self._cycle_s)

    def _bus(self, name: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        self._opened.append(self.buses.get(name, self.bus).bound(*filters))
        return self._opened[-1]

    def _line(self, device: str, baud: int, form: Form = "8N1") -> LockstepLine:
        return self.lines.setdefault(device, LockstepLine(self.clock))

    def close(self) -> None:
        """End the log."""
        self.vehicle.helm.stop("end of the run")
        self.vehicle.log.close()

    @property
    def elapsed_s(self) -> float:
        return self.clock.monotonic_s()

    def command(self, command: console.Commands) -> str | None:
        """Give a command of the operator; returns why it was refused, or None."""
        return self.vehicle.on_command(command)

    def order(self, command: console.Commands, operator: str) -> str | None:
        """Give a command as `command` does, and log it, as the boat's listeners do with each."""
        mode = self.state.mode
        why = self.vehicle.on_command(command, operator) if payload_of(operator) else self.command(command)
        self.ordered = Ordered(mode, str(command.__struct_config__.tag), why or "")
        if isinstance(self.log, OrderLog):
            self.log.command(command, why, self.state, operator)
        return why

    def breaks(self, broken: Breakage) -> None:
        """Begin a fault now."""
        if broken.kind == "restarted":
            self.restart(broken.value)
            return
        if broken.kind == "clock_stepped":
            self.clock.step(broken.value)
        self.faults.begin(broken, self.elapsed_s)

    def guest_says(self, line: bytes) -> None:
        """Send a line of the guest computer, unless its link is lost."""
        if "guest_lost" not in self.faults.on:
            self.vehicle.on_guest(line)

    def cycle(self) -> None:
        """Run one navigation period: the nodes send, the loop runs, time passes."""
        clock, world, vehicle, faults = self.clock, self._world, self.vehicle, self.faults
        now_s, utc_ns = clock.monotonic_s(), clock.time_ns()
        nodes = faults if faults.busy else self.nodes
        if self.bus.changes != self._changes:  # on a boat with other navigation nobody takes its messages: none are made
            self._changes, self.nodes.navigation.is_heard = self.bus.changes, self.bus.takes(MESSAGES)
        frames = nodes.step(now_s, utc_ns)
        self.bus.off = "bus_off" in faults.on
        world.send_many(frames)
        for devices, end in self._beside:
            if said := devices.step(now_s, utc_ns):
                end.send_many(said)
        if self.nodes.instruments is not None:
            for port, data in self.nodes.instruments.step(now_s, utc_ns):
                self._ports[port].put(data)
        if self.nodes.surroundings is not None:
            for program, sight in self.nodes.surroundings.step(now_s, counts=self.state.mode not in STAYS):
                self._see(program, sight)
        for source in vehicle.sources:
            vehicle.on_navigation(source)
        if nodes is faults:
            self._navigate_again()
        if self._receiver is not None:
            self._receiver.speak(now_s)
        for each in self._inputs:
            vehicle.on_sensor(each)
        for each, queue in self._queued:
            for _ in range(BURST):
                if not queue:
                    break
                vehicle.on_sensor(each)
        for hand in self._hands:
            for order in hand.orders(self.state, now_s):
                vehicle.on_command(order, hand.name)
        if now_s >= self._console_s and "console_lost" not in faults.on:
            self._console_s = now_s + CONSOLE_S
            vehicle.on_command(_ALIVE)
        if now_s >= self._watchdog_s:
            self._watchdog_s = now_s + WATCHDOG_S
            vehicle.on_watchdog()
            if self._logbook is not None:
                self._logbook.watch(self.state)
        for actuator in vehicle.propulsion.actuators:
            if actuator.period_s:
                vehicle.on_outlet(actuator)
        while world.queue:
            nodes.feed(world.queue.popleft(), now_s)
        for devices, end in self._beside:
            while end.queue:
                devices.feed(end.queue.popleft(), now_s)
        sent = self.state.actuation
        if self._outlet is not None and "outlet_silent" not in faults.on:
            self._answer(self._outlet)
        for i, row in self._others:  # told by pulses, or by a front seat: their devices are played in tests
            if "outlet_silent" not in faults.on or not self.settings.drives(row).outlet:
                self.nodes.model.push(row.name, sent.thrust[i], sent.angle_rad[i], sent.run)
        clock.advance(self._cycle_s)

    def _see(self, program: str, sight: console.Sight) -> None:
        """Tell the boat what a look-out sees, as the program that reads it does."""
        if "guest_lost" in self.faults.on:
            return
        why = self.vehicle.on_command(sight, f"{PAYLOAD}{program}")
        if self._logbook is not None:
            self._logbook.command(sight, why, self.state, f"{PAYLOAD}{program}")

    def _answer(self, outlet: LockstepLine) -> None:
        """Answer as the outlet does, which holds the last pulses while it is silent."""
        while outlet.written:
            counter, run = unpack_head(outlet.written.popleft())
            outlet.put(pack_answer(PulseAnswer(counter, STATES[2 * run], "")))

    def _navigate_again(self) -> None:
        """Deliver more messages of navigation: of late messages some come at once. Nobody knows whether a line has more."""
        for _ in range(BURST - 1):
            left = [source for source, queue in self._sources if queue is None or queue]
            if not left:
                return
            for source in left:
                self.vehicle.on_navigation(source)

    def cycles(self, seconds: float) -> Iterator[State]:
        """Run cycles for this many seconds; yields the state after each."""
        until_s = self.elapsed_s + seconds
        while self.elapsed_s < until_s:
            self.cycle()
            yield self.state

    @uncollected()
    def sail(self, mission: str, limit_s: float, look: Callable[[Self], object] = lambda run: None) -> str:
        """Load a mission's text, play it as soon as the boat is fit, and sail until it ends. Returns how it ended, in words.
        `look` is called after each cycle."""
        reason = self.order(console.LoadMission(mission), "simulation")
        if reason is not None:
            return f"stopped: {reason}"
        waits: str | None = "not played yet"
        for state in self.cycles(limit_s):
            look(self)
            if waits is not None:
                waits = self.order(console.Play(), "simulation")
            elif state.reason.startswith("play done"):
                return f"mission done in {self.elapsed_s:.0f} s"
            elif state.mode is Mode.IDLE:
                return f"stopped: {state.reason}"
        return f"time: {limit_s:.0f} s sailed, mode {self.state.mode.name.lower()}{f'; {waits}' if waits else ''}"


_ALIVE: Final = console.Alive()
