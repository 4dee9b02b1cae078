"""What a vehicle's file says of its boat, as the prior of a fit; where it says nothing, what the simulator guesses."""

import math
from typing import Final, NamedTuple

from delfim import config
from delfim.adoption.fitting import Prior
from delfim.adoption.model import NUMBERS, PLACE, SPREADS, MotorPush, SteeringGear, internal
from delfim.adoption.suited import along_n, at_side, hull_unfit, is_several, place_of, unfit
from delfim.base.errors import DelfimError
from delfim.simulator.model import hull_of
from delfim.vehicle.control.hull import craft, full_mps

LINEAR: Final = 0.2  # of the drag at full speed, that is linear, where the file says a speed alone
LEAST: Final = 0.01  # of a factor: what is nothing in the file may be something
DEAD: Final = 0.04  # of full command: motors have a dead band, whether their file says so or not
UNEVEN: Final = 0.25, 0.2  # spread of thrust, and of turning, of those at starboard over those at port, logarithms
LEAST_N: Final = 0.05  # of a motor that gives nothing astern
LAG_S, DELAY_S, LATE_S, LOSS = 0.25, 0.15, 0.1, 0.03  # a first guess


class Motor(NamedTuple):
    """A row of the file as the fit sees it, or all at a side that a trial commands alike."""

    row: int  # its place among the thrusters; of several the first
    name: str
    sign: float  # with which its part pushes the boat ahead
    aside_m: float  # from the middle, not less than zero
    rows: tuple[int, ...]  # all of them


class Motors(NamedTuple):
    starboard: Motor
    port: Motor


def gear_of(vehicle: config.Vehicle) -> SteeringGear | None:
    """What turns the one motor of a boat that steers; None: she is another boat."""
    if len(vehicle.thrusters) > 1 or unfit(vehicle.thrusters):
        return None
    row = vehicle.thrusters[0]
    assert row.steer is not None
    return SteeringGear(row.steer.kind == "rudder", math.copysign(1.0, row.x_m), math.radians(row.steer.angle_max_deg))


def motors_of(vehicle: config.Vehicle) -> Motors:
    """The motor at each side; that of a boat that steers twice. Raises DelfimError for boats that have other thrusters."""
    if gear_of(vehicle) is not None:
        row = vehicle.thrusters[0]
        return Motors(*(Motor(0, row.name, 1.0, abs(row.x_m), (0,)),) * 2)
    if is_several(vehicle.thrusters):
        return _of_several(vehicle)
    found = dict[str, Motor]()
    for index, row in enumerate(vehicle.thrusters):
        if row.steer is not None or row.angle_deg % 180.0 or not row.y_m:
            what = "turns" if row.steer is not None else "is in the middle" if not row.y_m else "pushes aside"
            raise DelfimError(
                f"{row.name} {what}: only boats with one fixed motor at each side, or one that steers, can be identified yet"
            )
        side = "starboard" if row.y_m > 0.0 else "port"
        if side in found:
            raise DelfimError(
                f"there are two motors to {side}: only boats with one at each side, or one that steers, can be identified yet"
            )
        found[side] = Motor(index, row.name, 1.0 if row.angle_deg % 360.0 == 0.0 else -1.0, abs(row.y_m), (index,))
    if len(found) < 2:
        raise DelfimError(
            "there is a motor at one side alone: only boats with one at each side, or one that steers, can be identified yet"
        )
    return Motors(**found)


def _of_several(vehicle: config.Vehicle) -> Motors:
    """All at each side, as one motor: the arm is that of what they give together."""
    rows, found = vehicle.thrusters, list[Motor]()
    if why := unfit(rows):
        raise DelfimError(f"the hull of this boat cannot be identified: {why}")
    for side in (1, -1):
        its = at_side(rows, side)
        moment = sum(along_n(rows[at]) * abs(place_of(rows[at]).turn_m / place_of(rows[at]).ahead) for at in its)
        arm_m = moment / max(sum(along_n(rows[at]) for at in its), LEAST_N)
        found.append(Motor(its[0], rows[its[0]].name, float(place_of(rows[its[0]]).way), arm_m, its))
    return Motors(*found)


def pushes_of(vehicle: config.Vehicle) -> tuple[MotorPush, ...]:
    """What each of three or four fixed motors does, for a fit of commands that are not alike at a side; nothing of fewer."""
    if not is_several(vehicle.thrusters):
        return ()
    motors, found, across = motors_of(vehicle), list[MotorPush](), hull_unfit(vehicle.thrusters)
    arm_m = 0.5 * (motors.starboard.aside_m + motors.port.aside_m)
    side_n = math.sqrt(math.prod(max(*_ends_n(vehicle, motor), LEAST_N) for motor in motors))
    for index, row in enumerate(vehicle.thrusters):
        its, (low, high) = place_of(row), row.ends_n
        side = next((side for side, motor in zip((1, -1), motors, strict=True) if index in motor.rows), 0)
        way = its.way or 1
        if side:
            share = along_n(row) / abs(its.ahead) / sum(along_n(vehicle.thrusters[at]) for at in motors[side < 0].rows)
            shares = share, share
        else:
            shares = high / side_n, -low / side_n
        beside = motors[side < 0].rows if side else ()
        within = 0.5 - beside.index(index) if len(beside) == 2 and across else 0.0
        found.append(MotorPush(side, way * its.ahead, way * its.aside, way * its.turn_m / arm_m, within, shares))
    return tuple(found)


def _ends_n(vehicle: config.Vehicle, motor: Motor) -> list[float]:
    """The larger and the smaller force of its full commands, along the keel, of all together."""
    if len(motor.rows) == 1:
        return sorted((abs(end) for end in vehicle.thrusters[motor.row].ends_n), reverse=True)
    its = [(abs(place_of(vehicle.thrusters[at]).ahead), vehicle.thrusters[at].ends_n) for at in motor.rows]
    return [sum(along * of(map(abs, ends)) for along, ends in its) for of in (max, min)]


def prior(vehicle: config.Vehicle) -> Prior:
    """The numbers from which a fit begins and how wrong each may be; and those of the file, as the simulator has them."""
    starboard, port = motors_of(vehicle)
    rows = [vehicle.thrusters[motor.row] for motor in (starboard, port)]
    ends = [_ends_n(vehicle, motor) for motor in (starboard, port)]
    uneven, uneven_astern = (math.log(max(ends[0][at], LEAST_N) / max(ends[1][at], LEAST_N)) for at in (0, 1))
    ahead_n, astern_n = (math.sqrt(max(ends[0][at], LEAST_N) * max(ends[1][at], LEAST_N)) for at in (0, 1))
    told = {number.name: 1.0 if number.is_factor else 0.0 for number in NUMBERS} | {
        "ahead": ahead_n / craft(vehicle).mass_kg,
        "astern": astern_n / ahead_n,
        "ahead_uneven": uneven,
        "astern_uneven": uneven_astern - uneven,
        "power": 2.0 if rows[0].curve else rows[0].power,
        "dead_starboard": rows[0].dead,
        "dead_port": rows[1].dead,
        "delay": rows[0].delay_s,
        "late": LATE_S,
    }
    twin = _of_the_twin(vehicle)
    likely = {"delay": DELAY_S, "dead_starboard": DEAD, "dead_port": DEAD, "loss": LOSS, "lag": LAG_S}
    centre = (
        told | {name: value for name, value in likely.items() if not told[name] or name == "lag"} | (twin or _likely(vehicle))
    )
    spreads = SPREADS.copy()
    if is_several(vehicle.thrusters):  # what stands for a motor are some, each as wrong as one
        spreads[[PLACE["ahead_uneven"], PLACE["arm_uneven"]]] = UNEVEN
    return Prior(internal(centre), spreads, internal(told | (twin or _guessed(vehicle))))


def _likely(vehicle: config.Vehicle) -> dict[str, float]:
    """A first guess of the hull from what the autopilot reckons with: a fit comes from it to the right minimum more surely than
    from the simulator's hull, with which the file is compared."""
    hull, boat, (starboard, port) = craft(vehicle), vehicle.boat, motors_of(vehicle)
    full, mass_kg = full_mps(boat), hull.mass_kg
    linear, square = hull.drag_n_per_mps, hull.drag_n_per_mps2
    if boat.drag_n_per_mps is None and boat.drag_n_per_mps2 is None:
        linear, square = LINEAR * hull.ahead_n / full, (1.0 - LINEAR) * hull.ahead_n / full**2
    damping = hull.damping_nm_per_radps / hull.inertia_kgm2
    return {
        "surge": max(linear, 0.02 * hull.ahead_n / full) / mass_kg,
        "surge2": max(square, 0.02 * hull.ahead_n / full**2) / mass_kg,
        "sway": 0.3,
        "sway2": 1.0,
        "sway_ahead": 0.3,
        "surge_turning": 1.6,
        "sway_turning": 0.65,
        "arm": 0.5 * (starboard.aside_m + port.aside_m) * mass_kg / hull.inertia_kgm2,
        "yaw": 0.5 * damping,
        "yaw2": 0.5 * damping,
        "yaw_ahead": 0.25 * damping,
    }


def _guessed(vehicle: config.Vehicle) -> dict[str, float]:
    """The numbers of the hull that the simulator makes of the file, with what the file says of turning."""
    boat, its, (starboard, port) = vehicle.boat, hull_of(vehicle), motors_of(vehicle)
    mass_kg, aside_kg = craft(vehicle).mass_kg, its.mass_kg + its.added_sway_kg
    inertia = boat.inertia_kgm2 or its.inertia_kgm2 + its.added_yaw_kgm2
    lift, lift_m = its.lift_kg_per_m, its.lift_m
    yaw, yaw2, ahead = its.yaw_nm_per_radps, its.yaw_nm_per_radps2, lift * lift_m**2
    if boat.yaw_nm_per_radps is not None:  # at cruising speed
        yaw, ahead = 0.7 * boat.yaw_nm_per_radps, 0.3 * boat.yaw_nm_per_radps / vehicle.control.speed.cruise_mps
        yaw2 = boat.yaw_nm_per_radps2 or yaw2
    factors = {
        "lag": its.motor_s,
        "surge": its.surge_n_per_mps / mass_kg,
        "surge2": its.surge_n_per_mps2 / mass_kg,
        "sway": its.sway_n_per_mps / aside_kg,
        "sway2": its.sway_n_per_mps2 / aside_kg,
        "sway_ahead": lift / aside_kg,
        "surge_turning": aside_kg / mass_kg,
        "sway_turning": (mass_kg - lift * lift_m) / aside_kg,
        "arm": 0.5 * (starboard.aside_m + port.aside_m) * mass_kg / inertia,
        "yaw": yaw / inertia,
        "yaw2": yaw2 / inertia,
        "yaw_ahead": ahead / inertia,
    }
    return {name: max(value, LEAST) for name, value in factors.items()} | {
        "munk": (aside_kg - mass_kg - lift * lift_m) / inertia,
    }


def _of_the_twin(vehicle: config.Vehicle) -> dict[str, float]:
    """The numbers that an earlier fit found, as the simulator has them: what is other now has changed since."""
    its = vehicle.table("simulation").hull
    if not its.mass_kg:
        return {}
    starboard, port = motors_of(vehicle)
    return {
        "lag": vehicle.thrusters[starboard.row].lag_s or LAG_S,
        "surge": its.surge_n_per_mps / its.mass_kg,
        "surge2": its.surge_n_per_mps2 / its.mass_kg,
        "sway": its.sway_n_per_mps / its.mass_aside_kg,
        "sway2": its.sway_n_per_mps2 / its.mass_aside_kg,
        "sway_ahead": its.sway_ahead_n_per_mps2 / its.mass_aside_kg,
        "sway_yaw": its.sway_yaw_n_per_radps / its.mass_aside_kg,
        "sway_turning": its.mass_kg / its.mass_aside_kg,
        "surge_turning": its.mass_turning_kg / its.mass_kg,
        "arm": 0.5 * (starboard.aside_m + port.aside_m) * its.mass_kg / its.inertia_kgm2,
        "yaw": its.yaw_nm_per_radps / its.inertia_kgm2,
        "yaw2": its.yaw_nm_per_radps2 / its.inertia_kgm2,
        "yaw_ahead": its.yaw_ahead_nm_s_per_m / its.inertia_kgm2,
        "munk": its.munk_nm_per_mps2 / its.inertia_kgm2,
        "loss": its.thrust_loss_s_per_m,
    }
