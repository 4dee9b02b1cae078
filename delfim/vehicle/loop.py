"""The critical program. `VehicleLoop` is figure 3-8 of the thesis: five inputs, each with the actions it triggers.

    navigation readable -> read -> control -> propulsion -> guest -> log      (profiled t0..t5)
    sensor readable     -> its values into the state, among them the health of the other nodes
    console command     -> command -> control -> propulsion -> state back
    guest readable      -> set point, obeyed in GREX mode only
    watchdog due        -> failsafe -> stop, hold or home -> propulsion

Beside them the outlet of an actuator that wants to hear its command more often repeats it while it is young.

The handlers are plain functions: no await, no wait, no exception for bad input. They do not know whether an event loop or a
replay in lock step calls them; clock, sockets and log are handed in.
"""

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.base.modes import Mode
from delfim.vehicle import console, snapshot
from delfim.vehicle.aboard import PartWatch
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.failsafe import failsafe
from delfim.vehicle.failsafe.failing import Failing
from delfim.vehicle.failsafe.troubles import Inputs, PartTrigger
from delfim.vehicle.grex import Guest, told
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.links import LoopInput
from delfim.vehicle.log.latency import Latency
from delfim.vehicle.navigation.fixes import Fix, Source, take
from delfim.vehicle.orders import entrusting
from delfim.vehicle.orders.returning import RESTART, Returning
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.report import LocalReport
from delfim.vehicle.state import HANDSET, Profile, StartConditions, State, StateLog

REPEAT_S = 0.5  # a propeller without commands for PROPELLER_TIMEOUT_S stops itself, which would hide the cause
HELD_S = 0.8  # a command stands so long: it comes with navigation, or without it from the watchdog after REPEAT_S
COLD_CYCLES = 10  # after the start, left out of the figures: 2 s at 5 Hz
LOCAL = "local"  # the operator at the local command socket
HELD_BY_HAND = "the hand-set has the boat, until its take-over switch gives it back"


class VehicleLoop:
    """The boat's brain. One instance, one state, five handlers."""

    def __init__(
        self,
        settings: config.Vehicle,
        clock: Clock,
        state: State,
        sources: tuple[Source, ...],
        propulsion: Propulsion,
        guest: Guest,
        log: StateLog,
        watches: tuple[PartWatch, ...] = (),  # of the parts aboard
        troubles: tuple[PartTrigger, ...] = (),
    ) -> None:
        self.clock, self.state, self.sources = clock, state, sources
        self.propulsion, self.guest, self.log = propulsion, guest, log
        self.helm, self._watches = Helm(settings, clock, state, propulsion, log, troubles), watches
        self._failing = Failing(settings, state, propulsion, log)
        self.returning = Returning(settings, self.helm, state)
        self.latency = Latency(skipped=COLD_CYCLES)
        self.judged_in = state.mode  # in which the failsafe looked for troubles last, for those who look on
        guest.on_line, state.actuation, state.started_s = self.on_guest, propulsion.still, clock.monotonic_s()

    # The five inputs.

    def on_navigation(self, source: Source) -> bool:
        """Navigation readable: the critical path. True when a navigation message was complete."""
        time_ns, state = self.clock.time_ns, self.state
        t1 = time_ns()
        now_s = self.clock.monotonic_s()
        fix = source.read(now_s)
        if fix is None or not self.take(source, fix):
            return False
        t2 = time_ns()
        wanted = self.helm.control(now_s)
        t3 = time_ns()
        state.actuation = self.propulsion.send(wanted, now_s)
        t4 = time_ns()
        self.guest.send()
        self._after(now_s)
        state.profile = tuple.__new__(Profile, (fix.t0_ns, t1, t2, t3, t4, state.profile.t5))  # in half the time
        self.log.write(state, now_s)
        state.profile = tuple.__new__(Profile, (fix.t0_ns, t1, t2, t3, t4, time_ns()))
        self.latency.add(state.profile)
        return True

    def on_sensor(self, sensor: LoopInput) -> None:
        """A sensor readable, or the reports of an actuator."""
        sensor.read(self.state, self.clock.monotonic_s())

    def on_command(self, command: console.Commands, operator: str = LOCAL) -> str | None:
        """A command of a console: carried out at once, propellers included. Returns why it was refused, or None. The last to
        command is the operator, whose silence is a trouble; while the hand-set is, others may only stop the boat."""
        now_s = self.state.ordered_s = self.clock.monotonic_s()
        state = self.state
        if isinstance(command, console.TellState | console.Watch):  # onlookers do not keep the boat sailing
            return None
        if name := entrusting.payload_of(operator):
            return entrusting.order(self.helm, name, command, now_s)
        if isinstance(command, console.Alive) and state.operator not in ("", operator):  # nor do other consoles
            return None
        state.console_s = now_s
        if operator == RESTART or isinstance(command, console.Return):
            return self.returning.obey(command, operator, now_s)
        is_below = state.operator == HANDSET != operator
        if is_below and not isinstance(command, console.Halts):
            return f"refused: {HELD_BY_HAND}"
        try:
            entrusting.obey(self.helm, command, now_s)
        except DelfimError as refusal:
            return str(refusal)
        if not isinstance(command, console.Alive):
            if not is_below and not isinstance(command, console.Kill):
                state.operator = "" if isinstance(command, console.Leave) else operator
            self.returning.overruled(command)
            self.helm.steer(now_s)
        return None

    def on_guest(self, line: bytes) -> None:
        """A line of the guest computer: its set point, obeyed in GREX mode only, or a vessel that it sees."""
        is_lookout = "guest" in self.helm.settings.traffic.hears
        if (setpoint := told(line, self.state, is_lookout, self.clock.monotonic_s())) is not None:
            self.state.guest_s, self.state.setpoint = self.clock.monotonic_s(), setpoint

    def on_namesakes(self, words: str) -> None:
        """Two consoles with one number, in words; empty: there are none."""
        self.state.namesakes = words

    def on_watchdog(self, computer: StartConditions | None = None) -> None:
        """Due ten times a second: detect troubles and act on them. `computer`: its present state."""
        state = self.state
        state.computer, state.guest_connected = computer or state.computer, self.guest.is_connected
        now_s = state.watchdog_s = self.clock.monotonic_s()
        helm = self.helm
        helm.go_on()
        self.returning.look(now_s)
        for watch in self._watches:
            watch.look(helm, now_s)
        self.judged_in = state.mode
        inputs = Inputs(self.log.reason(), helm.plans.fence, self._failing.look(now_s))
        helm.troubles, action, reason, notices = failsafe.failsafe(helm.rules, helm.troubles, state, inputs, now_s)
        if notices != state.notices:
            for text in failsafe.news(state.notices, notices):
                self.log.note(text)
            state.notices = notices
        if action > failsafe.Action.WARN:
            helm.fall_back(action, reason, now_s)
        helm.fade(now_s)
        if now_s - state.navigation_s > REPEAT_S:
            sends = self.propulsion  # no navigation cycle repeats the command
            is_off = state.mode is Mode.IDLE and not state.setpoint.alone
            state.actuation = sends.send(STOP, now_s) if is_off else sends.again(now_s)

    def on_outlet(self, actuator: Actuator) -> None:
        """Due every `period_s` of an actuator: its command again; one that is older than HELD_S becomes a stop of all."""
        now_s = self.clock.monotonic_s()
        if now_s - self.propulsion.sent_s > HELD_S:
            self.state.actuation = self.propulsion.send(STOP, now_s)
        self.propulsion.repeat(actuator, now_s)

    # The work of the handlers.

    def take(self, source: Source, fix: Fix) -> bool:
        """A fix into the state; False when it is not used."""
        state, plane = self.state, self.state.origin
        taken = take(source, fix, self.sources, state, self.helm.settings.navigation)
        if plane is None and state.origin is not None:
            self.helm.plans.found(state.origin)
        return taken

    def _after(self, now_s: float) -> None:
        """The rest of a cycle, once the propellers have their command."""
        state = self.state
        if "position" in state.motion.has:
            self.helm.track.add(state.motion.north_m, state.motion.east_m)
        if state.reference.done:
            self.helm.finish()

    def report(self, **more: object) -> LocalReport:
        """The boat's report; `more`: the fields that its program alone knows."""
        now_s, paused = self.clock.monotonic_s(), self.helm.paused
        more |= {"checks": tuple(self.helm.checks()), "latency": self.latency.facts(), "sails_by": self.helm.sails_by}
        more["paused"] = paused.mode.name.lower() if paused else None
        for watch in self._watches:
            more |= watch.report(now_s)
        return snapshot.report(self.state, now_s, self.helm.settings.thrusters, **more)

    def follow(self, other: "VehicleLoop") -> None:
        """Copy another vehicle's mode, set points and memory, and compute with its own tables, which are immutable."""
        state, its = self.state, other.state
        state.mode, state.setpoint, state.origin = its.mode, its.setpoint, its.origin
        self.helm.memory, self.helm.limits = other.helm.memory, other.helm.limits
        self.propulsion.follow(other.propulsion)
