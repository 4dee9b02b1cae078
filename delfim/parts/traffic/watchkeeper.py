"""The watchkeeper: once a second the guard decides and dangers are told; between, an order shapes the steps of the mode.

The mode stays the one it is, is never entered anew, and checks off its legs as ever: an order replaces course and speed inside
the step. A step reads the last order and its age; older than LATE_S it does without. While there is no order the steps are
the mode's own, and cost what they cost without a guard. A round of decision and dangers is done in slices: among two hundred
vessels it takes a second or two.
"""

import math
from collections.abc import Sequence
from typing import Final

from msgspec.structs import replace

from delfim import config
from delfim.base.clock import Clock
from delfim.base.cooperative import Sliced, Work
from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.base.vessels import THINGS
from delfim.parts.traffic import alarm, keepclear
from delfim.parts.traffic.beside import Company, company, danger_beside
from delfim.parts.traffic.cpa import into
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.judged import judged
from delfim.parts.traffic.keepclear import PassedBy, deciding
from delfim.parts.traffic.leash import Leash, paid_out
from delfim.parts.traffic.pastthings import Passage, past
from delfim.parts.traffic.routeahead import own_of, route_ahead
from delfim.parts.traffic.swimmers import SLOW, Stopped, nearby, stopped_for, swimmer_near
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.parts.traffic.vesselwords import making, traffic_told
from delfim.vehicle.control.autopilot import steer
from delfim.vehicle.control.control import Stepped, control
from delfim.vehicle.control.guidance import course_to_steer
from delfim.vehicle.control.memory import LineOfSight, Memory, Settings
from delfim.vehicle.control.modes.trial import FAR
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.failsafe.troubles import Trigger
from delfim.vehicle.helm import detour, setpoints
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.plans.fence import Fence, crossing, stopping_m
from delfim.vehicle.report import TrafficSeen
from delfim.vehicle.state import Reference, Setpoint, State, StateLog
from delfim.vehicle.target import NEVER_S, CourseOrder, Target

NAME: Final = "traffic"  # of its shape of the mode's steps
LATE_S: Final = 5.0  # an older order does not count
SLICE: Final = 200  # comparisons of one step, ...
AMONG_THINGS: Final = 270  # ... and where there are things, whose way past may need many
SILENT_S: Final = 360.0  # a lost vessel is kept clear of until its last report is so old
TURN_MIN_RADPS, TURN_MAX_RADPS = 0.05, 0.5
OVERRULED: Final = "the operator overruled the guard"
DOUBTED: Final = " (traffic.guard.stopped_s): is it there? Overrule if not"
LED_ASIDE: Final = "led aside by traffic"
BY_HAND: Final = (Mode.IDLE, Mode.MANUAL)  # the guard orders nothing, not even beside a swimmer: it is told of
LEGS: Final = (Mode.PLAY, Mode.GOTO, Mode.HOME)

_new = tuple.__new__  # a fifth of the time of Memory._replace(...): steps are on the critical path


def caution(settings: config.Vehicle, limits: Settings) -> Caution:
    """The boat's limits for avoidance; its rate of turn is the one at which its autopilot's largest moment, or all that its
    thrusters give, and the damping are equal. Of a boat that was adopted the water's damping and the way to stop are known."""
    gains, guard, speed, boat = limits.gains, settings.traffic.guard, limits.control.speed, settings.boat
    water, own, most_nm = limits.hull.damping_nm_per_radps, gains.d_nm_per_radps, gains.p_limit_nm
    turn_radps, ramp_mps2 = most_nm / max(own + water, 1e-6), speed.ramp_mps2
    if settings.adopted.on:
        slow, square = boat.yaw_nm_per_radps or water, boat.yaw_nm_per_radps2 or 0.0
        turn_radps = min(_rate(most_nm, own + slow, square), _rate(limits.hull.turn_nm, slow, square))
        stops_s = settings.fence.reaction_s + speed.cruise_mps / (2.0 * settings.fence.deceleration_mps2)
        ramp_mps2 = min(ramp_mps2, 0.5 * speed.cruise_mps / stops_s)  # that way, with a constant deceleration
    turn_radps = min(max(turn_radps, TURN_MIN_RADPS), TURN_MAX_RADPS)
    clear = guard.thing_clear_m, guard.person_clear_m, guard.person_stop_m
    return Caution(boat.length_m, turn_radps, ramp_mps2, guard.look_s, guard.stand_on, *clear)


def _rate(moment_nm: float, slow: float, square: float) -> float:
    """The rate of turn, rad/s, at which a damping takes this moment: slow, N m per rad/s, and with the square of the rate."""
    if square <= 0.0:
        return moment_nm / max(slow, 1e-6)
    return (math.sqrt(slow * slow + 4.0 * square * moment_nm) - slow) / (2.0 * square)


def slowed(setpoint: Setpoint, settings: Settings) -> Setpoint:
    """The set point at half the speed that is set, or half the cruising speed."""
    slow_mps = SLOW * setpoints.speed(setpoint.override_mps, settings.control.speed)
    return setpoint._replace(speed_mps=SLOW * setpoint.speed_mps, override_mps=slow_mps)


class Watchkeeper:
    def __init__(self, settings: config.Vehicle, clock: Clock, state: State, log: StateLog) -> None:
        self._guard, self._clock, self._state, self._log = settings.traffic.guard, clock, state, log
        names = self._guard.modes if self._guard.enabled else ()
        self._modes = frozenset(mode for mode in Mode if mode.name.lower() in names)
        self._alarms: alarm.Alarms
        self._memory, self._alarms = keepclear.Memory(), {}
        self._company, self._leash = Company(), Leash()
        self._passage: Passage | None = None
        self._swimmer, self._speed_mps = "", 0.0  # near, for which the boat goes slowly; speed that is asked for
        self._swimmers = tuple[Target, ...]()  # that are near
        self._stopped: Stopped | None = None  # the propellers are, for one of them
        self._passes, self._route = tuple[PassedBy, ...](), RouteAhead((), 0.0)
        self._looked_s = NEVER_S  # `Traffic.at_s` of the present round
        self._sailed_s, self._is_doubted = math.inf, False  # when no order stopped the boat last; a stop has lasted for long
        self._round: Sliced[None] | None = None
        self._has_things = False
        self._failing, self._awaits = "", settings.traffic.mmsi > 0

    def look(self, helm: Helm, now_s: float) -> bool:
        """Do a slice of work; call it with the watchdog. Returns whether it did one: the next look of the look-out waits for
        it."""
        if self._state.traffic.order is not None and self._denied(helm):  # at once: the next decision is a second away
            self._resume(helm)
            self._state.traffic = self._state.traffic._replace(order=None)
            helm.shapes.pop(NAME, None)
        if self._round is None and self._looked_s < self._state.traffic.at_s:
            self._looked_s, things = self._state.traffic.at_s, self._things()
            here = self._state.motion.north_m, self._state.motion.east_m
            self._has_things, self._swimmers = bool(things), nearby(things, *here, self._guard.person_stop_m)
            self._round = Sliced(self._watch(helm, now_s))
        if self._swimmers or self._stopped is not None:
            self._stop_beside(helm, now_s)
        if self._round is None:
            return False
        if self._round.step(AMONG_THINGS if self._has_things else SLICE):
            self._round = None
        return True

    def _stop_beside(self, helm: Helm, now_s: float) -> None:
        """Beside a swimmer the propellers stop, at once; when they may turn again the next decision goes on."""
        state, was = self._state, self._stopped
        is_asked = self._guard.enabled and state.mode not in BY_HAND and "position" in state.motion.has
        self._stopped = None
        if is_asked and not self._denied(helm):
            boat_m, stop_m = helm.settings.boat.length_m, self._guard.person_stop_m
            self._stopped = stopped_for(was, self._swimmers, self._looked_s, state.motion, boat_m, stop_m, now_s)
        if self._stopped is not None and was is None:
            order = self._stopped.order
            self._note(order)
            state.traffic = state.traffic._replace(order=order)
            helm.shapes[NAME] = self._still

    def told(self, now_s: float) -> TrafficSeen | None:
        """Other vessels for people and programs; a boat with a number of its own awaits to be heard."""
        return traffic_told(self._state.traffic, now_s, self._awaits)

    def _watch(self, helm: Helm, now_s: float) -> Work[None]:
        self._end_trial(helm)
        yield from self._decide(helm, now_s)
        self._doubt(now_s)
        yield SLICE  # what follows has a slice of its own
        yield from self._tell(helm, now_s)
        told = yield from making(self._state.traffic, self._state.origin)
        self._state.traffic = self._state.traffic._replace(told=told)

    def _decide(self, helm: Helm, now_s: float) -> Work[None]:
        state, mode = self._state, self._state.mode
        missing = sorted({"position", "velocity"} - state.motion.has)
        failing, order, self._passes = f"no {' and no '.join(missing)}" if missing else self._denied(helm), None, ()
        unjudged = ""
        if not missing:
            self._route = route_ahead(state.mode, helm.memory, state.setpoint, state.motion, helm.limits)
            self._accompany(helm.settings.boat.length_m, now_s)
        route, was = self._route, self._passage
        self._passage, self._swimmer = None, ""
        if state.mode not in self._modes:
            self._memory, failing = keepclear.Memory(), ""
        elif failing and not missing:
            self._memory = keepclear.Memory()
        elif not missing:
            own, boat, fence = own_of(state.motion), caution(helm.settings, helm.limits), helm.plans.fence
            things = self._things()
            try:
                if things:
                    yield from self._bend(boat, own, things, fence, was)
                watched, unjudged = yield from judged(boat, own, self._route, self._memory.choice, self._watched())
                found = yield from deciding(boat, self._memory, own, self._route, watched, fence, now_s, things)
                if state.mode is not mode:
                    return  # another one since: decided for with the next look
                self._memory, order, self._passes = found
                if order is None and self._passage is not None:
                    order = self._passage.order(own, self._speed_mps, now_s)
                order = None if order is None else order._replace(at_s=self._clock.monotonic_s())
            except (ValueError, ArithmeticError) as error:  # the mission goes on as the vehicle's file says
                self._memory, failing = keepclear.Memory(), f"the guard failed: {error}"
        if self._stopped is not None:
            order = self._stopped.order
        if not missing:
            to = state.setpoint
            task = mode, to.target, to.heading_rad, to.plan
            self._leash = paid_out(self._leash, self._guard, task, route, own_of(state.motion), order, now_s)
        if order is None and state.traffic.order is not None:
            self._resume(helm)
        self._note(order)
        is_guarded = "on" if state.mode in self._modes else "off"
        words = f"cannot avoid: {failing}" if failing and state.traffic.targets else is_guarded
        state.traffic = state.traffic._replace(order=order, guard=words, unjudged=unjudged)
        is_failing = state.traffic.targets and failing != OVERRULED
        self._act(helm, order, failing if is_failing else "", now_s)

    def _doubt(self, now_s: float) -> None:
        """A stop that lasts for long has the words that it may be for nothing."""
        traffic, limit_s = self._state.traffic, self._guard.stopped_s
        self._sailed_s = min(self._sailed_s, now_s)
        if traffic.order is None or traffic.order.speed_mps > 0.0:
            self._sailed_s, self._is_doubted = now_s, False
        elif now_s - self._sailed_s > limit_s and DOUBTED not in traffic.order.words:
            words = f"{traffic.order.words}; stopped for more than {limit_s:g} s{DOUBTED}"
            self._state.traffic = traffic._replace(order=traffic.order._replace(words=words))
            if not self._is_doubted:
                self._is_doubted = True
                self._log.note(f"traffic: {words}")

    def _bend(self, boat: Caution, own: Own, things: Sequence[Target], fence: Fence | None, was: Passage | None) -> Work[None]:
        """Lead the route past what stands in the way, and slowly by a swimmer: ships are judged along that."""
        asked, swimmer = self._route, swimmer_near(boat, own, self._route.speed_mps, things)
        if swimmer is not None:
            self._swimmer, self._route = swimmer.name, asked._replace(speed_mps=SLOW * asked.speed_mps)
        self._passage = yield from past(boat, own, self._route, things, fence, was)
        if self._passage is not None and self._passage.part < 1.0:
            self._route = asked  # it says itself how slowly
        self._speed_mps = self._route.speed_mps
        if self._passage is not None:
            self._route = self._passage.route(self._route)

    def _end_trial(self, helm: Helm) -> None:
        """A trial stops for a vessel on its way into the circle, whether or not the guard is on: it turns for nobody."""
        trial, look_s = self._state.setpoint.trial, self._guard.look_s
        if self._state.mode is not Mode.TRIAL or trial is None:
            return
        for each in (*self._watched(), *self._things()):
            if (at_s := into(trial.north_m, trial.east_m, FAR * trial.radius_m, each, look_s)) is not None:
                when = f"will come into the circle, in {at_s:.0f} s" if at_s else "is in the circle"
                helm.stop(f"trial ended: {each.name} {when}")
                return

    def _denied(self, helm: Helm) -> str:
        """Why the guard must leave the boat alone, in words: an operator says so, near the fence its mode alone steers it, and
        others move it no farther, and for no longer, than its file says."""
        if self._clock.monotonic_s() < self._state.overruled_s:
            return OVERRULED
        near = helm.troubles.get(Trigger.FENCE) or helm.troubles.get(Trigger.FENCE_LEFT)
        return f"the fence goes before: {near.reason}" if near is not None else self._leash.spent

    def _accompany(self, length_m: float, now_s: float) -> None:
        """Note which vessels move as the boat does, in a boat of this length."""
        state, was = self._state, self._company._replace(remembered=self._state.traffic.beside)
        self._company = company(was, own_of(state.motion), length_m, state.traffic.targets, now_s)
        state.traffic = state.traffic._replace(beside=self._company.remembered)
        for each in self._beside():
            if not was.has(each.key):
                self._log.note(f"traffic: {danger_beside(each).words}")

    def _beside(self) -> list[Target]:
        return [each for each in self._state.traffic.targets if self._company.has(each.key)]

    def _watched(self) -> list[Target]:
        """All vessels but those that were silent for long, and those that come along wherever the boat goes."""
        targets, beside = self._state.traffic.targets, self._company
        vessels = [each for each in targets if each.kind not in THINGS]
        return [each for each in vessels if (not each.is_lost or each.age_s < SILENT_S) and not beside.has(each.key)]

    def _things(self) -> list[Target]:
        """What stands, and swimmers."""
        return [each for each in self._state.traffic.targets if each.kind in THINGS]

    def _act(self, helm: Helm, order: CourseOrder | None, failing: str, now_s: float) -> None:
        """From now on the steps of the mode are shaped so."""
        is_new, self._failing = failing and not self._failing, failing
        does = self._guard.on_failure if failing else ""
        helm.shapes.pop(NAME, None)
        if self._stopped is not None:
            helm.shapes[NAME] = self._still
        elif order is not None:
            helm.shapes[NAME] = self._kept_clear
        elif does == "slow" or self._swimmer:
            helm.shapes[NAME] = self._slowly
        if is_new:
            self._log.note(f"traffic: cannot avoid: {failing}: {does}")
            if does == "hold" and self._state.mode is not Mode.HOLD:
                helm.fall_back(Action.HOLD, f"traffic cannot be avoided: {failing}", now_s)

    def _kept_clear(self, mode: Mode, memory: Memory, stepped: Stepped, settings: Settings, dt_s: float) -> Stepped:
        """A step of the mode with the order's course and speed in place of its own. The crab angle stays measured."""
        (after, reference, wanted), motion, order = stepped, self._state.motion, self._state.traffic.order
        if order is None or mode not in self._modes or not wanted.run or self._clock.monotonic_s() - order.at_s > LATE_S:
            return stepped
        was = LineOfSight(memory.course.crab_rad)
        course, heading_rad = course_to_steer(was, motion, order.course_rad, 0.0, settings.control.path, dt_s)
        integrals, wanted = steer(memory.integrals, motion, heading_rad, order.speed_mps, settings, dt_s)
        done = reference.done and mode is not Mode.PATH  # its end is passed abeam, however far away
        told = wrap(heading_rad), order.speed_mps, *reference[2:7], done, reference.reason, order.course_rad, reference.line
        reference = _new(Reference, told)
        return _new(Memory, (integrals, course, *after[2:])), reference, wanted

    def _still(self, mode: Mode, memory: Memory, stepped: Stepped, settings: Settings, dt_s: float) -> Stepped:
        """A step of the mode without propellers; it goes on from here afterwards."""
        stopped = self._stopped
        if stopped is None or mode in BY_HAND or self._clock.monotonic_s() - stopped.at_s > LATE_S:
            return stepped
        return memory, stepped[1], STOP

    def _slowly(self, mode: Mode, memory: Memory, stepped: Stepped, settings: Settings, dt_s: float) -> Stepped:
        """A step of the mode at half the speed, in place of this one."""
        return control(mode, memory, self._state.motion, slowed(self._state.setpoint, settings), settings, dt_s)

    def _resume(self, helm: Helm) -> None:
        """Go on, past and clear: the present leg begins anew from here. Where a zone is in the way from here it goes on as it
        was, on its line; but goto, which a turn beside a shore would end, looks for a way with room to stop."""
        state, memory, around = self._state, helm.memory, helm.plans.fence
        if state.mode in LEGS and not memory.left_s and (state.mode is not Mode.GOTO or state.setpoint.target is not None):
            north_m, east_m = state.reference.north_m, state.reference.east_m  # of the leg's end
            to = None if north_m is None or east_m is None else (north_m, east_m)
            if state.mode is Mode.GOTO and around is not None and to is not None and _goes_round(helm, around, to):
                return
            if around is None or crossing(around, state.motion, to) is None:
                helm.memory = memory._replace(north_m=state.motion.north_m, east_m=state.motion.east_m)

    def _note(self, order: CourseOrder | None) -> None:
        """Log each change of the order, not of its figures."""
        was = self._state.traffic.order
        if order is None:
            if was is not None:
                self._log.note("traffic: clear: back to the way")
        elif (
            was is None
            or (was.key, was.speed_part) != (order.key, order.speed_part)
            or (abs(wrap(was.course_rad - order.course_rad)) > 0.1 and (self._passage is None or was.words != order.words))
        ):
            self._log.note(f"traffic: {order.words}")

    def _tell(self, helm: Helm, now_s: float) -> Work[None]:
        state, settings = self._state, helm.settings
        if not state.traffic.targets and not self._alarms:
            state.traffic = state.traffic._replace(dangers=(), nearness=math.nan)
            return
        if not {"position", "velocity"} <= state.motion.has:
            return
        guarded: alarm.Guarded = "no" if state.traffic.guard != "on" else "away" if state.traffic.order else "on its way"
        near, boat, own = settings.failsafe.traffic, caution(settings, helm.limits), own_of(state.motion)
        watched, passes = [*self._watched(), *self._things()], self._passes
        told = yield from alarm.dangers(near, boat, own, self._route, watched, passes, guarded, self._alarms, now_s)
        found, self._alarms = told
        nearness = min((each.nearness for each in found), default=math.nan)
        state.traffic = state.traffic._replace(dangers=found + tuple(map(danger_beside, self._beside())), nearness=nearness)


def _goes_round(helm: Helm, around: Fence, to: tuple[float, float]) -> bool:
    """Whether goto looks for a way from here, as the straight one to the end of its leg leaves no room to stop: it waits
    meanwhile, and where there is none, with the reason."""
    state, limits = helm.state, around.limits
    speed_mps = setpoints.speed(state.setpoint.override_mps, helm.limits.control.speed)
    wide = around._replace(limits=replace(limits, margin_m=limits.margin_m + stopping_m(limits, speed_mps)))
    if crossing(wide, state.motion, to) is None:
        return False
    setpoint = state.setpoint._replace(via=())
    found = detour.begun(around, state.motion, setpoint, LED_ASIDE, wide)
    if found is not None:
        state.setpoint = setpoint._replace(target=None)
        helm.enter(Mode.GOTO, f"{LED_ASIDE}: {found.why}: a way round is looked for")
        helm.detour = found
    return found is not None
