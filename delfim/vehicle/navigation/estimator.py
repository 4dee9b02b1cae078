"""The estimator: position, velocity, heading and rate of turn from a receiver, a compass and a gyro (docs/estimator.md).

Two small Kalman filters in plain Python, without clock and input: times are handed in, in s, on an axis that does not step.
`HeadingFilter` has heading and the gyro's bias; `MotionFilter` has position and velocity over ground, whose north and east have
the same noise and so one covariance, which a rotation leaves as it is: the velocity turns with the boat. An input that the
estimate makes improbable is refused; a run of refusals starts its filter again. A value that is not known is None.
"""

import math
from typing import Final, NamedTuple

from delfim import config
from delfim.base import geodesy
from delfim.vehicle.inputhealth import KINDS, InputHealth

GATES: Final = {
    1: 10.8,
    2: 13.8,
}  # of the normalised innovation squared, by degrees of freedom: 0.1 % of good values are beyond
AGAIN: Final = 0.6  # part of `stale_s` without a used value after which a refused one starts its filter again ...
COAST: Final = 1.2  # parts of `stale_s` without a used value after which its filter knows nothing; silence is told before
RUN: Final = 2  # ... if it is not the first in a row
JUMP_RAD: Final = math.radians(20.0)  # a heading this far from the estimate is a jump, and starts nothing again
GYRO_S: Final = 0.5  # a rate of turn counts for so long
RATE_MAX_RADPS: Final = math.pi  # no boat turns faster
LATE_MAX_S: Final = 1.0  # values that are later than this are as late as this
VELOCITY_MAX_MPS: Final = 60.0  # refused beyond, NaN too
PLANE_M: Final = 10_000.0  # from its origin the plane is laid anew
BIAS_RADPS: Final = math.radians(2.0)  # of a gyro that nobody knows yet
BIAS_DRIFT: Final = math.radians(0.02)  # rad/s after a second, growing with the square root of time
TURN_DRIFT: Final = 0.1  # the same for the rate of turn of a boat without gyro
HEADING_DRIFT: Final = math.radians(0.1)  # rad after a second: mounting, waves
WANDER_M: Final = 0.1  # m after a second: how a receiver's slow error drifts, which no filter can see
ACCELERATED_S: Final = 1.0  # an acceleration that nothing tells lasts about so long
SPEED_MAX_MPS: Final = 5.0  # standard deviation of a velocity of which nothing is known
UNKNOWN_M, UNKNOWN_MPS, UNKNOWN_RAD, UNKNOWN_RADPS = 5.0, 0.7, math.radians(10.0), math.radians(8.0)  # deviations


class Estimate(NamedTuple):
    """The boat's motion, of its reference point. None: not known well enough."""

    latitude_rad: float | None
    longitude_rad: float | None
    north_mps: float | None
    east_mps: float | None
    heading_rad: float | None  # 0..2 pi
    yaw_rate_radps: float | None
    position_sd_m: float  # standard deviation per axis, as the filter believes
    heading_sd_rad: float


class HeadingFilter:
    """Heading, and the bias of the gyro. Without a gyro the rate of turn itself is estimated: it is a gyro that says zero."""

    def __init__(self, noise: config.EstimatorTable) -> None:
        self._gyro_noise = math.radians(noise.rate_degps) ** 2
        self.known = self.has_gyro = False
        self.heading_rad = self.gyro_radps = self.bias_radps = self.nis = 0.0
        self.p11, self.p12, self.p22 = 1.0, 0.0, TURN_DRIFT**2

    @property
    def rate_radps(self) -> float:
        return self.gyro_radps - self.bias_radps

    def gyro(self, rate_radps: float | None) -> None:
        """The rate from now on; None: the gyro is lost, and the rate of turn stays what it was."""
        if (rate_radps is not None) != self.has_gyro:
            self.has_gyro, self.p12 = not self.has_gyro, 0.0
            self.bias_radps = 0.0 if self.has_gyro else -self.rate_radps
            self.p22 = BIAS_RADPS**2 if self.has_gyro else TURN_DRIFT**2
        self.gyro_radps = rate_radps or 0.0

    def predict(self, dt_s: float) -> float:
        """Let time pass; returns the angle turned."""
        turned = self.rate_radps * dt_s
        self.heading_rad = (self.heading_rad + turned) % math.tau
        drift = BIAS_DRIFT**2 if self.has_gyro else TURN_DRIFT**2
        noise = HEADING_DRIFT**2 + (self._gyro_noise * dt_s if self.has_gyro else 0.0)
        self.p11 += dt_s * (dt_s * (self.p22 + drift * dt_s / 3.0) - 2.0 * self.p12 + noise)
        self.p12 -= dt_s * (self.p22 + 0.5 * drift * dt_s)
        self.p22 += drift * dt_s
        return turned

    def start(self, heading_rad: float, variance: float) -> None:
        self.heading_rad, self.p11, self.p12, self.known = heading_rad % math.tau, variance, 0.0, True
        self.p22 = BIAS_RADPS**2 if self.has_gyro else TURN_DRIFT**2

    def correct(self, error_rad: float, variance: float) -> bool:
        """With a heading that is so far from the estimate; False: it is refused."""
        v = self.p11 + variance
        self.nis = error_rad * error_rad / v
        if self.nis > GATES[1]:
            return False
        k1, k2 = self.p11 / v, self.p12 / v
        self.heading_rad = (self.heading_rad + k1 * error_rad) % math.tau
        self.bias_radps += k2 * error_rad
        self.p22 -= k2 * self.p12
        self.p12 -= k1 * self.p12
        self.p11 -= k1 * self.p11
        return True


class MotionFilter:
    """Position in a plane, m, velocity over ground, m/s, and the acceleration that the turn does not explain, m/s2, which lasts
    about ACCELERATED_S (Singer's model). Velocity and acceleration turn with the boat."""

    def __init__(self, noise: config.EstimatorTable) -> None:
        self._acceleration = noise.acceleration_mps2**2
        self.known = False
        self.nis = 0.0
        self.start(0.0, 0.0, 1.0)
        self.known = False

    def start(self, north_m: float, east_m: float, variance: float) -> None:
        self.north_m, self.east_m, self.known = north_m, east_m, True
        self.north_mps = self.east_mps = 0.0
        self.p11 = variance
        self.lose_velocity()

    def lose_velocity(self) -> None:
        """Know nothing of the velocity, whatever is estimated now."""
        self.north_mps2 = self.east_mps2 = 0.0
        self.p12 = self.p13 = self.p23 = 0.0
        self.p22, self.p33 = SPEED_MAX_MPS**2, self._acceleration

    def predict(self, dt_s: float, turned_rad: float) -> None:
        """Let time pass, in which the boat turned by this angle."""
        north, east = self.north_mps, self.east_mps
        if turned_rad:
            c, s = math.cos(turned_rad), math.sin(turned_rad)
            self.north_mps, self.east_mps = north * c - east * s, north * s + east * c
            self.north_mps2, self.east_mps2 = (
                self.north_mps2 * c - self.east_mps2 * s,
                self.north_mps2 * s + self.east_mps2 * c,
            )
        left = math.exp(-dt_s / ACCELERATED_S)
        g = ACCELERATED_S * (1.0 - left)  # velocity of an acceleration that fades
        h = 0.5 * dt_s * g
        self.north_mps += g * self.north_mps2
        self.east_mps += g * self.east_mps2
        self.north_mps2 *= left
        self.east_mps2 *= left
        self.north_m += 0.5 * dt_s * (north + self.north_mps)
        self.east_m += 0.5 * dt_s * (east + self.east_mps)
        q = self._acceleration * (1.0 - left * left)
        p12, p13, p22, p23, p33 = self.p12, self.p13, self.p22, self.p23, self.p33
        to1, to2, to3 = p12 + dt_s * p22 + h * p23, p22 + g * p23, p13 + dt_s * p23 + h * p33
        self.p11 += dt_s * (p12 + to1 + WANDER_M**2) + h * (p13 + to3)
        self.p12 = to1 + g * to3
        self.p13 = left * to3
        self.p22 = to2 + g * (p23 + g * p33) + q * dt_s * dt_s / 3.0
        self.p23 = left * (p23 + g * p33) + 0.5 * q * dt_s
        self.p33 = left * left * p33 + q

    def correct_position(self, north_m: float, east_m: float, variance: float) -> bool:
        """With a position; False: it is refused."""
        return self._correct(north_m - self.north_m, east_m - self.east_m, self.p11 + variance, self.p11, self.p12, self.p13)

    def correct_velocity(self, north_mps: float, east_mps: float, variance: float) -> bool:
        """With a velocity; False: it is refused."""
        north, east = north_mps - self.north_mps, east_mps - self.east_mps
        return self._correct(north, east, self.p22 + variance, self.p12, self.p22, self.p23)

    def _correct(self, north: float, east: float, v: float, c1: float, c2: float, c3: float) -> bool:
        """With an innovation of variance `v`; its covariances with position, velocity and acceleration."""
        self.nis = (north * north + east * east) / v
        if self.nis > GATES[2]:
            return False
        k1, k2, k3 = c1 / v, c2 / v, c3 / v
        self.north_m += k1 * north
        self.east_m += k1 * east
        self.north_mps += k2 * north
        self.east_mps += k2 * east
        self.north_mps2 += k3 * north
        self.east_mps2 += k3 * east
        self.p11 -= k1 * c1
        self.p12 -= k1 * c2
        self.p13 -= k1 * c3
        self.p22 -= k2 * c2
        self.p23 -= k2 * c3
        self.p33 -= k3 * c3
        return True


class Estimator:
    """Both filters, and the inputs with their ages, gates and counts. No time may be before the one before."""

    def __init__(self, settings: config.EstimatorTable, limits: config.NavigationTable, frozen_s: float) -> None:
        self._limits, self._frozen_s = limits, frozen_s
        self.turn, self.course = HeadingFilter(settings), MotionFilter(settings)
        self.inputs = tuple(map(InputHealth, KINDS))
        self.restarts = 0
        self._runs = dict.fromkeys(KINDS, 0)  # refused in a row
        self._position, self._velocity = settings.position_m**2, settings.velocity_mps**2  # variances
        self._heading = math.radians(settings.heading_deg) ** 2
        self._receiver_late_s, self._compass_late_s = settings.position_latency_s, settings.heading_latency_s
        self._forward_m, self._starboard_m = settings.antenna_forward_m, settings.antenna_starboard_m
        self._plane: geodesy.Origin | None = None
        self._at_s = -math.inf

    def begin(self, at_s: float) -> None:
        """Know nothing again; the axis of time may be another one. An input that was silent is judged from now on: a boat that
        sailed by its reserve would stop for it."""
        self.course.known = self.turn.known = False
        self._at_s = -math.inf
        self.turn.gyro(None)
        self._runs = dict.fromkeys(KINDS, 0)
        for each in self.inputs:
            if each.heard:
                each.heard_s = each.changed_s = at_s

    def position(
        self, at_s: float, latitude_rad: float, longitude_rad: float, late_s: float | None = None, deviation_m: float = 0.0
    ) -> None:
        """The antenna's position, as it was `late_s` before it came; None: as the settings say. `deviation_m`: its standard
        deviation per axis, where it is worse than the settings say."""
        health, course, variance = self.inputs[0], self.course, _variance(self._position, deviation_m)
        self._heard(health, (latitude_rad, longitude_rad), at_s)
        if not (abs(latitude_rad) < math.pi / 2 and abs(longitude_rad) <= math.tau):  # refuses NaN, too
            health.refused += 1
            return
        if self._plane is None or not course.known:
            self._plane = geodesy.origin(latitude_rad, longitude_rad)
        north_m, east_m = geodesy.to_plane(self._plane, latitude_rad, longitude_rad)
        late_s = self._receiver_late_s if late_s is None else min(max(late_s, 0.0), LATE_MAX_S)
        x, y = self._arm()
        if not self.turn.known:  # nobody knows on which side of the antenna the boat is
            variance += self._forward_m**2 + self._starboard_m**2
        if not course.known:
            course.start(north_m - x, east_m - y, variance)
        else:
            north_m, east_m = north_m + course.north_mps * late_s - x, east_m + course.east_mps * late_s - y
            away_m = math.hypot(north_m - course.north_m, east_m - course.east_m)
            if not course.correct_position(north_m, east_m, variance):
                limits, age_s = self._limits, at_s - health.used_s
                if self._stays_out(health, away_m, away_m > limits.jump_m + limits.jump_mps * age_s, at_s):
                    return
                course.start(north_m, east_m, variance)
        self._use(health, at_s)
        if abs(course.north_m) + abs(course.east_m) > PLANE_M:
            self._lay_anew()

    def velocity(
        self, at_s: float, north_mps: float, east_mps: float, late_s: float | None = None, deviation_mps: float = 0.0
    ) -> None:
        """The antenna's velocity over ground. It counts once there is a position."""
        health, course, turn, variance = self.inputs[1], self.course, self.turn, _variance(self._velocity, deviation_mps)
        self._heard(health, (north_mps, east_mps), at_s)
        if not abs(north_mps) + abs(east_mps) <= VELOCITY_MAX_MPS:
            health.refused += 1
            return
        if not course.known or at_s - health.changed_s > self._frozen_s:
            return
        x, y = self._arm()
        late_s = self._receiver_late_s if late_s is None else min(max(late_s, 0.0), LATE_MAX_S)
        rate_radps = turn.rate_radps
        turned = rate_radps * late_s
        if turned:
            c, s = math.cos(turned), math.sin(turned)
            north_mps, east_mps = north_mps * c - east_mps * s, north_mps * s + east_mps * c
        north_mps, east_mps = north_mps + rate_radps * y, east_mps - rate_radps * x
        if not course.correct_velocity(north_mps, east_mps, variance):
            if self._stays_out(health, 0.0, False, at_s):
                return
            course.lose_velocity()
            course.correct_velocity(north_mps, east_mps, variance)
        self._use(health, at_s)

    def heading(self, at_s: float, heading_rad: float, late_s: float | None = None, deviation_rad: float = 0.0) -> None:
        """The true heading, of a compass or of two antennas."""
        health, turn, variance = self.inputs[2], self.turn, _variance(self._heading, deviation_rad)
        self._heard(health, (heading_rad,), at_s)
        if not abs(heading_rad) <= 2.0 * math.tau:
            health.refused += 1
            return
        late_s = self._compass_late_s if late_s is None else min(max(late_s, 0.0), LATE_MAX_S)
        if not turn.known:
            turn.start(heading_rad, variance)
        else:
            error_rad = math.remainder(heading_rad + turn.rate_radps * late_s - turn.heading_rad, math.tau)
            if not turn.correct(error_rad, variance):
                if self._stays_out(health, abs(error_rad), abs(error_rad) > JUMP_RAD, at_s):
                    return
                turn.start(heading_rad, variance)
        self._use(health, at_s)

    def rate(self, at_s: float, rate_radps: float) -> None:
        """The gyro's rate of turn, positive to starboard. One that comes too seldom or says always the same is not used."""
        health, turn = self.inputs[3], self.turn
        before_s = health.heard_s
        is_rate = abs(rate_radps) <= RATE_MAX_RADPS
        if is_rate and turn.has_gyro:
            turn.gyro(0.5 * (turn.gyro_radps + rate_radps))  # on the way here
        self._heard(health, (rate_radps,), at_s)
        if not is_rate:
            health.refused += 1
        elif at_s - before_s <= GYRO_S and at_s - health.changed_s <= self._frozen_s:
            turn.gyro(rate_radps)
            self._use(health, at_s)

    def estimate(self, at_s: float) -> Estimate:
        """The motion now."""
        self._predict(at_s)
        course, turn, plane = self.course, self.turn, self._plane
        latitude = longitude = north = east = heading = rate = None
        if course.known and plane is not None and course.p11 < UNKNOWN_M**2:
            latitude, longitude = geodesy.from_plane(plane, course.north_m, course.east_m)
            if course.p22 < UNKNOWN_MPS**2:
                north, east = course.north_mps, course.east_mps
        if turn.known and turn.p11 < UNKNOWN_RAD**2:
            heading = turn.heading_rad
        if turn.has_gyro or (turn.known and turn.p22 < UNKNOWN_RADPS**2):
            rate = turn.rate_radps
        deviations = math.sqrt(course.p11), math.sqrt(turn.p11)
        return tuple.__new__(Estimate, (latitude, longitude, north, east, heading, rate, *deviations))  # on the critical path

    def _heard(self, health: InputHealth, value: tuple[float, ...], at_s: float) -> None:
        health.hear(value, at_s)
        self._predict(at_s)

    def _use(self, health: InputHealth, at_s: float) -> None:
        health.used_s = at_s
        self._runs[health.name] = 0

    def _stays_out(self, health: InputHealth, away: float, is_jump: bool, at_s: float) -> bool:
        """Whether a refused value stays refused. False: so many were that the estimate is wrong, and begins again with it. Not
        so after a jump: the estimate becomes unknown first."""
        health.refused += 1
        self._runs[health.name] += 1
        if is_jump:
            health.jumped(away, at_s, self._limits.stale_s)
            return True
        if self._runs[health.name] < RUN or at_s - health.used_s < AGAIN * self._limits.stale_s:
            return True
        self.restarts += 1
        return False

    def _predict(self, at_s: float) -> None:
        dt_s, turn, course = at_s - self._at_s, self.turn, self.course
        if dt_s <= 0.0:
            return
        self._at_s = at_s
        position, _, heading, rate = self.inputs
        oldest_s = at_s - COAST * self._limits.stale_s
        if position.used_s < oldest_s:
            course.known = False
        if heading.used_s < oldest_s:
            turn.known = False
        if turn.has_gyro and at_s - rate.used_s > GYRO_S:
            turn.gyro(None)
        turned = turn.predict(dt_s) if turn.known else turn.gyro_radps * dt_s
        if course.known:
            course.predict(dt_s, turned)

    def _arm(self) -> tuple[float, float]:
        """From the boat's reference point to the antenna, m north and east."""
        x, y, turn = self._forward_m, self._starboard_m, self.turn
        if not (x or y) or not turn.known:
            return 0.0, 0.0
        c, s = math.cos(turn.heading_rad), math.sin(turn.heading_rad)
        return x * c - y * s, x * s + y * c

    def _lay_anew(self) -> None:
        """The plane around where the boat is now."""
        assert self._plane is not None
        self._plane = geodesy.origin(*geodesy.from_plane(self._plane, self.course.north_m, self.course.east_m))
        self.course.north_m = self.course.east_m = 0.0


def _variance(settings: float, deviation: float) -> float:
    """The settings say how good a value is at best, for antennas swing with the waves; its device, when it is worse."""
    return max(deviation * deviation, settings)
