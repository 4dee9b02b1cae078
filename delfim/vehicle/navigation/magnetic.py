"""A heading from the earth's magnetic field, and the direction of down from a gyro and an accelerometer. Vectors are in the
axes of the device: x along its arrow, y to the right of it, z down when it lies flat with its face up.

The gyro turns the direction of down, and gravity corrects it slowly: in waves and turns an accelerometer feels more than
gravity. A tilt that is wrong by one degree makes a heading wrong by up to one and a half where the field dips by 56 degrees.
"""

import math
from typing import Final

Vector = tuple[float, float, float]
FLAT: Final[Vector] = (0.0, 0.0, 1.0)  # down, of a device that lies flat
CORRECTED_S: Final = 5.0  # time constant with which gravity corrects the gyro
GAP_S: Final = 0.5  # after which gravity alone counts
GRAVITY_MPS2: Final = 9.80665
SHARE: Final = 0.5  # of gravity: an acceleration that is further from it says nothing of where down is
FIELD_MIN_T: Final = 5e-6  # horizontal; the earth's is 10 to 40 uT, but for the poles
ASKEW: Final = 0.4  # of half the width of a circle
LEANING: Final = 0.5  # a bow that points up or down by more than 60 degrees has no heading


class Tilt:
    """The direction of down for a device; None while it is not known."""

    def __init__(self) -> None:
        self.down: Vector | None = None
        self.at_s = -math.inf  # of the last sample ...
        self._sample, self._rate_radps = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0  # ... which was this, and its rate of turn

    def feed(self, rate_radps: Vector, force_mps2: Vector, at_s: float) -> float | None:
        """A sample: rates, and specific force (at rest it points up); returns the rate of turn around down, rad/s, positive to
        starboard. The same sample again is the same rate, so that a frozen gyro is seen to be one."""
        dt_s, self.at_s = at_s - self.at_s, at_s
        strength = math.hypot(*force_mps2)
        feels = abs(strength - GRAVITY_MPS2) < SHARE * GRAVITY_MPS2
        if not 0.0 <= dt_s <= GAP_S:
            self.down = None
        elif self._sample == (rate_radps, force_mps2):
            return self._rate_radps
        if self.down is None:
            if not feels:
                return None
            x, y, z = (-each / strength for each in force_mps2)
        else:
            (x, y, z), (p, q, r) = self.down, rate_radps
            x, y, z = x + (y * r - z * q) * dt_s, y + (z * p - x * r) * dt_s, z + (x * q - y * p) * dt_s
            if feels:
                part = dt_s / CORRECTED_S
                x, y, z = (d - part * (f / strength + d) for d, f in zip((x, y, z), force_mps2, strict=True))
        length = math.hypot(x, y, z)
        self.down, self._sample = (x / length, y / length, z / length), (rate_radps, force_mps2)
        self._rate_radps = dot(rate_radps, self.down)
        return self._rate_radps


class Calibration:
    """The boat's own iron, from the vehicle's file."""

    def __init__(self, hard_iron_ut: Vector, soft_iron: tuple[float, float, float, float, float, float]) -> None:
        self._hard = tuple(each * 1e-6 for each in hard_iron_ut)
        xx, yy, zz, xy, xz, yz = soft_iron
        self._rows = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)

    def undone(self, field_t: Vector) -> Vector:
        """The earth's field, given the measured one, T."""
        x, y, z = (measured - own for measured, own in zip(field_t, self._hard, strict=True))
        a, b, c = self._rows
        return dot(a, (x, y, z)), dot(b, (x, y, z)), dot(c, (x, y, z))


class FieldCircle:
    """The fields that a compass measured at the least and the most of x and y, from which its calibration follows."""

    def __init__(self, field_t: Vector) -> None:
        self._low, self._high, self._left, self._right = (field_t,) * 4

    def add(self, field_t: Vector) -> None:
        if field_t[0] < self._low[0]:
            self._low = field_t
        if field_t[0] > self._high[0]:
            self._high = field_t
        if field_t[1] < self._left[1]:
            self._left = field_t
        if field_t[1] > self._right[1]:
            self._right = field_t

    def calibration(self) -> dict[str, list[float]] | None:
        """`hard_iron_ut` and `soft_iron` of a boat that was turned through a circle on level water. None: it was not. On a
        part of a circle x is not half-way where y is least or most."""
        ends = self._low, self._high, self._left, self._right
        x, y = 0.5 * (self._low[0] + self._high[0]), 0.5 * (self._left[1] + self._right[1])
        wide, across = self._high[0] - x, self._right[1] - y
        if min(wide, across) < FIELD_MIN_T:
            return None
        off = [abs(end[1] - y) / across for end in ends[:2]] + [abs(end[0] - x) / wide for end in ends[2:]]
        if max(off) > ASKEW:
            return None
        mean = 0.5 * (wide + across)
        soft_iron = [round(mean / wide, 3), round(mean / across, 3), 1.0, 0.0, 0.0, 0.0]
        return {"hard_iron_ut": [round(x * 1e6, 1), round(y * 1e6, 1), 0.0], "soft_iron": soft_iron}


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def magnetic_heading(field_t: Vector, down: Vector, arrow_rad: float) -> float | None:
    """The boat's heading from magnetic north, rad, by a device whose arrow points there, clockwise from the bow. None: the
    field is too weak, or the bow points up or down."""
    (x, y, z), (bx, by, _) = down, bow(down, arrow_rad)
    lean = x * bx + y * by
    ahead = bx - lean * x, by - lean * y, -lean * z  # the bow's part in the horizontal plane
    right = -z * by, z * bx, x * by - y * bx  # down cross bow
    length, north, east = math.hypot(*ahead), dot(field_t, ahead), -dot(field_t, right)
    if length < LEANING or math.hypot(north, east) < FIELD_MIN_T * length:
        return None
    return math.atan2(east, north)


def attitude(down: Vector, arrow_rad: float) -> tuple[float, float]:
    """(roll, pitch) of the boat, rad."""
    (x, y, z), (bx, by, _) = down, bow(down, arrow_rad)
    starboard = y * bx - x * by if z >= 0.0 else x * by - y * bx
    return math.atan2(starboard, abs(z)), -math.asin(max(-1.0, min(x * bx + y * by, 1.0)))


def bow(down: Vector, arrow_rad: float) -> Vector:
    """The direction of the bow in the axes of a device, which may lie on its face."""
    side = math.sin(arrow_rad)
    return math.cos(arrow_rad), -side if down[2] >= 0.0 else side, 0.0
