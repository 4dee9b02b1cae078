"""Surge, sway and yaw to the thrusters of the boat, whatever they are: control allocation by bounded least squares, exact.

    minimise  sum (f / F)^2 / STIFF + (B f - t)' Q (B f - t)        low <= f <= high

t is what is asked for, f the force of each thruster, F its largest, B their lever arms. Q weighs yaw far more than surge and
sway: what can be met is met, with the least effort; when it cannot, surge and sway give way, so that the boat keeps its heading
and is slow. (T. I. Johansen, T. I. Fossen, "Control allocation - a survey", Automatica 49, 2013; docs/propulsion.md.)

The forces of two fixed thrusters, the commonest boat, are in closed form, and so are those of others while no limit is in the
way; `solver.py` has all else.

A thruster that turns takes two passes: the first asks where it should point, the second is exact for where it points now.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.vehicle.control.pivot import Pivot, aim, forbidden, goes_astern, turn
from delfim.vehicle.control.solver import WEIGHTS, Column, Force, hessian, inverse, solved, times
from delfim.vehicle.control.thrustcurve import Curve, Law, Points

STIFF: Final = 1e4  # how much more the request weighs than the effort
ARM_M: Final = 0.1  # shortest lever arm
MET: Final = 0.01  # of a request, that may be missing from what meets it
LEAST_SWAY: Final = 1e-6  # of the strongest thruster: a boat with less has no sway
LEAST_TURN: Final = 0.01  # of its largest force: for less nothing is turned
SLOW, TURNING = 0.2, 0.1  # of the most that the sound boat can: what a boat must still do at once to be steered
HALF: Final = 0.5  # of that, at least

Side = tuple[
    float, float, float, float, float, float, float, float, float
]  # of two: surge, sway N, yaw N m of a newton; times their weights; low, high N; the weighted square of a newton


class Thruster(NamedTuple):
    """It pushes the boat along `angle_rad` (0 ahead, pi/2 to starboard), `x_m` ahead of the middle and `y_m` to starboard."""

    x_m: float
    y_m: float
    angle_rad: float
    curve: Curve
    pivot: Pivot | None = None


def thruster(row: config.ThrusterTable) -> Thruster:
    """A row of the vehicle's file."""
    curve = Points(row.curve) if row.curve else Law(*row.thrust_n, row.power, row.dead)
    pivot = None
    if (steer := row.steer) is not None:
        sectors = tuple((math.radians(begin), math.radians(end)) for begin, end in steer.forbidden_deg)
        widest_rad, rate_radps = math.radians(steer.angle_max_deg), math.radians(steer.rate_dps)
        pivot = Pivot(widest_rad, rate_radps, sectors, steer.kind == "rudder")
    return Thruster(row.x_m, row.y_m, math.radians(row.angle_deg), curve, pivot)


# The force of each thruster, N; its angle, rad, from its middle, zero for what is fixed; what was asked for minus what the boat
# gives, None where it gives it.
Allotted = tuple[Sequence[float], Sequence[float], Force | None]


class Allocation:
    """The allocation of one boat. Immutable: a thruster that failed makes another one (`without`)."""

    def __init__(self, thrusters: Sequence[Thruster], failed: frozenset[int] = frozenset()) -> None:
        """`failed`: indices of the thrusters that give nothing any more. At least one thruster has a force."""
        self.thrusters, self.failed = tuple(thrusters), failed
        self._unit_n = unit_n = max(max(t.curve.ahead_n, -t.curve.astern_n) for t in thrusters)
        self._arm_m = max(ARM_M, *(math.hypot(t.x_m, t.y_m) for t in thrusters))
        self._scale = 1.0 / unit_n, 1.0 / unit_n, 1.0 / (unit_n * self._arm_m)
        ends = [(0.0, 0.0) if i in failed else (t.curve.astern_n, t.curve.ahead_n) for i, t in enumerate(thrusters)]
        self._ends = [(low / unit_n, high / unit_n) for low, high in ends]
        self._turns = any(t.pivot is not None for t in thrusters)
        self._columns = [column for i in range(len(thrusters)) for column in self._free(i)]
        self._inverse = inverse(hessian(self._columns))
        self._quick = [(*self._share(column), column[6] * unit_n, column[7] * unit_n) for column in self._columns]
        ends_of = [[(k[i] * k[6], k[i] * k[7]) for k in self._columns] for i in range(3)]
        self._most = [
            (sum(map(min, each)) / scale, sum(map(max, each)) / scale) for each, scale in zip(ends_of, self._scale, strict=True)
        ]
        self._within = *self._most[0], *self._most[1], *self._most[2]
        self._is_full = self._gives_each()
        self._two = self._sides() if len(self._columns) == 2 and not self._turns else None
        self.surge_n, self.yaw_nm = self._most[0], min(-self._most[2][0], self._most[2][1])  # most astern and ahead; either way

    def without(self, failed: frozenset[int]) -> "Allocation":
        return Allocation(self.thrusters, failed)

    def allocate(self, surge_n: float, sway_n: float, yaw_nm: float, angles_rad: Sequence[float], dt_s: float) -> Allotted:
        """`angles_rad`: where everything points now; `dt_s`: how long it may turn. NaN in, NaN out."""
        if self._turns:
            return self._turned(surge_n, sway_n, yaw_nm, angles_rad, dt_s)
        if self._two is not None:
            return self._of_two(self._two, surge_n, sway_n, yaw_nm, angles_rad)
        least_x, most_x, least_y, most_y, least_n, most_n = self._within
        if self._is_full and least_x <= surge_n <= most_x and least_y <= sway_n <= most_y and least_n <= yaw_nm <= most_n:
            forces = []
            for x, y, n, low, high in self._quick:
                force_n = x * surge_n + y * sway_n + n * yaw_nm
                if not low <= force_n <= high:
                    break
                forces.append(force_n)
            else:
                return forces, angles_rad, None
        return self._exactly(self._columns, surge_n, sway_n, yaw_nm, angles_rad)

    def steerable(self) -> str:
        """Why the boat cannot be steered, in words; empty: it can. It must turn to either side while it goes ahead."""
        sound = Allocation(self.thrusters)
        ahead_n, turn_nm = SLOW * sound.surge_n[1], TURNING * sound.yaw_nm
        if not self.surge_n[1] > HALF * ahead_n:
            return "nothing pushes the boat ahead"
        for yaw_nm in (turn_nm, -turn_nm):
            short = self.allocate(ahead_n, 0.0, yaw_nm, [0.0] * len(self.thrusters), math.inf)[2] or (0.0, 0.0, 0.0)
            if not turn_nm or short[2] / yaw_nm > HALF or short[0] > HALF * ahead_n:
                return "the boat cannot turn to both sides while it goes ahead"
        return ""

    def _free(self, i: int) -> list[Column]:
        """The columns of a thruster: one, or two where it turns, along its middle and across it."""
        thruster, (low, high) = self.thrusters[i], self._ends[i]
        if thruster.pivot is None:
            return [self._column(thruster, thruster.angle_rad, low, high)]
        widest_rad = thruster.pivot.angle_max_rad
        aside = high * math.sin(min(widest_rad, 0.5 * math.pi))
        along = self._column(thruster, thruster.angle_rad, min(low, high * math.cos(widest_rad)), high)
        return [along, self._column(thruster, thruster.angle_rad + 0.5 * math.pi, -aside, aside)]

    def _column(self, thruster: Thruster, angle_rad: float, low: float, high: float) -> Column:
        x, y = math.cos(angle_rad), math.sin(angle_rad)
        n, w = (thruster.x_m * y - thruster.y_m * x) / self._arm_m, STIFF * max(-low, high) ** 2
        return x, y, n, w * x, w * y, w * n, low, high, w

    def _share(self, column: Column) -> Force:
        """The force, N, of a column for each N and N m that are asked for, while no limit is in the way."""
        x, y, n = times(self._inverse, *column[3:6])
        return x, y, n / self._arm_m

    def _gives_each(self) -> bool:
        """Whether the boat, while no limit is in the way, gives surge and yaw without each other, and sway if it has any."""
        for axis, (least, most) in enumerate(self._most):
            if axis == 1 and (most - least) * self._scale[1] < LEAST_SWAY:
                continue
            unit = [float(axis == i) for i in range(3)]
            x, y, n = times(self._inverse, unit[0], unit[1], unit[2])
            shares = [column[3] * x + column[4] * y + column[5] * n for column in self._columns]
            for i in range(3):
                if abs(sum(column[i] * share for column, share in zip(self._columns, shares, strict=True)) - unit[i]) > MET:
                    return False
        return True

    def _sides(self) -> tuple[Side, Side, float, float]:
        """Both columns in N and N m; their mixed product; the determinant of their matrix."""
        unit_n, arm_m, sides = self._unit_n, self._arm_m, list[Side]()
        qx, qy, qn = WEIGHTS[0], WEIGHTS[1], WEIGHTS[2] / arm_m**2
        for x, y, n_arm, _, _, _, low, high, w in self._columns:
            n = n_arm * arm_m
            square = qx * x * x + qy * y * y + qn * n * n + (1.0 / w if w else 1.0)  # what failed has no force, so any effort
            sides.append((x, y, n, qx * x, qy * y, qn * n, low * unit_n, high * unit_n, square))
        a, b = sides
        mixed = a[3] * b[0] + a[4] * b[1] + a[5] * b[2]
        return a, b, mixed, a[8] * b[8] - mixed * mixed

    def _of_two(
        self, two: tuple[Side, Side, float, float], surge_n: float, sway_n: float, yaw_nm: float, angles_rad: Sequence[float]
    ) -> Allotted:
        """As `allocate`, for two fixed thrusters. Where their best forces exceed limits, the best within the limits have one of
        them at a limit that it exceeds, and the other as good as it can be beside it. Plain statements: this is on the
        critical path."""
        least_x, most_x, least_y, most_y, least_n, most_n = self._within
        if self._is_full and least_x <= surge_n <= most_x and least_y <= sway_n <= most_y and least_n <= yaw_nm <= most_n:
            (fx, fy, fn, f_low, f_high), (gx, gy, gn, g_low, g_high) = self._quick
            f, g = fx * surge_n + fy * sway_n + fn * yaw_nm, gx * surge_n + gy * sway_n + gn * yaw_nm
            if f_low <= f <= f_high and g_low <= g <= g_high:
                return (f, g), angles_rad, None
        x = least_x if surge_n < least_x else most_x if surge_n > most_x else surge_n
        y = least_y if sway_n < least_y else most_y if sway_n > most_y else sway_n
        n = least_n if yaw_nm < least_n else most_n if yaw_nm > most_n else yaw_nm
        (ax, ay, an, wax, way, wan, a_low, a_high, aa), (bx, by, bn, wbx, wby, wbn, b_low, b_high, bb), mixed, whole = two
        to_a, to_b = wax * x + way * y + wan * n, wbx * x + wby * y + wbn * n
        f, g = (bb * to_a - mixed * to_b) / whole, (aa * to_b - mixed * to_a) / whole
        f_end = a_low if f < a_low else a_high if f > a_high else f
        g_end = b_low if g < b_low else b_high if g > b_high else g
        if f_end != f:
            beside = (to_b - mixed * f_end) / bb
            beside = b_low if beside < b_low else b_high if beside > b_high else beside
            if g_end == g or (to_a - aa * f_end - mixed * beside) * (f - f_end) >= 0.0:  # beyond the limit the sum only falls
                f, g, g_end = f_end, beside, beside
        if g_end != g:
            f = (to_a - mixed * g_end) / aa
            f = a_low if f < a_low else a_high if f > a_high else f
        short = surge_n - ax * f - bx * g_end, sway_n - ay * f - by * g_end, yaw_nm - an * f - bn * g_end
        return (f, g_end), angles_rad, self._missing(short, surge_n, sway_n, yaw_nm)

    def _exactly(
        self, columns: list[Column], surge_n: float, sway_n: float, yaw_nm: float, angles_rad: Sequence[float]
    ) -> Allotted:
        """Within the limits. The request is cut first to what the boat can give at all, or the weights mean little."""
        (least_x, most_x), (least_y, most_y), (least_n, most_n) = self._most
        sx, sy, sn = self._scale
        x = (least_x if surge_n < least_x else most_x if surge_n > most_x else surge_n) * sx
        y = (least_y if sway_n < least_y else most_y if sway_n > most_y else sway_n) * sy
        n = (least_n if yaw_nm < least_n else most_n if yaw_nm > most_n else yaw_nm) * sn
        start = self._inverse if columns is self._columns else inverse(hessian(columns))
        forces = solved(columns, x, y, n, *times(start, x, y, n))
        x = y = n = 0.0
        for column, f in zip(columns, forces, strict=True):
            x += column[0] * f
            y += column[1] * f
            n += column[2] * f
        unit_n = self._unit_n
        short = surge_n - x * unit_n, sway_n - y * unit_n, yaw_nm - n * unit_n * self._arm_m
        return [f * unit_n for f in forces], angles_rad, self._missing(short, surge_n, sway_n, yaw_nm)

    def _missing(self, short: Force, surge_n: float, sway_n: float, yaw_nm: float) -> Force:
        """What is short of a request, but for a hundredth: the effort alone keeps a ten-thousandth back where no limit is in
        the way, and would stop an integral for good. A boat that comes here for limits alone is told exactly."""
        if self._is_full and not self._turns:
            return short
        x, y, n = short
        return (
            0.0 if abs(x) <= MET * abs(surge_n) else x,
            0.0 if abs(y) <= MET * abs(sway_n) else y,
            0.0 if abs(n) <= MET * abs(yaw_nm) else n,
        )

    def _turned(self, surge_n: float, sway_n: float, yaw_nm: float, angles_rad: Sequence[float], dt_s: float) -> Allotted:
        """Two passes: where to point, then the forces for where everything points after `dt_s`."""
        free = iter(self._exactly(self._columns, surge_n, sway_n, yaw_nm, angles_rad)[0])
        columns: list[Column] = []
        angles: list[float] = []
        for thruster, (low, high), angle_rad in zip(self.thrusters, self._ends, angles_rad, strict=True):
            along_n, pivot = next(free), thruster.pivot
            if pivot is None:
                columns.append(self._column(thruster, thruster.angle_rad, low, high))
                angles.append(0.0)
                continue
            aside_n, most_n = next(free), high * self._unit_n
            is_astern = low < 0.0 and goes_astern(pivot, along_n, aside_n)
            to_rad = angle_rad
            if math.hypot(along_n, aside_n) > LEAST_TURN * most_n:
                to_rad = aim(pivot, along_n, aside_n, most_n, is_astern)
            angle_rad = turn(pivot, angle_rad, to_rad, dt_s)
            angles.append(angle_rad)
            if forbidden(pivot, angle_rad) is not None:
                low = high = 0.0
            elif pivot.is_rudder:
                low, high = (low, 0.0) if is_astern else (0.0, high)
            turned_rad = 0.0 if pivot.is_rudder and is_astern else angle_rad
            columns.append(self._column(thruster, thruster.angle_rad + turned_rad, low, high))
        return self._exactly(columns, surge_n, sway_n, yaw_nm, angles)
