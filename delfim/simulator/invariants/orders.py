"""An order is refused for a reason that is there, and changes nothing then; or it is obeyed, and the boat does what it says."""

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from delfim.base import geodesy
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Status
from delfim.simulator.invariants.cycle import Before, CycleSeen, before
from delfim.simulator.invariants.fence import PlainFence
from delfim.simulator.invariants.guidance import begun
from delfim.simulator.invariants.troubles import BATTERIES, NEEDS
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import Line, Motion, Setpoint, Waypoint

SAME: Final = 1e-9
NEAR: Final = 1e-6
ACTIONS: Final = ("none", "warn", "hold", "back", "unstick", "home", "stop")
STOP: Final = ACTIONS.index("stop")
HALTS: Final = console.Stop | console.ShutDown
ASKS: Final = console.Alive | console.TellState | console.Watch
FREE: Final = ("alive", "sight", "sampled", "tell")  # what a payload program may say though the boat is not its own
RIGHT: Final = {
    "pause": "hold",
    "sight": "obstacles",
    "sampled": "samples",
    "tell": "values",
    **{word: word for word in ("goto", "speed", "heading")},
    "course": "heading",
    **dict.fromkeys(("upload", "play", "continue"), "mission"),
}


class BeforeOrder(NamedTuple):
    """The part of the state that a refused order leaves as it is."""

    boat: Before
    armed: bool
    killed: object
    origin: object
    fence: object
    mission: object
    rally: object
    limits: object
    rules: object
    paused: object


class Whose(NamedTuple):
    """The part of the state that an order of a payload program leaves as it is, even if it is obeyed."""

    helmsman: str
    operator: str
    console_s: float
    troubles: object


def whose(run: Lockstep) -> Whose:
    state = run.state
    return Whose(state.helmsman, state.operator, state.console_s, run.vehicle.helm.troubles)


def aboard(run: Lockstep) -> BeforeOrder:
    state, helm = run.state, run.vehicle.helm
    plans = helm.plans
    return BeforeOrder(
        *(before(run), state.armed, state.killed, state.origin, plans.fence, plans.mission, plans.rally),
        *(helm.limits, helm.rules, helm.paused),
    )


class Orders:
    """The rules of orders, for `before` an order and `after` it."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._fence = run, PlainFence(run)
        self._was, self._whose = aboard(run), whose(run)

    def before(self) -> None:
        self._was, self._whose = aboard(self._run), whose(self._run)

    def after(self, command: console.Commands, why: str | None, payload: str = "") -> Iterator[str]:
        """What is wrong with the answer, in words. `payload`: the program that gave the order; empty: an operator did."""
        now, was, name = aboard(self._run), self._was, str(command.__struct_config__.tag)
        if why is not None:
            if self._whose.helmsman and not payload:  # it takes the boat back all the same, and the reason says so
                was = was._replace(boat=was.boat._replace(reason=now.boat.reason))
            for field, one, other in zip(BeforeOrder._fields, was, now, strict=True):
                if one is not other and one != other:
                    yield f"{name} was refused ({why}), and changed {field}"
            if not why.strip(": "):
                yield f"{name} was refused without a reason"
        if payload:
            yield from self._below(payload, command, why)
            if self._whose.helmsman != payload or (why or "").startswith("refused: "):  # by the rights of programs
                return
        elif not isinstance(command, ASKS | console.Entrust) and self._run.state.helmsman:
            yield f"{name} of an operator left the boat to payload {self._run.state.helmsman}"
        wanted = self._wanted(command)
        if wanted is not None:
            mode, setpoint = wanted
            forbidden = self._forbidden(mode, setpoint)
            if why is None and forbidden:
                yield f"{name} was obeyed, and is forbidden: {forbidden}"
            elif why is not None and forbidden == "":
                yield f"{name} was refused ({why}), and nothing forbids it"
            if why is None:
                yield from self._does(name, mode, setpoint)
        elif (
            why is None
            and isinstance(command, HALTS)
            and (self._run.state.mode is not Mode.IDLE or self._run.state.actuation.run)
        ):
            yield f"{name} was obeyed, and the boat goes on"
        elif isinstance(command, console.Manual) and why is not None:
            is_held = "release the joystick" in why or was.boat.mode is Mode.MANUAL
            if not is_held and self._forbidden(Mode.MANUAL, was.boat.setpoint) == "":
                yield f"{name} was refused ({why}), and nothing forbids it"
        elif isinstance(command, console.Manual):
            yield from self._does(name, Mode.MANUAL, was.boat.setpoint._replace(starboard=command.starboard, port=command.port))

    def _below(self, payload: str, command: console.Commands, why: str | None) -> Iterator[str]:
        """Check that a program did nothing that it may not do."""
        word, table = str(command.__struct_config__.tag), self._run.settings.table("payload").get(payload)
        has = self._whose.helmsman == payload or word in FREE
        if why is None and not (has and table is not None and table.may and (word == "alive" or RIGHT[word] in table.may)):
            yield f"{word} of payload {payload} was obeyed, which may not order it now"
        if whose(self._run)[1:] != self._whose[1:]:
            yield f"{word} of payload {payload} passed for an operator's, or overruled the failsafe"

    def entered(self, command: console.Commands) -> CycleSeen | None:
        """The first step of a mode that an order began, which is done at once. None: the order began none, or continued one, or
        a hand-set may have the boat."""
        run, was, state = self._run, self._was.boat, self._run.state
        is_manual = isinstance(command, console.Manual)
        if run.settings.handset.device or isinstance(command, console.Continue):
            return None
        if not is_manual and self._wanted(command) is None:
            return None
        memory = begun(state.mode, state.setpoint, state.motion)
        began = was._replace(now_s=run.elapsed_s, mode=state.mode, reason=state.reason, setpoint=state.setpoint, memory=memory)
        return CycleSeen(run, began, is_order=True)

    def _wanted(self, command: Any) -> tuple[Mode, Setpoint] | None:
        """The mode and the set points that an order asks for; None: it asks for none, or they depend on more than the order."""
        state, helm = self._run.state, self._run.vehicle.helm
        was, control = self._was.boat, helm.limits.control
        setpoint = was.setpoint
        match command:
            case console.Heading() | console.Course():
                is_heading = isinstance(command, console.Heading)
                asked_deg = command.heading_deg if isinstance(command, console.Heading) else command.course_deg
                setpoint = setpoint._replace(heading_rad=math.radians(asked_deg % 360.0))
                if command.speed_mps is not None:
                    setpoint = setpoint._replace(speed_mps=min(command.speed_mps, control.speed.max_mps))
                elif was.mode is not (Mode.HEADING if is_heading else Mode.COURSE):
                    sails = was.mode not in (Mode.IDLE, Mode.MANUAL, Mode.HOLD) and was.reference.speed_mps is not None
                    asked_mps = was.reference.speed_mps if sails else control.speed.cruise_mps
                    setpoint = setpoint._replace(speed_mps=min(asked_mps or 0.0, control.speed.max_mps))
                return (Mode.HEADING if is_heading else Mode.COURSE), setpoint
            case console.Goto(latitude_deg=float() as latitude, longitude_deg=float() as longitude) if state.origin is not None:
                place = geodesy.to_plane(state.origin, math.radians(latitude), math.radians(longitude))
                asked_mps = control.speed.cruise_mps if command.speed_mps is None else command.speed_mps
                target = Waypoint(*place, min(asked_mps, control.speed.max_mps), control.path.acceptance_m)
                return Mode.GOTO, setpoint._replace(target=target, via=(), end=command.end or control.goto.end)
            case console.Entrust(name=name) if state.helmsman == name:
                return Mode.HOLD, setpoint
            case console.Play():
                return Mode.PLAY, setpoint._replace(leg=command.leg)
            case console.SetMode(mode="idle"):
                return None
            case console.SetMode():
                mode = Mode.__members__.get(command.mode.upper())
                waits = mode is Mode.HOME and bool(self._run.settings.fence.chart)  # until the way home is known
                if (
                    mode is None
                    or waits
                    or command.line is not None
                    or mode in (Mode.HEADING, Mode.COURSE, Mode.GOTO)
                    or getattr(self._was.paused, "mode", None) is mode
                ):
                    return None
                if mode is Mode.MANUAL:
                    setpoint = setpoint._replace(starboard=0.0, port=0.0)
                if mode in (Mode.HOME, Mode.UNSTICK):
                    is_home = mode is Mode.UNSTICK and was.mode is Mode.HOME
                    setpoint = setpoint._replace(track=() if is_home else helm.track.way_home())
                if mode is Mode.PATH:
                    setpoint = setpoint._replace(piece=command.piece or 0)
                return mode, setpoint
        return None

    def _does(self, name: str, mode: Mode, setpoint: Setpoint) -> Iterator[str]:
        """Whether the boat is in the mode, and has the set points."""
        state, is_new = self._run.state, mode is not self._was.boat.mode
        if state.mode is not mode:
            yield f"{name} was obeyed, and the boat is in {state.mode.name.lower()}"
        if not state.armed or not state.has_left_idle:
            yield f"{name} was obeyed, and the boat is not armed"
        if is_new and state.mode_s != self._run.elapsed_s:
            yield f"{name} was obeyed, and the mode is told to have begun at {state.mode_s:.1f} s"
        has = state.setpoint
        if mode is Mode.GOTO and has.target is None and setpoint.target is not None:
            if self._fence.blocks(state.motion, setpoint.target[:2]) is False:
                yield f"{name} was obeyed, and waits, though the way is free"
            setpoint = setpoint._replace(target=None)
        setpoint = setpoint._replace(override_mps=None if is_new else setpoint.override_mps, alone=0.0)
        if is_new and self._was.boat.mode is Mode.PLAY and not self._was.boat.reference.done:  # which goes on with its leg
            setpoint = setpoint._replace(leg=self._was.boat.memory.leg)
        if mode is Mode.HOME and len(has.track) == len(setpoint.track) - 1:  # without the newest point, which a zone is before
            setpoint = setpoint._replace(track=setpoint.track[:-1])
        for field, one, other in zip(Setpoint._fields, has, setpoint, strict=True):
            if one is not other and _differ(one, other):
                yield f"{name} was obeyed, and the {field} is {one}, not {other}"

    def _forbidden(self, mode: Mode, setpoint: Setpoint) -> str | None:
        """The reason, in words, why docs/failsafe.md and docs/control.md forbid a mode; empty: they do not; None: not known
        here."""
        run, state = self._run, self._run.state
        settings, now_s, motion, failsafe = run.vehicle.helm.settings, run.elapsed_s, state.motion, run.settings.failsafe
        is_at_sea, fence = state.has_left_idle, run.vehicle.helm.plans.fence
        if state.inputs or settings.handset.device or settings.driven("nodes", False) or state.fence_lost:
            return None

        def acts(name: str) -> int:
            row = getattr(failsafe, name)
            own = getattr(row, mode.name.lower())
            return ACTIONS.index(row.action if own == "same" else own)

        if state.killed.reason:
            return "the kill"
        if now_s - state.navigation_s > settings.navigation.stale_s and not (is_at_sea and acts("navigation_silent") < STOP):
            return "navigation is silent"
        if not (is_at_sea and acts("sensor_bad") < STOP):
            for node in settings.sysstat.required or ():
                report = state.sysstat.get(node)
                if report is None or now_s - report[1] > settings.sysstat.stale_s or report[0].status is Status.BAD:
                    return f"{node} is bad"
            if settings.sensors.required:
                return None
        if acts("gnss_poor") > 1:
            return None
        needs_log = settings.log.required and mode not in (Mode.MANUAL, Mode.HOME) and not (is_at_sea and acts("log") < STOP)
        if needs_log and run.vehicle.log.reason():
            return "the log is not written"
        reports = [state.sysstat[side][0] for side in BATTERIES if side in state.sysstat]
        charges = [each.charge for each in reports if isinstance(each, BatteriesStatus) and each.charge is not None]
        if min(charges, default=2.0) <= failsafe.battery_critical.charge and acts("battery_critical") == STOP:
            return "batteries are empty"
        if failsafe.battery_critical.voltage_v:
            return None
        if fence is not None and mode is not Mode.MANUAL:
            if "position" not in motion.has or not fence.is_laid:
                return "the fence cannot be watched"
            if (is_outside := self._fence.is_outside(motion)) is None:
                return None
            if is_outside:
                return "the boat is outside the fence"
        if not motion.has >= NEEDS.get(mode, frozenset()):
            return "inputs are missing"
        return self._impossible(mode, setpoint, motion, now_s)

    def _impossible(self, mode: Mode, setpoint: Setpoint, motion: Motion, now_s: float) -> str | None:
        """The reason why the mode itself cannot begin, as `_forbidden`."""
        plan, settings = setpoint.plan, self._run.vehicle.helm.settings
        to: tuple[float, ...] | None = None
        if mode is Mode.GREX:
            if setpoint.guest_heading_rad is None or now_s - self._run.state.guest_s > settings.failsafe.guest_silent.after_s:
                return "the guest is silent"
        elif mode is Mode.HOME:
            if not setpoint.track:
                return "no track was driven"
            first = [self._fence.blocks(motion, point) for point in setpoint.track[-2:]]
            return None if True in first or None in first else ""  # it may leave out the newest
        elif mode is Mode.PLAY:
            if plan is None or not 0 <= setpoint.leg < len(plan.waypoints):
                return "there is no such leg"
            to = plan.waypoints[setpoint.leg][:2]
        elif mode is Mode.PATH:
            if plan is None or not 0 <= setpoint.piece < len(plan.path):
                return "there is no such piece"
            if not isinstance(plan.path[setpoint.piece], Line):
                return None  # an arc
            to = plan.path[setpoint.piece][:2]
        elif mode is Mode.GOTO and setpoint.target is not None:
            to = setpoint.target[:2]
            if self._fence.blocks(motion, (to[0], to[1])) is not False:
                return None  # it is led round, where there is a way
        if to is None:
            return ""
        if math.dist(to, (motion.north_m, motion.east_m)) > 20_000.0:
            return "it is too far away"
        if self._run.vehicle.helm.plans.behind != (0, 0):
            return None
        blocked = self._fence.blocks(motion, (to[0], to[1]))
        return None if blocked is None else "a zone is in the way" if blocked else ""


def _differ(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) > SAME
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other) and len(one) < 8:
        return any(_differ(a, b) for a, b in zip(one, other, strict=True))
    return bool(one != other)
