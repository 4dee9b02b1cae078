"""Which files there are, which belong together, and which a person means."""

import json
import os
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench import liblog
from delfim.base.errors import DelfimError, FormatError
from delfim.logging.ashore import tree
from delfim.logging.ashore.tree import Span

T0 = 1_262_338_200  # 2010-01-01 09:30:00
NOW_NS = (T0 + 86_400) * 1_000_000_000


def made(root: Path, name: str, end_s: float, *events: str) -> Path:
    """A log file "id/hhmmss.suffix" of that day, last written so long after 09:30, with a sidecar that tells events."""
    path = root / "20100101" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x" * 10)
    os.utime(path, (T0 + end_s, T0 + end_s))
    if events:
        lines = (json.dumps({"t_ns": int((T0 + end_s) * 1e9), "monotonic_s": 1.0, "event": event}) for event in events)
        path.with_name(path.name.partition(".")[0] + ".meta.jsonl").write_text("".join(line + "\n" for line in lines))
    return path


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two starts of the boat: the first ended in order after two files, the second lost its power."""
    made(tmp_path, "state/093000.state.gz", 600, "start", "mode")
    made(tmp_path, "state/094000.state.gz", 900, "end")
    made(tmp_path, "state/094503.state.gz", 1000, "start")
    made(tmp_path, "can0/092959.log.gz", 900, "start", "end")
    made(tmp_path, "can0/094502.log.gz", 1000, "start")
    return tmp_path


def test_an_id_is_shown_whatever_its_folder_is_called(tmp_path):
    for name in (b"can0", b"\xff\xfe", b"a\x1b[2Jb", b"two\nlines", "é".encode()):
        made(tmp_path, f"{os.fsdecode(name)}/093000.log", 600)
    shown = {run.id for run in tree.runs(tree.files([tmp_path]), NOW_NS)}
    assert shown == {"can0", r"\xff\xfe", r"a\x1b[2Jb", r"two\nlines", "é"}


def test_runs_begin_with_a_start_and_say_how_they_ended(root):
    runs = tree.runs(tree.files([root]), NOW_NS)
    assert [(run.name, run.id, len(run.files), run.end) for run in runs] == [
        ("20100101-092959", "can0", 1, "clean"),
        ("20100101-093000", "state", 2, "clean"),
        ("20100101-094502", "can0", 1, "cut"),
        ("20100101-094503", "state", 1, "cut"),
    ]
    assert runs[1].end_ns == (T0 + 900) * 1_000_000_000
    assert runs[1].size == 20


def test_what_was_written_a_moment_ago_is_running(root):
    assert tree.runs(tree.files([root]), (T0 + 1003) * 1_000_000_000)[-1].end == "running"


def test_all_logs_are_listed_without_a_look_into_a_log(tmp_path, monkeypatch):
    opened, calls = Counter[str](), Counter[str]()

    def counted(path, *how):
        opened[str(path)] += 1
        return open(path, *how)

    def looked(path):
        calls["scandir"] += 1
        return os.scandir(path)

    monkeypatch.setattr(liblog, "DAYS", 20)
    count = liblog.year(tmp_path)
    monkeypatch.setattr(tree, "open", counted, raising=False)
    monkeypatch.setattr(tree, "os", SimpleNamespace(**vars(os) | {"scandir": looked}))
    runs = tree.runs(tree.files([tmp_path]), NOW_NS)
    assert sum(len(run.files) for run in runs) == count == 960
    assert {run.end for run in runs} == {"clean"}
    assert calls["scandir"] == 1 + 20 * 3, "a look into every folder"
    assert all(path.endswith(".meta.jsonl") for path in opened)
    assert opened.total() <= count + len(runs), "a look into every sidecar, for starts, and another for the end"


def test_without_sidecars_a_pause_ends_a_run(tmp_path):
    for name, end_s in (("093000", 600), ("094000", 1200), ("095130", 1400)):
        made(tmp_path, f"gps/{name}.log", end_s)
    assert [len(run.files) for run in tree.runs(tree.files([tmp_path]), NOW_NS)] == [2, 1]


def test_the_last_run_takes_the_black_box_of_its_time_along(root):
    chosen = tree.choose(tree.files([root]), "last", NOW_NS)
    assert [run.name for run in chosen] == ["20100101-094502", "20100101-094503"]
    first = tree.choose(tree.files([root]), "20100101-0930", NOW_NS)
    assert [run.name for run in first] == ["20100101-092959", "20100101-093000"]
    with pytest.raises(DelfimError, match=r"no run 2011; there are 20100101-"):
        tree.choose(tree.files([root]), "2011", NOW_NS)
    with pytest.raises(DelfimError, match="may be one of"):
        tree.choose(tree.files([root]), "20100101", NOW_NS)


def test_a_tree_a_day_a_folder_and_a_file_may_be_named(root):
    assert len(tree.files([root])) == 5
    assert len(tree.files([root / "20100101"])) == 5
    assert len(tree.files([root / "20100101/state"])) == 3
    assert len(tree.files([root / "20100101/state", root])) == 5
    (one,) = tree.files([root / "20100101/state/094000.state.gz"])
    assert (one.begin_ns, one.id, one.suffix, one.size) == ((T0 + 600) * 1_000_000_000, "state", ".state.gz", 10)
    with pytest.raises(DelfimError, match="No such file"):
        tree.files([root / "no"])
    (root / "notes.txt").write_text("")
    with pytest.raises(FormatError, match="is not a log file"):
        tree.files([root / "notes.txt"])


def test_a_repaired_copy_stands_for_its_original(root):
    made(root, "state/094503-repaired.state.gz", 1000)
    names = [Path(file.path).name for file in tree.files([root / "20100101/state"])]
    assert names == ["093000.state.gz", "094000.state.gz", "094503-repaired.state.gz"]


def test_files_of_one_second_are_in_order_and_strangers_are_no_logs(tmp_path):
    for name in ("093000-10", "093000-2", "093000"):
        made(tmp_path, f"gps/{name}.log", 1)
    for name in ("093000.log.gz.part", "readme", "0930.log"):
        made(tmp_path, f"gps/{name}", 1)
    (tmp_path / "20109901").mkdir()
    assert [Path(file.path).stem for file in tree.files([tmp_path])] == ["093000", "093000-2", "093000-10"]


def test_files_of_a_time_are_those_that_may_hold_something_of_it(root):
    runs = tree.runs(tree.files([root]), NOW_NS)
    span = Span((T0 + 700) * 1_000_000_000, (T0 + 800) * 1_000_000_000)
    assert [Path(file.path).name for file in tree.within(runs, span)] == ["092959.log.gz", "094000.state.gz"]


def test_events_come_with_their_id_and_torn_lines_do_not(root):
    with (root / "20100101/state/094503.meta.jsonl").open("a") as file:
        file.write('{"t_ns": 12')
    told = [(event["id"], event["event"]) for event in tree.events(tree.files([root]))]
    assert told == [
        ("can0", "start"),
        ("can0", "end"),
        *(("state", e) for e in ("start", "mode", "end")),
        ("can0", "start"),
        ("state", "start"),
    ]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2010-01-01T09:31:00", 60),
        ("2010-01-01 09:31:00Z", 60),
        ("2010-01-01T10:31:00+01:00", 60),
        ("20100101-093100", 60),
        ("09:31", 60),
        ("9:31:00.5", 60.5),
        ("+60", 60),
        ("+0.25", 0.25),
    ],
)
def test_times_as_people_write_them(text, seconds):
    assert tree.instant(text, T0 * 1_000_000_000) == T0 * 1_000_000_000 + round(seconds * 1e9)


@pytest.mark.parametrize("text", ["", "soon", "+", "25:00", "2010-13-01", "+nan", "+1e400"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(FormatError, match="is not a time"):
        tree.instant(text, 0)


def test_a_range_that_ends_before_it_begins_is_refused():
    with pytest.raises(FormatError, match="before"):
        tree.span("+10", "+5", 0)
