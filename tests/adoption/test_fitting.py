"""The fit finds what hulls of another hand do, says what it did not see, and refuses what it does not understand."""

import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from delfim import config
from delfim.adoption.changes import unseen
from delfim.adoption.figures import calm, figures
from delfim.adoption.fitting import Fit, fitted
from delfim.adoption.foretold import motors_of, prior
from delfim.adoption.found import compass
from delfim.adoption.model import NAMES, ModelMotion, observe, said, values_of
from delfim.adoption.record import BoatRecord, Series
from delfim.adoption.windows import windows_of
from delfim.base.errors import DelfimError
from delfim.simulator.tables import Sea
from delfim.vehicle.navigation.iron import Iron
from tests.adoption import hulls
from tests.adoption.hulls import Hidden, Sensors, after, sailed, stopping_m

ROOT = Path(__file__).parents[2]
SEA = Sea(current_mps=0.2, current_to_deg=70.0)
HULLS = hulls.otter, hulls.heron, hulls.slim


def fit_of(hidden: Hidden, record: BoatRecord) -> Fit:
    motors = motors_of(hidden.told)
    windows = windows_of(record, [(motors.starboard.row, 1.0), (motors.port.row, 1.0)])
    return fitted(windows, prior(hidden.told))


def compass_error_deg(fit: Fit, sensors: Sensors) -> float:
    headings = np.radians(np.arange(0.0, 360.0, 10.0))
    off = said(values_of(fit.theta[None]), headings)[0] - [sensors.said(each) for each in headings]
    return float(np.degrees(np.sqrt(np.mean((np.remainder(off + np.pi, 2.0 * np.pi) - np.pi) ** 2))))


def judge(hidden: Hidden, fit: Fit) -> None:
    """The figures within the bounds that 95 of 100 trials must keep."""
    assert fit.refusal == ""
    found = {name: each.found for name, each in figures(fit, calm(fit)).items()}
    true = {
        "half_mps": after(hidden, 0.5, 0.5).surge_mps,
        "quarter_mps": after(hidden, 0.25, 0.25).surge_mps,
        "turn_dps": math.degrees(after(hidden, 0.3, 0.7).yaw_rate_radps),
        "spin_dps": math.degrees(after(hidden, -0.5, 0.5).yaw_rate_radps),
    }
    assert {name: found[name] for name in true} == pytest.approx(true, rel=0.10)
    assert found["full_mps"] == pytest.approx(after(hidden, 1.0, 1.0).surge_mps, rel=0.15)
    assert found["stop_full_m"] == pytest.approx(stopping_m(hidden, 1.0), rel=0.25)
    assert fit.values["delay"] + fit.values["lag"] == pytest.approx(hidden.late_s, abs=0.1)
    assert compass_error_deg(fit, Sensors()) < 1.5


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 12))
@pytest.mark.parametrize("hull", HULLS)
def test_hulls_of_another_hand_are_found_in_many_trials(hull: Callable[[], Hidden], seed: int) -> None:
    hidden = hull()
    sea = Sea(current_mps=0.03 * seed, current_to_deg=33.0 * seed)
    judge(hidden, fit_of(hidden, sailed(hidden, sea, seed)))


@pytest.fixture(scope="module")
def heron() -> Hidden:
    return hulls.heron()


@pytest.fixture(scope="module")
def trial(heron: Hidden) -> BoatRecord:
    return sailed(heron, SEA)


@pytest.fixture(scope="module")
def fit(heron: Hidden, trial: BoatRecord) -> Fit:
    return fit_of(heron, trial)


def test_a_hull_of_another_hand_is_found(heron: Hidden, fit: Fit) -> None:
    judge(heron, fit)


def test_the_same_record_gives_the_same_numbers(heron: Hidden, trial: BoatRecord, fit: Fit) -> None:
    second = fit_of(heron, trial)
    assert fit.theta.tobytes() == second.theta.tobytes()
    assert fit.covariance.tobytes() == second.covariance.tobytes()


def test_what_the_record_does_not_show_stays_as_the_file_has_it(heron: Hidden) -> None:
    steps = [("ahead", 0.5 + 0.2 * way, 0.5 - 0.2 * way, 3.0) for _ in range(15) for way in (1.0, -1.0)]
    fit = fit_of(heron, sailed(heron, SEA, steps=steps))
    assert {"astern", "astern_uneven"} <= set(fit.unseen)
    assert "arm" not in fit.unseen
    assert "yaw" not in fit.unseen or "yaw2" not in fit.unseen


def test_exchanged_motors_are_refused(heron: Hidden, trial: BoatRecord) -> None:
    crossed = trial._replace(told=Series(trial.told.at_s, trial.told.values[:, ::-1]))
    assert "the motion does not follow from the commands" in fit_of(heron, crossed).refusal


def test_too_little_is_refused_in_words(heron: Hidden, trial: BoatRecord) -> None:
    short = trial._replace(told=Series(trial.told.at_s[:300], trial.told.values[:300]))
    with pytest.raises(DelfimError, match=r"only \d windows of 12 s .* 5 are needed"):
        fit_of(heron, short)
    drifting = trial._replace(told=Series(trial.told.at_s, 0.0 * trial.told.values))
    with pytest.raises(DelfimError, match=r"has no window .* in which the motors ran"):
        fit_of(heron, drifting)
    blind = trial._replace(velocity=Series.of((), 2))
    with pytest.raises(DelfimError, match="no velocity over ground was measured"):
        fit_of(heron, blind)


def test_motors_that_always_run_alike_say_nothing_of_turning(heron: Hidden, trial: BoatRecord) -> None:
    alike = trial._replace(told=Series(trial.told.at_s, trial.told.values[:, :1].repeat(2, 1)))
    with pytest.raises(DelfimError, match="both motors always ran alike"):
        fit_of(heron, alike)


def test_a_boat_with_other_thrusters_is_refused_by_name() -> None:
    its = config.load(ROOT / "etc/boats/float.toml")
    middle = msgspec.structs.replace(its.thrusters[2], y_m=0.0, angle_deg=0.0)
    other = msgspec.structs.replace(its, thrusters=(*its.thrusters[:2], middle, its.thrusters[3]))
    with pytest.raises(DelfimError, match="stern_starboard hardly turns the boat by itself"):
        motors_of(other)


def test_the_compass_of_the_file_undoes_what_the_fit_found(fit: Fit) -> None:
    """The fit sees true headings; the boat undoes the iron in magnetic ones, before the variation."""
    told = config.load(ROOT / "etc/boats/blueboat.toml", ["nmea0183.variation_deg=15.0"])
    keys = {each.key[-1]: each.value for each in compass(fit, told, 0.0)}
    iron, sensors, variation = Iron(config.CompassTable(**keys)), Sensors(), math.radians(15.0)
    for degrees in range(0, 360, 20):
        true = math.radians(degrees)
        found = iron.undone(sensors.said(true) - variation) + variation
        assert math.degrees(math.remainder(found - true, math.tau)) == pytest.approx(0.0, abs=1.5)


def test_a_second_trial_refines_the_compass_of_the_first(heron: Hidden, trial: BoatRecord) -> None:
    """The boat sails with a table that is half right: the fit sees what it leaves, and the new table undoes all of it."""
    half, sensors, variation = config.CompassTable(hard_ahead=0.05, offset_deg=4.0), Sensors(), math.radians(15.0)
    file = config.load(ROOT / "etc/boats/blueboat.toml", ["nmea0183.variation_deg=15.0"])
    told = [(at, Iron(half).undone(each - variation) + variation) for at, (each,) in zip(*trial.heading, strict=True)]
    fit = fit_of(heron, trial._replace(heading=Series.of(told, 1)))
    keys = {each.key[-1]: each.value for each in compass(fit, msgspec.structs.replace(file, compass=half), 0.0)}
    iron = Iron(config.CompassTable(**keys))
    for degrees in range(0, 360, 20):
        true = math.radians(degrees)
        found = iron.undone(sensors.said(true) - variation) + variation
        assert math.degrees(math.remainder(found - true, math.tau)) == pytest.approx(0.0, abs=1.5)


def test_in_gusts_a_slow_speed_is_unsure_and_words_say_why() -> None:
    """The quarter of command of a slim hull gives less than the gusts do; that of a Heron does not care."""
    windy = Sea(current_mps=0.15, current_to_deg=165.0, wind_mps=2.4, wind_from_deg=200.0)
    hidden = hulls.slim()
    fit = fit_of(hidden, sailed(hidden, windy, 5))
    told = figures(fit, calm(fit))
    quarter, true_mps = told["quarter_mps"], after(hidden, 0.25, 0.25).surge_mps
    assert quarter.found < 0.8 * true_mps
    assert quarter.spread > 0.2 * quarter.found
    assert abs(quarter.found - true_mps) < 2.0 * quarter.spread
    assert any("too much wind or waves for slow speeds: fit a calm day" in words for words in unseen(fit, told))


def test_in_a_calm_no_speed_is_unsure(fit: Fit) -> None:
    told = figures(fit, calm(fit))
    assert told["quarter_mps"].spread < 0.05 * told["quarter_mps"].found
    assert not any("too much wind" in words for words in unseen(fit, told))


@pytest.mark.parametrize("late_s", [0.0, 0.1, 0.33])
def test_a_late_antenna_off_the_middle_tells_what_it_did_then(late_s: float) -> None:
    """A spin on the spot: the antenna goes round, and its velocity is that of the heading some time ago. It has no part along
    the keel of then, which would be speed that she does not make."""
    step_s, turn, ahead_m = 0.1, 0.8, -0.6
    heading = turn * step_s * np.arange(60)[:, None, None]
    nothing = np.zeros_like(heading)
    motion = ModelMotion(nothing, nothing, nothing + turn, heading)
    lane = values_of(np.zeros((1, len(NAMES)))) | {"late": np.array([[late_s]]), "antenna_ahead": np.array([[ahead_m]])}
    north, east, *_ = observe(lane, motion, step_s)
    then = heading[10:] - turn * late_s
    assert np.allclose(north[10:], -ahead_m * turn * np.sin(then), atol=1e-3)
    assert np.allclose(east[10:], ahead_m * turn * np.cos(then), atol=1e-3)
