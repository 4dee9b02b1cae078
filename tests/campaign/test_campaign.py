"""Campaigns from the command line: sailed by processes or by a Dask cluster, whatever dies; each run there once."""

import itertools
import json
import os
import platform
import shutil
import signal
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from importlib import metadata
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import DelfimError
from delfim.campaign import queries, runner, sailing, store, workers
from delfim.campaign.runplan import read
from tests.campaign.test_runplan import written

DELFIM = (sys.executable, "-m", "delfim", "campaign")
ROOT = Path(__file__).parents[2]
KILLS = 20


@pytest.fixture(scope="module")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A campaign's file, and the folder of its results."""
    place = tmp_path_factory.mktemp("campaign")
    lines = ['scenario = "mixed"', "seeds = {first = 3, count = 5}", "[vary]", '"simulation.sea.wind_mps" = [0.0, 6.0]']
    lines += ["[draw]", '"simulation.sea.current_mps" = {uniform = [0.0, 0.5]}']
    lines += ["[[pass]]", 'name = "never"', 'sql = "count(*) filter (not ok) = 0"']
    lines += ["[[pass]]", 'name = "far"', 'sql = "min(way_m) > 1.0"', 'each = "point"']
    lines += ["[[table]]", 'name = "By boat"', 'sql = "select vehicle as boat, count(*) as runs from runs group by all"']
    path = written(place, *lines)
    words = ["campaign", str(path), "--output", str(place / "out"), "--workers", "2", "--batch", "3"]
    assert main(words) == 0
    return path, place / "out"


def digests(folder: Path) -> dict[tuple[int, int], str]:
    rows = queries.selected(queries.connect(folder), "select point, seed, digest from runs")[1]
    assert len(rows) == len({row[:2] for row in rows}), "a run is there twice"
    return {(point, seed): digest for point, seed, digest in rows}


def test_the_page_is_left_out_by_a_word_and_what_is_sailed_is_the_same(sailed: tuple[Path, Path], tmp_path: Path) -> None:
    path, folder = sailed
    without = tmp_path / "campaign.toml"
    without.write_text("page = false\n" + path.read_text())
    file, plan = read(str(without))
    assert plan.digest == read(str(path))[1].digest
    copied = shutil.copytree(folder, tmp_path / "out")
    (copied / "report.html").unlink()
    assert runner.tell(file, plan, copied, "delfim campaign FILE", None) == 0
    assert not (copied / "report.html").exists()


HOSTILE = {
    "writes": "copy (select 'echo owned') to '{place}/profile' (format csv, header false, quote '')",
    "writes beside the results": "copy (select 1) to '{folder}/more.csv'",
    "reads": "select content from read_text('{place}/secret')",
    "reads by a detour": "select content from read_text('{folder}/../secret')",
    "lists": "select file from glob('{place}/*')",
    "opens a database": "attach '{place}/base.db' as base",
    "does two things": "select 1; copy (select 1) to '{place}/profile'",
    "unlocks": "set enable_external_access = true",
    "explains": "explain analyze copy (select 1) to '{place}/profile'",
}


@pytest.mark.parametrize("sql", HOSTILE.values(), ids=HOSTILE)
def test_the_sql_of_a_file_reads_the_results_alone_and_writes_nothing(sailed, tmp_path, sql):
    _, folder = sailed
    places = tmp_path, folder, folder.parent
    for place in places[::2]:
        (place / "secret").write_text("secret")
    (tmp_path / "file").mkdir()
    before = {each: each.stat().st_mtime_ns for place in places for each in place.iterdir() if each.is_file()}
    sql = sql.format(place=tmp_path, folder=folder)
    for kind, words in (("table", sql), ("pass", f"1) from runs; {sql}")):
        file, plan = read(
            written(tmp_path / "file", 'scenario = "mixed"', f"[[{kind}]]", 'name = "slip"', f'sql = """{words}"""')
        )
        with pytest.raises(DelfimError, match="slip: "):
            queries.rehearse(file, plan)
        with pytest.raises(DelfimError, match="slip: "):
            queries.verdicts(queries.connect(folder), file.must) or queries.answered(queries.connect(folder), file.answers)
    assert before == {each: each.stat().st_mtime_ns for place in places for each in place.iterdir() if each.is_file()}


def test_it_judges_reports_and_has_every_run_once(sailed, tmp_path, capsys):
    path, folder = sailed
    assert set(digests(folder)) == set(itertools.product((0, 1), range(3, 8)))
    (tmp_path / "campaign.toml").write_text("page = false\n" + path.read_text())
    words = ["campaign", str(tmp_path / "campaign.toml"), "--output", str(folder), "--batch", "3"]
    assert main(words) == 0, "nothing is left to sail"
    told = capsys.readouterr().out
    assert "10 of them are there already" in told
    assert "holds  never" in told
    assert "  By boat\n\n  boat     runs\n  delfimx  10\n" in told
    page = (folder / "report.html").read_text()
    for words in (
        "Holds: never",
        "Holds: far",
        "<h2>By boat</h2>",
        "95 % confidence",
        "Points",
        "What moves what",
        "Where boats ended",
        "--again",
    ):
        assert words in page
    assert page.count("data:image/png;base64,") == 4
    assert "http://" not in page
    assert "https://" not in page


def test_versions_platform_and_the_vehicles_file_stand_in_the_results(sailed):
    _, folder = sailed
    head = json.loads((folder / "campaign.json").read_text())
    assert head["version"] == sailing.VERSION
    assert head["packages"]["msgspec"] == metadata.version("msgspec")
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {line.partition(">")[0] for line in (*asked["dependencies"], *asked["optional-dependencies"]["campaign"])}
    assert set(head["packages"]) == needed - {"rich"}, "the live view has no part in it"
    assert head["platform"] == platform.platform()
    assert head["vehicles"]["delfimx"]["boat"]["name"] == "DelfimX"
    assert f"msgspec {metadata.version('msgspec')}" in (folder / "report.html").read_text()


def test_a_run_is_repeated_to_the_last_byte_with_its_log_and_a_picture(sailed, capsys):
    path, folder = sailed
    assert main(["campaign", str(path), "--output", str(folder), "--again", "1:7"]) == 0
    assert "the same run to the last byte" in capsys.readouterr().out
    assert (folder / "again-1-7/track.png").stat().st_size > 5000
    assert list(folder.glob("again-1-7/*/state/*.state"))


def test_it_is_asked_by_sql(sailed, capsys):
    _, folder = sailed
    assert (
        main(["campaign", "query", "select point, count(*) as runs from runs group by 1 order by 1", "--output", str(folder)])
        == 0
    )
    assert capsys.readouterr().out == "point  runs\n0      5\n1      5\n"
    assert main(["campaign", "query", "select nothing from runs", "--output", str(folder)]) == 2
    assert 'Referenced column "nothing" not found' in capsys.readouterr().err


def test_a_campaign_that_does_not_hold_ends_with_1_and_says_where(sailed, tmp_path, capsys):
    path, folder = sailed
    told = path.read_text().replace("min(way_m) > 1.0", "min(way_m) > 1e9")
    (tmp_path / "campaign.toml").write_text("page = false\n" + told)
    assert main(["campaign", str(tmp_path / "campaign.toml"), "--output", str(folder), "--batch", "3"]) == 1
    assert "FAILS  far (points 0, 1)" in capsys.readouterr().out


@pytest.mark.long
def test_another_campaign_is_compared_run_by_run(sailed, tmp_path, capsys):
    path, folder = sailed
    (tmp_path / "campaign.toml").write_text(path.read_text().replace("[0.0, 6.0]", "[0.0, 5.0]"))
    words = ["campaign", str(tmp_path / "campaign.toml"), "--output", str(tmp_path / "out"), "--against", str(folder)]
    assert main(words) == 0
    page = (tmp_path / "out/report.html").read_text()
    assert "10 runs in common, 5 of them the same to the last byte" in page
    capsys.readouterr()
    assert main(["campaign", str(path), "--output", str(tmp_path / "out")]) == 2
    assert "holds another campaign" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--again", "9:1"), "not POINT:SEED with a point up to 1"),
        (("--again", "x"), "not POINT:SEED"),
        (("--workers", "0"), "--workers is 1 to 1024"),
        (("select 1",), "SQL is for delfim campaign query"),
        pytest.param(("--cluster", "tcp://127.0.0.1:1"), "no Dask cluster at tcp://127.0.0.1:1", marks=pytest.mark.long),
    ],
)
def test_mistakes_are_said_in_words(sailed, tmp_path, capsys, words, said):
    if "--cluster" in words:  # Dask is slow to give up: its own process may wait
        command = (*DELFIM, str(sailed[0]), *words, "--output", str(tmp_path / "out"))
        end = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=100)
        assert (end.returncode, said in end.stderr) == (2, True), end.stderr
        return
    assert main(["campaign", str(sailed[0]), *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "lines",
    [("[[pass]]", 'name = "slip"', 'sql = "max(way) > 1.0"'), ("[[table]]", 'name = "slip"', 'sql = "select way from runs"')],
)
def test_sql_that_is_none_is_refused_before_the_first_run(tmp_path, capsys, lines):
    path = written(tmp_path, 'scenario = "mixed"', *lines)
    assert main(["campaign", str(path), "--output", str(tmp_path / "out")]) == 2
    assert 'slip: Binder Error: Referenced column "way" not found' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_results_to_compare_with_are_looked_for_before_the_first_run(tmp_path, capsys):
    path = written(tmp_path, 'scenario = "mixed"')
    assert main(["campaign", str(path), "--output", str(tmp_path / "out"), "--against", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"delfim: no results in {tmp_path}\n"
    assert not (tmp_path / "out").exists()


# The results.


def test_a_batch_counts_once_a_torn_part_not_at_all_and_what_is_missing_is_known(tmp_path):
    _, plan = read(written(tmp_path, 'scenario = "mixed"', "seeds = {count = 4}"))
    rows = {batch.number: sailing.sail_batch(plan, batch, sailing.VERSION) for batch in plan.batches(2)}
    kept = store.Store(tmp_path / "out", plan, 2, sailing.VERSION)
    for _ in range(2):
        kept.add(0, rows[0])
    kept.flush()
    (tmp_path / "out/part-000001.tmp").write_bytes(b"torn")  # the power failed before it had its name
    again = store.Store(tmp_path / "out", plan, 2, sailing.VERSION)
    assert [again.has(number) for number in range(4)] == [True, False, False, False]
    assert again.runs == 1
    assert not list((tmp_path / "out").glob("*.tmp"))
    for number in (1, 2, 3):
        again.add(number, rows[number])
    again.flush()
    assert set(digests(tmp_path / "out")) == {(0, 1), (0, 2), (0, 3), (0, 4)}
    with pytest.raises(DelfimError, match="results of other code"):
        store.Store(tmp_path / "out", plan, 2, "delfim 9.9")
    with pytest.raises(DelfimError, match="batches of another size"):
        store.Store(tmp_path / "out", plan, 3, sailing.VERSION)


def test_a_key_with_values_of_several_kinds_is_refused(tmp_path):
    _, plan = read(written(tmp_path, 'scenario = "mixed"', "[vary]", '"log.required" = [true]', '"boat.name" = ["a", "b"]'))
    store.schema(plan)
    with pytest.raises(DelfimError, match="several kinds"):
        store.schema(plan._replace(points=((0, {"a.b": "text"}), (0, {"a.b": 1.0}))))


def test_interval_of_a_share():
    assert queries.share(0, 600) == (0.0, pytest.approx(0.00636, abs=1e-4))
    assert queries.share(50, 100) == (pytest.approx(0.4038, abs=1e-3), pytest.approx(0.5962, abs=1e-3))


# Workers that die.


@pytest.mark.long
def test_a_killed_process_costs_no_run_and_counts_none_twice(tmp_path, sailed):
    path, folder = sailed
    _, plan = read(path)
    rows, killed = dict[int, list[dict]](), set[int]()
    for number, some in workers.by_processes(plan, plan.batches(2), 2):
        assert number not in rows
        rows[number] = some
        if len(killed) < 2 and some[0]["pid"] not in killed:
            killed.add(some[0]["pid"])
            os.kill(some[0]["pid"], signal.SIGKILL)
    assert len(killed) == 2
    assert {(row["point"], row["seed"]): row["digest"] for some in rows.values() for row in some} == digests(folder)


@pytest.mark.long
def test_ctrl_c_keeps_what_was_sailed_and_the_same_command_goes_on(tmp_path, sailed, monkeypatch, capsys):
    path, folder = sailed
    words = ["campaign", str(path), "--output", str(tmp_path / "out"), "--workers", "2", "--batch", "1"]
    taken = itertools.count()

    def struck(progress: runner.Progress, rows: list[dict]) -> None:
        if next(taken) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(runner.Progress, "add", struck)
        assert main(words) == 130
    assert "ended after 4 of 10 runs; the same command goes on" in capsys.readouterr().err
    assert len(digests(tmp_path / "out")) == 4
    assert main(words) == 0
    assert "4 of them are there already" in capsys.readouterr().out
    assert digests(tmp_path / "out") == digests(folder)


CUT = """
import os, signal, sys
from delfim.campaign.runplan import read
from delfim.campaign.workers import by_processes
if __name__ == "__main__":
    plan = read(sys.argv[1])[1]
    for _, rows in by_processes(plan, plan.batches(1), 2):
        print(rows[0]["pid"], flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.long
def test_no_worker_outlives_the_campaign_whatever_ended_it(tmp_path, sailed):
    (tmp_path / "cut.py").write_text(CUT)
    words = (sys.executable, tmp_path / "cut.py", sailed[0])
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}) as cut:
        assert cut.stdout is not None
        worker = Path("/proc") / cut.stdout.readline().strip()
        cut.stdout.read()  # until nobody holds the pipe any more: each worker has it, too
    assert not (worker / "exe").exists()


ENDED = """
import signal, sys
from delfim.campaign.runplan import read
from delfim.campaign.workers import by_processes
def endless(plan, batch, version):
    if batch.number:
        signal.pause()
    return []
if __name__ == "__main__":
    plan = read(sys.argv[1])[1]
    sailing = by_processes(plan, plan.batches(1), 2, endless)
    next(sailing)
    sailing.close()
"""


def test_whoever_ends_a_campaign_does_not_wait_for_what_is_being_sailed(tmp_path, sailed):
    (tmp_path / "ended.py").write_text(ENDED)
    words = (sys.executable, tmp_path / "ended.py", sailed[0])
    end = subprocess.run(words, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=100)
    assert (end.returncode, end.stderr) == (0, "")


def test_a_run_that_a_broken_pool_refuses_is_sailed_by_the_next_one(tmp_path, monkeypatch):
    """The pool notices a killed process at any time: here just before it is handed a run, which no kill hits surely."""
    offered = itertools.count()

    class Breaking(ProcessPoolExecutor):
        def submit(self, *args, **more):
            if next(offered) == 3:
                raise BrokenProcessPool("a process died")
            return super().submit(*args, **more)

    monkeypatch.setattr(workers, "ProcessPoolExecutor", Breaking)
    path = written(tmp_path, 'scenario = "mixed"', "seeds = {first = 0, count = 6}")
    runner.sail(read(path)[1], tmp_path / "out", 1, 2, None)
    assert set(digests(tmp_path / "out")) == {(0, seed) for seed in range(6)}


@pytest.mark.long
def test_twenty_killed_processes_cost_no_run_and_count_none_twice(tmp_path, monkeypatch):
    path = written(tmp_path, 'scenario = "mixed"', "seeds = {first = 0, count = 60}")
    plan, killed = read(path)[1], set[int]()

    def struck(progress: runner.Progress, rows: list[dict]) -> None:
        if len(killed) < KILLS and rows[0]["pid"] not in killed:
            killed.add(rows[0]["pid"])
            with suppress(ProcessLookupError):  # it died with the pool of one that was killed before
                os.kill(rows[0]["pid"], signal.SIGKILL)

    monkeypatch.setattr(runner.Progress, "add", struck)
    runner.sail(plan, tmp_path / "out", 1, 2, None)
    assert len(killed) == KILLS
    assert set(digests(tmp_path / "out")) == {(0, seed) for seed in range(60)}


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """The address of a Dask scheduler on loopback with two workers, each a process that is started again when it dies."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address, quiet = f"tcp://127.0.0.1:{port}", os.environ | {"PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "error"}
    dask = (sys.executable, "-W", "ignore", "-m", "distributed.cli.dask_spec")
    scheduler = {"cls": "distributed.Scheduler", "opts": {"host": "127.0.0.1", "port": port, "dashboard": False}}
    worker = {"cls": "distributed.Nanny", "opts": {"nthreads": 1, "host": "127.0.0.1", "dashboard": False}}
    with ExitStack() as running:
        for words in ((json.dumps(scheduler),), *2 * ((json.dumps(worker), address),)):
            program = subprocess.Popen((*dask, "--spec", *words), env=quiet, cwd=tmp_path, stderr=subprocess.DEVNULL)
            running.callback(program.wait)
            running.callback(program.kill)
        yield address


KILLING = """
import json, os, signal, sys
from delfim.campaign.runplan import read
from delfim.campaign.workers import by_cluster
plan, dead, found = read(sys.argv[1])[1], set(), {}
for number, (row,) in by_cluster(plan, plan.batches(1), sys.argv[2]):
    assert number not in found
    found[number] = [row["point"], row["seed"], row["digest"]]
    if len(dead) < int(sys.argv[3]) and row["pid"] not in dead:
        dead.add(row["pid"])
        os.kill(row["pid"], signal.SIGKILL)
assert len(dead) == int(sys.argv[3])
print(json.dumps(list(found.values())))
"""


def killing(path: Path, cluster: str, kills: int) -> list[tuple[int, int, str]]:
    """(point, seed, digest) of all rows of a campaign whose workers are killed on the way."""
    command = (sys.executable, "-c", KILLING, path, cluster, str(kills))
    end = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=500)
    assert end.returncode == 0, end.stderr
    return [tuple(row) for row in json.loads(end.stdout)]


@pytest.mark.long
def test_a_cluster_whose_worker_is_killed_gives_the_same_rows(sailed, cluster):
    path, folder = sailed
    assert {(point, seed): digest for point, seed, digest in killing(path, cluster, 1)} == digests(folder)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_cluster_of_which_twenty_workers_are_killed_gives_each_run_once(tmp_path, cluster):
    path = written(tmp_path, 'scenario = "mixed"', "seeds = {first = 0, count = 60}")
    runs = [(point, seed) for point, seed, _ in killing(path, cluster, KILLS)]
    assert sorted(runs) == [(0, seed) for seed in range(60)]
