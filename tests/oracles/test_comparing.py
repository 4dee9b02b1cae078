"""The words for a difference name the boat, the cycle, the field and both values."""

import re
from functools import cache

import pytest

from delfim import config
from tests.oracles import keeping
from tests.oracles.comparing import of_lines, of_trace
from tests.oracles.kinds import LINES
from tests.oracles.statelogs import ALL, explained
from tests.oracles.traces import Trace
from tests.oracles.voyages import ROOT, Voyage, boats

HERON = "etc/boats/heron.toml"
SAILED_S = 20.4


@cache
def heron() -> Voyage:
    return next(voyage for voyage in boats() if voyage.name == HERON)


@cache
def sailed(*overrides: str) -> Trace:
    """Twenty seconds with these keys of the vehicle's file."""
    return heron()._replace(settings=config.load(ROOT / HERON, overrides)).sail({}, SAILED_S)


def words(now: Trace, *, same_arithmetic: bool = True) -> str:
    return of_trace(HERON, sailed(), now, same_arithmetic)


def test_the_same_voyage_is_the_same() -> None:
    assert words(heron().sail({}, SAILED_S)) == ""
    assert words(heron().sail({}, 12.0)) == "", "as far as both go"


def test_another_gain_is_found_in_the_cycle_and_the_command_that_it_changed_first() -> None:
    told = words(sailed("control.heading.p_nm_per_rad=60.0"))
    match = re.fullmatch(
        r"etc/boats/heron\.toml, cycle (\d+) \(t = (\S+) s\), what it commanded \(where the boat truly is, what it sensed, "
        r"what it decided: as before\): field (\w+)_command: kept (\S+), now ([^;]+).*",
        told,
    )
    assert match, told
    cycle, at_s, name, kept, now = match.groups()
    assert float(at_s) == pytest.approx(int(cycle) / 5.0)
    traces = sailed(), sailed("control.heading.p_nm_per_rad=60.0")
    for trace, value in zip(traces, (kept, now), strict=True):
        assert float(value) == pytest.approx(trace.columns[f"{name}_command"][int(cycle) - 1], abs=1e-3)
    before = [[column[int(cycle) - 2] for column in each.columns.values()] for each in traces]
    assert repr(before[0]) == repr(before[1])


def test_another_sea_is_told_as_such_and_words_that_were_said_are_quoted() -> None:
    assert f"{HERON}, cycle 2 (t = 0.4 s), where the boat truly is: " in words(sailed("simulation.sea.wind_mps=9.0"))
    now = sailed()._replace(told=[(1.0, "hold: fence ahead"), *sailed().told[1:]])
    then = sailed().told[0]
    assert words(now) == f"{HERON}: said: kept {then[1]!r} at {then[0]:.1f} s, now 'hold: fence ahead' at 1.0 s"


def test_a_field_that_is_gone_is_named() -> None:
    now = sailed()._replace(groups=sailed().groups | {"decided": ("cycle",)})
    assert words(now).startswith(f"{HERON}: there is no field mode nor troubles")


def test_where_the_last_bit_is_another_one_values_may_differ_a_little_and_no_more() -> None:
    slightly = {cycle: {name: value + 1e-5 for name, value in values.items()} for cycle, values in sailed().ends.items()}
    marks = dict.fromkeys(sailed().marks, ("another", ""))
    assert words(sailed()._replace(marks=marks, ends=slightly), same_arithmetic=False) == ""
    more = {cycle: values | {"heading": values["heading"] + 0.1} for cycle, values in slightly.items()}
    told = words(sailed()._replace(marks=marks, ends=more), same_arithmetic=False)
    assert re.fullmatch(r"etc/boats/heron\.toml: cycle 100 \(t = 20\.0 s\), field heading: kept \S+, now \S+", told)


def test_a_trace_is_read_as_it_was_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(keeping, "KEPT", tmp_path)
    keeping.keep_traces("boats", {HERON: sailed()})
    kept, arithmetic = keeping.kept_traces("boats")
    assert arithmetic == keeping.arithmetic()
    assert of_trace(HERON, kept[HERON], sailed(), same_arithmetic=True) == ""
    assert of_trace(HERON, kept[HERON], sailed(), same_arithmetic=False) == ""
    assert (kept[HERON].groups, kept[HERON].rows, kept[HERON].marks) == (sailed().groups, sailed().rows, sailed().marks)


@pytest.mark.parametrize(
    ("kept", "now", "told"),
    [
        (["stop: 301 0000140b"], ["stop: 301 0000150b"], "stop: 301, byte 2: kept 14, now 15 (kept 0000140b, now 0000150b)"),
        (["a", "b"], ["a", "c", "b"], "new, and was not kept: c"),
        (["a", "b", "c"], ["a"], "kept, and not there any more: b (the first of 2 lines that differ)"),
        (["vehicle.mode = 'play'"], ["vehicle.mode = 'hold'"], "vehicle.mode =: kept 'play', now 'hold'"),
        (["exit code 2"], ["exit code 100"], "exit code: kept 2, now 100"),
    ],
    ids=["a byte", "a new line", "a lost line", "a value", "a number"],
)  # fmt: skip
def test_the_first_line_that_differs_is_told(kept: list[str], now: list[str], told: str) -> None:
    assert of_lines({"vesc": kept}, {"vesc": now}) == [f"vesc: {told}"]


def test_what_is_not_there_any_more_and_what_is_new_are_told() -> None:
    assert of_lines({"vesc": []}, {"otter": []}) == [
        "vesc: it was kept, and is not there any more",
        "otter: it is new: it was not kept",
    ]


def test_a_record_of_the_log_is_told_by_its_field() -> None:
    kept = {ALL: ["field fix B -: a fix"], HERON: ["field roll f rad: starboard down", "record 1: 02 0000003f"]}
    now = {ALL: ["field new B -: it is new", "field fix B -: a fix"], HERON: [kept[HERON][0], "record 1: 07 02 0000403f"]}
    assert explained(kept[HERON][1], now[HERON][1], kept, now, HERON) == "record 1, field roll: kept 0.5, now 0.75"
    more = now | {HERON: [kept[HERON][0], "record 1: 07 02 0000003f"]}
    assert (
        explained(kept[HERON][1], more[HERON][1], kept, more, HERON) == "record 1: what was kept is the same, and there is more"
    )


def test_a_table_of_the_vehicles_file_is_told_by_its_name() -> None:
    (told,) = of_lines(
        {"delfim describe": ["`[can]` 49", "`[log]` 17"]},
        {"delfim describe": ["`[can]` 49", "`[log]` 18"]},
        LINES["vehicle-files"].explain,
    )
    assert told == "delfim describe: `[log]` is not described as it was: git diff docs/vehicle-file.md"
