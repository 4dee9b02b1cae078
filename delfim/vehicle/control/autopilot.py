"""Heading and speed to revolutions: two PI(D) loops that share two propellers, the first row and the second.

    differential = sat(Kp e) + Kd (turn - r) + Kt turn + I_heading    e = wrap(heading asked for - heading), r yaw rate
    n            = u_d / speed_per_rpm + Kp (u_d - u) + I_speed       u speed over ground along the keel
    port, starboard = common + differential, common - differential    common = n |n| / rpm_max

Thrust goes with the square of revolutions. So the two parts are added as thrust, in units of a thrust of n |n| / rpm_max, and
turned into revolutions in the end: the same gains turn the boat alike at rest and at full speed (`docs/control.md`).

When both together exceed `rpm_max` the differential is kept and the common part gives way: a boat that holds its heading and
is slow is safe; a boat off its heading is not. Speed falls with the cosine of the heading error, so that the
boat turns first; an order ahead never runs both propellers astern.
"""

import math

from delfim.geodesy import wrap
from delfim.vehicle.control.memory import Integrals, Settings
from delfim.vehicle.state import Actuation, Motion

STAYS_RADPS = math.radians(3.0)  # the heading integral takes lasting errors, not those that the boat is turning away
TURNING_RAD = 0.5  # beyond this heading error the speed integral waits: the boat is turning, not slowed by the sea


def entered(motion: Motion) -> Integrals:
    """The autopilot's memory at the moment of entering a mode: the speed ramp starts at the speed the boat has."""
    return Integrals(speed_mps=surge_mps(motion))


def surge_mps(motion: Motion) -> float:
    """Speed over ground along the keel; zero where velocity is not known."""
    return motion.north_mps * math.cos(motion.heading_rad) + motion.east_mps * math.sin(motion.heading_rad)


def steer(
    was: Integrals,
    motion: Motion,
    heading_rad: float,
    speed_mps: float,
    settings: Settings,
    dt_s: float,
    turn_radps: float = 0.0,
) -> tuple[Integrals, Actuation]:
    """One step towards a heading and a speed over ground (negative: astern). `turn_radps` is the rate of turn of the path
    itself. Without velocity the speed loop is open: feed-forward alone.
    """
    heading, speed, rpm_max = settings.control.heading, settings.control.speed, settings.dsor.rpm_max
    error_rad = wrap(heading_rad - motion.heading_rad)
    change_mps = speed.ramp_mps2 * dt_s
    asked_mps = clamp(clamp(speed_mps, -speed.max_mps, speed.max_mps), was.speed_mps - change_mps, was.speed_mps + change_mps)

    differential_rpm = (
        clamp(heading.p_rpm_per_rad * error_rad, -heading.p_limit_rpm, heading.p_limit_rpm)
        + heading.d_rpm_per_radps * (turn_radps - motion.yaw_rate_radps)
        + heading.turn_rpm_per_radps * turn_radps
        + was.heading_rpm
    )
    differential, spare = _saturated(differential_rpm, -rpm_max, rpm_max)
    heading_rpm = was.heading_rpm
    stays = abs(error_rad) < TURNING_RAD and abs(motion.yaw_rate_radps - turn_radps) < STAYS_RADPS
    if stays and error_rad * spare >= 0.0:
        change_rpm = heading.i_rpm_per_rad_s * error_rad * dt_s
        heading_rpm = clamp(heading_rpm + change_rpm, -heading.i_limit_rpm, heading.i_limit_rpm)

    wanted_mps = asked_mps * max(math.cos(error_rad), 0.0)
    lag_mps = wanted_mps - surge_mps(motion) if "velocity" in motion.has else 0.0
    common_rpm = wanted_mps / settings.propulsion.speed_per_rpm_mps + speed.p_rpm_per_mps * lag_mps + was.speed_rpm
    room = rpm_max - abs(differential)
    astern = asked_mps < 0.0
    common, spare = _saturated(common_rpm * abs(common_rpm) / rpm_max, -room if astern else 0.0, 0.0 if astern else room)
    speed_rpm = was.speed_rpm
    if abs(error_rad) < TURNING_RAD and lag_mps * spare >= 0.0:
        speed_rpm = clamp(speed_rpm + speed.i_rpm_per_m * lag_mps * dt_s, -speed.i_limit_rpm, speed.i_limit_rpm)
    sides = _revolutions(common - differential, rpm_max), _revolutions(common + differential, rpm_max)
    return Integrals(heading_rpm, speed_rpm, asked_mps), Actuation(sides, (0.0, 0.0), True)


def _revolutions(thrust: float, rpm_max: float) -> float:
    """The rpm, as a part of rpm_max, that give a thrust of n |n| / rpm_max."""
    return math.copysign(math.sqrt(abs(thrust) / rpm_max), thrust)


def clamp(value: float, low: float, high: float) -> float:
    """`value` within low..high. NaN stays NaN, for the last gate to refuse."""
    return low if value < low else high if value > high else value


def _saturated(value: float, low: float, high: float) -> tuple[float, float]:
    """The value within its bounds, and the excess with its sign turned: an error of the other sign may integrate."""
    within = clamp(value, low, high)
    return within, within - value
