"""The reduced model of a boat with a motor at each side, of one that steers, or of three or four fixed motors: surge, sway and
yaw, 43 numbers, of which each boat has some, and what a trial measures of them.

Everything is an acceleration: without a force gauge mass and thrust are known up to one factor, and control needs no more.
Equations: T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2011, 6.5 and 7.1, solved for u', v', r'.
Lanes of numbers and windows of a record are simulated at once, as one array of the shape (steps, lanes, windows).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Values = Mapping[str, Array]  # of the numbers by name, each of the shape (lanes, 1)


class Number(NamedTuple):
    """A number of the model. Its prior is a normal distribution about what the vehicle's file says, or follows from it."""

    name: str
    spread: float  # standard deviation of the prior; of the logarithm where the number is a factor
    unit: str
    words: str
    is_factor: bool = False  # above zero: wrong by a factor rather than by a difference
    low: float = -math.inf
    high: float = math.inf
    of: str = ""  # SIDES, STEERS or ACROSS: of such boats alone


DEGREE: Final = math.pi / 180.0
SIDES, STEERS = "sides", "steers"  # boats with a motor at each side, and those whose one motor steers
WITHIN: Final = "within"  # boats with two motors at a side, set across
ACROSS: Final = "across"  # boats with a motor that pushes aside alone
NUMBERS: Final = (
    Number("ahead", 0.7, "m/s2", "acceleration by one motor at full command ahead", True),
    Number("ahead_uneven", 0.12, "", "starboard motor over port ahead, logarithm", of=SIDES),
    Number("astern", 0.4, "", "thrust astern over thrust ahead", True),
    Number("astern_uneven", 0.1, "", "starboard motor over port astern, logarithm", of=SIDES),
    Number("power", 0.25, "", "power of the thrust's law", True),
    Number(
        "dead_starboard",
        0.06,
        "",
        "command up to which the starboard motor, or the only one, gives nothing",
        low=0.0,
        high=0.35,
    ),
    Number("dead_port", 0.06, "", "command up to which the port motor gives nothing", low=0.0, high=0.35, of=SIDES),
    Number("loss", 0.08, "s/m", "part of the thrust that is lost for each m/s of way", low=0.0, high=0.4),
    Number("delay", 0.12, "s", "from a command to its motor", low=0.0, high=0.8),
    Number("lag", 0.5, "s", "time constant of the motors", True),
    Number("surge", 1.0, "1/s", "drag ahead, with the speed", True),
    Number("surge2", 0.8, "1/m", "drag ahead, with the square of the speed", True),
    Number("sway", 1.0, "1/s", "drag sideways, with the speed", True),
    Number("sway2", 1.0, "1/m", "drag sideways, with the square of the speed", True),
    Number("sway_ahead", 1.0, "1/m", "drag sideways, with the way ahead", True),
    Number("sway_yaw", 0.1, "m/s", "acceleration sideways for a rate of turn", low=-0.6, high=0.6),
    Number("surge_turning", 0.3, "", "mass sideways over mass ahead", True),
    Number("sway_turning", 0.3, "", "mass ahead over mass sideways", True),
    Number("arm", 0.7, "rad/m", "turning by a motor, over its acceleration ahead", True),
    Number("arm_uneven", 0.1, "", "starboard motor's turning over port, logarithm", of=SIDES),
    Number("yaw", 1.0, "1/s", "damping of a turn", True),
    Number("yaw2", 1.2, "1/rad", "damping of a turn, with its square", True),
    Number("yaw_ahead", 1.2, "1/m", "damping of a turn, with the way ahead", True),
    Number("munk", 1.0, "rad/m2", "turning by leeway, of the added masses", low=-4.0, high=4.0),
    Number(
        "straight",
        4.0 * DEGREE,
        "rad",
        "angle of the motor, as it is told, at which it pushes straight",
        low=-0.3,
        high=0.3,
        of=STEERS,
    ),
    Number("across", 0.35, "", "strength of motors that push aside alone, over that of the others", True, of=ACROSS),
    Number("within_starboard", 0.25, "", "first motor over second at starboard, logarithm", of=WITHIN),
    Number("within_port", 0.25, "", "first motor over second at port, logarithm", of=WITHIN),
    Number("turning", 0.02, "rad/s2", "turning by itself"),
    Number("wind_north", 0.03, "m/s2", "acceleration by the wind, to the north"),
    Number("wind_east", 0.03, "m/s2", "acceleration by the wind, to the east"),
    Number("wind_turning", 20.0, "s2/m2", "turning by the wind from abaft or ahead of the beam"),
    Number("current_north", 0.15, "m/s", "current and leeway, to the north"),
    Number("current_east", 0.15, "m/s", "current and leeway, to the east"),
    Number("late", 0.12, "s", "age of a measured velocity", low=0.0, high=0.6),
    Number("antenna_ahead", 0.7, "m", "antenna, ahead of the point about which she turns"),
    Number("antenna_aside", 0.3, "m", "antenna, to starboard of it"),
    Number("gyro_bias", DEGREE, "rad/s", "what the gyro says at rest"),
    Number("compass_offset", 8.0 * DEGREE, "rad", "what the compass says too much"),
    Number("hard_ahead", 0.12, "", "hard iron ahead, over the earth's horizontal field"),
    Number("hard_aside", 0.12, "", "hard iron to starboard, over the earth's horizontal field"),
    Number("soft_along", 0.035, "", "soft iron: more along than across"),
    Number("soft_across", 0.035, "", "soft iron: from along to across"),
)
NAMES: Final = tuple(each.name for each in NUMBERS)
PLACE: Final = {name: index for index, name in enumerate(NAMES)}
FACTORS: Final = np.array([each.is_factor for each in NUMBERS])
SPREADS: Final = np.array([each.spread for each in NUMBERS])
LOWS, HIGHS = (np.array([getattr(each, end) for each in NUMBERS]) for end in ("low", "high"))
OF_THE_DAY: Final = (  # of sea and sensors, not of the boat
    *("wind_north", "wind_east", "current_north", "current_east", "late", "antenna_ahead", "antenna_aside"),
    *("gyro_bias", "compass_offset", "hard_ahead", "hard_aside", "soft_along", "soft_across", "turning"),
)
LOCAL: Final = 4  # unknowns of a window: surge, sway, rate of turn and heading where it begins
SMALLEST: Final = 1e-4  # of a factor


class SteeringGear(NamedTuple):
    """What turns a motor."""

    is_rudder: bool  # it turns nothing astern
    way: float  # -1: behind the middle, where a thrust to starboard turns the boat to port; 1: before it
    most_rad: float


class MotorPush(NamedTuple):
    """What one of three or four fixed motors does to the boat, each commanded by itself. Its command is positive where it
    pushes ahead; of one that pushes aside alone along its angle."""

    side: int  # 1 starboard, -1 port: whose numbers it has; 0: it pushes aside alone
    ahead: float  # of its force, by a positive command
    aside: float
    arm: float  # of its moment, positive to starboard, over the mean arm of both sides
    within: float  # 0.5, -0.5: the first and the second of two at its side that push across; 0
    shares: tuple[float, float]  # its force, full ahead and full astern, over that of its side ahead, as the file has them

    @property
    def weight(self) -> float:
        """Its part of the push ahead of its side."""
        return self.ahead * self.shares[0]


class Windows(NamedTuple):
    """Pieces of a record of one length, on an even grid. The second motor is the port one; of a boat that steers the second
    column is the angle of its motor, rad. Where there are `rows`, each has a column."""

    step_s: float
    commands: Array  # (windows, back + steps, columns): mean part of each motor over each step, and over those before the first
    measured: Array  # (steps, windows, 4): velocity north and east, heading, rate of turn; NaN: not measured
    from_s: Array  # (windows,), of the record's clock
    back: int
    gear: SteeringGear | None = None
    rows: tuple[MotorPush, ...] = ()

    @property
    def steps(self) -> int:
        return len(self.measured)

    @property
    def has_pairs(self) -> bool:
        """Whether two motors stand at a side."""
        return any(sum(row.side == side for row in self.rows) > 1 for side in (1, -1))

    @property
    def pushes_aside(self) -> bool:
        """Whether a motor pushes aside alone."""
        return any(not row.side for row in self.rows)

    @property
    def sides(self) -> Array:
        """The commands of starboard and of port, of each the mean of its motors by their pushes ahead; else the two columns."""
        if not self.rows:
            return self.commands
        weights = np.array([[row.weight * (row.side == side) for side in (1, -1)] for row in self.rows])
        return np.asarray(self.commands @ (weights / weights.sum(0)))


class ModelMotion(NamedTuple):
    """The simulated motion through the water at the beginning of each step: (steps, lanes, windows)."""

    surge: Array
    sway: Array
    turn: Array
    heading: Array


def internal(values: Mapping[str, float]) -> Array:
    """The numbers as the fit changes them: the logarithm of a factor."""
    every = np.array([float(values[name]) for name in NAMES])
    every[FACTORS] = np.log(np.maximum(every[FACTORS], SMALLEST))
    return every


def values_of(theta: Array) -> dict[str, Array]:
    """The numbers by name, of the internal ones (lanes, numbers)."""
    every = np.where(FACTORS, np.exp(np.where(FACTORS, theta, 0.0)), theta)
    return {name: every[:, index : index + 1] for name, index in PLACE.items()}


def plain(theta: Array) -> dict[str, float]:
    """One set of internal numbers (numbers,) by name."""
    return {name: float(each[0, 0]) for name, each in values_of(theta[None]).items()}


def simulate(p: Values, windows: Windows, start: Array) -> ModelMotion:
    """Simulate all lanes from their first states (lanes, windows, LOCAL), by the midpoint rule."""
    pushes = _pushes(p, windows)
    steps, lanes, count = pushes[0].shape
    u, v, r, psi = (start[..., index].copy() for index in range(LOCAL))
    h, half = windows.step_s, 0.5 * windows.step_s
    motion = ModelMotion(*(np.empty((steps, lanes, count)) for _ in ModelMotion._fields))
    pushed = _by_rows(p, windows.rows) if windows.rows else _by_sides(p)
    if windows.gear is not None:
        pushed = _by_steering(p, windows.gear)
    for step in range(steps):
        surge, sway, turn = pushed([each[step] for each in pushes], u)
        c, s = np.cos(psi), np.sin(psi)
        wind_u, wind_v = p["wind_north"] * c + p["wind_east"] * s, p["wind_east"] * c - p["wind_north"] * s
        push = (
            surge + wind_u,
            sway + 1.5 * p["sway_turning"] * wind_v,
            turn + p["turning"] + p["wind_turning"] * wind_u * wind_v,
        )
        du, dv, dr = _accelerations(p, u, v, r, push)
        for kept, each in zip(motion, (u, v, r, psi), strict=True):
            kept[step] = each
        psi = psi + h * (r + half * dr)
        du, dv, dr = _accelerations(p, u + half * du, v + half * dv, r + half * dr, push)
        u, v, r = np.clip(u + h * du, -20.0, 20.0), np.clip(v + h * dv, -10.0, 10.0), np.clip(r + h * dr, -6.0, 6.0)
    return motion


Pushed = Callable[[Sequence[Array], Array], tuple[Array, Array, Array]]  # of what `_pushes` has of a step, and the way ahead


def _by_sides(p: Values) -> Pushed:
    """The acceleration ahead, aside and of the turn, by a motor at each side."""
    arm_port, arm_starboard = p["arm"] * np.exp(-0.5 * p["arm_uneven"]), p["arm"] * np.exp(0.5 * p["arm_uneven"])

    def pushed(motors: Sequence[Array], u: Array) -> tuple[Array, Array, Array]:
        starboard, starboard_loss, port, port_loss = motors
        starboard = np.maximum(starboard - starboard_loss * u, np.minimum(starboard, 0.0))
        port = np.maximum(port - port_loss * u, np.minimum(port, 0.0))
        return starboard + port, np.zeros(()), arm_port * port - arm_starboard * starboard

    return pushed


def _by_rows(p: Values, rows: Sequence[MotorPush]) -> Pushed:
    """The same by three or four fixed motors, each commanded by itself."""
    arms = [row.arm * p["arm"] * np.exp(0.5 * row.side * p["arm_uneven"]) for row in rows]

    def pushed(motors: Sequence[Array], u: Array) -> tuple[Array, Array, Array]:
        ahead = aside = turn = np.zeros(())
        for row, arm, push, loss in zip(rows, arms, motors[::2], motors[1::2], strict=True):
            its = np.maximum(push - loss * u, np.minimum(push, 0.0))
            ahead, aside, turn = ahead + row.ahead * its, aside + row.aside * its, turn + arm * its
        return ahead, p["sway_turning"] * aside, turn

    return pushed


def _by_steering(p: Values, gear: SteeringGear) -> Pushed:
    """The same by one motor that steers: its force is turned as a whole, but for that of a rudder astern."""

    def pushed(motors: Sequence[Array], u: Array) -> tuple[Array, Array, Array]:
        thrust, loss, angle = motors
        thrust = np.maximum(thrust - loss * u, np.minimum(thrust, 0.0))
        angle = np.where(thrust < 0.0, 0.0, angle - p["straight"]) if gear.is_rudder else angle - p["straight"]
        aside = thrust * np.sin(angle)
        return thrust * np.cos(angle), p["sway_turning"] * aside, gear.way * p["arm"] * aside

    return pushed


def _accelerations(p: Values, u: Array, v: Array, r: Array, push: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    ahead = np.abs(u)
    du = push[0] - (p["surge"] + p["surge2"] * ahead) * u + p["surge_turning"] * v * r
    dv = (
        push[1]
        - p["sway_turning"] * u * r
        - (p["sway"] + p["sway2"] * np.abs(v) + p["sway_ahead"] * ahead) * v
        - p["sway_yaw"] * r
    )
    dr = push[2] - (p["yaw"] + p["yaw2"] * np.abs(r) + p["yaw_ahead"] * ahead) * r - p["munk"] * u * v
    return du, dv, dr


def _pushes(p: Values, windows: Windows) -> list[Array]:
    """The acceleration that each motor gives at rest, and what it loses for each m/s, (steps, lanes, windows): starboard,
    its loss, port, its loss; or the one motor, its loss, its angle. Few lanes differ in what makes a motor late."""
    late, of_lane = np.unique(np.hstack([p["delay"], p["lag"]]), axis=0, return_inverse=True)
    turned = [_turned(windows, delay_s, lag_s) for delay_s, lag_s in late]
    each = np.stack(turned)[of_lane.reshape(-1)]  # (lanes, steps, windows, 2)
    if windows.rows:
        return _pushes_of_rows(p, windows.rows, each)
    out = list[Array]()
    sides = ((0, 0.5, p["dead_starboard"]), (1, -0.5, p["dead_port"]))
    for side, sign, dead in sides if windows.gear is None else [(0, 0.0, p["dead_starboard"])]:
        part = each[..., side].transpose(1, 0, 2)
        ahead = p["ahead"] * np.exp(sign * p["ahead_uneven"])
        back = ahead * p["astern"] * np.exp(sign * p["astern_uneven"])
        share = np.maximum((np.abs(part) - dead) / (1.0 - dead), 0.0)
        lawful = np.power(share + 1e-12, p["power"]) * (share > 0.0)
        push = np.where(part > 0.0, ahead * lawful, -back * lawful)
        out += [push, p["loss"] * ahead * np.maximum(part, 0.0) * (push > 0.0)]
    return out if windows.gear is None else [*out, each[..., 1].transpose(1, 0, 2)]


def _pushes_of_rows(p: Values, rows: Sequence[MotorPush], each: Array) -> list[Array]:
    """The same of three or four fixed motors, one after the other, of their parts (lanes, steps, windows, rows). One that
    pushes aside alone loses nothing by the way ahead."""
    out = list[Array]()
    for index, row in enumerate(rows):
        part, sign = each[..., index].transpose(1, 0, 2), 0.5 * row.side
        dead = {1: p["dead_starboard"], -1: p["dead_port"], 0: 0.5 * (p["dead_starboard"] + p["dead_port"])}[row.side]
        among = row.within * p["within_starboard" if row.side > 0 else "within_port"]
        side = p["ahead"] * np.exp(sign * p["ahead_uneven"] + among)
        share = np.maximum((np.abs(part) - dead) / (1.0 - dead), 0.0)
        lawful = np.power(share + 1e-12, p["power"]) * (share > 0.0)
        if row.side:
            ahead, loss = side * row.shares[0], p["loss"] / row.ahead
            back = ahead * p["astern"] * np.exp(sign * p["astern_uneven"])
        else:
            ahead, back = (side * p["across"] * its for its in row.shares)
            loss = np.zeros_like(dead)
        push = np.where(part > 0.0, ahead * lawful, -back * lawful)
        out += [push, loss * ahead * np.maximum(part, 0.0) * (push > 0.0)]
    return out


def _turned(windows: Windows, delay_s: float, lag_s: float) -> Array:
    """The part that each motor gives in the middle of each step, (steps, windows, columns): late, and slow to change. The
    boat's gate makes an angle as slow as its gear."""
    later, part = divmod(delay_s / windows.step_s, 1.0)
    shift, last, slow = int(later), windows.commands.shape[1] - 1, math.exp(-windows.step_s / lag_s)
    keep = np.array([slow, 0.0]) if windows.gear is not None else np.full(windows.commands.shape[2], slow)
    turned = np.empty((windows.steps, len(windows.commands), windows.commands.shape[2]))
    at = [windows.commands[:, min(max(index, 0), last)] for index in range(-shift - 1, last + 1 - shift)]
    motor = at[0]
    for index, (before, now) in enumerate(pairwise(at)):
        after = (1.0 - part) * now + part * before
        after = after + (motor - after) * keep
        if index >= windows.back:
            turned[index - windows.back] = 0.5 * (motor + after)
        motor = after
    return turned


def said(p: Values, heading: Array) -> Array:
    """The heading that the compass says: two numbers of hard iron, two of soft iron, an offset."""
    c, s = np.cos(heading), np.sin(heading)
    along = (1.0 + p["soft_along"]) * c - p["soft_across"] * s + p["hard_ahead"]
    across = p["soft_across"] * c - (1.0 - p["soft_along"]) * s + p["hard_aside"]
    return np.asarray(np.arctan2(-across, along) + p["compass_offset"])


def observe(p: Values, motion: ModelMotion, step_s: float) -> tuple[Array, Array, Array, Array]:
    """What is measured of this motion: the antenna's velocity some time ago, north and east, and current; the heading as the
    compass says it; the rate of turn as the gyro does."""
    c, s, r = np.cos(motion.heading), np.sin(motion.heading), motion.turn
    u, v = motion.surge - p["antenna_aside"] * r, motion.sway + p["antenna_ahead"] * r
    north, east = _earlier(np.stack([u * c - v * s, u * s + v * c]), p["late"], step_s)
    return north + p["current_north"], east + p["current_east"], said(p, motion.heading), r + p["gyro_bias"]


def _earlier(values: Array, late_s: Array, step_s: float) -> Array:
    """Values (kinds, steps, lanes, windows) as they were some time before, that of each lane (lanes, 1): on a line between two
    steps, and before the first step on that of the first two."""
    out, steps = np.empty_like(values), values.shape[1]
    for each in np.unique(late_s):
        lanes = late_s[:, 0] == each
        its, (shift, part) = values[:, :, lanes], divmod(each / step_s, 1.0)
        count = int(shift) + 1
        before = its[:, :1] - np.arange(count, 0, -1)[None, :, None, None] * (its[:, 1:2] - its[:, :1])
        every = np.concatenate([before, its], 1)
        out[:, :, lanes] = (1.0 - part) * every[:, 1 : 1 + steps] + part * every[:, :steps]
    return out
