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

import msgspec

from delfim import config, geodesy
from delfim.canproxy.socket import CanSocket
from delfim.clock import Clock
from delfim.errors import ConfigError, DelfimError, Refused
from delfim.vehicle import console, failsafe, fence, sysstat
from delfim.vehicle.checks import Check, checks, refusal
from delfim.vehicle.control.control import MODES, Settings, admit, control, enter
from delfim.vehicle.failsafe import Action, Inputs
from delfim.vehicle.grex import Guest
from delfim.vehicle.latency import Latency
from delfim.vehicle.mission import Mission, checked, parse_mission, plan
from delfim.vehicle.navcan import Fix, Source, preferred
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Mode, Motion, Profile, Reference, Setpoint, State, Waypoint, mode_named
from delfim.vehicle.track import Track

REPEAT_S = 0.5  # a propeller that heard nothing for PROPELLER_TIMEOUT_S stops itself, and that would hide the cause
PUSHED_S = 1.0  # manual commands that come faster are one push
LOCAL = "local"  # the operator at the local command socket


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
        self.zones = config.Zones()  # the mission's
        self.mission: Mission | None = None  # as loaded
        self.rally: tuple[tuple[float, float], ...] = ()  # harbours, degrees
        self.fence = fence.survey(settings.fence, self.zones, state.origin)  # the boat's and the mission's; None: none
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
        if fix is None or not self.take(source, fix):
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

    def on_command(self, command: console.Commands, operator: str = LOCAL) -> str | None:
        """A command of a console: carried out at once, propellers included. Returns why it was refused, or None. Who commanded
        last is the operator, and must go on being heard."""
        now_s, state = self.clock.monotonic_s(), self.state
        if isinstance(command, console.Report | console.Watch):  # onlookers do not keep the boat sailing
            return None
        if isinstance(command, console.Alive) and state.operator not in ("", operator):  # nor do other consoles
            return None
        state.console_s = now_s
        try:
            self._obey(command, now_s)
        except DelfimError as refusal:
            return str(refusal)
        if not isinstance(command, console.Alive):
            state.operator = operator
            self.steer(now_s)
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
        self._fade(now_s)
        if now_s - state.navigation_s > REPEAT_S:
            again = STOP if state.mode is Mode.IDLE else state.actuation  # no navigation cycle says it
            state.actuation = self.propulsion.send(again, now_s)

    # What they do.

    def stop(self, reason: str) -> None:
        """Idle and propellers off, now. The reason is shown and logged."""
        self._enter(Mode.IDLE, reason)
        self.state.actuation = self.propulsion.send(STOP, self.clock.monotonic_s())

    def steer(self, now_s: float) -> None:
        """A step of the mode, and what it asks for to the propellers."""
        self.state.actuation = self.propulsion.send(self._control(now_s), now_s)

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

    def _fade(self, now_s: float) -> None:
        """Manual thrust that nobody repeats ends; the mode stays. Coming back, the operator lets go before it turns again."""
        state, silent_s = self.state, now_s - self.state.manual_s
        held = state.setpoint.starboard or state.setpoint.port
        if state.mode is Mode.MANUAL and held and silent_s > self.settings.failsafe.manual_silent.thrust_s:
            state.setpoint, self._taken = state.setpoint._replace(starboard=0.0, port=0.0), True
            state.reason = f"no thrust: no manual command for {silent_s:.1f} s"
            self.log.note(state.reason)
            state.actuation = self.propulsion.send(STOP, now_s)  # at once; from the next cycle on, none

    def unfit(self) -> str | None:
        """Why the boat cannot leave idle, in words; None: it can. Manual asks for least: what forbids it forbids everything."""
        return refusal(self._rules, Mode.MANUAL, self.checks())

    def home(self) -> tuple[float, float] | None:
        """(latitude_rad, longitude_rad) of the end of the way home; None where no track was driven yet."""
        track, at = self._way_home(), self.state.origin
        return geodesy.from_plane(at, *track[0]) if track and at is not None else None

    def _fall_back(self, action: Action, reason: str, now_s: float) -> None:
        """Do what the failsafe asks, or the next safer thing that can be done."""
        state = self.state
        if action is Action.DISCONNECT:
            self.propulsion.disconnect(failsafe.unfollowed(self._rules.table.thruster, state, now_s))
            return
        setpoint = state.setpoint._replace(track=self._way_home())
        mode, reason = failsafe.fallback(action, reason, state.motion.has, setpoint)
        if mode is not state.mode:
            state.setpoint, self._taken = setpoint, True
            self._enter(mode, reason)
            self.steer(now_s)

    def take(self, source: Source, fix: Fix) -> bool:
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
                self.fence = fence.survey(self.settings.fence, self.zones, state.origin)
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
        state.armed = mode is not Mode.IDLE
        state.mode, state.reason, state.reference = mode, reason, Reference()
        self.log.note(f"{mode.name.lower()}: {reason}")

    def _request(self, mode: Mode, setpoint: Setpoint, now_s: float) -> None:
        """The one door: the operator asks for a mode with its set points. Raises Refused; nothing has changed then."""
        state = self.state
        if mode is Mode.HOME:
            setpoint = setpoint._replace(track=self._way_home())
        if mode is not state.mode:
            setpoint = setpoint._replace(override_mps=None)
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
                self._push(starboard, port, now_s)
            case console.Heading(heading_deg, speed_mps):
                asked = setpoint._replace(heading_rad=math.radians(heading_deg % 360.0), speed_mps=self._speed(speed_mps))
                self._request(Mode.HEADING, asked, now_s)
            case console.SetSpeed(speed_mps):
                override_mps = None if speed_mps is None else self._speed(speed_mps)
                self.state.setpoint = setpoint._replace(speed_mps=self._speed(speed_mps), override_mps=override_mps)
            case console.Goto(latitude_deg, longitude_deg, speed_mps):
                self._request(Mode.GOTO, setpoint._replace(target=self._target(latitude_deg, longitude_deg, speed_mps)), now_s)
            case console.Mission(text):
                self._load(parse_mission(text))
            case console.Upload(mission):
                self._load(checked(mission))
            case console.Play(leg):
                self._request(Mode.PLAY, setpoint._replace(leg=leg), now_s)
            case console.Leg(leg):
                self._choose(leg, now_s)
            case console.Unload():
                self._unload()
            case console.Fence(zones):
                self._surround(zones)
            case console.Rally(points):
                self.rally = points
            case console.Arm():
                self._arm()
            case console.Reset(node):
                if self.state.mode is not Mode.IDLE:
                    raise Refused("reset refused: stop first")
                self.propulsion.reset(node)
            case console.Set(key, value):
                self._set(key, value)

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

    def _load(self, mission: Mission) -> None:
        state = self.state
        self._spare("mission")
        first = mission.waypoint[0]
        origin = state.origin or geodesy.origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
        planned = plan(mission, origin, self._limits.control)
        around = fence.survey(self.settings.fence, mission.fence, origin)
        radius_m = self._limits.control.hold.radius_m
        if around is not None and (why := fence.complaint(around, planned, radius_m)) is not None:
            raise Refused(f"mission refused: {why}")
        state.origin, state.setpoint = origin, state.setpoint._replace(plan=planned, leg=0)
        self.mission, self.zones, self.fence = mission, mission.fence, around

    def _unload(self) -> None:
        self._spare("unload")
        self.mission, self.state.setpoint = None, self.state.setpoint._replace(plan=None, leg=0)

    def _surround(self, zones: config.Zones) -> None:
        """Other zones of the mission. Without a position there is no plane yet, and no mission in it."""
        state = self.state
        self._spare("fence")
        self.zones, self.fence = zones, fence.survey(self.settings.fence, zones, state.origin)
        if self.mission is None or state.setpoint.plan is None:
            return
        radius_m = self._limits.control.hold.radius_m
        why = fence.complaint(self.fence, state.setpoint.plan, radius_m) if self.fence is not None else None
        self.mission = msgspec.structs.replace(self.mission, fence=zones)
        if why is not None:
            self._unload()
            self.log.note(f"the mission is forgotten: {why}")

    def _spare(self, what: str) -> None:
        """Raises Refused while the mission is under the boat."""
        if self.state.mode in (Mode.PLAY, Mode.PATH):
            raise Refused(f"{what} refused: the mission is being played; stop or hold first")

    def _choose(self, leg: int, now_s: float) -> None:
        setpoint = self.state.setpoint._replace(leg=leg)
        if (reason := MODES[Mode.PLAY].lacks(setpoint)) is not None:
            raise Refused(f"leg refused: {reason}")
        if self.state.mode is Mode.PLAY:
            self._request(Mode.PLAY, setpoint, now_s)
        self.state.setpoint = self.state.setpoint._replace(leg=leg)

    def _push(self, starboard: float, port: float, now_s: float) -> None:
        """Manual thrust. After the failsafe took it away, the operator first lets go: by silence, or by asking for none."""
        state = self.state
        pushed, state.manual_s = now_s - state.manual_s < PUSHED_S, now_s
        if state.mode is Mode.MANUAL and not starboard and not port:
            self._taken = False
        if self._taken and (pushed or state.mode is Mode.MANUAL):
            raise Refused(f"manual refused: {state.reason}; let go for {PUSHED_S:g} s or ask for a mode")
        state.setpoint = setpoint = state.setpoint._replace(starboard=starboard, port=port)
        if state.mode is not Mode.MANUAL:
            self._request(Mode.MANUAL, setpoint, now_s)

    def _arm(self) -> None:
        if self.state.mode is Mode.IDLE and (reason := self.unfit()) is not None:
            raise Refused(f"arm refused: {reason}")
        self.state.armed = True

    def _way_home(self) -> tuple[tuple[float, float], ...]:
        """The driven track, from the last harbour that it passed."""
        track, at = self._track.points(), self.state.origin
        if at is None or not self.rally:
            return track
        harbours = [geodesy.to_plane(at, math.radians(place[0]), math.radians(place[1])) for place in self.rally]
        near_m = self.settings.control.path.acceptance_m
        passed = [i for i, point in enumerate(track) if any(math.dist(point, harbour) <= near_m for harbour in harbours)]
        return track[passed[-1] :] if passed else track

    def _set(self, key: str, value: float | str) -> None:
        """A value of the tables that may change while the boat sails. Raises Refused with what is allowed."""
        try:
            self.settings = settings = config.changed(self.settings, key, value)
        except ConfigError as error:
            raise Refused(f"set refused: {error.key}: {error.reason}; {error.allowed}") from None
        self._limits, self._rules = Settings(settings.control, settings.propulsion), failsafe.Rules(settings)


_MEASURED = slice(1, 9)  # of a navigation message: position, velocity, attitude
_POSITION, _HEADING, _VELOCITY = 1, 2, 4
_HAS = tuple(
    frozenset(name for bit, name in ((1, "position"), (2, "heading"), (4, "velocity")) if known & bit) for known in range(8)
)
