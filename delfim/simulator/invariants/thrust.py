"""Thrust is what docs/control.md computes from the motion and the set points, within what docs/propulsion.md allows."""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.simulator.invariants.cycle import NOTHING, Before, CycleSeen
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.control.hull import Gains
from delfim.vehicle.control.memory import Settings
from delfim.vehicle.state import Arc, Line, Motion, Reference

ROUNDING: Final = 1e-9
OFF_N: Final = 0.5  # least force that counts: less than 1e-4 of a thruster's is no command
OFF: Final = 0.004  # of a thruster's force: what yaw, weighted far above surge, gives way where both are too much
SMOOTH: Final = 1e-6  # of an integral
SHORT: Final = 0.01  # of a thruster's force
STAYS_RADPS: Final = math.radians(3.0)  # docs/control.md, anti-windup
TURNS_AWAY_RAD: Final = 0.5


class Pair(NamedTuple):
    """Two fixed thrusters that push ahead on either side of the boat."""

    arms_m: tuple[float, float]  # yaw N m of a newton
    least_n: tuple[float, float]
    most_n: tuple[float, float]
    rows: tuple[config.ThrusterTable, config.ThrusterTable]


def pair_of(rows: Sequence[config.ThrusterTable]) -> Pair | None:
    """The pair of these rows; None: the boat has other thrusters."""
    if len(rows) != 2 or any(row.steer is not None or row.curve or row.angle_deg for row in rows):
        return None
    one, two = rows
    if not one.y_m * two.y_m < 0.0:
        return None
    (least_one, most_one), (least_two, most_two) = one.thrust_n, two.thrust_n
    return Pair((-one.y_m, -two.y_m), (least_one, least_two), (most_one, most_two), (one, two))


def force_n(row: config.ThrusterTable, command: float) -> float:
    """The force of a command, N (docs/propulsion.md)."""
    share = max((abs(command) - row.dead) / (1.0 - row.dead), 0.0)
    return math.copysign(abs(row.thrust_n[command > 0.0]) * share**row.power, command)


def shared(pair: Pair, surge_n: float, yaw_nm: float) -> tuple[float, float]:
    """The forces of both, N: yaw as far as it can be given, and then surge as far as yaw leaves it."""
    (n1, n2), (low1, low2), (high1, high2) = pair.arms_m, pair.least_n, pair.most_n
    ends = [n1 * f1 + n2 * f2 for f1 in (low1, high1) for f2 in (low2, high2)]
    yaw_nm = min(max(yaw_nm, min(ends)), max(ends))
    # f1 = (yaw - n2 surge) / (n1 - n2), f2 = surge - f1: the surge at which either is at an end.
    at = sorted((yaw_nm - (n1 - n2) * f) / n2 for f in (low1, high1))
    by = sorted(((n2 - n1) * f - yaw_nm) / -n1 for f in (low2, high2))
    surge_n = min(max(surge_n, at[0], by[0]), at[1], by[1])
    f1 = (yaw_nm - n2 * surge_n) / (n1 - n2)
    return f1, surge_n - f1


class CommandedThrust:
    """Every command is finite, within full command, no faster than its rate, off when it is off, and what is on the bus."""

    def __init__(self, run: Lockstep) -> None:
        self._rates = tuple(row.rate_per_s for row in run.settings.thrusters)
        steers = [row.steer for row in run.settings.thrusters]  # what is fixed turns by nothing
        self._turns = [
            (math.radians(steer.angle_max_deg), math.radians(steer.rate_dps)) if steer else (0.0, 0.0) for steer in steers
        ]
        self._dsor = [
            (i, run.nodes.model.drives[row.name], run.settings.rpm_max(row)) for i, row in run.settings.driven("nodes")
        ]
        self._quiet_s = 0.0

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, was = cycle.state, cycle.was
        thrust, run = state.actuation.thrust, state.actuation.run
        passed_s = min(max(cycle.run.vehicle.propulsion.sent_s - was.sent_s, 0.0), 1.0)
        if len(thrust) != len(self._rates):
            yield f"{len(thrust)} commands for {len(self._rates)} thrusters"
        elif run and cycle.run.vehicle is was.handed:
            for part, before, rate in zip(thrust, was.sent.thrust, self._rates, strict=True):
                if part and abs(part - before) > rate * passed_s + ROUNDING:  # off is at once
                    yield f"thrust from {before:.3f} to {part:.3f} in {passed_s:.1f} s"
        for angle_rad, before, (most_rad, rate) in zip(state.actuation.angle_rad, was.sent.angle_rad, self._turns, strict=True):
            if abs(angle_rad) > most_rad + ROUNDING or abs(wrap(angle_rad - before)) > rate * passed_s + ROUNDING:
                yield f"a thruster turned from {before:.3f} to {angle_rad:.3f} rad in {passed_s:.1f} s"
        if cycle.run.faults.busy:
            self._quiet_s = cycle.now_s + 2.0
        if cycle.now_s > self._quiet_s and cycle.now_s - state.navigation_s < 1.0:
            for i, drive, rpm_max in self._dsor:
                if drive.run is not run or (run and abs(drive.reference_rpm - thrust[i] * rpm_max) > 0.5 + ROUNDING):
                    yield f"commanded {thrust[i]:.3f} ({run}), and the bus says {drive.reference_rpm:.0f} rpm ({drive.run})"


def command(row: config.ThrusterTable, force_n: float) -> float:
    """The command for a force."""
    share = abs(force_n / row.thrust_n[force_n > 0.0])
    return math.copysign(row.dead + (1.0 - row.dead) * share ** (1.0 / row.power), force_n) if share >= 1e-4 else 0.0


def bounded(value: float, most: float) -> float:
    return min(max(value, -most), most)


class LawStep(NamedTuple):
    """The output of the control law, and its memory after that."""

    surge_n: float
    yaw_nm: float
    held_nm: float  # the integrals
    push_n: float
    speed_mps: float  # after the ramp


def law(before: Before, motion: Motion, reference: Reference, limits: Settings, dt_s: float, turn_radps: float) -> LawStep:
    """One step of the control law (docs/control.md, "Autopilot")."""
    was, short, gains, hull, speed = before.memory.integrals, before.short, limits.gains, limits.hull, limits.control.speed
    assert reference.heading_rad is not None
    assert reference.speed_mps is not None
    error_rad = wrap(reference.heading_rad - motion.heading_rad)
    ahead = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
    made_mps = motion.north_mps * ahead[0] + motion.east_mps * ahead[1]
    turning_radps = turn_radps - motion.yaw_rate_radps
    ramped_mps = was.speed_mps + bounded(bounded(reference.speed_mps, speed.max_mps) - was.speed_mps, speed.ramp_mps2 * dt_s)
    more = 1.0 + limits.control.heading.ahead_per_mps * max(made_mps, 0.0)
    yaw_nm = bounded(more * gains.p_nm_per_rad * error_rad, gains.p_limit_nm) + gains.d_nm_per_radps * turning_radps
    yaw_nm += gains.turn_nm_per_radps * turn_radps + was.yaw_nm
    wanted_mps = ramped_mps * max(math.cos(error_rad), 0.0)
    lag_mps = wanted_mps - made_mps if "velocity" in motion.has else 0.0
    surge_n = (hull.drag_n_per_mps + hull.drag_n_per_mps2 * abs(wanted_mps)) * wanted_mps + was.surge_n
    surge_n, short_n, held_nm, push_n = surge_n + gains.p_n_per_mps * lag_mps, short[0], was.yaw_nm, was.surge_n
    if (ramped_mps >= 0.0 > surge_n) or (ramped_mps < 0.0 < surge_n):  # an order ahead never asks for surge astern
        surge_n, short_n = 0.0, surge_n
    if abs(error_rad) < TURNS_AWAY_RAD:
        if abs(turning_radps) < STAYS_RADPS and error_rad * short[2] <= 0.0:
            held_nm = bounded(held_nm + more * gains.i_nm_per_rad_s * error_rad * dt_s, gains.i_limit_nm)
        if lag_mps * short_n <= 0.0:
            push_n = bounded(push_n + gains.i_n_per_m * lag_mps * dt_s, gains.i_limit_n)
    return LawStep(surge_n, yaw_nm, held_nm, push_n, ramped_mps)


class ControlLaw:
    """In each mode that steers, the two thrusters of a boat give the yaw moment and the surge of the control law."""

    def __init__(self, run: Lockstep) -> None:
        self._pair = pair_of(run.settings.thrusters)

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, pair, after = cycle.state, self._pair, cycle.memory.integrals
        if not cycle.steered or pair is None or state.failed or state.reference.reason:
            return
        if state.mode in (Mode.IDLE, Mode.TRIAL) or state.reference.done:  # the pieces of a trial obey no law
            return
        if not state.actuation.run:
            if state.mode is not Mode.GREX or state.setpoint.guest_heading_rad is not None:
                yield f"under way in {state.mode.name.lower()}, and the thrusters are off"
            return
        if state.mode is Mode.HEADING and cycle.run.settings.control.heading.turn_dps is not None:  # nobody tells its reference
            return
        reference, short = state.reference, cycle.run.vehicle.propulsion.short or NOTHING
        forces, asked = (0.0, 0.0), None
        if state.mode is Mode.MANUAL:
            if cycle.run.settings.handset.device:  # its sticks move after the step that is looked at
                return
            sides = [state.setpoint.starboard if row.y_m > 0.0 else state.setpoint.port for row in pair.rows]
        elif reference.heading_rad is None or reference.speed_mps is None:
            sides = [0.0, 0.0]
        else:
            asked = law(cycle.was, state.motion, reference, cycle.run.vehicle.helm.limits, cycle.dt_s, _turn_radps(cycle))
            forces = shared(pair, asked.surge_n, asked.yaw_nm)
            sides = [command(row, each) for row, each in zip(pair.rows, forces, strict=True)]
        for part, before, row, side in zip(state.actuation.thrust, cycle.was.sent.thrust, pair.rows, sides, strict=True):
            wanted = bounded(before + bounded(side - before, row.rate_per_s * cycle.dt_s), 1.0)
            if abs(force_n(row, part) - force_n(row, wanted)) > OFF_N + OFF * max(pair.most_n):
                yield f"{row.name} thrust {part:.3f}, and {state.mode.name.lower()} asks for {wanted:.3f}"
        if asked is None:
            return
        for name, has, should in zip(
            ("yaw", "surge", "speed"), (after.yaw_nm, after.surge_n, after.speed_mps), asked[2:], strict=True
        ):
            if abs(has - should) > SMOOTH:
                yield f"the memory of {name} is {has:.3f}, not {should:.3f}"
        given_n, given_nm = sum(forces), sum(n * f for n, f in zip(pair.arms_m, forces, strict=True))
        if abs(short[0] - asked.surge_n + given_n) > SHORT * max(pair.most_n) or abs(
            short[2] - asked.yaw_nm + given_nm
        ) > SHORT * max(pair.most_n):
            left_n, left_nm = asked.surge_n - given_n, asked.yaw_nm - given_nm
            yield f"short of {short[0]:.0f} N, {short[2]:.0f} N m, not {left_n:.0f}, {left_nm:.0f}"


def _turn_radps(cycle: CycleSeen) -> float:
    """The rate of turn of the path itself."""
    plan, leg, speed_mps = cycle.state.setpoint.plan, cycle.was.memory.leg, cycle.state.reference.speed_mps
    if cycle.state.mode is not Mode.PATH or plan is None or speed_mps is None:
        return 0.0
    piece = plan.path[leg] if leg >= 0 else None
    if isinstance(piece, Arc):
        return math.copysign(speed_mps / piece.radius_m, piece.turn_rad)
    return _turn_onto(cycle, piece, speed_mps)


def _turn_onto(cycle: CycleSeen, piece: Line | None, speed_mps: float) -> float:
    """That of atan(y / ahead) on a line; None: on the way to the path. Farther off the boat comes back at 45 degrees."""
    was, to, motion, ahead_m = cycle.was.memory, cycle.state.reference, cycle.state.motion, _ahead_m(cycle)
    off_m, left_m, plan = to.cross_track_m, to.distance_m, cycle.state.setpoint.plan
    if was.left_s > 0.0 or plan is None or off_m is None or left_m is None or to.north_m is None or to.east_m is None:
        return 0.0
    stops = piece is not None and (piece.hold_s > 0.0 or was.leg == len(plan.path) - 1)
    if abs(off_m) > ahead_m and not (stops and left_m < abs(off_m)):
        return 0.0
    from_n, from_e = piece[:2] if piece is not None else (was.north_m, was.east_m)
    along_m = math.hypot(to.north_m - from_n, to.east_m - from_e)
    if not along_m:
        return 0.0
    aside_mps = ((to.north_m - from_n) * motion.east_mps - (to.east_m - from_e) * motion.north_mps) / along_m
    return -bounded(aside_mps, speed_mps) * ahead_m / (ahead_m**2 + off_m**2)


def _ahead_m(cycle: CycleSeen) -> float:
    return cycle.run.vehicle.helm.limits.control.path.lookahead_m


class DerivedGains:
    """Gains that the vehicle's file does not give, and the drag, follow from its hull as docs/control.md says."""

    def __init__(self, run: Lockstep) -> None:
        self._pair, self._settings = pair_of(run.settings.thrusters), run.settings
        self._limits: Settings | None = None

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        limits = cycle.run.vehicle.helm.limits
        if limits is self._limits or self._pair is None:
            return
        self._limits, boat = limits, self._settings.boat
        if boat.mass_kg is None or boat.full_mps is None or boat.drag_n_per_mps is not None or boat.drag_n_per_mps2 is not None:
            return
        if boat.inertia_kgm2 is not None or boat.yaw_nm_per_radps is not None:
            return
        ahead_n, sides = sum(self._pair.most_n), list(zip(*self._pair[:3], strict=True))
        most_nm = min(sum(max(k * n * low, k * n * high) for n, low, high in sides) for k in (1.0, -1.0))
        inertia, water = boat.mass_kg * (0.465 * boat.length_m) ** 2, 10.0 * boat.length_m**3
        natural = min(0.83 * math.sqrt(4.5 / boat.length_m), 1.0)
        total = max(2.4 * natural * inertia, water + 0.3 * natural * inertia)
        p_nm, p_n = natural * total / 2.4, 0.8 * 1.05 * boat.mass_kg
        limit_nm = min(p_nm, 0.75 * most_nm)
        made = (
            p_nm,
            limit_nm,
            max(total - water, 0.5 * total),
            water,
            p_nm / 23.0,
            0.22 * limit_nm,
            p_n,
            p_n / 4.0,
            0.5 * ahead_n,
        )
        tables = self._settings.control.heading, self._settings.control.speed
        changed = cycle.run.vehicle.helm.changed
        for name, has, should in zip(Gains._fields, limits.gains, made, strict=True):
            given = any(getattr(table, name, None) is not None for table in tables) or any(name in key for key in changed)
            if not given and abs(has - should) > SMOOTH * should:
                yield f"{name} is {has:.3f}, and follows from the hull as {should:.3f}"
        drag = ahead_n / boat.full_mps**2
        if abs(limits.hull.drag_n_per_mps2 - drag) > SMOOTH * drag or limits.hull.drag_n_per_mps:
            yield f"drag {limits.hull.drag_n_per_mps:.3f} and {limits.hull.drag_n_per_mps2:.3f}, not 0 and {drag:.3f}"
