"""Thrust curves: the command of a force gives that force, whatever the curve; nothing is beyond its ends."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.vehicle.control.thrustcurve import LEAST, Curve, Law, Points

IDLE = Points([(-1.0, -300.0), (-0.05, -50.0), (-0.05, 0.0), (0.0, 0.0), (0.05, 0.0), (0.05, 60.0), (0.5, 300.0), (1.0, 800.0)])
laws = st.builds(Law, st.floats(-900.0, -1.0), st.floats(1.0, 900.0), st.floats(0.2, 4.0), st.floats(0.0, 0.9))


@st.composite
def tables(draw: st.DrawFn) -> Points:
    def side() -> list[tuple[float, float]]:
        steps = draw(st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.1, 100.0)), min_size=1, max_size=6))
        total, c, force_n, points = sum(step for step, _ in steps), 0.0, 0.0, []
        for step, more_n in steps:
            c, force_n = min(c + step / total, 1.0), force_n + more_n
            points.append((c, force_n))
        return points

    astern, ahead = side(), side()
    return Points([*((-c, -f) for c, f in reversed(astern)), (0.0, 0.0), *ahead])


curves = st.one_of(laws, tables())


@given(curves, st.floats(-1.0, 1.0))
def test_a_force_and_its_command_belong_together(curve: Curve, share: float) -> None:
    wanted_n = share * (curve.ahead_n if share > 0.0 else -curve.astern_n)
    command = curve.command(wanted_n)
    assert -1.0 <= command <= 1.0
    assert curve.force(command) == pytest.approx(wanted_n, rel=1e-6, abs=2.0 * LEAST * max(curve.ahead_n, -curve.astern_n))


@given(curves, st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_more_force_is_more_command_and_nothing_is_beyond_the_ends(curve: Curve, a: float, b: float) -> None:
    low, high = min(a, b), max(a, b)
    assert -1.0 <= curve.command(low) <= curve.command(high) <= 1.0
    assert curve.astern_n <= curve.force(low) <= curve.force(high) <= curve.ahead_n


@pytest.mark.parametrize("curve", [Law(-1.0, 2.0), Law(-1.0, 2.0, 1.5, 0.1), IDLE])
def test_a_force_without_meaning_is_no_command(curve: Curve) -> None:
    assert math.isnan(curve.command(math.nan))


def test_a_deadband_is_passed_in_one_step_and_a_whisper_starts_nothing() -> None:
    curve = Law(-60.0, 100.0, dead=0.08)
    assert curve.command(0.009) == 0.0
    assert curve.command(0.02) == pytest.approx(0.093, abs=0.001)
    assert curve.command(25.0) == pytest.approx(0.54)
    assert curve.command(-15.0) == pytest.approx(-0.54)
    assert curve.force(0.08) == curve.force(-0.05) == 0.0


def test_a_thruster_without_force_astern_gets_no_command_astern() -> None:
    assert Law(0.0, 10.0).command(-5.0) == 0.0
    ahead_only = Points([(0.0, 0.0), (1.0, 10.0)])
    assert (ahead_only.command(-5.0), ahead_only.force(-1.0), ahead_only.astern_n) == (0.0, 0.0, 0.0)


def test_an_engine_in_gear_idles_or_stands() -> None:
    """Of what is less than idle it gives the nearer: nothing, or idle."""
    assert (IDLE.ahead_n, IDLE.astern_n) == (800.0, -300.0)
    assert [IDLE.command(force_n) for force_n in (29.0, 31.0, 60.0, -20.0, -30.0)] == [0.0, 0.05, 0.05, 0.0, -0.05]
    assert IDLE.force(0.05) == 60.0
    assert IDLE.command(180.0) == pytest.approx(0.275)
    assert IDLE.force(0.75) == pytest.approx(550.0)
