"""The helm: the boat's mode, changes of it, and the operator's set points. Only the loop calls this."""

import math
from collections.abc import Callable
from typing import Protocol

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import Clock
from delfim.base.cooperative import Sliced
from delfim.base.errors import Refused
from delfim.base.modes import Mode
from delfim.base.parts import OrderRow
from delfim.config import ASTERN
from delfim.vehicle import console
from delfim.vehicle.control.control import Memory, Settings, Stepped, admit, lacking, settings_of
from delfim.vehicle.control.control import control as step
from delfim.vehicle.control.control import enter as begin
from delfim.vehicle.control.hull import filled
from delfim.vehicle.control.modes import path
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.failsafe import failsafe
from delfim.vehicle.failsafe.checks import checks, refusal
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.failsafe.troubles import Inputs, PartTrigger
from delfim.vehicle.helm import detour, setpoints
from delfim.vehicle.helm.alone import Alone
from delfim.vehicle.helm.announcing import Announcing
from delfim.vehicle.helm.homeward import Homeward
from delfim.vehicle.helm.planning import Plans
from delfim.vehicle.helm.stations import Stations
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.track import Track, back
from delfim.vehicle.plans.underway import Paused, UnderWay, under_way
from delfim.vehicle.plans.zones import Point
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.report import Check
from delfim.vehicle.state import Reference, Setpoint, State, StateLog, Wanted

Shape = Callable[[Mode, Memory, Stepped, Settings, float], Stepped]  # of a step of the mode, with the memory before it


class CarriesOut(Protocol):
    """An order of a part: it answers with the order of the console that it stands for, if it is one, or raises Refused."""

    row: OrderRow

    def carry_out(self, values: console.Values, settings: config.Vehicle, now_s: float) -> console.Meant | None: ...


class Helm:
    """The mode with its memory, the plans, the failsafe's rules, and the one door from mode to mode."""

    def __init__(
        self,
        settings: config.Vehicle,
        clock: Clock,
        state: State,
        propulsion: Propulsion,
        log: StateLog,
        troubles: tuple[PartTrigger, ...] = (),
    ) -> None:
        """`troubles`: of the parts aboard. Raises ConfigError where the boat's chart is not whole."""
        chart = None
        if settings.fence.chart:
            from delfim.vehicle.plans.clearancefile import load  # other boats do without

            chart = load(settings)
        self.filed, self.sails_by, self.state = filled(settings), settings.sails_by, state
        self._clock, self.propulsion, self._log, self.note = clock, propulsion, log, log.note
        self.limits, self.shapes = settings_of(settings), dict[str, Shape]()  # by who changes the steps of the mode now
        self.memory = begin(Mode.IDLE, state.motion, state.setpoint, self.limits)
        self.track = Track(settings.control.home)
        self.plans = Plans(settings.fence, self.limits, state, self.track, log, self.under_way, chart)
        self.homeward, self._goes_home = Homeward(self.track, self.plans.remains), ""  # why, as soon as the way is found
        self.rules, self.troubles = failsafe.Rules(settings, troubles), failsafe.NO_TROUBLE
        self.settings, self.changed = self.filed, dict[str, float | str]()  # keys of the vehicle's file that consoles set
        self.taken = False  # the failsafe changed the mode; a joystick held over does not change it back
        self.paused: Paused | None = None
        self.orders = dict[str, CarriesOut]()  # of parts, by name
        self.alone = Alone(settings.thrusters, state, propulsion, log)
        self._announcing, self.stations = Announcing(state, log), Stations(state, log)
        self._seeking: Sliced[tuple[Point, float]] | None = None  # the search for a better place to hold
        self.detour: detour.Detour | None = None  # and for a way round zones
        self._unstuck: tuple[Point, Mode] | None = None  # where the boat went astern last, and in which mode it got stuck
        self._retreat: tuple[Point, ...] = ()  # the driven track, up to where the boat went back to; empty: it did not
        self._controlled_s = clock.monotonic_s()

    def stop(self, reason: str) -> None:
        """Idle and propellers off, now. The reason is shown and logged; a kill remains the reason until it is cleared."""
        self.enter(Mode.IDLE, f"kill: {killed}" if (killed := self.state.killed.reason) else reason)
        self.state.actuation = self.propulsion.send(STOP, self._clock.monotonic_s())

    def steer(self, now_s: float) -> None:
        """One step of the mode; its command goes to the propellers."""
        self.state.actuation = self.propulsion.send(self.control(now_s), now_s)

    def control(self, now_s: float) -> Wanted:
        state = self.state
        dt_s, self._controlled_s = min(now_s - self._controlled_s, 1.0), now_s
        if (short := self.propulsion.short) is not None:
            self.memory = lacking(self.memory, short)
        stepped = step(state.mode, self.memory, state.motion, state.setpoint, self.limits, dt_s)
        for shape in self.shapes.values():
            stepped = shape(state.mode, self.memory, stepped, self.limits, dt_s)
        self.memory, state.reference, wanted = stepped
        return wanted

    def checks(self) -> list[Check]:
        """The checks before the start, a line each."""
        inputs = Inputs(self._log.reason(), self.plans.fence)
        return checks(self.rules, self.state, inputs, self._clock.monotonic_s(), self._clock.time_ns())

    def unfit(self, lines: list[Check] | None = None) -> str | None:
        """Why the boat cannot leave idle, in words; None: it can. Manual needs least: if it is forbidden, so is every mode."""
        return refusal(self.rules, Mode.MANUAL, self.checks() if lines is None else lines, self.state.has_left_idle)

    def home(self) -> tuple[float, float] | None:
        """(latitude_rad, longitude_rad) of the end of the way home; None where no track was driven yet."""
        end, at = self.track.end(), self.state.origin
        return geodesy.from_plane(at, *end) if end is not None and at is not None else None

    def fall_back(self, action: Action, reason: str, now_s: float) -> None:
        """Do the failsafe's action, or the next safer one that is possible. A boat that holds and was led away from its place
        holds anew, where it is, if a zone is on the way back."""
        state = self.state
        if words := state.relieve(f"failsafe: {reason}"):
            self.note(words)
        action = self.possible(action)
        if action is Action.UNSTICK and state.mode is not Mode.UNSTICK and (why_not := self._cannot_unstick(again=False)):
            action, reason = Action.HOLD, f"{reason}; {why_not}"
        if action >= Action.STOP:
            self.propulsion.disconnect(state.overdue)
        if action is Action.DISCONNECT:
            return
        setpoint, cannot, why = state.setpoint, "", reason
        if action is Action.UNSTICK:
            setpoint = setpoint._replace(track=self._way_out())
        elif action is Action.HOME:
            setpoint, cannot = self._homewards(setpoint)
        if cannot:
            action, reason = Action.HOLD, f"{reason}; {cannot}"
        mode, reason = failsafe.fallback(action, reason, state.motion.has, setpoint)
        holds, place = action is Action.HOLD and self._seeking is None, (self.memory.north_m, self.memory.east_m)
        if mode is not state.mode or (mode is Mode.HOLD and holds and fence.cuts_off(self.plans.fence, state.motion, place)):
            state.setpoint, self.taken = setpoint, True
            self.enter(mode, reason)
            self.steer(now_s)
        if cannot and mode is Mode.HOLD:
            self._hold_instead(why, cannot)
        if action is Action.BACK and mode is Mode.HOLD:
            self._go_back()

    def _homewards(self, setpoint: Setpoint) -> tuple[Setpoint, str]:
        """The set points of home, and why the boat cannot go there, in words; empty: nothing forbids it."""
        around = self.plans.fence
        self.homeward.look(around, self.settings.control.home.speed_mps)  # the newest piece may be a tenth of a second old
        track, cannot = self.track.way_home(), self.homeward.why
        if around is not None and track and not cannot:
            # The newest point may be behind a boat that drifts towards a zone.
            ways = [fence.crossing(around, self.state.motion, to) for to in track[-1:-3:-1]]
            if ways[0] is not None and ways[-1] is None:
                track = track[:-1]
            elif ways[0] is not None:
                cannot = f"no way home: {ways[0]}"
        return setpoint._replace(track=track), cannot

    def _hold_instead(self, why: str, cannot: str) -> None:
        """The boat holds, as it cannot go home; where the way is not known yet it does once it is."""
        self._goes_home = why if self.homeward.is_sought else ""
        if cannot not in self.state.reason:
            self.state.reason = f"{why}; {cannot}"
            self.note(f"hold: {self.state.reason}")

    def _go_home(self) -> None:
        """Home once its way is known, and hold once it is no way any more, as zones or an opened band have changed."""
        state, why = self.state, self._goes_home
        if why and not self.homeward.is_sought:
            self._goes_home, (setpoint, cannot) = "", self._homewards(state.setpoint)
            if cannot := cannot or admit(Mode.HOME, state.motion.has, setpoint) or "":
                self._hold_instead(why, cannot)
            else:
                state.setpoint = setpoint
                self.enter(Mode.HOME, why)
        elif state.mode is Mode.HOME and (cannot := self.homeward.why):
            why = state.reason
            self.enter(Mode.HOLD, f"{why}; {cannot}")
            self._hold_instead(why, cannot)

    def possible(self, action: Action) -> Action:
        """This action, or a stop where nobody knows yet what the motors do."""
        return action if self.settings.adopted.proven else failsafe.unsteered(action)

    def _way_out(self) -> tuple[Point, ...]:
        """The driven track. On the way home its newest point lies ahead, and the way out is straight astern."""
        return () if self.state.mode is Mode.HOME else self.track.way_home()

    def _cannot_unstick(self, *, again: bool) -> str:
        """Why the boat does not go astern out of where it is, in words; empty: it does. `again`: also where it just did."""
        if self.limits.hull.astern_n < ASTERN * self.limits.hull.ahead_n:
            return "it cannot go astern: its thrusters push ahead alone"
        near_m, here = 2.0 * self.limits.control.unstick.distance_m, (self.state.motion.north_m, self.state.motion.east_m)
        was_here = self._unstuck is not None and math.dist(self._unstuck[0], here) < near_m
        return "" if again or not was_here else "it went astern here before"

    def _go_back(self) -> None:
        """Hold some way back along the driven track, and further back once the boat is there and still in trouble."""
        memory, here = self.memory, (self.state.motion.north_m, self.state.motion.east_m)
        is_there = math.dist((memory.north_m, memory.east_m), here) <= self.settings.control.hold.radius_m
        if self._seeking is None and (is_there or not self._retreat):
            self._retreat = back(self._retreat or self.track.points() or (here,), self.rules.table.back_m)
            self._settle(self._retreat[-1], self._retreat)

    def _settle(self, here: Point, track: tuple[Point, ...]) -> None:
        """Hold here or, where the fence leaves no room, at the newest place of this track that has it."""
        at = self.memory.north_m, self.memory.east_m
        self.memory = self.memory._replace(north_m=here[0], east_m=here[1])
        if self.plans.fence is not None:
            self._seeking = Sliced(fence.place_to_hold(self.plans.fence, at, here, track, self.settings.control.hold.radius_m))
            self._seek()

    def fade(self, now_s: float) -> None:
        """Thrust that is not repeated ends; the mode stays. Thrust returns only after the joystick is released."""
        self.alone.fade(now_s)
        state, silent_s = self.state, now_s - self.state.manual_s
        held = state.mode is Mode.MANUAL and (state.setpoint.starboard or state.setpoint.port)
        if held and silent_s > self.settings.failsafe.manual_silent.thrust_s:
            self.release(f"no thrust: no manual command for {silent_s:.1f} s", now_s)
        if state.mode is Mode.TRIAL and silent_s > self.settings.failsafe.manual_silent.thrust_s:
            self.stop(f"trial ended: nobody asks for it for {silent_s:.1f} s")

    def release(self, reason: str, now_s: float) -> None:
        """No thrust by hand from now on."""
        state, self.taken = self.state, True
        state.setpoint, state.reason = state.setpoint._replace(starboard=0.0, port=0.0), reason
        self._log.note(reason)
        state.actuation = self.propulsion.send(STOP, now_s)  # at once; from the next cycle on, none

    def go_on(self) -> None:
        """A slice of long work."""
        self.plans.go_on()
        self._seek()
        if self.detour is None:
            self.homeward.look(self.plans.fence, self.settings.control.home.speed_mps)
        self._go_home()
        if self.detour is not None and (found := self.detour.step()) is not None:
            self.state.setpoint, reason = found
            self.enter(Mode.GOTO, reason)
        self.stations.look(self.memory, self._clock.monotonic_s())
        leg = path.piece_of(self.memory.leg) if self.memory.line_m else self.memory.leg  # back to where its line was left
        self.state.announced = self._announcing.news(self.plans.mission, leg)

    def _seek(self) -> None:
        """The place to hold moves to a better one as soon as that is found, and the radius to what the fence leaves."""
        if self._seeking is not None and self._seeking.step():
            ((north_m, east_m), room), self._seeking = self._seeking.result, None
            self.memory = self.memory._replace(north_m=north_m, east_m=east_m, room=room)

    def finish(self) -> None:
        """The mode is at its end: home if the mission says so, else hold, or idle if it cannot or was told to stop there. After
        a trial idle."""
        state, end, waits = self.state, f"{self.state.mode.name.lower()} done", ""
        if state.mode is Mode.TRIAL:
            self.stop(state.reference.reason)
            return
        goes_home = state.setpoint.plan is not None and state.setpoint.plan.then_home and state.mode in (Mode.PLAY, Mode.PATH)
        if state.mode is Mode.UNSTICK:
            end = f"{end}: {state.reference.reason}"
            was_home = self._unstuck is not None and self._unstuck[1] is Mode.HOME
            goes_home = not state.reference.distance_m and (was_home or self.limits.control.unstick.then == "home")
        if goes_home:
            setpoint, cannot = self._homewards(state.setpoint)
            if (reason := cannot or admit(Mode.HOME, state.motion.has, setpoint)) is None:
                state.setpoint = setpoint
                self.enter(Mode.HOME, end)
                return
            end, waits = f"{end}, cannot go home: {reason}", end if self.homeward.is_sought else ""
        if (reason := admit(Mode.HOLD, state.motion.has, state.setpoint)) is not None:
            self.stop(f"{end}, cannot hold: {reason}")
        elif state.mode is Mode.GOTO and state.setpoint.end == "idle":
            self.stop(end)
        else:
            self.enter(Mode.HOLD, end)
            self._goes_home = waits

    def enter(self, mode: Mode, reason: str, resumed: Memory | None = None) -> None:
        """`resumed`: the mode goes on with this memory."""
        self.alone.release()
        state = self.state
        if mode is Mode.IDLE and state.mode is Mode.IDLE and state.reason == reason:
            return
        is_same = state.helmsman and (mode, reason) == (state.mode, state.reason)  # a program may ask five times a second
        if mode is Mode.IDLE:
            state.relieve(reason)
        self._remember(mode)
        if mode is Mode.UNSTICK and state.mode is not Mode.UNSTICK:
            self._unstuck = (state.motion.north_m, state.motion.east_m), state.mode
        self.memory, self._seeking, self._retreat = begin(mode, state.motion, state.setpoint, self.limits), None, ()
        self._goes_home = ""
        if self.detour is not None:
            self.plans.remains.add(*self.detour.held)
            self.detour = None
        if resumed is not None:
            self.memory = resumed._replace(integrals=self.memory.integrals)
        if mode is Mode.HOLD or (mode is Mode.GOTO and state.setpoint.target is None):
            self._settle((self.memory.north_m, self.memory.east_m), self.track.points())
        if mode is Mode.PATH and resumed is None and state.setpoint.piece and state.setpoint.plan is not None:
            reason = f"{reason}; begins at piece {state.setpoint.piece + 1} of {len(state.setpoint.plan.path)}"
        if mode is not state.mode:
            state.mode_s = self._clock.monotonic_s()
        if mode is Mode.IDLE and (mode is not state.mode or state.actuation.run):
            state.off_s = self._clock.monotonic_s()
        state.armed = mode is not Mode.IDLE
        state.has_left_idle |= state.armed
        state.mode, state.reason, state.reference = mode, reason, Reference()
        if not is_same:
            self._log.note(f"{mode.name.lower()}: {reason}")

    def _remember(self, entered: Mode) -> None:
        """A hold remembers the mode that it interrupts, and so does the way astern; every other mode forgets it. Play that was
        left begins with its leg."""
        state = self.state
        if entered not in (Mode.HOLD, Mode.UNSTICK):
            self.paused = None
        elif state.mode not in (Mode.IDLE, Mode.MANUAL, Mode.TRIAL, Mode.HOLD, Mode.UNSTICK) and not state.reference.done:
            plan = state.setpoint.plan
            self.paused = Paused(state.mode, self.memory, plan.number if plan is not None else 0)
        if state.mode is Mode.PLAY and entered is not Mode.PLAY and not state.reference.done:
            state.setpoint = state.setpoint._replace(leg=self.memory.leg)

    def request(self, mode: Mode, setpoint: Setpoint, now_s: float, resumed: Memory | None = None, restarted: str = "") -> None:
        """The one door: enter the mode the operator asks for, with its set points, or the one after a restart, which gives a
        reason. Raises Refused; nothing has changed then."""
        state = self.state
        cannot = ""
        if mode is Mode.UNSTICK:
            setpoint = setpoint._replace(track=self._way_out())
        elif mode is Mode.HOME:
            setpoint, cannot = self._homewards(setpoint)
            if cannot and not self.homeward.is_sought:
                raise Refused(f"home refused: {cannot}")
            mode = Mode.HOLD if cannot else mode
        if mode is not state.mode and resumed is None:
            setpoint = setpoint._replace(override_mps=None)
        if mode is Mode.PATH and resumed is not None and setpoint.plan is not None:
            resumed = path.resumed(resumed, state.motion, setpoint.plan, self.limits)
        if mode is not Mode.IDLE:
            reason = refusal(self.rules, mode, self.checks(), state.has_left_idle) or admit(mode, state.motion.has, setpoint)
            if reason is None and mode is Mode.GREX and now_s - state.guest_s > self.settings.failsafe.guest_silent.after_s:
                reason = "no set point from the guest"
            if reason is None and mode is Mode.UNSTICK:
                reason = self._cannot_unstick(again=True) or None
            memory = begin(mode, state.motion, setpoint, self.limits) if resumed is None else resumed
            to = None if reason else setpoints.first(mode, memory, setpoint)
            reason = reason or setpoints.too_far(to, state.motion) or self.plans.barred(mode, memory.leg)
            if reason is None and self.plans.fence is not None:
                reason = fence.crossing(self.plans.fence, state.motion, to)
            if reason is not None:
                raise Refused(f"{mode.name.lower()} refused: {reason}")
        state.setpoint = setpoint
        who = state.orderer
        if not restarted and not state.helmsman:  # who overrules no failsafe
            self.troubles, self.taken = failsafe.overruled(self.troubles), False
        self.enter(mode, restarted or (who if resumed is None else f"{who} continues"), resumed)
        if cannot:
            self._hold_instead(restarted or who, cannot)

    def under_way(self) -> UnderWay | None:
        return under_way(self.state.mode, self.memory.leg, self.paused, self.state.setpoint.plan)
