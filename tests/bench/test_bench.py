"""The benchmark itself runs: tiny slices, all competitors, every field of its result. Nothing here judges speed."""

import argparse
import json
import socket
import sys
from pathlib import Path

import pytest

from bench import critical_path, fleet, liblog
from bench.__main__ import main
from bench.critical_path import LABELS, LONG_CYCLES, Plan, Slice
from bench.report import PERCENTILES, STAGES, Cycle, over_budget
from delfim.base.errors import DelfimError
from tests.parts.fleet.mosquitto import needs_mosquitto

pytestmark = pytest.mark.long

VEHICLE = str(Path(__file__).parents[2] / "etc" / "delfimx.toml")


def asked(**options: object) -> argparse.Namespace:
    return argparse.Namespace(**{"rates": None, "seconds": None, "rounds": None, "quick": False, "long": False} | options)


def test_quick_run_has_every_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["critical-path", "--quick", "--seconds", "0.25", "--rates", "200"]
    ended = main([*words, "--file", VEHICLE, "--output", str(tmp_path)])
    results = json.loads((tmp_path / "critical-path.json").read_text())
    assert ended == any(over_budget(group) for group in results["groups"]), "1 where a service exceeds its budget"
    assert [(group["rate_hz"], group["load"]) for group in results["groups"]] == [(200.0, "idle"), (200.0, "full load")]
    for group in results["groups"]:
        competitors = [key for key in results["plan"]["competitors"] if key != "apart" or group["load"] != "idle"]
        assert [row["competitor"] for row in group["rows"]] == competitors
        assert set(group["noise"]) == set(PERCENTILES)
        assert 0 <= group["steal_share"] <= 1
        assert 0 <= group["others_share"] <= 1
        assert group["late_us_max"] > 0
        for row in group["rows"]:
            assert row["cycles"] + row["lost"] == (100 if row["competitor"] == "c" else 50)
            known = [row[f"{name}_us"] for name in PERCENTILES if row[f"{name}_us"] is not None]
            assert 0 < known[0] <= known[-1] <= row["worst_us"]
            assert 0 < row["cpu_us"] <= row["cpu_all_us"]
            assert (row["window_share"] is not None) == (row["competitor"] in critical_path.OURS)
            assert ("canzlogd" in row["over_budget_per_s"]) == (row["competitor"] in {*critical_path.OURS} - {"apart"})
            assert set(row["stages_us"]) == set(STAGES)
            assert sum(row["histogram"]) == row["cycles"]
            assert set(row["ratio"]) == set(row["verdict"]) == set(PERCENTILES)
            if group["load"] != "idle":
                assert all(count > 0 for count in row["served"].values())
    assert (tmp_path / "critical-path.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert all(row["label"] in printed for row in results["groups"][1]["rows"])
    assert "noise, C against C" in printed


def test_lock_step_bench(tmp_path: Path) -> None:
    words = ["sim", "--rounds", "2", "--seconds", "20"]
    assert main([*words, "--file", VEHICLE, "--output", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "sim.json").read_text())
    assert results["repetitions"] == 2
    assert {*results["boats"]} == {"delfimx", *(file.stem for file in Path(VEHICLE).parent.glob("boats/*.toml"))}
    for boat in results["boats"].values():
        for times in boat["times_real_time"], boat["times_processor_time"]:
            assert 1 < times["min"] <= times["median"] <= times["max"]


@needs_mosquitto
def test_bench_of_a_fleet(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "SIZES", (3,))
    assert fleet.run(asked(seconds=2.0)) == 0
    assert "3 boats, 3 at the console" in capsys.readouterr().out


def test_bench_of_log_calls(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(liblog, "QUICK_WRITES", 100)
    monkeypatch.setattr(liblog, "DAYS", 2)
    assert main(["log", "--quick", "--seconds", "0.2", "--file", VEHICLE, "--output", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "log.json").read_text())
    ours = [f"liblog {method}, paced" for method in ("write", "zwrite", "zpipe")]
    assert list(results["us"]) == [*liblog.WAYS, "os.write, paced", *ours]
    assert all(0 < each["p50"] <= each["worst"] for each in results["us"].values())
    assert results["black_box"]["frames"] > 0
    assert results["ls_s"] > 0
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")
    assert "96 files" in capsys.readouterr().out


def test_every_habit_can_be_broken() -> None:
    """In a process of its own, which it spoils: what it breaks has the names that it knows."""
    program = "from bench import habits; [habits.broken(habit) for habit in habits.HABITS]"
    with critical_path.running([sys.executable, "-c", program]) as child:
        assert child.wait(60.0) == 0


def test_every_round_lets_c_begin_and_end() -> None:
    plan = Plan((100.0,), ("idle", "full load"), tuple(LABELS), 1.0, 2)
    ours = ["delfim", "ordinary", "dronecan", "vesc", "empty", "apart"]
    assert plan.turns("idle", 0) == ["c", "uvloop", "asyncio", *reversed(ours[:-1]), "realtime", "c"]
    assert plan.turns("full load", 1) == ["c", "realtime", *ours, "asyncio", "uvloop", "c"]
    assert plan.slices() == 2 * (10 + 11)


def test_long_run_is_as_long_as_the_one_of_the_thesis() -> None:
    plan = critical_path.planned(asked(long=True))
    assert plan.rates_hz == (100.0,)
    assert LONG_CYCLES <= plan.rounds * plan.seconds * 100 < LONG_CYCLES + 6000
    assert [plan.turns("full load", number) for number in range(2)] == [["c", "delfim"], ["delfim", "c"]]


def test_a_long_run_at_another_rate_is_as_long_as_asked() -> None:
    plan = critical_path.planned(asked(long=True, rates=[5.0], rounds=4))
    assert plan == Plan((5.0,), ("full load",), ("c", "delfim"), 60.0, 4)


def test_a_slice_takes_its_own_cycles() -> None:
    log = [Cycle(t, t, t, t, t, t) for t in range(0, 1000, 10)]
    part = Slice(100, 200, 10, 0.0, 0.0, None, {}, 0.0, 0.0, {}, {})
    assert [cycle.t0 for cycle in critical_path._within(log, part)] == list(range(100, 200, 10))


def test_without_its_sources_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(critical_path, "SOURCES", tmp_path)
    with pytest.raises(DelfimError, match="checkout"):
        critical_path.build(tmp_path)


def test_a_program_that_does_not_compile_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loop.c").write_text("int main(void) { return x; }\n")
    monkeypatch.setattr(critical_path, "SOURCES", tmp_path)
    with pytest.raises(DelfimError, match="does not compile"):
        critical_path.build(tmp_path)


def test_ports_are_free() -> None:
    for port in critical_path.free_ports(4):
        with socket.socket() as one:
            one.bind(("127.0.0.1", port))
