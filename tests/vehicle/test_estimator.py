"""The estimator by itself: consistent, bounded, honest; each input gated, counted and started again by itself."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base import geodesy
from delfim.vehicle import inputhealth
from delfim.vehicle.navigation.estimator import Estimate, Estimator
from tests.vehicle.estimator_trial import ABOARD, PLACE, bounds, figures, tape, trial

LIMITS = config.NavigationTable(sources=("nmea2000",))
FROZEN_S = 3.0
HZ = 10
EAST = math.pi / 2


class Boat:
    """A boat on a straight line, whose sensors say so exactly ten times a second, and whatever is done to them."""

    def __init__(self, heading_rad: float = EAST, speed_mps: float = 1.0, has_gyro: bool = True, **settings: float) -> None:
        self.estimator = Estimator(config.EstimatorTable(**settings), LIMITS, FROZEN_S)
        self.heading_rad, self.speed_mps, self.rate_radps, self.has_gyro = heading_rad, speed_mps, 0.0, has_gyro
        self.t_s, self.north_m, self.east_m, self.tick = 100.0, 0.0, 0.0, 0
        self.deaf: set[str] = set()
        self.jump_m = self.compass_rad = self.gyro_radps = 0.0
        self.frozen: set[str] = set()
        self._said: dict[str, tuple[float, ...]] = {}

    def sail(self, seconds: float) -> Estimate:
        for _ in range(round(seconds * HZ)):
            self.t_s += 1.0 / HZ
            self.tick += 1
            self.heading_rad = (self.heading_rad + self.rate_radps / HZ) % math.tau
            self.north_m += self.speed_mps / HZ * math.cos(self.heading_rad)
            self.east_m += self.speed_mps / HZ * math.sin(self.heading_rad)
            self._speak()
        return self.estimator.estimate(self.t_s)

    def _speak(self) -> None:
        wobble = 1e-4 * (self.tick % 7)  # sensors never say the same twice
        velocity = self.speed_mps * math.cos(self.heading_rad) + wobble, self.speed_mps * math.sin(self.heading_rad)
        say = {
            "rate": (self.rate_radps + self.gyro_radps + wobble,),
            "heading": (self.heading_rad + self.compass_rad + wobble,),
            "position": geodesy.from_plane(PLACE, self.north_m + self.jump_m + wobble, self.east_m),
            "velocity": velocity,
        }
        for kind, value in say.items():
            if kind in self.deaf or (kind == "rate" and not self.has_gyro):
                continue
            self._said[kind] = self._said.get(kind, value) if kind in self.frozen else value
            getattr(self.estimator, kind)(self.t_s, *self._said[kind])

    def away_m(self) -> float:
        """From the true place; -1: the estimator does not know."""
        e = self.estimator.estimate(self.t_s)
        if e.latitude_rad is None or e.longitude_rad is None:
            return -1.0
        return math.dist(geodesy.to_plane(PLACE, e.latitude_rad, e.longitude_rad), (self.north_m, self.east_m))

    def health(self, kind: str) -> inputhealth.InputHealth:
        return self.estimator.inputs[inputhealth.KINDS.index(kind)]

    def words(self) -> str:
        return inputhealth.in_words(self.estimator.inputs, self.t_s, LIMITS.stale_s, FROZEN_S)


@pytest.mark.parametrize("name", ABOARD)
def test_errors_are_what_the_filter_believes(name):
    """On the simulator's hull in current and wind. NEES and NIS are 1 in a filter that is right; more: it believes too much."""
    told = figures([trial(tape(seed, 60.0), seed, ABOARD[name]) for seed in range(6)])
    assert 0.5 < told["NEES position"] < 1.1, told
    assert 0.5 < told["NEES velocity"] < 1.1, told
    assert 0.4 < told["NEES heading"] < 1.2, told
    assert 0.6 < told["NIS position"] < 1.2, told
    assert 0.8 < told["NIS heading"] < 1.2, told
    assert told["heading, degrees"] < (0.6 if ABOARD[name].has_gyro else 1.6), "the compass alone: 2"
    assert told["position, m"] < 0.4
    assert told["velocity, m/s"] < (0.2 if ABOARD[name].has_velocity else 0.4)


@pytest.mark.long
@pytest.mark.parametrize("name", ABOARD)
def test_the_mean_errors_of_twenty_seeds_are_within_their_bounds(name):
    """As the picture of docs/estimator.md shows them: of a filter that is right, 95 % of such means are."""
    told = figures([trial(tape(seed), seed, ABOARD[name]) for seed in range(20)])
    for of, freedom in (("position", 2), ("velocity", 2), ("heading", 1)):
        low, high = bounds(freedom, 20)
        assert low < told[f"NEES {of}"] < high, told


VALUES = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(-10.0, 10.0), st.sampled_from([0.0, 0.67, -0.16, math.pi])
)
HEARD = st.tuples(
    st.sampled_from(inputhealth.KINDS),
    VALUES,
    VALUES,
    st.sampled_from([0.0, 1e-3, 0.1, 0.2, 1.0, 5.0, 1e5]),
    st.floats(-5.0, 5.0),
)


@given(st.lists(HEARD, max_size=60), st.sampled_from([0.0, 3.0]), st.booleans())
def test_whatever_comes_nothing_is_ever_not_a_number_nor_grows_for_ever(heard, arm_m, is_told):
    estimator = Estimator(config.EstimatorTable(antenna_forward_m=arm_m, position_latency_s=0.2), LIMITS, FROZEN_S)
    t_s = 5.0
    for kind, a, b, dt_s, late_s in heard:
        t_s += dt_s
        late = (late_s,) if is_told and kind != "rate" else ()
        getattr(estimator, kind)(t_s, *((a, b) if kind in ("position", "velocity") else (a,)), *late)
        e = estimator.estimate(t_s)
        assert all(value is None or math.isfinite(value) for value in e), e
        assert e.heading_rad is None or 0.0 <= e.heading_rad <= math.tau
        assert e.latitude_rad is None or abs(e.latitude_rad) < 1.6
        for each in (estimator.course, estimator.turn):
            assert min(each.p11, each.p22, each.p11 * each.p22 - each.p12**2) > 0.0, "a covariance is positive"
            assert max(each.p11, each.p22) < 1e4
        assert 0.0 < estimator.course.p33 < 1.0


def test_a_boat_without_inputs_knows_nothing():
    e = Estimator(config.EstimatorTable(), LIMITS, FROZEN_S).estimate(1.0)
    assert e[:6] == (None,) * 6


def test_a_position_that_jumps_is_refused_until_the_estimate_is_unknown_and_taken_then():
    boat = Boat()
    boat.sail(20.0)
    boat.jump_m = 40.0
    boat.sail(0.9)
    assert 0.0 <= boat.away_m() < 0.2, "it coasts"
    assert inputhealth.jumping(boat.estimator.inputs, boat.t_s, 0.5, LIMITS.stale_s) == "position jumped by 40 m"
    boat.sail(0.2)
    assert boat.estimator.course.known
    boat.sail(0.3)
    assert boat.away_m() == pytest.approx(40.0, abs=0.3), "nobody knows better: the failsafe has stopped the boat by now"
    assert boat.health("position").refused in range(11, 14)


def test_a_small_step_of_the_receiver_is_taken_before_position_is_unknown():
    boat = Boat()
    boat.sail(20.0)
    boat.jump_m = 4.0
    seen = [boat.away_m() for _ in range(12) if boat.sail(0.1)]
    assert min(seen) >= 0.0, "never unknown"
    assert seen[4] < 0.2
    assert seen[-1] == pytest.approx(4.0, abs=0.3)
    assert inputhealth.jumping(boat.estimator.inputs, boat.t_s, 0.5, LIMITS.stale_s) is None
    assert boat.estimator.restarts == 1


def test_a_single_outlier_leaves_no_trace():
    boat = Boat()
    boat.sail(20.0)
    boat.jump_m = 40.0
    boat.sail(0.1)
    boat.jump_m = 0.0
    boat.sail(0.1)
    assert 0.0 <= boat.away_m() < 0.05
    assert boat.health("position").refused == 1


def test_a_compass_that_jumps_is_refused_while_the_gyro_says_otherwise():
    boat = Boat()
    boat.sail(20.0)
    boat.compass_rad = math.radians(40.0)
    e = boat.sail(0.8)
    assert e.heading_rad == pytest.approx(EAST, abs=math.radians(1.0))
    assert inputhealth.jumping(boat.estimator.inputs, boat.t_s, 0.5, LIMITS.stale_s) == "heading jumped by 40 degrees"


@pytest.mark.parametrize("has_gyro", [True, False])
def test_a_boat_that_really_turns_is_not_refused(has_gyro):
    boat = Boat(has_gyro=has_gyro)
    boat.sail(20.0)
    boat.rate_radps = math.radians(25.0)
    e = boat.sail(5.0)
    assert e.heading_rad == pytest.approx(boat.heading_rad, abs=math.radians(1.5))
    assert e.yaw_rate_radps == pytest.approx(boat.rate_radps, abs=math.radians(1.0))
    assert boat.health("heading").refused == 0
    assert 0.0 <= boat.away_m() < 0.3
    assert math.hypot(e.north_mps, e.east_mps) == pytest.approx(1.0, abs=0.1), "the velocity turns with the boat"


def test_the_drift_of_a_gyro_is_learnt():
    boat = Boat()
    for minute in range(10):
        boat.gyro_radps = math.radians(0.2 * minute)
        e = boat.sail(60.0)
    assert e.heading_rad == pytest.approx(EAST, abs=math.radians(1.0))
    assert e.yaw_rate_radps == pytest.approx(0.0, abs=math.radians(0.2))
    assert boat.health("heading").refused == 0


def test_a_gyro_that_freezes_in_a_turn_is_left():
    boat = Boat()
    boat.rate_radps = math.radians(10.0)
    boat.sail(20.0)
    boat.frozen = {"rate"}
    boat.rate_radps = 0.0
    e = boat.sail(10.0)
    assert e.heading_rad == pytest.approx(boat.heading_rad, abs=math.radians(2.0))
    assert "rate frozen for" in boat.words()
    assert not boat.estimator.turn.has_gyro


def test_a_frozen_velocity_is_left_and_positions_go_on():
    boat = Boat()
    boat.sail(20.0)
    boat.frozen = {"velocity"}
    boat.speed_mps = 0.2
    e = boat.sail(20.0)
    assert e.east_mps == pytest.approx(0.2, abs=0.1)
    assert boat.away_m() < 0.3
    assert "velocity frozen for" in boat.words()


@pytest.mark.parametrize("kind", ["position", "heading"])
def test_what_freezes_is_told_by_its_kind_although_the_estimate_moves_on(kind):
    boat = Boat()
    boat.rate_radps = math.radians(5.0)
    boat.sail(20.0)
    boat.frozen = {kind}
    boat.sail(3.5)
    assert inputhealth.frozen(boat.estimator.inputs, boat.t_s, FROZEN_S).startswith(f"{kind} frozen for 3.")
    boat.frozen = set()
    boat.sail(0.5)
    assert inputhealth.frozen(boat.estimator.inputs, boat.t_s, FROZEN_S) is None


def test_a_receiver_that_holds_its_position_at_rest_is_not_frozen():
    boat = Boat(speed_mps=0.1)
    boat.sail(5.0)
    boat.frozen = {"position"}
    boat.sail(10.0)
    assert inputhealth.frozen(boat.estimator.inputs, boat.t_s, FROZEN_S) is None
    boat.frozen = {"position", "velocity"}
    boat.sail(4.0)
    assert "position frozen" in inputhealth.frozen(boat.estimator.inputs, boat.t_s, FROZEN_S), "the velocity is no witness now"


@pytest.mark.parametrize(("kind", "gone"), [("position", (0, 1, 2, 3)), ("heading", (4,))])
def test_silence_is_told_at_the_input_and_coasting_is_bounded(kind, gone):
    boat = Boat()
    boat.sail(20.0)
    boat.deaf = {kind}
    e = boat.sail(0.9)
    assert None not in e[:6], "it coasts"
    assert boat.away_m() < 0.1
    assert inputhealth.silent(boat.estimator.inputs, boat.t_s, 0.5) == f"{kind} silent for 0.9 s"
    e = boat.sail(0.4)
    assert [i for i in range(6) if e[i] is None] == list(gone)
    assert boat.words().startswith(f"{kind} silent for 1 s")
    boat.deaf = set()
    assert None not in boat.sail(1.0)[:6]


def test_without_a_gyro_the_compass_gives_the_rate_of_turn_and_a_gyro_that_is_lost_leaves_it():
    boat = Boat()
    boat.rate_radps = math.radians(6.0)
    boat.sail(20.0)
    boat.deaf = {"rate"}
    e = boat.sail(5.0)
    assert e.yaw_rate_radps == pytest.approx(boat.rate_radps, abs=math.radians(1.0))
    assert boat.words() == "rate silent for 5 s"
    boat.deaf = {"rate", "heading"}
    assert boat.sail(2.0).yaw_rate_radps is None


@pytest.mark.parametrize("has_velocity", [True, False])
def test_the_antenna_is_not_the_boat(has_velocity):
    """The boat turns on the spot, the antenna drives in a circle around it."""
    arm = complex(3.0, -1.0)  # forward, starboard
    estimator = Estimator(config.EstimatorTable(antenna_forward_m=3.0, antenna_starboard_m=-1.0), LIMITS, FROZEN_S)
    rate_radps, heading_rad = 0.3, 0.0
    for i in range(300):
        t_s, heading_rad = 0.1 * i, 0.03 * i
        place = arm * complex(math.cos(heading_rad), math.sin(heading_rad))
        estimator.heading(t_s, heading_rad)
        estimator.rate(t_s, rate_radps + 1e-4 * (i % 3))
        estimator.position(t_s, *geodesy.from_plane(PLACE, place.real, place.imag))
        if has_velocity:
            way = place * complex(0.0, rate_radps)
            estimator.velocity(t_s, way.real, way.imag)
    e = estimator.estimate(t_s)
    assert math.hypot(*geodesy.to_plane(PLACE, e.latitude_rad, e.longitude_rad)) < 0.1
    assert math.hypot(e.north_mps, e.east_mps) < 0.05


@pytest.mark.parametrize("is_told", [True, False])
def test_late_values_are_carried_to_the_present(is_told):
    """Of a boat that drives in a circle; each value is as old as it says, or as the settings say."""
    late_s, rate_radps, speed_mps = 0.3, 0.2, 2.0
    settings = (
        config.EstimatorTable() if is_told else config.EstimatorTable(position_latency_s=late_s, heading_latency_s=late_s)
    )
    estimator, told = Estimator(settings, LIMITS, FROZEN_S), (late_s,) if is_told else ()

    def at(t_s: float) -> tuple[float, float]:
        return speed_mps / rate_radps * math.sin(rate_radps * t_s), -speed_mps / rate_radps * math.cos(rate_radps * t_s)

    for i in range(400):
        t_s = 0.1 * i
        then_s = t_s - late_s
        estimator.rate(t_s, rate_radps + 1e-5 * (i % 3))
        estimator.heading(t_s, rate_radps * then_s, *told)
        estimator.position(t_s, *geodesy.from_plane(PLACE, *at(then_s)), *told)
        estimator.velocity(t_s, speed_mps * math.cos(rate_radps * then_s), speed_mps * math.sin(rate_radps * then_s), *told)
    e = estimator.estimate(t_s)
    assert math.dist(geodesy.to_plane(PLACE, e.latitude_rad, e.longitude_rad), at(t_s)) < 0.1
    assert math.remainder(e.heading_rad - rate_radps * t_s, math.tau) == pytest.approx(0.0, abs=0.01)
    assert e.north_mps == pytest.approx(speed_mps * math.cos(rate_radps * t_s), abs=0.05)


def test_a_voyage_around_the_world_lays_its_plane_anew():
    boat = Boat(speed_mps=30.0)
    boat.sail(900.0)
    e = boat.estimator.estimate(boat.t_s)
    assert boat.estimator.course.p11 < 1.0
    assert abs(boat.estimator.course.east_m) < 10_100.0
    assert boat.health("position").refused == 0
    assert e.east_mps == pytest.approx(30.0, abs=0.2)


def test_nothing_is_told_of_a_healthy_boat():
    boat = Boat()
    boat.sail(20.0)
    assert boat.words() == ""
    inputs = boat.estimator.inputs
    assert inputhealth.silent(inputs, boat.t_s, 1.0) is inputhealth.frozen(inputs, boat.t_s, 3.0) is None
    assert inputhealth.jumping(inputs, boat.t_s, 0.5, 1.0) is None
    assert [each.refused for each in inputs] == [0, 0, 0, 0]


def test_a_position_that_its_receiver_doubts_counts_less_and_is_none_in_the_end():
    """The settings say how good it is at best."""
    moved = {}
    for deviation_m in (0.0, 0.01, 4.0):
        boat = Boat(speed_mps=0.0, position_m=0.1)
        boat.sail(5.0)
        boat.t_s += 0.1
        boat.estimator.position(boat.t_s, *geodesy.from_plane(PLACE, 0.1, 0.0), None, deviation_m)
        moved[deviation_m] = boat.away_m()
    assert moved[4.0] < 0.1 * moved[0.0]
    assert moved[0.01] == moved[0.0]
    lost = Estimator(config.EstimatorTable(), LIMITS, FROZEN_S)
    lost.position(100.0, *geodesy.from_plane(PLACE, 0.0, 0.0), None, 12.0)
    assert lost.estimate(100.0).latitude_rad is None


@pytest.mark.parametrize(("deviation_deg", "least", "most"), [(0.0, 0.1, 0.4), (0.4, 0.1, 0.4), (20.0, 0.0, 0.05)])
def test_a_heading_counts_by_its_stated_deviation(deviation_deg, least, most):
    boat = Boat(speed_mps=0.0, has_gyro=False)
    boat.sail(10.0)
    boat.t_s += 0.1
    boat.estimator.heading(boat.t_s, EAST + math.radians(1.0), None, math.radians(deviation_deg))
    turned_deg = math.degrees((boat.estimator.estimate(boat.t_s).heading_rad or 0.0) - EAST)
    assert least <= turned_deg <= most
