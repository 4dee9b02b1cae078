"""The critical program. `Vehicle` is figure 3-8 of the thesis: five inputs, each with the list of what it sets off.

    navigation readable -> read -> control -> propulsion -> guest -> log      (profiled t0..t5)
    sysstat readable    -> update the health of the other nodes
    console command     -> command -> control -> propulsion -> state back
    guest readable      -> set point, obeyed in GREX mode only
    watchdog due        -> failsafe -> stop, hold or home -> propulsion

The handlers are plain functions: no await, no wait, no exception for bad input. Who calls them, an event loop or a replay
in lock step, is not their business; clock, sockets and log are handed in.
"""

import math
from typing import Protocol

from delfim import config, geodesy
from delfim.canproxy.socket import CanSocket
from delfim.clock import Clock
from delfim.errors import DelfimError, Refused
from delfim.vehicle import console, failsafe, fence, sysstat
from delfim.vehicle.checks import Check, checks, refusal
from delfim.vehicle.control.control import Settings, admit, control, enter
from delfim.vehicle.failsafe import Action, Inputs
from delfim.vehicle.grex import Guest
from delfim.vehicle.latency import Latency
from delfim.vehicle.mission import parse_mission, plan
from delfim.vehicle.navcan import Fix, Source, preferred
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Mode, Motion, Profile, Reference, Setpoint, State, Waypoint, mode_named
from delfim.vehicle.track import Track

REPEAT_S = 0.5  # a propeller that heard nothing for PROPELLER_TIMEOUT_S stops itself, and that would hide the cause
PUSHED_S = 1.0  # manual commands that come faster are one push


class StateLog(Protocol):
    """Where a cycle's record goes."""

    def write(self, state: State, now_s: float) -> None: ...
    def note(self, text: str) -> None: ...  # an event, in words
    def reason(self) -> str: ...  # why nothing is being written, in words; empty while all is well
    def close(self) -> None: ...


class Vehicle:
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
    ) -> None:
        self.settings, self.clock, self.state = settings, clock, state
        self.sources, self.propulsion, self.guest, self.log = sources, propulsion, guest, log
        self.latency = Latency()
        self._limits = Settings(settings.control, settings.propulsion)
        self._memory = enter(Mode.IDLE, state.motion, state.setpoint, self._limits)
        self._track = Track(settings.control.home)
        self._rules, self._troubles = failsafe.Rules(settings), failsafe.NO_TROUBLE
        self._zones = config.Zones()  # the mission's
        self.fence = fence.survey(settings.fence, self._zones, state.origin)  # the boat's and the mission's; None: none
        self._taken = False  # the failsafe changed the mode; a joystick that is still pushed does not take it back
        self._segmented = sysstat.receiver()
        self._controlled_s = clock.monotonic_s()

    # The five inputs.

    def on_navigation(self, source: Source) -> bool:
        """Navigation readable: the critical path. True when a navigation message was complete."""
        time_ns, state = self.clock.time_ns, self.state
        t1 = time_ns()
        now_s = self.clock.monotonic_s()
        fix = source.read(now_s)
        if fix is None or not self._take(source, fix):
            return False
        t2 = time_ns()
        wanted = self._control(now_s)
        t3 = time_ns()
        state.actuation = self.propulsion.send(wanted, now_s)
        t4 = time_ns()
        self.guest.send()
        self._after(now_s)
        state.profile = Profile(fix.t0_ns, t1, t2, t3, t4, state.profile.t5)
        self.log.write(state, now_s)
        state.profile = Profile(fix.t0_ns, t1, t2, t3, t4, time_ns())
        self.latency.add(state.profile)
        return True

    def on_sysstat(self, socket: CanSocket) -> None:
        """A status socket readable."""
        sysstat.read(socket, self._segmented, self.state, self.clock.monotonic_s())

    def on_command(self, command: console.Commands) -> str | None:
        """A command of the console: carried out at once, propellers included. Returns why it was refused, or None."""
        now_s = self.clock.monotonic_s()
        if isinstance(command, console.Report | console.Watch):  # onlookers do not keep the boat sailing
            return None
        self.state.console_s = now_s
        try:
            self._obey(command, now_s)
        except DelfimError as refusal:
            return str(refusal)
        if not isinstance(command, console.Alive):
            self.state.actuation = self.propulsion.send(self._control(now_s), now_s)
        return None

    def on_guest(self, line: bytes) -> None:
        """A line of the guest computer."""
        self.guest.reference(line)

    def on_watchdog(self) -> None:
        """Due ten times a second: what has gone wrong, and what is done about it."""
        state = self.state
        now_s = state.watchdog_s = self.clock.monotonic_s()
        inputs = Inputs(self.log.reason(), self.fence)
        self._troubles, action, reason, notices = failsafe.failsafe(self._rules, self._troubles, state, inputs, now_s)
        if notices or state.notices:
            for text in failsafe.news(state.notices, notices):
                self.log.note(text)
            state.notices = notices
        if action > Action.WARN:
            self._fall_back(action, reason, now_s)
        if now_s - state.navigation_s > REPEAT_S:
            again = STOP if state.mode is Mode.IDLE else state.actuation  # no navigation cycle says it
            state.actuation = self.propulsion.send(again, now_s)

    # What they do.

    def stop(self, reason: str) -> None:
        """Idle and propellers off, now. The reason is shown and logged."""
        self._enter(Mode.IDLE, reason)
        self.state.actuation = self.propulsion.send(STOP, self.clock.monotonic_s())

    def follow(self, other: "Vehicle") -> None:
        """Be in the mode that another vehicle is in, with its set points and its memory."""
        self.state.mode, self.state.setpoint, self._memory = other.state.mode, other.state.setpoint, other._memory
        self.state.origin = other.state.origin

    def snapshot(self, extra: dict[str, object]) -> dict[str, object]:
        """The state for the console, JSON-ready."""
        lines = [line._asdict() for line in self.checks()]
        more = {"checks": lines, "latency": self.latency.summary(), **extra}
        return console.snapshot(self.state, self.clock.monotonic_s(), more)

    def checks(self) -> list[Check]:
        """What is in order before the start and what is not, a line each."""
        inputs = Inputs(self.log.reason(), self.fence)
        return checks(self._rules, self.state, inputs, self.clock.monotonic_s(), self.clock.time_ns())

    def _fall_back(self, action: Action, reason: str, now_s: float) -> None:
        """Do what the failsafe asks, or the next safer thing that can be done."""
        state = self.state
        if action is Action.DISCONNECT:
            self.propulsion.disconnect(failsafe.unfollowed(self._rules.table.thruster, state, now_s))
            return
        setpoint = state.setpoint._replace(track=self._track.points())
        mode, reason = failsafe.fallback(action, reason, state.motion.has, setpoint)
        if mode is not state.mode:
            state.setpoint, self._taken = setpoint, True
            self._enter(mode, reason)
            state.actuation = self.propulsion.send(self._control(now_s), now_s)

    def _take(self, source: Source, fix: Fix) -> bool:
        """A fix into the state; False when it is not used: a better source speaks, or no boat moves that fast."""
        state, limits = self.state, self.settings.navigation
        if not preferred(source, self.sources, fix.received_s, limits.stale_s):
            return False
        n, last = fix.navigation, state.navigation
        if last is not None and n.counter == last.counter and n.utc_ns == last.utc_ns and state.source == source.name:
            state.count("navigation_repeated")
            source.heard_s = state.navigation_s  # what says the same again is silent: the next source may speak
            return False
        if n.latitude_rad is not None and n.longitude_rad is not None:
            if not (abs(n.latitude_rad) < math.pi / 2 and abs(n.longitude_rad) <= math.tau):  # nor what is no number
                state.count("navigation_malformed")
                return False
            if state.origin is None:
                state.origin = geodesy.origin(n.latitude_rad, n.longitude_rad)
                self.fence = fence.survey(self.settings.fence, self._zones, state.origin)
            north_m, east_m = geodesy.to_plane(state.origin, n.latitude_rad, n.longitude_rad)
            has = _POSITION
        else:
            north_m, east_m, has = state.motion.north_m, state.motion.east_m, 0
        if has and self._jumped(north_m, east_m, fix.received_s):
            return False
        moving, headed = n.north_mps is not None, n.heading_rad is not None
        state.motion = Motion(
            _HAS[has | (_HEADING if headed else 0) | (_VELOCITY if moving else 0)],
            north_m,
            east_m,
            n.heading_rad or 0.0,
            n.yaw_rate_radps or 0.0,
            n.north_mps or 0.0,
            n.east_mps or 0.0,
        )
        if last is None or n[_MEASURED] != last[_MEASURED]:
            state.changed_s = fix.received_s
        state.navigation, state.navigation_s, state.source = n, fix.received_s, source.name
        state.cycles += 1
        return True

    def _jumped(self, north_m: float, east_m: float, now_s: float) -> bool:
        """Whether the boat would have to move impossibly fast to be here. After a silence anything may be true."""
        state, limits = self.state, self.settings.navigation
        age_s = now_s - state.navigation_s
        if age_s > limits.stale_s or "position" not in state.motion.has:
            return False
        moved_m = math.hypot(north_m - state.motion.north_m, east_m - state.motion.east_m)
        if moved_m <= limits.jump_m + limits.jump_mps * age_s:
            return False
        state.count("navigation_jumps")
        if now_s - state.jumped_s > limits.stale_s:
            state.jumping_s = now_s
        state.jumped_s, state.jumped_m = now_s, moved_m
        return True

    def _control(self, now_s: float) -> Actuation:
        state = self.state
        dt_s = min(now_s - self._controlled_s, 1.0)
        self._controlled_s = now_s
        self._memory, state.reference, wanted = control(
            state.mode, self._memory, state.motion, state.setpoint, self._limits, dt_s
        )
        return wanted

    def _after(self, now_s: float) -> None:
        """What a cycle leaves to do once the propellers have their command."""
        state = self.state
        if "position" in state.motion.has:
            self._track.add(state.motion.north_m, state.motion.east_m)
        if state.reference.done:
            end = f"{state.mode.name.lower()} done"
            reason = admit(Mode.HOLD, state.motion.has, state.setpoint)
            self._enter(Mode.HOLD, end) if reason is None else self.stop(f"{end}, cannot hold: {reason}")

    def _enter(self, mode: Mode, reason: str) -> None:
        state = self.state
        if mode is Mode.IDLE and state.mode is Mode.IDLE and state.reason == reason:
            return
        self._memory = enter(mode, state.motion, state.setpoint, self._limits)
        if mode is Mode.HOLD and self.fence is not None:
            here, radius_m = (self._memory.north_m, self._memory.east_m), self.settings.control.hold.radius_m
            north_m, east_m = fence.place_to_hold(self.fence, here, self._track.points(), radius_m)
            self._memory = self._memory._replace(north_m=north_m, east_m=east_m)
        if mode is not state.mode:
            state.mode_s = self.clock.monotonic_s()
        state.mode, state.reason, state.reference = mode, reason, Reference()
        self.log.note(f"{mode.name.lower()}: {reason}")

    def _request(self, mode: Mode, setpoint: Setpoint, now_s: float) -> None:
        """The one door: the operator asks for a mode with its set points. Raises Refused; nothing has changed then."""
        state = self.state
        if mode is Mode.HOME:
            setpoint = setpoint._replace(track=self._track.points())
        if mode is not Mode.IDLE:
            reason = refusal(self._rules, mode, self.checks()) or admit(mode, state.motion.has, setpoint)
            if reason is None and mode is Mode.GREX and now_s - state.guest_s > self.settings.failsafe.guest_silent.after_s:
                reason = "no reference from the guest"
            if reason is None and self.fence is not None:
                reason = fence.crossing(self.fence, mode, state.motion, setpoint)
            if reason is not None:
                raise Refused(f"{mode.name.lower()} refused: {reason}")
        state.setpoint = setpoint
        self._troubles, self._taken = failsafe.overruled(self._troubles), False
        self._enter(mode, "operator")

    def _obey(self, command: console.Commands, now_s: float) -> None:
        setpoint = self.state.setpoint
        match command:
            case console.Stop() | console.Shutdown():  # what else a shutdown is, is not the vehicle's
                self._taken = False
                self.stop("operator")
            case console.Mode(mode):
                wanted = mode_named(mode)
                if wanted is Mode.MANUAL:  # without thrust, until told
                    self.state.manual_s, setpoint = now_s, setpoint._replace(starboard=0.0, port=0.0)
                self._request(wanted, setpoint, now_s)
            case console.Manual(starboard, port):
                pushed, self.state.manual_s = now_s - self.state.manual_s < PUSHED_S, now_s
                if self._taken and pushed:
                    raise Refused(f"manual refused: {self.state.reason}; let go for {PUSHED_S:g} s or ask for a mode")
                self.state.setpoint = setpoint = setpoint._replace(starboard=starboard, port=port)
                if self.state.mode is not Mode.MANUAL:
                    self._request(Mode.MANUAL, setpoint, now_s)
            case console.Heading(heading_deg, speed_mps):
                asked = setpoint._replace(heading_rad=math.radians(heading_deg % 360.0), speed_mps=self._speed(speed_mps))
                self._request(Mode.HEADING, asked, now_s)
            case console.SetSpeed(speed_mps):
                self.state.setpoint = setpoint._replace(speed_mps=self._speed(speed_mps))
            case console.Goto(latitude_deg, longitude_deg, speed_mps):
                self._request(Mode.GOTO, setpoint._replace(target=self._target(latitude_deg, longitude_deg, speed_mps)), now_s)
            case console.Mission(text):
                self._load(text)
            case console.Play(leg):
                self._request(Mode.PLAY, setpoint._replace(leg=leg), now_s)

    def _speed(self, asked_mps: float | None) -> float:
        """The operator's speed within the boat's; the present one, or cruising speed, where none was named."""
        speeds = self.settings.control.speed
        return min(speeds.cruise_mps if asked_mps is None else asked_mps, speeds.max_mps)

    def _target(self, latitude_deg: float | None, longitude_deg: float | None, speed_mps: float | None) -> Waypoint | None:
        """A free point of the operator; None: the mission's first waypoint."""
        if latitude_deg is None or longitude_deg is None:
            return None
        if self.state.origin is None:
            raise Refused("goto refused: no position yet")
        north_m, east_m = geodesy.to_plane(self.state.origin, math.radians(latitude_deg), math.radians(longitude_deg))
        return Waypoint(north_m, east_m, self._speed(speed_mps), self.settings.control.path.acceptance_m)

    def _load(self, text: str) -> None:
        state = self.state
        if state.mode in (Mode.PLAY, Mode.PATH):
            raise Refused("mission refused: one is being played; stop or hold first")
        mission = parse_mission(text, "mission")
        first = mission.waypoint[0]
        origin = state.origin or geodesy.origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
        planned = plan(mission, origin, self._limits.control)
        around = fence.survey(self.settings.fence, mission.fence, origin)
        if around is not None and (why := fence.complaint(around, planned)) is not None:
            raise Refused(f"mission refused: {why}")
        state.origin, state.setpoint = origin, state.setpoint._replace(plan=planned, leg=0)
        self._zones, self.fence = mission.fence, around


_MEASURED = slice(1, 9)  # of a navigation message: position, velocity, attitude
_POSITION, _HEADING, _VELOCITY = 1, 2, 4
_HAS = tuple(
    frozenset(name for bit, name in ((1, "position"), (2, "heading"), (4, "velocity")) if known & bit) for known in range(8)
)
