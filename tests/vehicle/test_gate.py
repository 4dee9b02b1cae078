"""The last gate: whatever control wants, what leaves it is finite, within limits, and no faster than the rates allow."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from delfim.config import DELFIMX, Steer, ThrusterTable
from delfim.vehicle.propulsion.gate import GateLimits, limited
from delfim.vehicle.state import Actuation

TWO = GateLimits(DELFIMX)
STEER = Steer(kind="azimuth", angle_max_deg=40.0, rate_dps=30.0, forbidden_deg=((10.0, 20.0),))
OUTBOARD = ThrusterTable(name="motor", driver="dsor", thrust_n=(-100.0, 300.0), rate_per_s=0.5, steer=STEER)
ROUND = ThrusterTable(
    name="pod", driver="dsor", thrust_n=(-100.0, 300.0), steer=Steer(kind="azimuth", angle_max_deg=180.0, rate_dps=90.0)
)
MIXED = GateLimits((OUTBOARD, ROUND))
FLOATS = st.floats(allow_nan=True, allow_infinity=True)
ANYTHING = st.builds(Actuation, st.lists(FLOATS, max_size=3).map(tuple), st.lists(FLOATS, max_size=3).map(tuple), st.booleans())
FRACTIONS = st.tuples(*[st.floats(-1.0, 1.0)] * 2)


@given(ANYTHING, FRACTIONS, FLOATS)
@example(Actuation((0.5, math.nan), (0.0, 0.0), True), (0.0, 0.0), 0.2)
def test_the_gate_passes_nothing_else(wanted: Actuation, previous: tuple[float, float], dt_s: float) -> None:
    for limits in (TWO, MIXED):
        sent = limited(wanted, Actuation(previous, (0.2, 3.0), True), limits, dt_s)
        assert len(sent.thrust) == len(sent.angle_rad) == 2
        assert all(-1.0 <= each <= 1.0 for each in sent.thrust), "no number is none of these"
        assert abs(sent.angle_rad[0]) <= math.radians(40.0)
        assert abs(sent.angle_rad[1]) <= math.pi
        assert sent.run or sent.thrust == (0.0, 0.0)


@given(FRACTIONS, FRACTIONS, st.floats(0.0, 1.0))
def test_the_gate_limits_the_rate_and_arrives(asked: tuple[float, float], was: tuple[float, float], dt_s: float) -> None:
    wanted = Actuation(asked, (0.0, 0.0), True)
    after = limited(wanted, Actuation(was, (0.0, 0.0), True), TWO, dt_s)
    assert max(abs(new - old) for new, old in zip(after.thrust, was, strict=True)) <= 0.6667 * dt_s + 1e-9
    for _ in range(16):  # twice full command at 0.67 a second
        after = limited(wanted, after, TWO, 0.2)
    assert after == wanted


@pytest.mark.parametrize(
    "wanted",
    [
        Actuation((), (), False),
        Actuation((0.5, 0.5), (0.0, 0.0), False),
        Actuation((math.nan, 0.0), (0.0, 0.0), True),
        Actuation((0.0, math.inf), (0.0, 0.0), True),
        Actuation((0.5,), (0.0,), True),
        Actuation((0.5, 0.5, 0.5), (0.0, 0.0, 0.0), True),
    ],
)
def test_a_stop_is_immediate(wanted: Actuation) -> None:
    assert limited(wanted, Actuation((1.0, 1.0), (0.0, 0.0), True), TWO, 0.001) == TWO.still


@pytest.mark.parametrize(("asked", "sent"), [(-9.0, -1.0), (-1.5, -1.0), (-1.0, -1.0), (1.0, 1.0), (1.5, 1.0), (9.0, 1.0)])
def test_no_thruster_is_told_more_than_all(asked: float, sent: float) -> None:
    """However much is asked, and however little time its rate needs."""
    for limits in (TWO, MIXED):
        after = limited(Actuation((asked, asked), (0.0, 0.0), True), Actuation((0.0, 0.0), (0.0, 0.0), True), limits, 60.0)
        assert after == Actuation((sent, sent), (0.0, 0.0), True)


@pytest.mark.parametrize("limits", [TWO, MIXED])
def test_a_step_of_time_that_runs_backwards_changes_nothing(limits: GateLimits) -> None:
    was = Actuation((0.3, -0.4), (0.1, 2.0), True)
    assert limited(Actuation((0.9, -0.9), (0.5, -2.0), True), was, limits, -0.5) == was


def test_after_a_stop_thrust_begins_at_zero() -> None:
    after = limited(Actuation((0.9, 0.9), (0.0, 0.0), True), TWO.still, TWO, 0.1)
    assert after.thrust == pytest.approx((0.06667, 0.06667))


def test_what_turns_turns_at_its_rate_and_the_short_way_round() -> None:
    was = Actuation((0.0, 0.5), (math.radians(30.0), math.radians(175.0)), True)
    after = limited(Actuation((0.0, 0.5), (1.0, math.radians(-170.0)), True), was, MIXED, 0.1)
    assert [math.degrees(angle) for angle in after.angle_rad] == pytest.approx([33.0, -176.0])
    assert after.run


@pytest.mark.parametrize(("asked_deg", "sent_deg"), [(-90.0, -9.0), (-3.0, -3.0), (0.0, 0.0), (3.0, 3.0), (90.0, 9.0)])
def test_what_turns_all_round_does_so_to_either_side(asked_deg: float, sent_deg: float) -> None:
    was, wanted = ((Actuation((0.5, 0.5), (0.0, math.radians(angle)), True)) for angle in (0.0, asked_deg))
    assert math.degrees(limited(wanted, was, MIXED, 0.1).angle_rad[1]) == pytest.approx(sent_deg)


def test_an_angle_that_is_not_finite_is_a_stop_and_a_stop_leaves_the_angles() -> None:
    was = Actuation((0.3, 0.5), (0.1, 2.0), True)
    for wanted in (Actuation((0.3, 0.5), (math.nan, 2.0), True), Actuation((0.3, 0.5), (0.1,), True), Actuation((), (), False)):
        assert limited(wanted, was, MIXED, 0.1) == Actuation((0.0, 0.0), (0.1, 2.0), False)


def test_a_thruster_gives_no_thrust_in_a_sector_that_is_forbidden() -> None:
    thrust = [
        limited(Actuation((0.4, 0.4), (angle, 0.0), True), Actuation((0.4, 0.4), (angle, 0.0), True), MIXED, 0.1).thrust
        for angle in map(math.radians, (9.0, 10.0, 15.0, 20.0, 21.0))
    ]
    assert thrust == [(0.4, 0.4), (0.4, 0.4), (0.0, 0.4), (0.4, 0.4), (0.4, 0.4)], "its edges are allowed"
