"""When the computer's clock is stepped, slewed or left, with times that are handed in."""

import random
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import MADE_NS
from delfim.services.clock.discipline import (
    AGREE_S,
    DRIFT,
    ENOUGH,
    HEARD_S,
    LATEST_S,
    SLEW_EVERY_S,
    STEP_S,
    TIME_FRAME,
    ClockKeeper,
    Correction,
)
from delfim.vehicle.report import ClockStatus

NAVIGATION = "navigation (dsor)"
SAILED_NS = MADE_NS + 200 * 86_400_000_000_000  # UTC when the computer started
YEARS_S = 56 * 365.25 * 86_400.0


class Desk:
    """A keeper, a computer's clock that is `off_s` wrong, and sources of time. A second is one look."""

    def __init__(self, off_s: float) -> None:
        self.keeper, self.now_s = ClockKeeper("kept by this program"), 10.0
        self.off_s = off_s  # of the computer's clock
        self.sources: dict[str, float] = {TIME_FRAME: 0.0}  # how wrong each is
        self.idle = self.may_set = True
        self.done: list[Correction] = []

    def second(self) -> Correction | None:
        self.now_s += 1.0
        for name, wrong_s in self.sources.items():
            self.keeper.tell(name, SAILED_NS + round(wrong_s * 1e9), self.now_s)
        own_ns = SAILED_NS + round(self.off_s * 1e9)
        correction = self.keeper.look(own_ns, self.now_s, idle=self.idle, may_set=self.may_set)
        if correction is not None:
            self.done.append(correction)
            self.off_s += correction.by_s if correction.do == "step" else 0.0
        return correction

    def seconds(self, count: int) -> list[str]:
        """What was done in so long."""
        return [correction.do for correction in (self.second() for _ in range(count)) if correction]

    @property
    def words(self) -> str:
        return self.keeper.status.fault


def test_a_clock_of_1970_is_stepped_once_when_its_source_was_steady():
    desk = Desk(-YEARS_S)
    assert desk.seconds(ENOUGH - 1) == []
    assert desk.second() == Correction("step", pytest.approx(YEARS_S), TIME_FRAME)
    assert desk.off_s == pytest.approx(0.0, abs=1e-6)
    assert desk.keeper.status == ClockStatus("kept by this program", TIME_FRAME, 0.0, "", True)
    assert desk.seconds(60) == ["slew"] * 8


def test_under_way_it_is_not_stepped_and_says_so_and_in_idle_it_is():
    desk = Desk(-3.0)
    desk.idle = False
    assert desk.seconds(100) == []
    assert desk.words == "it is -3.0 s off the time frame and is set when the boat is idle"
    desk.idle = True
    assert desk.seconds(1) == ["step"]
    assert desk.words == ""


def test_a_small_difference_is_slewed_also_under_way():
    desk = Desk(0.2)
    desk.idle = False
    assert desk.seconds(ENOUGH + 1) == ["slew"]
    assert desk.done[0] == Correction("slew", pytest.approx(-0.2), TIME_FRAME)


@pytest.mark.parametrize("idle", [False, True])
def test_a_clock_that_was_right_is_not_stepped_again_whatever_the_sources_say(idle):
    desk = Desk(0.0)
    desk.seconds(20)
    desk.idle, desk.sources = idle, {TIME_FRAME: 60.0, NAVIGATION: 60.0}
    assert "step" not in desk.seconds(1000)
    assert desk.words == "the time frame is +60.0 s off the clock, which was right in this run: it is not taken"
    desk.sources = {TIME_FRAME: 0.0}
    assert set(desk.seconds(20)) == {"slew"}
    assert desk.words == ""


def test_after_a_long_silence_a_clock_may_have_drifted_and_is_slewed():
    desk = Desk(0.0)
    desk.seconds(10)
    desk.sources, silent_s = {}, 100_000
    desk.now_s += silent_s
    desk.off_s, desk.sources = 0.9 * DRIFT * silent_s, {TIME_FRAME: 0.0}
    assert desk.off_s > STEP_S
    assert desk.seconds(10) == ["slew"]


@pytest.mark.parametrize(
    ("wrong_s", "date"),
    [(-1024 * 7 * 86_400.0, "2006-12-04"), (-200.5 * 86_400.0, "2025-12-31"), (-YEARS_S, "1970-07-20"), (8e8, "2051-11-25")],
)
def test_a_time_that_cannot_be_is_not_taken(wrong_s, date):
    desk = Desk(-YEARS_S)
    desk.sources = {TIME_FRAME: wrong_s}
    assert desk.seconds(30) == []
    assert desk.words == f"the time frame says {date}, which cannot be: it is not taken"
    desk.sources[NAVIGATION] = 0.1
    assert desk.seconds(10)[0] == "step"
    assert desk.done[0].source == NAVIGATION
    assert "the time frame says" in desk.words


def test_a_source_that_jumps_is_not_taken_before_it_is_steady():
    desk = Desk(-YEARS_S)
    for wrong_s in range(20):
        desk.sources = {TIME_FRAME: wrong_s * 0.2}
        assert desk.second() is None
    assert desk.words == "the time frame jumps by +1.4 s: it is not taken"


def test_sources_that_disagree_are_both_not_taken():
    desk = Desk(-YEARS_S)
    desk.sources = {TIME_FRAME: 0.0, NAVIGATION: -AGREE_S - 0.5}
    assert desk.seconds(30) == []
    assert desk.words == "the time frame is +1.5 s off navigation (dsor): neither is taken"
    desk.sources = {TIME_FRAME: 0.0, NAVIGATION: -0.4}
    assert desk.seconds(20)[0] == "step"
    assert desk.done[0].source == TIME_FRAME


def test_who_may_not_set_compares_and_does_nothing():
    desk = Desk(-3.0)
    desk.may_set = False
    assert desk.seconds(100) == []
    assert desk.keeper.status.off_s == pytest.approx(-3.0)
    assert desk.words == ""


def test_silent_sources_are_no_time():
    desk = Desk(0.0)
    desk.seconds(10)
    desk.sources = {}
    assert desk.seconds(int(HEARD_S)) is not None
    desk.second()
    assert desk.keeper.status.off_s is None
    assert desk.keeper.status.source == TIME_FRAME, "it still has its time from there"
    desk.sources = {TIME_FRAME: 0.0}
    assert desk.seconds(ENOUGH - 1) == [], "after a silence a source begins anew"


class Weather(NamedTuple):
    """A second of a run: how wrong each source is, None where it is silent; whether the boat is in idle."""

    frame_s: float | None
    navigation_s: float | None
    idle: bool


WRONG = st.none() | st.sampled_from((0.0, 0.2, -0.4, 30.0, -YEARS_S, 8e8)) | st.floats(-5.0, 5.0)


@given(
    st.sampled_from((-YEARS_S, -2.0, 0.0, 0.3, 40.0)), st.lists(st.builds(Weather, WRONG, WRONG, st.booleans()), max_size=60)
)
def test_whatever_comes_it_steps_once_in_idle_and_to_a_possible_time(off_s, weather):
    desk = Desk(off_s)
    for second in weather:
        desk.idle = second.idle
        told = {TIME_FRAME: second.frame_s, NAVIGATION: second.navigation_s}
        desk.sources = {name: wrong_s for name, wrong_s in told.items() if wrong_s is not None}
        correction = desk.second()
        if correction is not None and correction.do == "step":
            assert second.idle
            assert abs(correction.by_s) > STEP_S
            assert 0.0 <= (SAILED_NS - MADE_NS) / 1e9 + desk.now_s + desk.off_s <= LATEST_S
        elif correction is not None:
            assert abs(correction.by_s) <= STEP_S + DRIFT * len(weather)
    assert [correction.do for correction in desk.done].count("step") <= 1


@pytest.mark.parametrize("drift", [-5e-5, 3e-5])
def test_a_drifting_clock_and_a_late_source_stay_within_a_twentieth_of_a_second(drift):
    """The kernel slews by 0.5 ms a second at most."""
    chance, desk, left_s = random.Random(1), Desk(-YEARS_S), 0.0
    for second in range(3600):
        desk.sources = {TIME_FRAME: -chance.uniform(0.0, 0.04)}
        desk.off_s += drift
        slewed_s = max(-5e-4, min(5e-4, left_s))
        desk.off_s, left_s = desk.off_s + slewed_s, left_s - slewed_s
        correction = desk.second()
        if correction is not None and correction.do == "slew":
            left_s = correction.by_s
        assert second < ENOUGH or abs(desk.off_s) < 0.05
    assert SLEW_EVERY_S > 1.0
