"""Fossen's Otter, a hull that nobody here wrote, sails with the gains that follow from its description."""

import math

import pytest

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.vehicle.state import Setpoint
from tests.parts.frontseats.otter import DESCRIBED, FULL_MPS, Otter
from tests.vehicle.closed_loop import DOCA, Boat, current, errors, path_errors


def otter(seed: int, of: int) -> Boat:
    """In half a metre per second of current, all around the compass."""
    return Boat(seed, model=Otter(current(seed, of)), vehicle=DESCRIBED)


def test_the_model_is_the_published_one() -> None:
    """Its speed at full thrust, and the rate of turn of its propellers set against each other."""
    ahead, turning = Otter(current(0, mps=0.0)), Otter(current(0, mps=0.0))
    for side, part in (("starboard", -1.0), ("port", 1.0)):
        ahead.command(side, 1200.0, True)
        turning.command(side, 1200.0 * part, True)
    ahead.advance(60.0)
    turning.advance(20.0)
    assert ahead.north_mps == pytest.approx(FULL_MPS, rel=0.01)
    assert math.degrees(turning.yaw_rate_radps) == pytest.approx(20.4, abs=2.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_heading_is_held_within_two_degrees_in_current(seed: int) -> None:
    boat = otter(seed, 4)
    for heading_rad in (0.0, math.pi / 2.0, math.pi):
        samples = list(boat.sail(Mode.HEADING, Setpoint(speed_mps=1.5, heading_rad=heading_rad), 60.0))
        left_deg = [math.degrees(wrap(heading_rad - x.truth.heading_rad)) for x in samples if x.t_s > samples[0].t_s + 20.0]
        assert errors(left_deg).most < 2.0
        ahead_mps = [
            x.truth.north_mps * math.cos(heading_rad) + x.truth.east_mps * math.sin(heading_rad) for x in samples[200:]
        ]
        assert sum(ahead_mps) / len(ahead_mps) == pytest.approx(1.5, abs=0.05)


def test_a_path_is_followed_within_half_a_metre_in_current() -> None:
    """Its lines and arcs at 1.5 m/s; root of the mean square of the true cross-track error."""
    runs = [path_errors(otter(seed, 8), DOCA.path) for seed in range(8)]
    assert errors([e for on_lines, on_arcs in runs for e in (*on_lines, *on_arcs)]).rms < 0.5
