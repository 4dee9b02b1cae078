"""The tracker of other vessels, report by report: what is known, of which vessel, and who has a place (docs/traffic.md)."""

import math
from typing import Any

import pytest

from delfim.base.cooperative import Sliced
from delfim.parts.traffic import targets
from delfim.parts.traffic.targets import Tracker, met_s
from delfim.vehicle.target import NEVER_S
from tests.parts.traffic.test_reckoning import north_of_the_equator
from tests.parts.traffic.test_targets import AT, FULL, JUMP, MARIA, NOWHERE, OWN, TWICE, TWO, facts, report, seen, tracker

MANY = "too many vessels with one number: those met last are not kept"
SOUTH = math.pi
LIES: dict[str, Any] = {"speed_mps": 0.0}


def keys(tracked: Tracker, now_s: float) -> list[str]:
    return [each.key for each in seen(tracked, now_s)]


def test_what_a_program_names_is_never_the_boat_nor_a_buoy_nor_distress() -> None:
    tracked = tracker()
    for i, mmsi in enumerate((OWN, 992_446_006, 970_012_345)):
        tracked.hear(report(100.0 * i, 0.0, mmsi=mmsi, kind="payload", is_own=True), "guest", 1.0, f"radar {i}")
        tracked.facts(facts(mmsi=mmsi, name=f"R{i}", is_own=True), 2.0, f"radar {i}")
    found = [(each.key, each.name, each.kind) for each in seen(tracked, 2.0)]
    assert found == [(f"radar {i}", f"R{i}", "payload") for i in range(3)]
    assert (tracked.own_s, tracked.heard_s, tracked.refused) == (NEVER_S, 2.0, {})
    tracked.hear(report(0.0, 0.0), "nmea2000", 1.5)
    assert tracked.heard_s == 2.0


def test_facts_of_400_are_kept_those_heard_last() -> None:
    tracked = tracker()
    for i in range(400):
        tracked.facts(facts(mmsi=MARIA + i, name=f"SHIP {i}"), 0.0)
    tracked.facts(facts(mmsi=MARIA, length_m=12.0, beam_m=4.0), 0.0)
    tracked.facts(facts(mmsi=MARIA + 400, name="SHIP 400"), 0.0)
    for i in (0, 1, 2, 400):
        tracked.hear(report(100.0 * i, 0.0, mmsi=MARIA + i), "nmea2000", 0.0)
    assert [each.name for each in seen(tracked, 0.0)] == ["SHIP 0", str(MARIA + 1), "SHIP 2", "SHIP 400"]


def test_facts_are_of_all_that_speak_with_a_number_and_of_a_program_by_its_key() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0), "nmea2000", 0.0)
    tracked.facts(facts(name="MARIA"), 0.0)
    for i in (1, 2):
        tracked.hear(report(0.0, 60.0 * i), "nmea2000", 0.1 * i)
    assert [each.name for each in seen(tracked, 0.2)] == ["MARIA"] * 3
    tracked.facts(facts(length_m=30.0, beam_m=6.0), 0.5)
    assert [(each.key[9:], each.name, each.length_m) for each in seen(tracked, 1.0)] == [
        ("", "MARIA", 30.0),
        (" b", "MARIA", 30.0),
        (" c", "MARIA", 30.0),
    ]
    tracked.facts(facts(mmsi=0, name="NINA"), 1.0, "fishing boat 2")
    tracked.hear(report(900.0, 0.0, mmsi=0, kind="payload"), "guest", 1.0, "fishing boat 2")
    tracked.hear(report(950.0, 0.0, mmsi=0, kind="payload"), "guest", 1.0, "fishing boat 3")
    assert [each.name for each in seen(tracked, 1.0)][3:] == ["NINA", "fishing boat 3"]


@pytest.mark.parametrize(
    ("first", "second", "by", "after_s", "is_known"),
    [
        ({}, {"north_m": 5.0}, "nmea2000", -0.1, True),
        ({}, {"north_m": 5.0}, "nmea2000", 0.0, False),
        (LIES, LIES, "udp", 4.9, True),  # without a time of their own
        (LIES, LIES, "udp", 5.0, False),
        (LIES, LIES, "udp", 0.0, True),
        (LIES, LIES, "nmea2000", 1.0, False),
        (LIES, {**LIES, "north_m": 1.0}, "udp", 1.0, False),
        ({**LIES, "second": 9}, LIES, "udp", 1.0, True),
        (LIES, {**LIES, "second": 9}, "udp", 1.0, True),
        ({**LIES, "second": 9}, LIES, "udp", 6.0, False),
        ({"second": 9}, {"second": 9}, "nmea2000", 1.0, True),
        ({"second": 9}, {"second": 9, "north_m": 3.0}, "udp", 1.0, False),
        ({"second": 59, **LIES}, {"second": 0, **LIES}, "udp", 1.0, False),
        ({"second": 9}, {"second": 39, "north_m": -150.0}, "udp", 1.0, False),
        ({"second": 59}, {"second": 29, "north_m": -145.0}, "udp", 1.0, False),
        ({"second": 9}, {"second": 40, "north_m": -145.0}, "udp", 1.0, True),  # 29 s before
        ({"second": 9}, {"second": 40, "north_m": 0.0}, "udp", 1.0, False),  # there it was not then
        ({"second": 9}, {"second": 8}, "udp", 1.0, True),
        ({"second": 9}, {"second": 7, "north_m": 14.0, "speed_mps": 3.2}, "udp", 1.0, True),
        ({"second": 1, **LIES}, {"second": 58, **LIES}, "udp", 14.9, True),
        ({"second": 1, **LIES}, {"second": 58, **LIES}, "udp", 15.0, False),
        ({"second": 9, **LIES}, {"second": 9, **LIES}, "udp", 14.9, True),
        ({"second": 9, **LIES}, {"second": 9, **LIES}, "udp", 15.0, False),
        ({"second": 9, **LIES}, {"second": 7, **LIES, "north_m": 29.9}, "udp", 1.0, True),
        ({"second": 9, **LIES}, {"second": 7, **LIES, "north_m": 30.1}, "udp", 1.0, False),
    ],
)
def test_what_was_heard_before(first: dict[str, Any], second: dict[str, Any], by: str, after_s: float, is_known: bool) -> None:
    tracked = tracker()
    tracked.hear(report(**({"north_m": 0.0, "east_m": 0.0} | first)), "nmea2000", 100.0)
    tracked.hear(report(**({"north_m": 0.0, "east_m": 0.0} | second)), by, 100.0 + after_s)
    assert (tracked.refused.get(TWICE, 0), "the same place of a vessel that moves" in tracked.refused) == (int(is_known), False)
    assert min(each.age_s for each in seen(tracked, 120.0)) == pytest.approx(20.0 if is_known else 20.0 - after_s)


def test_a_receiver_that_hangs_moves_nobody() -> None:
    tracked = tracker()
    for second in (0.0, 3.0, 20.0):
        tracked.hear(report(0.0, 0.0), "nmea2000", second)
    tracked.hear(report(math.nan, 0.0), "nmea2000", 20.0)
    assert tracked.refused == {"the same place of a vessel that moves": 2, NOWHERE: 1}
    assert seen(tracked, 20.0)[0].age_s == 20.0


@pytest.mark.parametrize(
    ("far_m", "after_s", "is_believed"), [(5e3, 10.0, True), (6e4, 30.1, True), (6e4, 400.0, True), (6e4, 400.1, False)]
)
def test_the_second_report_from_there_is_believed_for_400_s(far_m: float, after_s: float, is_believed: bool) -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0, **LIES), "nmea2000", 0.0)
    tracked.hear(report(1.0, 0.0, **LIES), "nmea2000", 5.0)
    seen(tracked, 5.0)
    tracked.hear(report(far_m, 0.0, course_rad=SOUTH), "nmea2000", 10.0)
    assert (len(tracked), tracked.refused) == (1, {JUMP: 1})
    tracked.hear(report(far_m, 50.0, course_rad=SOUTH, speed_mps=9.0), "nmea2000", 10.0 + after_s)
    assert tracked.refused == ({JUMP: 2, TWO: 1} if is_believed else {JUMP: 2})
    assert keys(tracked, 10.0 + after_s) == [str(MARIA), f"{MARIA} b"][: 1 + is_believed]
    assert tracked.disputed == (NEVER_S, "")


@pytest.mark.parametrize(("key", "kind", "reports"), [("boat 2", "fleet", 2), ("", "A", 1)])
def test_who_is_believed_or_was_heard_once_is_moved(key: str, kind: str, reports: int) -> None:
    tracked = tracker()
    for i in range(reports):
        tracked.hear(report(10.0 * i, 0.0, kind=kind), "nmea2000", 2.0 * i, key)
    seen(tracked, 4.0)
    tracked.hear(report(9000.0, 0.0, kind=kind, course_rad=SOUTH), "nmea2000", 35.0, key)
    assert tracked.refused == {JUMP: 1}
    tracked.hear(report(8995.0, 0.0, kind=kind, course_rad=SOUTH), "nmea2000", 36.0, key)
    (target,) = seen(tracked, 36.0)
    assert (target.key, target.kind) == (key or str(MARIA), kind)
    assert target.north_m == pytest.approx(8995.0, abs=0.1)
    assert (tracked.refused, tracked.disputed[1]) == ({JUMP: 2}, "")


def test_a_named_one_is_one_vessel_wherever_its_reports_are() -> None:
    tracked = tracker()
    seen(tracked, 0.0)
    for i in range(9):
        tracked.hear(report(3000.0 * (i % 3), 0.0, kind="fleet", course_rad=SOUTH), "console", float(i), "boat 2")
        tracked.hear(report(3000.0 * (i % 3), 60.0, kind="fleet"), "console", float(i), "boat 2")
    assert (len(tracked), tracked.disputed, tracked.refused[JUMP] > 10) == (1, (NEVER_S, ""), True)
    for i in range(31):
        tracked.hear(report(0.0, 0.0, kind="fleet"), "console", 9.0, f"another {i}")
    assert len(tracked) == 32, "it takes one place, however often it moved"


@pytest.mark.parametrize(
    ("apart_s", "speed_mps", "looks", "parts"),
    [
        (30.0, 12.0, True, True),
        (30.1, 12.0, True, False),
        (10.0, 9.8, True, True),  # met within 15 min
        (10.0, 9.6, True, False),
        (10.0, 12.0, False, False),  # nobody knows where the boat is
    ],
)
def test_two_jumps_to_different_places_are_vessels_at_once_where_they_would_be_met(apart_s, speed_mps, looks, parts):
    tracked = tracker()
    tracked.facts(facts(name="MARIA"), 0.0)
    for second in (0.0, 2.0):
        tracked.hear(report(second, 0.0), "nmea2000", second)
    if looks:
        seen(tracked, 2.0)
    tracked.hear(report(0.0, 90_000.0), "nmea2000", 10.0)
    far_m = 900.0 * (9.7 + 0.3)
    tracked.hear(report(far_m, 0.0, course_rad=SOUTH, speed_mps=speed_mps), "nmea2000", 10.0 + apart_s)
    assert tracked.disputed == ((10.0 + apart_s, "MARIA") if parts else (NEVER_S, ""))
    assert tracked.refused == ({JUMP: 1, TWO: 1} if parts else {JUMP: 2})
    assert len(tracked) == 1 + parts


def test_a_dispute_lasts_while_two_speak_and_names_who_is_believed() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0), "nmea2000", 0.0)
    tracked.hear(report(0.0, 60.0), "nmea2000", 1.0)
    assert tracked.disputed == (1.0, str(MARIA))
    tracked.facts(facts(name="MARIA"), 1.0)
    tracked.hear(report(5.0, 0.0), "nmea2000", 2.0)
    assert tracked.disputed == (2.0, "MARIA"), "the other one spoke within its minute"
    tracked.hear(report(305.0, 0.0), "nmea2000", 61.0)
    assert tracked.disputed == (61.0, "MARIA")
    tracked.hear(report(310.0, 0.0), "nmea2000", 62.0)
    assert tracked.disputed == (61.0, "MARIA"), "it is silent for longer now"


def test_a_report_goes_to_the_vessel_that_it_is_least_unlike() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0), "nmea2000", 0.0)
    tracked.hear(report(0.0, 60.0), "nmea2000", 0.0)
    tracked.hear(report(50.0, 35.0), "nmea2000", 10.0)  # both could be there
    tracked.hear(report(55.0, 0.0), "nmea2000", 11.0)
    assert [round(each.east_m) for each in seen(tracked, 11.0)] == [0, 35]
    tracked.hear(report(60.0, 17.0, course_rad=0.5), "nmea2000", 12.0)
    assert tracked.refused == {TWO: 1}


def group(tracked: Tracker, many: int, now_s: float, far_m: float = 1000.0) -> None:
    """So many that lie, with one number, beside each other."""
    for i in range(many):
        tracked.hear(report(far_m, 60.0 * i, **LIES), "nmea2000", now_s)


def test_a_seventh_takes_the_place_of_who_is_silent_or_is_met_last_or_makes_the_nearest_uncertain() -> None:
    tracked = tracker()
    group(tracked, 6, 0.0)
    assert keys(tracked, 0.0) == [str(MARIA), *(f"{MARIA} {each}" for each in "bcdef")]
    tracked.hear(report(1000.0, 400.0, **LIES), "nmea2000", 1.0)
    assert tracked.refused == {TWO: 5, MANY: 1}
    assert tracked.disputed == (1.0, str(MARIA))
    assert [round(each.margin_m) for each in seen(tracked, 1.0)] == [10, 10, 10, 10, 10, 110]
    tracked.hear(report(900.0, 400.0, **LIES), "nmea2000", 2.0)  # met sooner
    assert tracked.refused == {TWO: 6, MANY: 1}
    assert sorted(round(each.east_m) for each in seen(tracked, 2.0)) == [0, 60, 120, 180, 240, 400]
    for east_m in (0.0, 120.0, 180.0, 240.0, 400.0):
        tracked.hear(report(900.0 if east_m == 400.0 else 1000.0, east_m, **LIES), "nmea2000", 62.0)
    for second in (62.0, 63.0):
        tracked.hear(report(9000.0, 0.0, **LIES), "nmea2000", second)
    found = {each.key[9:]: round(each.north_m) for each in seen(tracked, 63.0)}
    assert found == {"": 1000, " b": 9000, " c": 1000, " d": 1000, " e": 1000, " f": 900}


def test_who_does_not_fit_leaves_the_nearest_uncertain() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0, **LIES), "nmea2000", 0.0)
    for i in range(1, 200):
        tracked.hear(report(100.0 + i, 0.0, mmsi=MARIA + i, **LIES), "nmea2000", 0.0)
    seen(tracked, 0.0)
    tracked.hear(report(5000.0, 0.0, mmsi=MARIA + 200), "nmea2000", 0.0)
    tracked.hear(report(-120.0, 0.0, course_rad=SOUTH, speed_mps=9.0), "nmea2000", 0.5)
    assert tracked.refused[FULL] == 2
    assert seen(tracked, 0.5)[0].margin_m == pytest.approx(130.0, abs=0.5)


def full(ago_s: float = 0.0, many: int = 200, **more: Any) -> Tracker:
    """200 vessels that lie, one kilometre after the other."""
    tracked = tracker()
    for i in range(many):
        tracked.hear(report(1000.0 * (i + 1), 0.0, mmsi=MARIA + i, **(LIES | more)), "nmea2000", -ago_s)
    return tracked


def test_200_are_known_and_between_two_looks_those_that_came_stay() -> None:
    tracked = full()
    assert (len(tracked), tracked.refused) == (200, {})
    tracked.hear(report(10.0, 0.0, mmsi=MARIA + 900), "nmea2000", 1.0)
    assert (len(tracked), tracked.refused, tracked.left_out_s) == (200, {FULL: 1}, NEVER_S), "nobody looked yet"
    seen(tracked, 1.0)
    for i in range(3):
        tracked.hear(report(10.0, 100.0 * i, mmsi=MARIA + 901 + i), "nmea2000", 1.0)
    assert tracked.refused == {FULL: 4}
    found = set(keys(tracked, 1.0))
    assert len(found) == 200
    assert found >= {str(MARIA + 901 + i) for i in range(3)} | {str(MARIA + i) for i in range(197)}


def test_who_came_since_the_last_look_stays_though_another_one_with_its_number_had_to_go() -> None:
    tracked = full()
    seen(tracked, 0.0)
    tracked.hear(report(10.0, 0.0, mmsi=MARIA + 900), "nmea2000", 0.0)
    tracked.hear(report(20.0, 0.0, mmsi=MARIA + 199), "nmea2000", 0.0)
    tracked.hear(report(30.0, 0.0, mmsi=MARIA + 901), "nmea2000", 0.0)
    assert set(keys(tracked, 0.0)) == {str(MARIA + i) for i in (900, 901, 199, *range(197))}


def test_who_is_met_as_late_as_the_last_does_not_come_in() -> None:
    tracked = full()
    seen(tracked, 0.0)
    tracked.hear(report(200_000.0, 0.0, mmsi=MARIA + 900, **LIES), "nmea2000", 0.0)
    assert str(MARIA + 900) not in keys(tracked, 0.0)
    tracked.hear(report(199_999.0, 0.0, mmsi=MARIA + 900, **LIES), "nmea2000", 0.0)
    assert str(MARIA + 900) in keys(tracked, 0.0)


@pytest.mark.parametrize(
    ("speed_mps", "new_m", "left_out"),
    [(10.0, 8.0, True), (0.0, 8.0, False), (10.0, 9200.0, True), (10.0, 9400.0, False)],
)
def test_it_is_told_when_who_is_met_within_15_min_is_left_out(speed_mps: float, new_m: float, left_out: bool) -> None:
    tracked = tracker()
    for i in range(200):
        tracked.hear(report(9000.0 - i, 0.0, mmsi=MARIA + i, course_rad=SOUTH, speed_mps=speed_mps), "nmea2000", 0.0)
    seen(tracked, 0.0)
    tracked.hear(report(new_m, 0.0, mmsi=MARIA + 900, course_rad=SOUTH, speed_mps=speed_mps), "nmea2000", 3.0)
    assert tracked.left_out_s == (3.0 if left_out else NEVER_S)
    assert tracked.refused == {FULL: 1}


def test_a_lost_one_gives_way_to_anybody_and_is_not_missed() -> None:
    tracked = full(ago_s=1081.0, many=1, status=1)
    for i in range(1, 200):
        tracked.hear(report(1000.0 * (i + 1), 0.0, mmsi=MARIA + i, **LIES), "nmea2000", 0.0)
    seen(tracked, 0.0)
    tracked.hear(report(900_000.0, 0.0, mmsi=MARIA + 900), "nmea2000", 0.0)
    assert {str(MARIA), str(MARIA + 900)} & set(keys(tracked, 0.0)) == {str(MARIA + 900)}
    assert (tracked.left_out_s, tracked.refused) == (NEVER_S, {FULL: 1})


def test_what_is_met_at_the_limit_is_not_met_within_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(targets, "met_s", lambda own, north_m, *_: 1.0 if 0.0 < north_m < 20.0 else 900.0)
    tracked = tracker()
    group(tracked, 6, 0.0)
    seen(tracked, 0.0)
    tracked.hear(report(1000.0, 400.0, **LIES), "nmea2000", 1.0)
    assert tracked.refused == {TWO: 5, MANY: 1}
    tracked = tracker()
    for i in range(3):
        tracked.hear(report(0.0, 9000.0 * i), "nmea2000", 0.0)
        seen(tracked, 0.0)
    assert tracked.refused == {JUMP: 2}
    tracked = full()
    seen(tracked, 0.0)
    tracked.hear(report(10.0, 0.0, mmsi=MARIA + 900), "nmea2000", 0.0)
    tracked.hear(report(900.0, 0.0, mmsi=MARIA + 901), "nmea2000", 0.0)
    assert (tracked.refused, tracked.left_out_s) == ({FULL: 2}, NEVER_S)


def test_a_report_at_the_edge_of_what_a_vessel_can_do_is_its_own() -> None:
    for second, refused in ((None, {}), (7, {TWICE: 1})):
        tracked = tracker()
        for latitude_rad, its_second in ((0.0, 9 if second else None), (north_of_the_equator(30.0), second)):
            position = report(0.0, 0.0, second=its_second, **LIES)
            tracked.hear(position._replace(latitude_rad=latitude_rad, longitude_rad=0.1), "nmea2000", 0.0)
        assert (len(tracked), tracked.refused) == (1, refused)


def test_another_one_in_the_place_of_a_number_is_of_its_own_class() -> None:
    tracked = tracker()
    tracked.hear(report(0.0, 0.0, **LIES), "nmea2000", 0.0)
    for second in (10.0, 50.0):
        tracked.hear(report(9000.0, 0.0, kind="B", **LIES), "nmea2000", second)
    assert [(each.key, each.kind) for each in seen(tracked, 50.0)] == [(str(MARIA), "B")]


@pytest.mark.parametrize(("kind", "most"), [("payload", 64), ("fleet", 32)])
def test_programs_leave_room_for_ships_and_have_theirs_again(kind: str, most: int) -> None:
    tracked = tracker()
    for i in range(most + 2):
        tracked.hear(report(float(i), 0.0, kind=kind, **LIES), "guest", 0.0, f"it {i}")
    assert (len(seen(tracked, 60.0)), tracked.refused) == (most, {FULL: 2})
    assert seen(tracked, 60.1) == ()
    for i in range(most + 1):
        tracked.hear(report(float(i), 0.0, kind=kind, **LIES), "guest", 61.0, f"other {i}")
    assert (len(tracked), tracked.refused) == (most, {FULL: 3})


@pytest.mark.parametrize(
    ("own", "vessel", "time_s"),
    [
        ((0.0, 0.0, 0.0, 0.0), (300.0, 400.0, 0.0, 0.0), 500.0 / 0.3),
        ((100.0, -50.0, 0.0, 0.0), (100.0, 450.0, 3.0 * math.pi / 2.0, 4.7), 100.0),
        ((0.0, 0.0, 1.0, 0.5), (1000.0, 0.0, SOUTH, 3.7), 200.0),
        ((0.0, 10.0, 0.5, 1.2), (0.0, 1010.0, 3.0 * math.pi / 2.0, 3.5), 200.0),
        ((0.0, 0.0, 0.0, 0.0), (600.0, 800.0, SOUTH, 2.0), 1000.0 / 1.5),  # closes with a part of its speed
        ((0.0, 0.0, 0.0, 0.0), (300.0, 400.0, math.atan2(-400.0, -300.0), 4.7), 100.0),
        ((0.0, 0.0, 0.0, 0.0), (600.0, 0.0, 0.0, 5.0), 600_000.0),  # draws apart
        ((0.0, 0.0, 0.0, 0.0), (0.5, 0.0, SOUTH, 2.0), 0.5 / 1.3),
    ],
)
def test_when_a_vessel_is_met(own: tuple[float, float, float, float], vessel: Any, time_s: float) -> None:
    assert met_s(own, *vessel) == pytest.approx(time_s)


def test_a_look_is_sliced_and_reports_come_in_between() -> None:
    tracked = tracker()
    for i in range(3):
        tracked.hear(report(-100.0 * i, 200.0 * (i - 1), kind="fleet", **LIES), "console", 0.0, f"boat {i}")
    tracked.hear(report(9000.0, 0.0, kind="fleet", **LIES), "console", 0.0, "boat 1")
    work = tracked.looked(5.0, AT, -150.0, 60.0)
    assert next(work) == 3
    tracked.hear(report(9000.0, 0.0, kind="fleet", **LIES), "console", 0.5, "boat 1")
    sliced = Sliced(work)
    assert not sliced.step(3)
    while not sliced.step(1):
        pass
    assert [each.key for each in sliced.result] == ["boat 2", "boat 0"], "the nearest first, without who is another one since"
    assert [each.age_s for each in seen(tracked, -1.0)] == [0.0] * 3


def test_who_is_met_is_judged_by_the_way_of_the_boat() -> None:
    """Two at the same distance, and the boat goes to one of them: the other one gives way."""
    for north_mps, east_mps, gone in ((2.0, 0.0, "244660124"), (0.0, 2.0, "244660123")):
        tracked = full(many=0)
        tracked.hear(report(5000.0, 0.0, **LIES), "nmea2000", 0.0)
        tracked.hear(report(0.0, 5000.0, mmsi=MARIA + 1, **LIES), "nmea2000", 0.0)
        for i in range(2, 200):
            tracked.hear(report(float(i), float(i), mmsi=MARIA + i, course_rad=-2.3, speed_mps=20.0), "nmea2000", 0.0)
        Sliced(tracked.looked(0.0, AT, 0.0, 0.0, north_mps, east_mps)).finish()
        tracked.hear(report(10.0, 10.0, mmsi=MARIA + 900, **LIES), "nmea2000", 0.0)
        assert gone not in keys(tracked, 0.0)
