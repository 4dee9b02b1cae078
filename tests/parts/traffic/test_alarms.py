"""Which vessels are a danger: the two levels, limit by limit, with approaches that are played."""

import math
from typing import Any

import pytest

from delfim.config import TrafficNear
from delfim.parts.traffic import alarm
from delfim.parts.traffic.alarm import Alarm
from delfim.parts.traffic.cpa import Approach
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.keepclear import PassedBy
from delfim.parts.traffic.trialways import Caution, RouteAhead, route_legs
from delfim.vehicle.target import Danger, Target

LIMITS, OWN, ROUTE = Caution(5.0, 0.2, 0.3), Own(100.0, -200.0, 1.0, 2.0), RouteAhead(((900.0, -200.0),), 1.5)
SHIP = Target("1", "MARIA", 400.0, 200.0, 3.0, 1.5, math.nan, 30.0, 8.0, True, 0.0, 0.0, False, "A", 0)  # 500 m away
INF = math.inf


class Told:
    """The danger of a vessel, and what was reckoned for it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **more: Any) -> None:
        asked: dict[str, Any] = {
            "here": 9.0,
            "to_come": (9.0, 50.0),
            "cpa": (50.0, 60.0),
            "guarded": "no",
            "near": TrafficNear(),
        }
        asked |= {"own": OWN, "targets": [SHIP], "passed": (), "before": {}} | more
        self.calls = list[Any]()
        for name, answer in (
            ("measured", ("around", 180.0, 0.0, 0.0)),
            ("passing_by", (asked["here"], 0.0, 0.0, 0.0)),
            ("approach", Approach(asked["to_come"][0], asked["to_come"][1], 0.0, 0.0)),
            ("closest", asked["cpa"]),
        ):
            monkeypatch.setattr(alarm, name, self.played(name, answer))
        work = alarm.dangers(
            *(
                asked["near"],
                LIMITS,
                asked["own"],
                ROUTE,
                asked["targets"],
                asked["passed"],
                asked["guarded"],
                asked["before"],
                70.0,
            )
        )
        self.slices = list[int]()
        while True:
            try:
                self.slices.append(next(work))
            except StopIteration as end:
                self.dangers, self.after = end.value
                break

    def played(self, name: str, answer: Any) -> Any:
        return lambda *told: self.calls.append((name, *told)) or answer  # type: ignore[func-returns-value]

    @property
    def level(self) -> str:
        (found,) = self.dangers
        assert list(self.after) == ([] if found.level == "none" else ["1"])
        assert bool(found.words) is (found.level != "none")
        return str(found.level)


def passed(nearness: float, without: float, at_s: float = 50.0) -> tuple[PassedBy, ...]:
    return (PassedBy("1", Approach(without, at_s, 0.0, 0.0), nearness),)


def test_what_is_reckoned_of_each_vessel(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Told(monkeypatch, targets=[SHIP, SHIP._replace(key="2")], passed=passed(3.0, 4.0))
    north_mps, east_mps = 2.0 * math.cos(1.0), 2.0 * math.sin(1.0)
    now = ((0.0, 1.0, 100.0, -200.0, 0.0, 0.0),)
    of_one = [
        ("closest", 100.0, -200.0, north_mps, east_mps, SHIP),
        ("measured", LIMITS, OWN, 1.5, SHIP),
        ("passing_by", "around", now, 1e-6),
    ]
    assert found.calls[:3] == of_one
    assert [call[0] for call in found.calls[3:]] == ["closest", "measured", "passing_by", "approach"]
    assert found.calls[-1] == ("approach", "around", route_legs(OWN, ROUTE), 360.0)
    assert found.dangers == (Danger("1", 50.0, 60.0, 3.0, "none"), Danger("2", 50.0, 60.0, 9.0, "none"))
    assert (found.after, found.slices) == ({}, [6, 6])


def test_what_makes_no_sense_is_no_danger(monkeypatch: pytest.MonkeyPatch) -> None:
    odd = Told(monkeypatch, own=OWN._replace(north_m=math.nan), here=0.5)
    assert (odd.dangers, odd.after, odd.slices) == ((), {}, [])
    targets = [SHIP._replace(north_m=math.nan), SHIP._replace(speed_mps=INF), SHIP._replace(length_m=math.nan), SHIP]
    found = Told(monkeypatch, targets=targets)
    assert ([each.key for each in found.dangers], found.slices) == (["1"], [6] * 4)


@pytest.mark.parametrize(
    ("more", "level"),
    [
        ({}, "none"),
        ({"here": 0.75}, "danger"),
        ({"here": 1.0}, "near"),
        ({"to_come": (0.75, 50.0)}, "danger"),
        ({"to_come": (0.75, 180.0)}, "near"),
        ({"to_come": (0.75, 50.0), "guarded": "on its way"}, "near"),
        ({"here": 0.75, "guarded": "on its way"}, "danger"),
        ({"to_come": (0.75, 200.0), "guarded": "away"}, "danger"),
        ({"to_come": (1.0, 50.0)}, "none"),
        ({"passed": passed(3.0, 0.75), "guarded": "away"}, "near"),
        ({"passed": passed(0.75, 3.0), "guarded": "away"}, "danger"),
        ({"passed": passed(0.75, 3.0), "guarded": "on its way"}, "near"),
        ({"passed": passed(0.75, 3.0, 200.0), "guarded": "no"}, "near"),
        ({"passed": passed(INF, 0.75), "guarded": "away"}, "none"),
        ({"here": 1.75}, "near"),
        ({"here": 2.0}, "none"),
        ({"here": 1.75, "cpa": (50.0, 0.5)}, "near"),
        ({"here": 1.75, "cpa": (50.0, 0.0)}, "none"),
        *(
            ({"near": TrafficNear(cpa_m=100.0), "cpa": each}, level)
            for each, level in (
                ((99.0, 60.0), "near"),
                ((100.0, 60.0), "none"),
                ((50.0, 0.0), "near"),
                ((50.0, 0.5), "near"),
                ((50.0, -0.5), "none"),
                ((50.0, 600.0), "none"),
                ((50.0, 599.0), "near"),
            )
        ),
        ({"cpa": (0.0, 60.0)}, "none"),
        ({"near": TrafficNear(zone_m=501.0)}, "near"),
        ({"near": TrafficNear(zone_m=500.0)}, "none"),
        ({"targets": [SHIP._replace(kind="distress")]}, "near"),
    ],
)
def test_the_two_levels(monkeypatch: pytest.MonkeyPatch, more: dict[str, Any], level: str) -> None:
    assert Told(monkeypatch, **more).level == level


@pytest.mark.parametrize(("own_mps", "its_mps", "level"), [
    (0.2, 0.2, "none"), (0.25, 0.2, "danger"), (0.2, 0.25, "danger"), (2.0, 0.0, "danger"), (0.0, 2.0, "danger"),
])  # fmt: skip
def test_two_that_lie_in_a_harbour_are_no_danger(monkeypatch, own_mps, its_mps, level):
    found = Told(
        monkeypatch, own=OWN._replace(speed_mps=own_mps), targets=[SHIP._replace(speed_mps=its_mps)], to_come=(0.75, 5.0)
    )
    assert found.level == level
    assert found.dangers[0].nearness == (INF if level == "none" else 0.75)


NEAR, DANGER = Alarm("near", 60.5), Alarm("danger", 60.5)


@pytest.mark.parametrize(
    ("was", "close", "near", "found"),
    [
        (None, 1.0, 1.0, None),
        (None, 0.75, 9.0, Alarm("danger", 70.0)),
        (None, 1.25, 0.75, Alarm("near", 70.0)),
        (NEAR, 0.75, 9.0, Alarm("danger", 70.0)),
        (NEAR, 1.25, 1.25, Alarm("near", 70.0)),
        (NEAR, 1.25, 1.5, NEAR),
        (NEAR._replace(seen_s=60.0), 1.25, 1.5, None),
        (DANGER, 1.25, 9.0, Alarm("danger", 70.0)),
        (DANGER, 1.5, 0.75, DANGER),
        (DANGER._replace(seen_s=60.0), 1.5, 1.25, Alarm("near", 70.0)),
        (DANGER._replace(seen_s=60.0), 1.5, 1.5, None),
    ],
)
def test_a_danger_is_over_when_it_was_far_for_a_while(was, close, near, found):
    assert alarm._alarm(was, close, near, 70.0) == found


def test_an_alarm_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Told(monkeypatch, here=1.25, cpa=(50.0, -1.0), before={"1": DANGER})
    assert found.after == {"1": Alarm("danger", 70.0)}
    assert found.dangers[0].words == "MARIA is close: 500 m away, drawing apart"


def test_the_words(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Told(monkeypatch, here=1.5).dangers[0].words == "MARIA is near: 500 m away, CPA 50 m in 60 s"
    assert Told(monkeypatch, here=0.5, cpa=(50.0, 0.5)).dangers[0].words == "MARIA is close: 500 m away, CPA 50 m in 0 s"
    assert Told(monkeypatch, here=0.5, cpa=(50.0, 0.0)).dangers[0].words == "MARIA is close: 500 m away, drawing apart"
    signal = Told(monkeypatch, targets=[SHIP._replace(kind="distress")])
    assert signal.dangers[0].words == "distress signal of MARIA, 500 m away"


@pytest.mark.parametrize(
    ("kind", "away_m", "more", "level"),
    [
        ("thing", 8.9, {"guarded": "on its way"}, "danger"),  # half of 10 m, beyond the boat's half, the thing's and its margin
        ("thing", 9.1, {"guarded": "on its way"}, "none"),
        ("thing", 9.1, {"guarded": "on its way", "to_come": (0.75, 10.0)}, "none"),  # the guard leads round it
        ("thing", 9.1, {"to_come": (0.75, 29.0)}, "danger"),
        ("thing", 9.1, {"to_come": (0.75, 30.0)}, "near"),
        ("thing", 9.1, {"to_come": (1.25, 29.0)}, "none"),
        ("thing", 8.9, {"own": OWN._replace(speed_mps=0.25)}, "danger"),
        ("thing", 8.9, {"own": OWN._replace(speed_mps=0.2)}, "none"),  # it lies beside a pier
        ("person", 18.9, {"guarded": "away"}, "danger"),
        ("person", 19.1, {"guarded": "away"}, "near"),
        ("person", 63.9, {"guarded": "away"}, "near"),
        ("person", 64.1, {"guarded": "away"}, "none"),
        ("person", 64.1, {"to_come": (0.75, 50.0)}, "none"),
    ],
)
def test_a_thing_is_a_danger_at_half_the_distance_and_a_swimmer_near_at_twice(monkeypatch, kind, away_m, more, level):
    here = OWN.north_m + 0.6 * away_m, OWN.east_m - 0.8 * away_m
    thing = SHIP._replace(kind=kind, north_m=here[0], east_m=here[1], speed_mps=0.0, length_m=1.0, margin_m=1.0)
    assert Told(monkeypatch, targets=[thing], **more).level == level
