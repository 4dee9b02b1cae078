"""The comparison with MOOS-IvP where that is not there, and a real turn of Delfim. Nothing here judges speed."""

import subprocess
import sys
from pathlib import Path

import pytest

from bench import peers
from bench.__main__ import main
from bench.critical_path import running
from delfim.base.errors import DelfimError

ROOT = Path(__file__).parents[2]


def turn(stopped_s: float | None, *latency_us: float) -> peers.Turn:
    return peers.Turn(2.5, 0.05, 90_000_000, stopped_s, list(latency_us))


def test_the_table_says_how_often_nobody_stopped() -> None:
    rows = {"one": [turn(0.1, 50.0, 60.0, 70.0), turn(0.3, 80.0)], "other": [turn(None), turn(2.0, 21_000.0)]}
    head, one, other = peers.table(rows).splitlines()
    assert head.split() == ["start", "s", "processor", "PSS", "MB", "stopped", "s", "p50", "ms", "p99", "ms", "cycles"]
    assert one.split() == ["one", "2.5", "5.0%", "90", "0.20", "0.070", "0.080", "4"]
    assert other.split() == ["other", "2.5", "5.0%", "90", "never:", "1", "21.000", "21.000", "1"]


def test_where_it_is_not_built_there_is_nothing_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert list(peers.moos(tmp_path)) == []
    for name in ("MOOSDB", "pAntler", *peers.PROGRAMS[:-1]):
        (tmp_path / name).touch(mode=0o755)
    with pytest.raises(DelfimError, match="MOOS-IvP lacks pNodeReporter in PATH"):
        next(peers.moos(tmp_path))
    (tmp_path / "pNodeReporter").touch(mode=0o755)
    with pytest.raises(DelfimError, match=r"has no libMOOS.a, or not its headers"):
        next(peers.moos(tmp_path))


def test_the_first_order_that_is_wanted_counts_from_a_time_on() -> None:
    says = "import signal; print('0 100'); print('30 200'); print('0 300', flush=True); signal.pause()"
    with running([sys.executable, "-c", says], stdout=subprocess.PIPE) as probe:
        orders = peers.Orders(probe)
        assert orders.first(lambda thrust: thrust > 0, 0, 60.0) == 200
        assert orders.first(lambda thrust: thrust == 0, 150, 60.0) == 300
        with pytest.raises(TimeoutError, match="no such order was heard"):
            orders.first(lambda thrust: thrust > 0, 250, 0.0)


def test_a_mission_has_the_rates_that_were_asked_for(tmp_path: Path) -> None:
    label = "as fast as it goes"
    words = peers.Moos(label, tmp_path / "probe", tmp_path)._mission(9000, peers.PROGRAMS)
    for program, hz in zip(("uSimMarineV22", "pHelmIvP", "pMarinePIDV22"), peers.RATES_HZ[label], strict=True):
        assert f"ProcessConfig = {program}\n{{\nAppTick = {hz}\nCommsTick = {hz}\n" in words
    assert "ServerPort = 9000\n" in words


@pytest.mark.long
def test_delfim_alone_is_measured_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(peers, "moos", lambda _: iter(()))
    words = ["peers", "--seconds", "2", "--rounds", "1", "--file", str(ROOT / "etc/delfimx.toml"), "--output", str(tmp_path)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "MOOS-IvP is not built here" in said
    row = next(line for line in said.splitlines() if line.startswith("Delfim ")).split()
    assert "never:" not in row, "the propellers were told to stop"
    assert int(row[-1]) > 0, "cycles were seen on the bus"
