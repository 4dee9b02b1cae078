"""Allocation: never beyond a limit, the optimum that an independent solver finds, yaw before surge; what fails drops out."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.allocation import BOATS, EIGHT, FOUR, measured
from delfim.base.geodesy import wrap
from delfim.vehicle.control import allocation, solver
from delfim.vehicle.control.allocation import Allocation, Thruster
from delfim.vehicle.control.pivot import Pivot
from delfim.vehicle.control.solver import WEIGHTS
from delfim.vehicle.control.thrustcurve import Law

DT_S = 0.2


class Told(NamedTuple):
    """The answer of an allocation."""

    forces_n: Sequence[float]
    angles_rad: Sequence[float]
    short: tuple[float, float, float] | None


TWIN = tuple(Thruster(-1.5, y_m, 0.0, Law(-150.0, 240.0)) for y_m in (0.39, -0.39))
BOW = (
    *(Thruster(-2.0, y_m, 0.0, Law(-100.0, 250.0)) for y_m in (1.0, -1.0)),
    Thruster(2.0, 0.0, math.pi / 2, Law(-60.0, 60.0)),
)
RUDDER = (Thruster(-0.35, 0.0, 0.0, Law(-5.0, 10.0), Pivot(math.radians(35.0), 2.0, is_rudder=True)),)
OUTBOARD = (Thruster(-1.9, 0.0, 0.0, Law(-300.0, 800.0), Pivot(math.radians(35.0), math.radians(20.0))),)
ALL_ROUND = Pivot(math.pi, 1.0, ((math.radians(60.0), math.radians(120.0)),))
AZIMUTHS = tuple(Thruster(x_m, 0.0, 0.0, Law(0.0, 100.0), ALL_ROUND) for x_m in (2.0, -2.0))
ALL = {"twin": TWIN, "four": FOUR, "bow": BOW, "eight": EIGHT, "rudder": RUDDER, "outboard": OUTBOARD, "azimuths": AZIMUTHS}
AHEAD, TURNS = "nothing pushes the boat ahead", "the boat cannot turn to both sides while it goes ahead"

places = st.floats(-3.0, 3.0)
laws = st.builds(Law, st.floats(-200.0, 0.0), st.floats(1.0, 300.0), st.just(2.0), st.just(0.0))
fixed = st.builds(Thruster, places, places, st.floats(-math.pi, math.pi), laws, st.none())
pivots = st.builds(
    Pivot,
    st.floats(0.1, math.pi),
    st.floats(0.1, 10.0),
    st.sampled_from([(), ((0.5, 1.0),), ((2.5, -2.5), (-1.0, 0.2))]),
    st.booleans(),
)
turning = st.builds(Thruster, places, places, st.floats(-math.pi, math.pi), laws, pivots)
requests = st.tuples(st.floats(-3e3, 3e3), st.floats(-3e3, 3e3), st.floats(-5e3, 5e3))


def given_by(boat: Sequence[Thruster], told: Told) -> tuple[float, float, float]:
    """Surge, sway and yaw of these forces, from first principles."""
    surge = sway = yaw = 0.0
    for thruster, force_n, angle_rad in zip(boat, told.forces_n, told.angles_rad, strict=True):
        if thruster.pivot is not None and thruster.pivot.is_rudder and force_n < 0.0:
            angle_rad = 0.0
        x, y = force_n * math.cos(thruster.angle_rad + angle_rad), force_n * math.sin(thruster.angle_rad + angle_rad)
        surge, sway, yaw = surge + x, sway + y, yaw + thruster.x_m * y - thruster.y_m * x
    return surge, sway, yaw


def asked(boat: Sequence[Thruster], request: tuple[float, float, float], failed: frozenset[int] = frozenset()) -> Told:
    return Told(*Allocation(boat, failed).allocate(*request, [0.0] * len(boat), DT_S))


@given(st.lists(st.one_of(fixed, turning), min_size=1, max_size=16), requests, st.floats(0.0, 1.0))
def test_no_boat_gets_more_than_its_limits(boat: list[Thruster], request: tuple[float, float, float], dt_s: float) -> None:
    """Also over several cycles; and what it is told to be short of is what it is short of, but for a hundredth."""
    allocation, angles = Allocation(boat), [0.0] * len(boat)
    for _ in range(3):
        told = Told(*allocation.allocate(*request, angles, dt_s))
        for thruster, force_n, angle_rad, before_rad in zip(boat, told.forces_n, told.angles_rad, angles, strict=True):
            assert thruster.curve.astern_n - 1e-6 <= force_n <= thruster.curve.ahead_n + 1e-6
            if (pivot := thruster.pivot) is None:
                assert angle_rad == 0.0
                continue
            assert abs(angle_rad) <= pivot.angle_max_rad + 1e-9
            turned_rad = angle_rad - before_rad
            assert abs(wrap(turned_rad) if pivot.angle_max_rad == math.pi else turned_rad) <= pivot.rate_radps * dt_s + 1e-9
            if any(1e-6 < (angle_rad - a) % math.tau < (b - a) % math.tau - 1e-6 for a, b in pivot.forbidden):
                assert force_n == pytest.approx(0.0, abs=1e-9)
        short = told.short or (0.0, 0.0, 0.0)
        for wanted, missing, is_given in zip(request, short, given_by(boat, told), strict=True):
            assert wanted - missing == pytest.approx(is_given, abs=0.3 if missing else 0.3 + 0.01 * abs(wanted))
        angles = list(told.angles_rad)


def best(boat: Sequence[Thruster], request: tuple[float, float, float]) -> list[float]:
    """The optimum by scipy's bounded-variable least squares, from the same sum of squares."""
    optimize = pytest.importorskip("scipy.optimize", reason="needs the packages of `make formats`")
    np = pytest.importorskip("numpy")
    unit_n = max(max(t.curve.ahead_n, -t.curve.astern_n) for t in boat)
    arm_m = max(allocation.ARM_M, *(math.hypot(t.x_m, t.y_m) for t in boat))
    rows = np.array([[math.cos(t.angle_rad), math.sin(t.angle_rad), 0.0] for t in boat]).T
    rows[2] = [(t.x_m * math.sin(t.angle_rad) - t.y_m * math.cos(t.angle_rad)) / arm_m for t in boat]
    low, high = np.array([t.curve.astern_n for t in boat]) / unit_n, np.array([t.curve.ahead_n for t in boat]) / unit_n
    ends = np.stack([rows * low, rows * high])
    wanted = np.array([request[0], request[1], request[2] / arm_m]) / unit_n
    wanted = np.clip(wanted, ends.min(0).sum(1), ends.max(0).sum(1))
    weights = np.sqrt(WEIGHTS)
    effort = np.diag(1.0 / (np.maximum(-low, high) * math.sqrt(allocation.STIFF)))
    solved = optimize.lsq_linear(
        np.vstack([weights[:, None] * rows, effort]),
        np.concatenate([weights * wanted, np.zeros(len(boat))]),
        (low - 1e-12, high),
        tol=1e-14,
        method="bvls",
    )
    return [float(force * unit_n) for force in solved.x]


@given(st.lists(fixed, min_size=1, max_size=16), requests)
def test_the_forces_are_those_of_an_independent_solver(boat: list[Thruster], request: tuple[float, float, float]) -> None:
    largest_n = max(max(t.curve.ahead_n, -t.curve.astern_n) for t in boat)
    assert asked(boat, request).forces_n == pytest.approx(best(boat, request), abs=1e-4 * largest_n)


@given(st.lists(fixed, min_size=2, max_size=2), st.sets(st.sampled_from([0, 1])), requests)
def test_two_fixed_thrusters_have_the_forces_of_the_general_solver(boat, failed, request):
    """Also where one failed. The general solver ends at `CLOSE`, from which two almost parallel thrusters may be so far."""
    allocation = Allocation(boat, frozenset(failed))
    general, told = (
        allocation._exactly(allocation._columns, *request, [0.0, 0.0]),
        allocation.allocate(*request, [0.0, 0.0], DT_S),
    )
    assert told[0] == pytest.approx(general[0], abs=3e-4 * allocation._unit_n)
    if told[2] is not None:
        assert told[2] == pytest.approx(general[2], abs=3e-3 * allocation._unit_n)


@given(st.lists(fixed, min_size=2, max_size=2), requests)
def test_the_forces_of_two_thrusters_are_those_of_an_independent_solver(boat, request):
    largest_n = max(max(t.curve.ahead_n, -t.curve.astern_n) for t in boat)
    assert asked(boat, request).forces_n == pytest.approx(best(boat, request), abs=1e-6 * largest_n)


@given(st.lists(fixed, min_size=1, max_size=16), requests, st.floats(-1e-5, 1e-5), st.sampled_from([0, 1, 2]))
def test_a_little_more_asked_for_is_a_little_more_force(boat, request, more, which):
    other = list(request)
    other[which] += more
    a, b = asked(boat, request), asked(boat, (other[0], other[1], other[2]))
    gain = math.sqrt(max(WEIGHTS) * allocation.STIFF)  # the most that least squares can have
    largest_n = max(max(t.curve.ahead_n, -t.curve.astern_n) for t in boat)
    assert a.forces_n == pytest.approx(b.forces_n, abs=gain * abs(more) + 1e-4 * largest_n)


@pytest.mark.parametrize("boat", ALL.values(), ids=ALL)
@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_request_without_meaning_never_becomes_a_force(boat: Sequence[Thruster], which: int) -> None:
    """It stays one without meaning, for the last gate to refuse; and it is no error in the loop."""
    for nonsense in (math.nan, math.inf, -math.inf):
        request = [10.0, 0.0, 10.0]
        request[which] = nonsense
        told = asked(boat, (request[0], request[1], request[2]))
        for thruster, force_n in zip(boat, told.forces_n, strict=True):
            assert force_n != force_n or thruster.curve.astern_n <= force_n <= thruster.curve.ahead_n
        if math.isnan(nonsense):
            assert any(force_n != force_n for force_n in told.forces_n)


@pytest.mark.parametrize(
    ("boat", "surge_n", "kept"), [(TWIN, 247.0, 0.99), (FOUR, 411.0, 0.99), (BOW, 338.0, 0.99), (EIGHT, 213.0, 0.99)]
)
def test_yaw_is_kept_and_surge_gives_way(boat: Sequence[Thruster], surge_n: float, kept: float) -> None:
    """Far too much surge, and 60 % of the most yaw. A boat whose request is cut thruster by thruster loses its heading here."""
    most_nm = Allocation(boat).yaw_nm
    told = asked(boat, (1e4, 0.0, 0.6 * most_nm))
    surge, _, yaw = given_by(boat, told)
    assert yaw >= kept * 0.6 * most_nm
    assert surge == pytest.approx(surge_n, rel=0.01)


def test_a_request_that_the_boat_can_meet_is_met() -> None:
    for boat in (TWIN, FOUR, BOW, EIGHT):
        told = asked(boat, (60.0, 0.0, 30.0))
        assert told.short is None
        assert given_by(boat, told) == pytest.approx((60.0, 0.0, 30.0), abs=0.05)
    assert given_by(FOUR, asked(FOUR, (60.0, 50.0, 30.0))) == pytest.approx((60.0, 50.0, 30.0), abs=0.05)


@pytest.mark.parametrize("failed", range(4))
def test_three_of_four_carry_on(failed: int) -> None:
    told = asked(FOUR, (60.0, 0.0, 30.0), frozenset({failed}))
    assert told.forces_n[failed] == 0.0
    assert given_by(FOUR, told)[0::2] == pytest.approx((60.0, 30.0), abs=0.2)
    assert Allocation(FOUR).without(frozenset({failed})).steerable() == ""


@pytest.mark.parametrize(
    ("boat", "failed", "words"),
    [
        (TWIN, {0}, TURNS),
        (TWIN, {1}, TURNS),
        (TWIN, {0, 1}, AHEAD),
        (TWIN[:1], set(), TURNS),
        ((TWIN[0]._replace(y_m=0.0),), set(), TURNS),
        (BOW, {0}, ""),
        (BOW, {2}, ""),
        (BOW, {0, 1}, AHEAD),
        (FOUR, {3}, ""),
        (FOUR, {0, 1, 2}, TURNS),
        (RUDDER, {0}, AHEAD),
        *((boat, set(), "") for boat in ALL.values()),
    ],
)
def test_the_allocation_tells_when_a_boat_cannot_be_steered(boat: Sequence[Thruster], failed: set[int], words: str) -> None:
    assert Allocation(boat, frozenset(failed)).steerable() == words


@pytest.mark.parametrize("boat", [RUDDER, OUTBOARD])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_propeller_that_steers_pushes_as_much_as_the_turn_needs(boat: Sequence[Thruster], side: float) -> None:
    """Never astern for it; and full thrust gives way to the turn."""
    most_nm = Allocation(boat).yaw_nm
    for surge_n in (0.0, 1e4):
        told = asked(boat, (surge_n, 0.0, side * 0.5 * most_nm))
        for _ in range(20):
            told = Told(*Allocation(boat).allocate(surge_n, 0.0, side * 0.5 * most_nm, told.angles_rad, DT_S))
        surge, _, yaw = given_by(boat, told)
        assert side * yaw == pytest.approx(0.5 * most_nm, rel=0.03)
        assert surge > 0.0
        assert side * told.angles_rad[0] < 0.0  # aft of the middle: the stern goes to port when the bow goes to starboard


BOW_AND_STERN = (Thruster(-1.0, 0.0, 0.0, Law(-60.0, 100.0)), Thruster(1.0, 0.0, math.pi / 2, Law(-30.0, 30.0)))
PUSHED = {"rudder": (RUDDER, 5.0, 0.3), "outboard": (OUTBOARD, 300.0, 20.0), "bow and stern": (BOW_AND_STERN, 40.0, 5.0)}


@pytest.mark.parametrize(("boat", "surge_n", "yaw_nm"), PUSHED.values(), ids=PUSHED)
def test_a_boat_within_its_limits_is_short_of_nothing_but_sway(boat: Sequence[Thruster], surge_n: float, yaw_nm: float) -> None:
    """Or the integral of its speed waits for ever, and a small boat is slow against the wind."""
    allocation, angles = Allocation(boat), [0.0] * len(boat)
    for _ in range(10):
        told = Told(*allocation.allocate(surge_n, 0.0, yaw_nm, angles, DT_S))
        angles = list(told.angles_rad)
    assert told.short is not None
    assert told.short[0::2] == (0.0, 0.0)
    told = Told(*allocation.allocate(20.0 * surge_n, 0.0, yaw_nm, angles, DT_S))
    assert told.short is not None
    assert told.short[0] > 10.0 * surge_n


def test_a_rudder_does_nothing_astern() -> None:
    told = asked(RUDDER, (-4.0, 0.0, 0.5))
    assert told.forces_n[0] == pytest.approx(-4.0, abs=0.01)
    assert told.angles_rad == [0.0]
    assert told.short is not None
    assert told.short[2] == pytest.approx(0.5)


def test_an_azimuth_thruster_turns_to_the_force_and_passes_forbidden_sectors_without_thrust() -> None:
    allocation, angles, passed = Allocation(AZIMUTHS), [0.0, 0.0], 0
    for _ in range(40):
        told = Told(*allocation.allocate(-50.0, 20.0, 0.0, angles, DT_S))
        angles = list(told.angles_rad)
        for angle_rad, force_n in zip(told.angles_rad, told.forces_n, strict=True):
            if math.radians(60.0) < angle_rad < math.radians(120.0):
                passed += 1
                assert force_n == pytest.approx(0.0, abs=1e-6)
    assert passed > 2
    assert given_by(AZIMUTHS, told) == pytest.approx((-50.0, 20.0, 0.0), abs=0.1)
    for _ in range(40):  # straight to starboard is forbidden: to the nearer edge, each on its own
        told = Told(*allocation.allocate(0.0, 50.0, 0.0, told.angles_rad, DT_S))
    assert all(abs(wrap(a - math.radians(e))) < 1e-6 for a, e in zip(told.angles_rad, (120.0, 120.0), strict=True)) or all(
        not math.radians(60.1) < a < math.radians(119.9) for a in told.angles_rad
    )


@settings(max_examples=20)
@given(st.integers(0, 1000))
def test_the_solver_ends_after_few_steps(seed: int) -> None:
    """So that no request takes long: a limit of steps is never what ends it."""
    import random

    rnd, searched = random.Random(seed), 0
    real = solver._far

    def counting(*arguments: object) -> float:
        nonlocal searched
        searched += 1
        return real(*arguments)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "_far", counting)
        for _ in range(100):
            searched = 0
            asked(EIGHT, (rnd.uniform(-600.0, 600.0), rnd.uniform(-600.0, 600.0), rnd.uniform(-600.0, 600.0)))
            assert searched < 20


def test_the_benchmark_measures_every_boat() -> None:
    figures = measured(requests=50)
    assert [figure.name for figure in figures] == list(BOATS)
    assert all(figure.met_us > 0.0 and 0.0 < figure.saturated_us <= figure.worst_us for figure in figures)
