"""Swimmers: how a thing moves is known from its sightings, and beside a swimmer the propellers stop until it is clear."""

import math
from collections.abc import Callable
from random import Random

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.base.vessels import ThingSeen
from delfim.parts.traffic.swimmers import CLEAR_S, MORE_M, Stopped, stopped_for, swimmer_near
from delfim.parts.traffic.thingmotion import FASTEST_MPS, SURE_S, ThingMotion, seen_again, seen_at, told_to_move
from delfim.parts.traffic.things import Things
from delfim.parts.traffic.trialways import swept
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import Motion
from delfim.vehicle.target import Target
from tests.parts.traffic.test_things import LIMITS, OWN, looked, nearest_m, seen, thing, way
from tests.parts.traffic.test_watchkeeper import VEHICLE, Notes

STOP_M = 8.0
HALVES_M = 2.5  # of a boat of 4 m and a head of 1 m


def swimmer(north_m: float, east_m: float = 0.0, course_deg: float = 0.0, speed_mps: float = 0.0) -> Target:
    return thing(1, north_m, east_m, kind="person")._replace(course_rad=math.radians(course_deg), speed_mps=speed_mps)


def watched(
    north_mps: float, east_mps: float, noise_m: float, seconds: float, each_s: float = 0.25, seed: int = 1
) -> ThingMotion:
    """What is known of a thing that was seen for so long."""
    random, found = Random(seed), seen_at(*seen()[:2], 0.0)
    for i in range(1, round(seconds / each_s)):
        t_s = i * each_s
        place = seen(north_mps * t_s + random.gauss(0.0, noise_m), east_mps * t_s + random.gauss(0.0, noise_m))
        found = seen_again(found, *place[:2], t_s)
    return found


# How a thing moves.


@pytest.mark.parametrize("noise_m", [0.1, 0.5])
@pytest.mark.parametrize("mps", [(0.8, 0.0), (-0.3, 0.3), (0.0, -1.5)])
def test_a_motion_is_known_from_its_sightings(mps: tuple[float, float], noise_m: float) -> None:
    for seed in range(20):
        assert watched(*mps, noise_m, 15.0, seed=seed).mps == pytest.approx(mps, abs=0.15)


@pytest.mark.parametrize(("noise_m", "each_s"), [(0.1, 0.25), (1.5, 0.25), (1.5, 1.0), (5.0, 5.0)])
def test_what_is_told_poorly_and_stands_is_not_taken_to_move(noise_m: float, each_s: float) -> None:
    for seed in range(50):
        assert watched(0.0, 0.0, noise_m, 60.0, each_s, seed).mps == (0.0, 0.0)


def test_it_moves_only_once_it_was_seen_for_long_enough_and_not_after_a_silence() -> None:
    assert watched(0.8, 0.0, 0.0, SURE_S).mps == (0.0, 0.0)
    known = watched(0.8, 0.0, 0.0, SURE_S + 1.0)
    assert known.mps == pytest.approx((0.8, 0.0), abs=0.01)
    assert seen_again(known, *seen()[:2], 60.0).mps == (0.0, 0.0)


def test_a_motion_that_is_told_is_taken_within_bounds() -> None:
    told = told_to_move(seen_at(*seen()[:2], 0.0), math.radians(90.0), 0.7)
    assert told.mps == pytest.approx((0.0, 0.7))
    assert told_to_move(told, 0.0, 0.0).mps == (0.0, 0.0)
    assert told_to_move(told, 0.0, 50.0).mps == pytest.approx((FASTEST_MPS, 0.0))


@given(st.lists(st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-5.0, 60.0)), max_size=30))
def test_no_sightings_make_it_faster_than_the_bound(places: list[tuple[float, float, float]]) -> None:
    found, t_s = seen_at(*seen()[:2], 0.0), 0.0
    for north_m, east_m, passed_s in places:
        t_s += passed_s
        found = seen_again(found, *seen(north_m, east_m)[:2], t_s)
        assert math.hypot(*found.mps) <= FASTEST_MPS + 1e-9
        assert math.isfinite(found.latitude_rad + found.longitude_rad)


def test_out_of_view_it_is_reckoned_on_for_a_while_and_its_reach_grows() -> None:
    things = Things(config.TrafficTable())
    for i in range(40):
        things.hear(seen(0.2 * i, kind="person"), "camera 1", 0.25 * i)
    (now,) = looked(things, 10.0)
    assert (now.speed_mps, now.course_rad) == pytest.approx((0.8, 0.0), abs=0.02)
    (later,) = looked(things, 9.75 + 8.0)
    assert later.north_m == pytest.approx(7.8 + 0.8 * 8.0, abs=0.5)
    assert later.margin_m == pytest.approx(10.0)
    (at_last,) = looked(things, 9.75 + 60.0)
    assert (at_last.speed_mps, at_last.margin_m) == (0.0, pytest.approx(62.0))
    assert at_last.north_m == pytest.approx(7.8 + 0.8 * 10.0, abs=0.5)


def test_what_is_small_and_swims_is_a_swimmer_though_nobody_calls_it_so() -> None:
    for radius_m, kind in ((0.5, "person"), (3.0, "thing")):
        things = Things(config.TrafficTable())
        for i in range(60):
            things.hear(seen(0.0, 0.15 * i, radius_m=radius_m), "lidar 1", 0.25 * i)
        (one,) = looked(things, 15.0)
        assert (one.kind, one.speed_mps) == (kind, pytest.approx(0.6, abs=0.02))


def test_a_report_that_tells_its_motion_is_believed_at_once() -> None:
    things = Things(config.TrafficTable())
    things.hear(seen(kind="person", course_rad=math.pi, speed_mps=0.5), "camera 1", 0.0)
    (one,) = looked(things, 0.0)
    assert (one.course_rad, one.speed_mps) == pytest.approx((math.pi, 0.5))


# Keeping clear of what moves.


def test_all_places_where_it_will_be_are_kept_clear_of() -> None:
    comes = swimmer(40.0, -25.0, 90.0, 0.8)
    wide = swept(OWN, 1.5, comes)
    assert (wide.east_m, wide.margin_m) == pytest.approx((-25.0 + 8.0, 2.0 + 8.0))
    assert swept(OWN, 1.5, swimmer(40.0)) == swimmer(40.0)
    passage = way(comes)
    assert passage is not None
    for at_s in (0.0, 10.0, 20.0):
        assert nearest_m(passage, comes._replace(east_m=-25.0 + 0.8 * at_s)) > 30.0


@pytest.mark.parametrize(
    ("swims", "is_slow"),
    [
        (swimmer(-20.0, 0.0, 0.0, 0.9), False),  # it would catch up with the slow boat
        (swimmer(-20.0, 0.0, 0.0, 0.3), True),
        (swimmer(10.0, 40.0, 10.0, 0.7), False),  # the slow boat would go beside it for long
        (swimmer(10.0, 20.0, 10.0, 0.7), True),  # it is nearer than the boat keeps
        (swimmer(20.0, 0.0, 180.0, 0.9), True),
    ],
)
def test_near_a_swimmer_the_boat_goes_slowly_but_not_beside_it_for_long(swims: Target, is_slow: bool) -> None:
    assert (swimmer_near(LIMITS, OWN, 1.5, [swims]) is not None) is is_slow


# Beside one.


def stop(
    was: Stopped | None, away_m: float, now_s: float, at_s: float | None = None, course_deg: float = 0.0, speed_mps: float = 0.0
) -> Stopped | None:
    here = Motion(frozenset({"position"}), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    swims = swimmer(away_m + HALVES_M, 0.0, course_deg, speed_mps)
    return stopped_for(was, [swims], now_s if at_s is None else at_s, here, LIMITS.length_m, STOP_M, now_s)


def test_the_propellers_turn_again_when_the_swimmer_is_clear_by_more_for_some_seconds() -> None:
    assert stop(None, STOP_M + 0.1, 0.0) is None
    was = stop(None, STOP_M - 0.1, 0.0)
    assert was is not None
    assert was.words == "propellers stopped: lidar 1, a swimmer, is beside the boat"
    assert was.order.speed_mps == 0.0
    was = stop(was, STOP_M + MORE_M - 0.1, 10.0)
    assert was is not None
    was = stop(was, STOP_M + MORE_M + 0.1, 10.0 + CLEAR_S - 0.1)
    assert was is not None
    assert stop(was, STOP_M + MORE_M + 0.1, 10.0 + CLEAR_S) is None


def test_it_is_reckoned_on_since_the_last_look() -> None:
    assert stop(None, STOP_M + 1.0, 2.0, 0.0, 180.0, 0.8) is not None
    assert stop(None, STOP_M + 1.0, 2.0, 0.0, 0.0, 0.8) is None


def test_the_nearest_one_is_named_and_who_is_forgotten_is_clear() -> None:
    here = Motion(frozenset({"position"}), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    far, near = swimmer(9.0)._replace(name="far"), swimmer(6.0)._replace(name="near")
    was = stopped_for(None, [far, near], 0.0, here, LIMITS.length_m, STOP_M, 0.0)
    assert was is not None
    assert was.name == "near"
    assert stopped_for(was, [], 0.0, here, LIMITS.length_m, STOP_M, CLEAR_S - 0.1) is not None
    assert stopped_for(was, [], 0.0, here, LIMITS.length_m, STOP_M, CLEAR_S) is None
    assert stopped_for(None, [near], 0.0, here, LIMITS.length_m, 0.0, 0.0) is None, "the file asks for none"


# In the boat.


class Bay:
    """A boat in lock step, to which a camera tells of a swimmer."""

    def __init__(self, *overrides: str) -> None:
        self.run = Lockstep(config.load(VEHICLE, ("simulation.heading_deg=0.0", *overrides)), 1, Notes)
        self.turned = list[bool]()  # in each cycle, whether the boat commanded its propellers
        self.words = set[str]()
        for _ in self.run.cycles(10.0):
            pass

    def order(self, command: console.Commands) -> None:
        assert self.run.command(command) is None

    def sail(self, seconds: float, ahead_m: Callable[[float], float] | None = None) -> None:
        """`ahead_m`: how far to the north of the boat's middle the swimmer is, by the seconds since."""
        state, began_s = self.run.state, self.run.elapsed_s
        for _ in self.run.cycles(seconds):
            motion, now_s = state.motion, self.run.clock.monotonic_s()
            if ahead_m is not None:
                assert state.origin is not None
                north_m = motion.north_m + ahead_m(self.run.elapsed_s - began_s)
                place = from_plane(state.origin, north_m, motion.east_m)
                state.hear(ThingSeen(*place, 0.3, "person"), "payload camera", now_s, "camera 1")
            self.turned.append(state.actuation.run)
            if state.traffic.order is not None:
                self.words.add(state.traffic.order.words)


WORDS = "propellers stopped: camera 1, a swimmer, is beside the boat"


@pytest.mark.parametrize("mode", ["course", "heading", "hold"])
def test_beside_a_swimmer_the_propellers_stop_and_go_on_when_it_is_clear(mode: str) -> None:
    bay = Bay()
    orders = {"course": console.Course(0.0, 1.0), "heading": console.Heading(0.0, 1.0), "hold": console.SetMode("hold")}
    bay.order(orders[mode])
    bay.sail(20.0)
    assert bay.turned[-1]
    bay.sail(20.0, lambda _: 8.0)
    assert WORDS in bay.words
    assert not any(bay.turned[-80:]), "from some seconds after it was seen first on"
    assert bay.run.state.mode.name.lower() == mode, "the mode is the same"
    assert any(WORDS in each.reason for each in bay.run.vehicle.helm.troubles.values())
    told = msgspec.json.decode(in_json(bay.run.vehicle.report()))["traffic"]
    assert told["order"]["words"] == WORDS, "to consoles and the page"
    assert bay.run.log.lines.count(f"traffic: {WORDS}") == 1  # type: ignore[attr-defined]
    bay.sail(15.0, lambda t_s: 8.0 + t_s)
    bay.sail(25.0, lambda t_s: 23.0 + t_s)
    assert bay.turned[-1]
    assert bay.run.state.traffic.order is None or bay.run.state.traffic.order.words != WORDS


def test_a_boat_that_is_driven_by_hand_is_warned_and_obeys() -> None:
    bay = Bay()
    bay.order(console.SetMode("manual"))
    for _ in range(20):
        bay.run.command(console.Manual(0.4, 0.4))
        bay.sail(1.0, lambda _: 9.0)
    assert bay.run.state.mode is Mode.MANUAL
    assert bay.turned[-1]
    assert any("camera 1 is close" in each.reason for each in bay.run.vehicle.helm.troubles.values())


def test_the_operator_overrules_a_stop_for_a_swimmer_that_is_not_there() -> None:
    bay = Bay()
    bay.order(console.Course(0.0, 1.0))
    bay.sail(20.0, lambda _: 8.0)
    assert not bay.turned[-1]
    bay.order(console.Overrule())
    bay.sail(3.0, lambda _: 8.0)
    assert bay.turned[-1]


def test_a_file_may_ask_for_no_stop() -> None:
    bay = Bay("traffic.guard.person_stop_m=0.0")
    bay.order(console.Course(0.0, 1.0))
    bay.sail(20.0, lambda _: 8.0)
    assert WORDS not in bay.words
