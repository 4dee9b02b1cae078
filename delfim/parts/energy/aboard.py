"""The energy aboard: once a second the boat learns what it draws and where it drifts, and reckons the way home.

Costs by direction and the way home are reckoned in slices, for a track has thousands of points. On the way home the boat goes
as slowly as it must to come home with the reserve.
"""

import math
from typing import Final, NamedTuple

from delfim.base.cooperative import Sliced, Work
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus
from delfim.parts.energy.consumption import Consumption, Propulsive
from delfim.parts.energy.drift import Drifting
from delfim.parts.energy.gauge import Gauge
from delfim.parts.energy.reach import Point, ahead_of, costs, doubt, joules, metres
from delfim.parts.energy.table import EnergyTable
from delfim.parts.energy.wayback import WayBack
from delfim.vehicle.aboard import Added, OpenedWith
from delfim.vehicle.failsafe.troubles import charge
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.report import EnergyFacts
from delfim.vehicle.state import Actuation, Plan, State

EACH_S: Final = 1.0
SMOOTH_S: Final = 8.0  # of push and velocity: as long as a boat needs to follow its thrusters
SLOW_S: Final = 24.0  # the push of so long is compared with it ...
STEADY: Final = 0.05  # ... and where they differ by more, of full push, the boat gathers way or loses it
SETTLED_S: Final = 16.0  # it went straight with one push for so long: it has the way that the push gives
UNDER_WAY: Final = 0.03  # of full push: a boat with less drifts, aside and faster
TURNING_RADPS: Final = math.radians(4.0)  # a boat that turns more quickly does not go where it points
SIGMAS: Final = 0.5  # of what is not known of the way home, kept beside the reserve
SLOWER: Final = 0.85, 0.7, 0.55  # of the speed of the way home, which saves energy ...
SHORT: Final = 0.9  # ... where less than this part of the reserve would be left
UNSURE_S: Final = 60.0  # before that, nothing is said of the range
W_PER_N: Final = 8.0  # of small electric motors at full thrust: those of maker's pages draw 6 to 12
FARTHEST_M: Final = 1e6


class Reckoned(NamedTuple):
    """J/m by direction; J of the way home with its standard deviation, of this plan with its way home (NaN: unknown), and of
    the way home by speed, m/s, from that of the file on; one only where the boat is not on its way."""

    by_direction: tuple[float, ...] = ()
    home_j: float = math.nan
    unsure_j: float = 0.0
    plan: Plan | None = None
    plan_j: float = math.nan
    by_speed: tuple[tuple[float, float], ...] = ()


class EnergyWatch:
    """Nothing of it raises; without batteries that tell their charge it says why it reckons nothing."""

    def __init__(self, boat: OpenedWith) -> None:
        settings, self._state = boat.settings, boat.state
        self._table, self._speed_mps = settings.of(EnergyTable), settings.control.home.speed_mps
        self._stale_s = settings.sysstat.stale_s
        self._hull: Propulsive | None = None  # until the helm tells it
        self._consumption: Consumption
        self._drifting: Drifting
        self._most_mps = settings.control.speed.max_mps
        self._push = self._slow = self._north_mps = self._east_mps = self._watts = 0.0  # smoothed
        self._steady_s, self._next_s = 0.0, -math.inf
        self._gauge, self._log = Gauge(self._table.capacity_wh), boat.log
        self._work: Sliced[Reckoned] | None = None
        self._found = Reckoned()
        self._back, self._looks_back = WayBack(), False
        self._spared_mps: float | None = None  # the speed of the way home that saves energy

    def look(self, helm: Helm, now_s: float) -> None:
        if self._hull is None:
            craft = helm.limits.hull
            self._hull = Propulsive((craft.drag_n_per_mps, craft.drag_n_per_mps2), craft.ahead_n)
            self._drifting = Drifting(self._speed_mps, is_guessed=not craft.drag_n_per_mps)
            self._consumption = Consumption(self._hull, self._table.idle_w, self._table.full_w or W_PER_N * craft.ahead_n)
        if now_s >= self._next_s:
            dt_s = min(now_s - self._next_s + EACH_S, 5.0) if self._next_s > -math.inf else EACH_S
            self._next_s = now_s + EACH_S
            watts = power(self._state, self._stale_s, now_s)
            self._learn(helm, self._hull, watts, dt_s)
            self._state.energy = now = self._told(watts)
            self._gauge.learn(now.left_wh, watts, dt_s)
            self._spare(now.left_wh)
        elif self._looks_back and self._back.look(helm, self._speed_mps):
            self._looks_back = False
        elif self._work is None:
            self._work = Sliced(self._reckoned(min(self._hull.full_mps, self._most_mps), helm.track.way_home()))
        else:
            self._looks_back = True  # each has every second slice
            if self._work.step():
                self._found, self._work = self._work.result, None

    def _learn(self, helm: Helm, hull: Propulsive, watts: float | None, dt_s: float) -> None:
        state, motion, still_mps = self._state, self._state.motion, 0.0
        is_known = {"heading", "velocity"} <= motion.has
        self._drifting.pass_by(dt_s)
        share, push = 1.0 - math.exp(-dt_s / SMOOTH_S), pushed_n(helm, state.actuation) / hull.ahead_n
        self._push += share * (push - self._push)
        self._slow += (1.0 - math.exp(-dt_s / SLOW_S)) * (push - self._slow)
        self._watts += share * ((watts or 0.0) - self._watts)
        if is_known:
            self._north_mps += share * (motion.north_mps - self._north_mps)
            self._east_mps += share * (motion.east_mps - self._east_mps)
        is_steady = abs(self._push - self._slow) < STEADY and abs(motion.yaw_rate_radps) < TURNING_RADPS
        self._steady_s = self._steady_s + dt_s if is_steady and self._push >= UNDER_WAY else 0.0
        if self._steady_s >= SETTLED_S and is_known:
            still_mps = hull.still_mps(self._push)
            self._drifting.learn(still_mps, motion.heading_rad, self._north_mps, self._east_mps, dt_s)
        elif state.actuation.run:
            return
        if watts is not None:
            self._consumption.learn(still_mps, self._watts if still_mps else watts, dt_s)

    def _reckoned(self, most_mps: float, track: tuple[Point, ...]) -> Work[Reckoned]:
        """The way home leads back along the track; the plan's, from its last place to the track's end."""
        power_of, drift = self._consumption, self._drifting.found
        by_direction = yield from costs(power_of, drift, most_mps, self._speed_mps)
        motion, state = self._state.motion, self._state
        here = ((motion.north_m, motion.east_m),) if "position" in motion.has else ()
        home_m = yield from metres((*here, *reversed(track)))
        by_speed = [(self._speed_mps, joules(home_m, by_direction))]
        for part in SLOWER if state.mode is Mode.HOME else ():
            slower = yield from costs(power_of, drift, most_mps, part * self._speed_mps)
            by_speed.append((part * self._speed_mps, joules(home_m, slower)))
        plan, plan_j = state.setpoint.plan, math.nan
        turns = self._back.turns
        if plan is not None and here and turns is not None:
            is_sailed = state.mode in (Mode.PLAY, Mode.PATH)
            places, speed_mps = yield from ahead_of(plan, state.reference.leg if is_sailed else 0)
            as_planned = yield from costs(power_of, drift, most_mps, speed_mps)
            plan_m = yield from metres((*here, *places))
            back_m = yield from metres((*places[-1:], *turns, *(track[:1] or here)))
            plan_j = joules(plan_m, as_planned) + joules(back_m, by_direction)
        unsure_j = doubt(home_m, by_direction, drift)
        return Reckoned(tuple([each.joules for each in by_direction]), by_speed[0][1], unsure_j, plan, plan_j, tuple(by_speed))

    def _spare(self, left_wh: float | None) -> None:
        """The boat slows down on its way home where it would not come home with the reserve, and slowness helps. The operator's
        own speed stays."""
        state, was_mps = self._state, self._spared_mps
        if state.setpoint.override_mps not in (None, was_mps):
            self._spared_mps = None
            return
        mps = None
        if state.mode is Mode.HOME and left_wh is not None and self._found.by_speed:
            mps = self._slowed(left_wh, was_mps or self._speed_mps)
        if mps != was_mps and (mps is None or self._found.by_speed[1:]):
            state.setpoint, self._spared_mps = state.setpoint._replace(override_mps=mps), mps
            if state.mode is Mode.HOME:
                self._log.note(f"energy: home at {mps or self._speed_mps:.2f} m/s, to come home with the reserve")

    def _slowed(self, left_wh: float, now_mps: float) -> float | None:
        """The fastest speed that leaves enough, or the one that leaves most; None: that of the file."""
        reserve_wh, per = self._table.reserve * self._table.capacity_wh, self._gauge.per / 3600.0
        for mps, home_j in self._found.by_speed:
            if left_wh - per * home_j >= (SHORT if mps <= now_mps else 1.0) * reserve_wh:
                break
        else:
            mps = min(self._found.by_speed, key=lambda each: each[1])[0]
        return None if mps == self._speed_mps else mps

    def _told(self, watts: float | None) -> EnergyFacts:
        table, drift = self._table, self._drifting.found
        least, batteries = charge(self._state)
        why = "" if batteries else "no battery tells its charge"
        left_wh = least * table.capacity_wh if batteries else None
        usable_wh = max((left_wh or 0.0) - table.reserve * table.capacity_wh, 0.0)
        found, per = self._found, self._gauge.per / 3600.0
        plan_j = found.plan_j if found.plan is self._state.setpoint.plan else math.nan  # a new plan is not reckoned yet
        sure = self._consumption.learnt_s >= UNSURE_S
        return EnergyFacts(
            left_wh=None if left_wh is None else round(left_wh, 1),
            home_wh=round(per * found.home_j, 1) if math.isfinite(found.home_j) else None,
            doubt_wh=round(SIGMAS * per * found.unsure_j, 1),
            plan_wh=round(per * plan_j, 1) if math.isfinite(plan_j) else None,
            reserve_wh=round(table.reserve * table.capacity_wh, 1),
            power_w=None if watts is None else round(watts, 1),
            range_m=tuple(
                [round(min(usable_wh / (per * each), FARTHEST_M)) for each in found.by_direction] if left_wh is not None else []
            ),
            current_mps=round(math.hypot(drift.north_mps, drift.east_mps), 2),
            current_deg=round(math.degrees(math.atan2(drift.east_mps, drift.north_mps)) % 360.0),
            no_way_home=found.home_j == math.inf,
            why=why or ("" if sure else "by the file: the batteries have not told for a minute yet"),
        )

    def report(self, now_s: float) -> dict[str, object]:
        return {}  # the state has it


def pushed_n(helm: Helm, sent: Actuation) -> float:
    """The force ahead of these commands in still water, N, as the vehicle's file has it."""
    if not sent.run:
        return 0.0
    rows = zip(helm.propulsion.allocation.thrusters, sent.thrust, sent.angle_rad, strict=False)
    return sum(each.curve.force(thrust) * math.cos(each.angle_rad + angle_rad) for each, thrust, angle_rad in rows)


def power(state: State, stale_s: float, now_s: float) -> float | None:
    """The power that all batteries give, or else all thrusters take, W; None: one of them does not tell."""
    batteries = [(report, at_s) for report, at_s in state.sysstat.values() if isinstance(report, BatteriesStatus)]
    drawn = [_drawn(report.voltage_v, report.current_a, now_s - at_s <= stale_s) for report, at_s in batteries]
    if not drawn or None in drawn:
        drawn = [_drawn(each.voltage_v, each.current_a, now_s - each.heard_s <= stale_s) for each in state.thrusters.values()]
    return max(sum(each or 0.0 for each in drawn), 0.0) if drawn and None not in drawn else None


def _drawn(volts: float | None, amperes: float | None, is_fresh: bool) -> float | None:
    return volts * amperes if is_fresh and volts is not None and amperes is not None else None


def opened(boat: OpenedWith) -> Added:
    """Open the watch of the energy."""
    return Added(EnergyWatch(boat))
