"""Who moves as the boat does: the limits of it, look by look."""

import math
from typing import Any

import pytest

from delfim.parts.traffic.beside import Companion, Company, company, danger_beside
from delfim.parts.traffic.encounter import Own
from delfim.vehicle.target import Target

OWN = Own(100.0, -200.0, 0.0, 1.5)  # with a boat of 4 m, and 10 m of margin: 15 m off at most
KNOWN = Companion(40.0, 50.0, 98.0, 2, is_sure=False)


def tug(north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> Target:
    place = OWN.north_m + north_m, OWN.east_m + east_m
    return Target("1", "TUG", *place, 0.0, 1.5, math.nan, 15.0, 5.0, False, 10.0, 1.0, False, "B", 0)._replace(**more)


def looked(*targets: Target, own: Own = OWN, now_s: float = 101.0, **before: Any) -> Company:
    return company(Company(**{"at_s": 100.0, "sailed_m": 100.0} | before), own, 4.0, targets, now_s)


@pytest.mark.parametrize(
    ("speed_mps", "now_s", "sailed_m"),
    [
        (1.5, 102.0, 103.0),
        (2.0, 105.0, 110.0),
        (2.0, 110.0, 110.0),
        (2.0, 99.0, 100.0),
        (0.25, 104.0, 100.0),
        (0.5, 104.0, 102.0),
    ],
)
def test_the_boats_own_way(speed_mps: float, now_s: float, sailed_m: float) -> None:
    found = looked(own=OWN._replace(speed_mps=speed_mps), now_s=now_s)
    assert (found.sailed_m, found.at_s, found.vessels, found.remembered) == (sailed_m, now_s, {}, ())
    assert company(Company(), OWN, 4.0, (), 100.0).sailed_m == 7.5


@pytest.mark.parametrize(
    ("target", "is_seen"),
    [
        (tug(15.0), True),
        (tug(-15.0), True),
        (tug(0.0, 15.0), True),
        (tug(9.0, 12.0), True),
        (tug(15.5), False),
        (tug(0.0, -15.5), False),
        (tug(age_s=3.0), True),
        (tug(age_s=3.5), False),
        (tug(kind="payload"), False),
        (tug(20.0, margin_m=15.0), True),
    ],
)
def test_who_is_where_the_boat_is(target: Target, is_seen: bool) -> None:
    found = looked(target)
    began = Companion(101.0 - target.age_s, 101.5, 101.0 - target.age_s, 1, is_sure=False)
    assert found.vessels == ({"1": began} if is_seen else {})
    assert not found.has("1")
    assert not found.has("2")


@pytest.mark.parametrize(
    ("known", "now_s", "reports", "is_sure"),
    [
        (KNOWN, 101.0, 3, True),
        (KNOWN._replace(since_s=40.5), 101.0, 3, False),
        (KNOWN._replace(sailed_m=51.5), 101.0, 3, True),
        (KNOWN._replace(sailed_m=52.0), 101.0, 3, False),
        (KNOWN._replace(reports=1), 101.0, 2, False),
        (KNOWN._replace(reported_s=99.5), 101.0, 2, False),
        (KNOWN._replace(reported_s=99.25), 101.0, 3, True),
        (KNOWN._replace(since_s=99.0, is_sure=True), 101.0, 3, True),
    ],
)
def test_who_stays_for_a_minute_and_some_way_as_three_reports_tell(known, now_s, reports, is_sure):
    found = looked(tug(), now_s=now_s, vessels={"1": known})
    assert found.vessels == {"1": known._replace(reported_s=100.0, reports=reports, is_sure=is_sure)}
    assert found.remembered == (("1",) if is_sure else ())
    assert found.has("1") is is_sure


@pytest.mark.parametrize(("far_m", "is_sure", "stays"), [(30.0, True, True), (30.5, True, False), (15.5, False, False)])
def test_who_is_one_may_be_twice_as_far_off(far_m: float, is_sure: bool, stays: bool) -> None:
    found = looked(tug(far_m), vessels={"1": KNOWN._replace(is_sure=is_sure)}, remembered=("1",) if is_sure else ())
    assert (found.has("1"), list(found.vessels)) == (stays, ["1"] if stays else [])
    assert found.remembered == (("1",) if stays else ())


def test_what_no_report_tells_stays_as_it_was() -> None:
    sure = {"1": KNOWN._replace(is_sure=True)}
    for remembered in ((), ("2", "1")):
        found = looked(tug(900.0, age_s=9.0), vessels=sure, remembered=remembered)
        assert (found.vessels, found.remembered) == (sure, remembered or ("1",))
    assert looked(vessels=sure).vessels == {}


def test_the_nearest_four_are_looked_at_and_those_that_are_known() -> None:
    targets = [tug(key=str(number)) for number in range(1, 8)]
    assert list(looked(*targets).vessels) == ["1", "2", "3", "4"]
    found = looked(*targets, vessels={"6": KNOWN})
    assert list(found.vessels) == ["1", "2", "3", "4", "6"]
    found = looked(*targets, remembered=("7",))
    assert list(found.vessels) == ["1", "2", "3", "4", "7"]
    assert found.vessels["7"].is_sure
    assert (found.remembered, found.has("7"), found.has("1")) == (("7",), True, False)


def test_the_newest_eight_are_remembered() -> None:
    keys = tuple("abcdefgh")
    sure = {"1": KNOWN._replace(is_sure=True)}
    assert looked(tug(), vessels=sure, remembered=keys).remembered == (*keys[1:], "1")
    assert looked(tug(), vessels=sure, remembered=("1", "a")).remembered == ("a", "1")
    assert looked(tug(16.0), remembered=("1", "a")).remembered == ("a",)


def test_people_are_told_the_number() -> None:
    found = danger_beside(tug(key="263000009 b"))
    assert (found.key, found.level) == ("263000009 b", "near")
    assert found.words == "TUG moves as this boat does and is not avoided. Its own transponder? Then traffic.mmsi = 263000009"
    assert all(math.isnan(each) for each in found[1:4])
