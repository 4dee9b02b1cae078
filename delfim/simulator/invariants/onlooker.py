"""Checks the invariants: what must never happen to a boat in lock step, whatever fails."""

import math
from collections.abc import Callable
from typing import Final

from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.simulator.invariants.cycle import CycleSeen, Invariant, before
from delfim.simulator.invariants.facts import Batteries, NotedChanges, Plausible, Reported, Struck
from delfim.simulator.invariants.guidance import Beginnings, Guidance
from delfim.simulator.invariants.orders import Orders
from delfim.simulator.invariants.restart import Returns
from delfim.simulator.invariants.thrust import CommandedThrust, ControlLaw, DerivedGains
from delfim.simulator.invariants.troubles import Troubles
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.orders.entrusting import payload_of
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.zones import Point, clearance_m
from delfim.vehicle.state import State

TURNS: Final = 0.0857  # of full command; above this, 120 rpm of DelfimX, a thruster gives relevant thrust
COAST_S: Final = 4.0  # time in which a stopped one comes to rest
ASTRAY_S: Final = 12.0  # the same for one that does not obey: detected, disconnected, coasted
BLIND_S: Final = 0.5  # time beyond the limit until the watchdog acts
ROUNDING_M: Final = 1e-6  # of a clearance, far more than that
NOISE_M: Final = 1.5  # between the true and the measured position
DECEIVED_M: Final = 3.0  # with a larger error of position a boat cannot keep its fence
_TOLD_NOTHING: Final = frozenset(
    {"bus_off", "sensor_silent", "outlet_silent"}
)  # faults after which a propeller is told nothing, or tells nothing
OVERRULE: Final = (
    console.Entrust | console.SetMode | console.Heading | console.Course | console.Goto | console.Play | console.Continue
)
_IDLE: Final = Mode.IDLE  # asked for in each cycle; the lookup in the enumeration takes longer than the comparison


class TruePlace:
    """The true position of the hull, for all who look at a run: computed once in each cycle. Call `look` after it, before
    theirs."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._model = run, run.nodes.model
        self.at: Point | None = None  # in the boat's local plane; None: it has none yet
        self._found: tuple[Fence, Point, float] | None = None  # the clearance of a fence at a place

    def look(self) -> None:
        model, origin = self._model, self._run.state.origin
        if origin is None:
            self.at = None
            return
        latitude_rad, longitude_rad = from_plane(model.origin, model.north_m, model.east_m)
        north_m = (latitude_rad - origin.latitude_rad) * origin.north_m_per_rad
        self.at = north_m, (longitude_rad - origin.longitude_rad) * origin.east_m_per_rad

    def clear_m(self, within_m: float) -> float:
        """The clearance from the fence, negative outside it: exact where it is less than `within_m`. It is not computed again
        before the boat can have come so near: it loses no more than the distance sailed."""
        fence, at = self._run.vehicle.helm.plans.fence, self.at
        if fence is None or at is None or not fence.zones:
            return math.inf
        if self._found is not None and self._found[0] is fence:
            _, there, clear_m = self._found
            if at is there:
                return clear_m
            least_m = clear_m - math.dist(at, there) - ROUNDING_M
            if least_m >= within_m:
                return least_m
        clear_m = min([clearance_m(zone, *at) for zone in fence.zones])
        if not any(zone.areas or zone.field for zone in fence.zones):  # from one area or grid into the next it may lose more
            self._found = fence, at, clear_m
        return clear_m


RULES: Final[tuple[Callable[[Lockstep], Invariant], ...]] = (CommandedThrust, ControlLaw, DerivedGains, Guidance)
FACTS: Final[tuple[Callable[[Lockstep], Invariant], ...]] = (Plausible, Batteries, NotedChanges, Reported, Struck)


class Onlooker:
    """Call `look` after each cycle, `order` to give an order, and `ready` after anything else that changes the boat."""

    def __init__(self, run: Lockstep, *, facts: bool = False) -> None:
        """`facts`: the checks of a caller that calls `look` after each single cycle."""
        self._run, self._drives, self.place = run, run.nodes.model.drives, TruePlace(run)
        self.failures: list[str] = []
        self._uncut = {row.name for _, row in run.settings.driven("nodes", False)}
        self._blind_s = run.settings.failsafe.navigation_silent.after_s + BLIND_S
        self._turning_since_s = math.inf
        self._was_inside, self._astray, self._drifted = True, False, False
        self._orders, self._facts, self._before = Orders(run), facts, before(run)
        self._begin()

    def _begin(self) -> None:
        """Begin with the boat's program as it is: what rules remember of another one does not apply to it."""
        run = self._run
        self._vehicle, self._troubles, self._beginnings = run.vehicle, Troubles(run), Beginnings(run)
        self._rules = [*(rule(run) for rule in (RULES + FACTS if self._facts else RULES)), self._troubles, self._beginnings]
        if run.vehicle is not self._before.handed:
            self._rules.append(Returns(run, self._before))

    def ready(self) -> None:
        """Begin the next cycle."""
        if self._run.vehicle is not self._vehicle:
            self._begin()
        self._before = before(self._run)

    def look(self) -> None:
        run, state = self._run, self._run.state
        now_s, sent = run.elapsed_s, state.actuation
        idle = state.mode is _IDLE
        self.place.look()
        fastest = max(map(abs, sent.thrust))
        tries = state.setpoint.alone  # the operator has one motor turn in idle
        if not fastest <= 1.0 or (fastest and ((idle and not tries) or not sent.run)):
            self._fail(f"commanded {sent}")
        if idle and not state.reason:
            self._fail("stopped without a reason")
        if not idle and now_s - state.navigation_s > self._blind_s:
            self._fail(f"sailing blind in mode {state.mode.name.lower()}")
        if not (idle and self._turns()):
            self._turning_since_s, self._astray = math.inf, False
        else:
            self._adrift(now_s)
        if (around := run.vehicle.helm.plans.fence) is not None:
            self._fenced(around, state, idle)
        if run.vehicle is not self._vehicle:
            self._begin()
        else:
            cycle = CycleSeen(run, self._before)
            self._rules = [rule for rule in self._rules if not self._is_broken(rule, cycle)]
        self._before = before(run)

    def order(self, command: console.Commands, by: str) -> str | None:
        """Give an order, and check its effect."""
        self.ready()
        self._orders.before()
        why = self._run.order(command, by)
        payload = payload_of(by)
        for words in self._orders.after(command, why, payload):
            self._fail(words)
        if why is None and (cycle := self._orders.entered(command)) is not None:
            for rule in self._rules:
                if isinstance(rule, ControlLaw | Guidance) and (words := next(rule.look(cycle), "")):
                    self._fail(words)
        if why is None and not isinstance(command, console.Alive):
            is_hold = isinstance(command, console.Entrust) or (isinstance(command, console.SetMode) and command.mode == "hold")
            self._beginnings.ordered(self._run.state, is_hold=is_hold)
        if self._run.state.mode is not _IDLE:
            self._turning_since_s, self._astray = math.inf, False
        begins = self._run.state.mode_s == self._run.elapsed_s
        if (
            why is None
            and not payload
            and (isinstance(command, OVERRULE) or (begins and isinstance(command, console.Manual | console.Pause)))
        ):
            self._troubles.overruled()
        self.ready()
        return why

    def _is_broken(self, rule: Invariant, cycle: CycleSeen) -> bool:
        """Whether a rule is broken; one that was broken is not checked again."""
        words = next(rule.look(cycle), "")
        if words:
            self._fail(words)
        return bool(words)

    def _turns(self) -> bool:
        """Whether propellers give thrust. One that does not obey, and that the boat cannot cut off, does not count."""
        drives = [drive for name, drive in self._drives.items() if not (drive.fault and name in self._uncut)]
        return any(abs(drive.part) > TURNS for drive in drives)

    def _adrift(self, now_s: float) -> None:
        """Propellers give thrust while nothing steers the boat. Neither a failed bus, nor an outlet that hangs, nor a silent
        node is the boat's fault: it learns afterwards what turns then."""
        on = self._run.faults.on
        if not _TOLD_NOTHING.isdisjoint(on) or any(kind.startswith("frames_") for kind in on):
            self._turning_since_s, self._astray = math.inf, False
            return
        self._turning_since_s = min(self._turning_since_s, now_s)
        self._astray = self._astray or any(drive.fault for drive in self._drives.values())
        if now_s - self._turning_since_s > (ASTRAY_S if self._astray else COAST_S):
            self._fail("adrift under power")

    def _fenced(self, around: Fence, state: State, idle: bool) -> None:
        """A boat that obeys, knows its position and drives must not leave its fence. A stopped boat may drift, and so may one
        that received a wrong position; one that was within the margin when it began to drive, or learnt where it is, may go on
        while it turns, until it has the margin again."""
        at, clear_m = self.place.at, self.place.clear_m(around.limits.margin_m)
        if at is None:
            return
        inside, has_margin = clear_m > -NOISE_M, clear_m >= around.limits.margin_m
        deceived = not has_margin and math.dist(at, (state.motion.north_m, state.motion.east_m)) > DECEIVED_M
        self._drifted = not has_margin and (idle or deceived or self._drifted)
        if self._was_inside and not inside and not self._drifted and not any(drive.fault for drive in self._drives.values()):
            self._fail(f"outside the fence in mode {state.mode.name.lower()}")
        self._was_inside = inside

    def _fail(self, words: str) -> None:
        if not any(words in known for known in self.failures):
            self.failures.append(f"{words} at {self._run.elapsed_s:.1f} s ({self._run.state.reason})")
