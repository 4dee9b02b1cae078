"""The way home where a chart is aboard: never through what it forbids, known before it is needed, and why there is none."""

import itertools
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.cooperative import Remains
from delfim.base.modes import Mode
from delfim.config import HomeTable
from delfim.simulator.scenarios import trial
from delfim.vehicle import console
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.helm import homeward
from delfim.vehicle.helm.homeward import SEEKING, Homeward
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.clearance import laid
from delfim.vehicle.plans.clearancefile import read
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.track import Track
from delfim.vehicle.plans.zones import LOOKS, Point, charted, clearance_m, least
from tests.vehicle.charted import Shoal, chart
from tests.vehicle.headland import AT, FILE, headland
from tests.vehicle.test_charted import CharteredSea
from tests.vehicle.test_track import sail

LIMITS = config.FenceTable()
BAR: list[Shoal] = [(60.0, east, 12.0) for east in range(-300, 61, 10)]
"""From the western edge of the chart to 72 m east of its middle."""
OVER, AWAY = (120.0, 0.0), (-100.0, -100.0)


def water(shoals: Sequence[Shoal]) -> Fence:
    return Fence((charted("no-go water", laid(read(chart(AT, shoals)).water(""), AT)),), LIMITS)


def looked_at(track: Track, around: Fence, most: int = 3000) -> Homeward:
    found = Homeward(track, Remains())
    for _ in range(most):
        found.look(around, 1.5)
        if not found.is_sought:
            break
    return found


def least_m(around: Fence, way: Sequence[Point]) -> float:
    return min(least(around.zones[0], a, b)[0] for a, b in itertools.pairwise(way))


def driven(*corners: Point, points: int = 1500) -> Track:
    track = Track(HomeTable(points=points))
    sail(track, *corners)
    return track


def test_a_track_through_free_water_stays_as_it_was_driven() -> None:
    track = driven((0.0, 0.0), (0.0, 110.0), (120.0, 110.0))
    was = track.points()
    assert looked_at(track, water(BAR)).why == ""
    assert track.points() == was


def test_a_piece_over_water_that_is_closed_now_leads_round_it() -> None:
    around, track = water(BAR), driven((0.0, 0.0), OVER)
    assert least_m(around, track.way_home()) <= 0.0
    assert looked_at(track, around).why == ""
    way = track.way_home()
    assert (way[0], way[-1]) == ((0.0, 0.0), track.points()[-1])
    assert least_m(around, way) >= LIMITS.margin_m - 1.0
    assert max(east_m for _, east_m in way) > 72.0
    assert sum(itertools.starmap(math.dist, itertools.pairwise(way))) < 260.0


def test_a_track_that_lost_points_is_looked_at_again() -> None:
    around, track = water(BAR), driven((0.0, 0.0), (0.0, 110.0), (120.0, 110.0), OVER, points=12)
    assert looked_at(track, around).why == ""
    assert least_m(around, track.way_home()) >= LIMITS.margin_m - 1.0


def test_the_drift_of_a_boat_that_was_off_is_no_way() -> None:
    around, track = water(BAR), driven((0.0, 0.0), (40.0, 0.0))
    track.add(*OVER)
    assert looked_at(track, around).why == ""
    assert least_m(around, track.way_home()) >= LIMITS.margin_m - 1.0


def test_without_a_way_it_is_told_why_until_the_boat_or_the_water_is_another() -> None:
    wall: list[Shoal] = [(60.0, east, 12.0) for east in range(-300, 301, 10)]
    shut, track = water(wall), driven((0.0, 0.0), OVER)
    found = looked_at(track, shut)
    assert found.why.startswith("no way home: no-go water is all about the ")
    track.add(150.0, 0.0)
    assert looked_at(track, shut).why == found.why
    found.look(water(BAR), 1.5)
    assert found.why in ("", SEEKING)
    assert looked_at(track, water(BAR)).why == ""
    gone = driven((0.0, 0.0), OVER)
    assert looked_at(gone, shut).why
    sail(gone, OVER, (0.0, 0.0))
    assert looked_at(gone, shut).why == "", "it came back by itself"


def test_a_place_within_the_margin_is_left_out_once_the_boat_is_beyond_it() -> None:
    around = water([(60.0, 0.0, 30.0)])
    track = driven((0.0, -60.0), (28.0, 0.0), (0.0, 60.0))
    assert looked_at(track, around).why == ""
    assert least_m(around, track.way_home()) >= LIMITS.margin_m - 1.0
    home = driven((28.0, 0.0), (0.0, 60.0))
    assert looked_at(home, around).why == "no way home: its end is in water that is forbidden"


def test_without_a_chart_nothing_is_looked_at() -> None:
    track = driven((0.0, 0.0), OVER)
    was, found = track.points(), Homeward(track, Remains())
    found.look(Fence((), LIMITS), 1.5)
    assert (found.why, found.is_sought, track.points()) == ("", False, was)


CORNER = st.tuples(st.integers(-140, 140), st.integers(-140, 140))
ROCKS: list[list[Shoal]] = [
    BAR,
    [(0.0, 0.0, 40.0), (80.0, 60.0, 25.0), (-90.0, 40.0, 30.0), (60.0, -90.0, 10.0)],
    [(-60.0 + 50.0 * math.cos(t / 4.0), 50.0 * math.sin(t / 4.0), 12.0) for t in range(26)],
]


@cache
def rocky(which: int) -> Fence:
    return water(ROCKS[which])


@settings(max_examples=30, deadline=None)
@given(corners=st.lists(CORNER, min_size=2, max_size=5, unique=True), which=st.integers(0, 2), points=st.integers(8, 60))
def test_whatever_was_driven_the_way_home_is_free_or_there_is_none(corners: list[Point], which: int, points: int) -> None:
    around, track = rocky(which), Track(HomeTable(points=points))
    found = Homeward(track, Remains())
    for a, b in itertools.pairwise(corners):
        sail(track, a, b, step_m=3.0)
        found.look(around, 1.5)
    for _ in range(3000):
        found.look(around, 1.5)
        if not found.is_sought:
            break
    assert found.why != SEEKING
    way = track.way_home()
    assert way[0] == track.end()
    if not found.why:
        for b, a in itertools.pairwise(way):
            smallest_m, looked = least(around.zones[0], a, b, LIMITS.margin_m)
            leads_out = a == way[-1] and smallest_m >= clearance_m(around.zones[0], *a) - fence.RECEDES_M
            assert smallest_m >= LIMITS.margin_m - 1.0 or leads_out or looked > LOOKS


# The boat.


def test_the_chart_of_the_scenario_is_the_one_of_this_file() -> None:
    assert read(FILE.read_bytes()).fields == read(headland()).fields


def test_the_failsafe_goes_home_round_a_headland(tmp_path: Path) -> None:
    east_m = list[float]()

    def look(run: object, place: trial.TruePlace) -> None:
        del run
        if place.at is not None and 55.0 < place.at[0] < 65.0:
            east_m.append(place.at[1])

    file = FILE.with_suffix(".toml")
    scenario = trial.load_scenario(file)
    result = trial.sail(scenario, trial.settings_of(scenario, FILE.parents[1] / "delfimx.toml"), 3, look=look)
    assert not result.failures
    assert east_m[-1] > 72.0 > east_m[0], "over the bar, and home round its end"


@pytest.fixture
def shut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CharteredSea:
    """A boat behind a wall, which was driven over it."""
    wall: list[Shoal] = [(60.0, east, 12.0) for east in range(-300, 301, 10)]
    monkeypatch.setattr("tests.vehicle.test_charted.DATA", chart(AT, wall))
    sea = CharteredSea(tmp_path)
    sea.run.vehicle.helm.track.restore(((200.0, 0.0), (150.0, 0.0)), 5.0)
    for _ in sea.run.cycles(2.0):
        pass
    return sea


def test_home_without_a_way_is_refused_in_words_and_the_failsafe_holds(shut: CharteredSea) -> None:
    refused = shut.run.command(console.SetMode("home"))
    assert refused is not None
    assert refused.startswith("home refused: no way home: no-go water is all about the ")
    assert shut.run.command(console.SetMode("hold")) is None
    helm = shut.run.vehicle.helm
    helm.fall_back(Action.HOME, "console silent for 40.0 s", shut.run.elapsed_s)
    assert shut.run.state.mode is Mode.HOLD
    assert shut.run.state.reason.startswith("console silent for 40.0 s; no way home: no-go water is all about the ")
    assert shut.run.command(console.Heading(180.0, 1.0)) is None
    helm.fall_back(Action.HOME, "console silent for 41.0 s", shut.run.elapsed_s)
    assert shut.run.state.reason.startswith("console silent for 41.0 s; no way home: no-go water is all about the ")


def test_home_waits_for_its_way_and_ends_where_the_water_is_closed_under_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sea = CharteredSea(tmp_path)
    helm, state = sea.run.vehicle.helm, sea.run.state
    helm.track.restore(((180.0, 0.0),), 5.0)  # beyond the shoal
    monkeypatch.setattr(homeward, "SLICE", 20)
    for _ in sea.run.cycles(0.4):
        pass
    assert sea.run.command(console.SetMode("home")) is None
    assert (state.mode, state.reason) == (Mode.HOLD, f"operator; {SEEKING}")
    monkeypatch.undo()
    for _ in sea.run.cycles(30.0):
        if state.mode is Mode.HOME:
            break
    assert (state.mode, state.reason) == (Mode.HOME, "operator")
    assert helm.plans.fence is not None
    helm.plans.fence = water([(90.0, 0.0, 30.0), (180.0, 0.0, 40.0)])
    for _ in sea.run.cycles(1.0):
        pass
    assert (state.mode, state.reason) == (Mode.HOLD, "operator; no way home: its end is in water that is forbidden")
    helm.enter(Mode.HOLD, "test")
    helm.fall_back(Action.HOME, "console silent", sea.run.elapsed_s)
    assert state.reason == "console silent; no way home: its end is in water that is forbidden"


def test_the_first_stretch_of_the_way_home_keeps_out_of_zones_without_a_chart_too(tmp_path: Path) -> None:
    sea = CharteredSea(tmp_path)
    helm, state = sea.run.vehicle.helm, sea.run.state
    pier = fence.charted("the pier", laid(read(chart(AT, [(-30.0, 0.0, 12.0)])).water(""), AT))
    helm.plans.fence = Fence((pier._replace(name="the pier"),), LIMITS)
    helm.homeward = Homeward(Track(HomeTable()), Remains())
    helm.track.restore(((-70.0, 0.0),), 5.0)
    helm.fall_back(Action.HOME, "console silent", sea.run.elapsed_s)
    assert state.mode is Mode.HOLD
    assert state.reason == "console silent; no way home: the way leads through the pier"
