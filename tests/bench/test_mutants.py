"""The changes of the safety core that `make mutants` tries: which there are, who is asked, and what comes of it."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bench.mutants import __main__ as command
from bench.mutants import choice, ledger, reach
from bench.mutants.__main__ import answered, drawn
from bench.mutants.changes import changed, changes, functions
from bench.mutants.choice import Choice
from bench.mutants.core import ABOUT, CORE
from bench.mutants.ledger import Figures, Ledger, measured, measured_now, reasons, shown
from bench.mutants.workers import TimeIsOver, Worker
from delfim.base.errors import ConfigError

ROOT = Path(__file__).parents[2]
subprocess_run = subprocess.run


def tried(source: str) -> list[str]:
    """What each change makes of one statement."""
    return [ast.unparse(changed(source, number)) for number in range(len(changes(source)[1]))]


@pytest.mark.parametrize(
    ("source", "become"),
    [
        ("a < b", ["pass", "a <= b", "a >= b"]),
        ("x = a == b", ["x = a != b"]),
        ("x = a <= b < c", ["x = a < b < c", "x = a > b < c", "x = a <= b <= c", "x = a <= b >= c"]),
        ("x = a is None", ["x = a is not None"]),
        ("x = a and f(b or c)", ["x = a and f(b and c)", "x = a or f(b or c)"]),
        ("x = a + b * c", ["x = a - b * c", "x = a + b / c"]),
        ("x = -a", ["x = a"]),
        ("x = not a", ["x = a"]),
        ("x = 7", ["x = 8"]),
        ("x = 0.0", ["x = 1.0"]),
        ("x = 0.4", ["x = 0.8"]),
        ("x = True", ["x = False"]),
        ("x.y = z", ["pass"]),
        ("x += y", ["pass", "x -= y"]),
        ("x = y if z else w", ["x = y if not z else w"]),
        ("x = [y for y in z if y]", ["x = [y for y in z if not y]"]),
        ("raise x", ["pass"]),
        ('x: int = "words"', []),
        ('"""Words."""', []),
        ('if __name__ == "__main__":\n    main(1)', []),
    ],
)
def test_one_place_changes_at_a_time(source: str, become: list[str]) -> None:
    assert sorted(tried(source)) == sorted(become)


def test_an_answer_is_not_given_and_a_condition_is_negated() -> None:
    source = "def f(x: int = 1) -> int:\n    '''One.'''\n    if x:\n        return g(x)\n    return None"
    assert [change.name for change in changes(source)[1]] == [
        "<module> | def f(x: int = 1) -> int: | 1 → 2",
        "f | if x: | not x",
        "f | return g(x) | return None",
    ]


def test_of_a_table_the_functions_are_asked_that_use_it() -> None:
    source = (
        "LIMIT = 3\nALONE = 4\nclass A:\n    ONE = 1\n    def f(self):\n        return LIMIT\ndef g(most=2):\n    return A()\n"
    )
    asks = {change.name.rpartition(" | ")[2]: change.asks for change in changes(source)[1] if change.function == "<module>"}
    assert asks == {
        "3 → 4": frozenset({"A.f"}),
        "4 → 5": frozenset({"<module>"}),
        "1 → 2": frozenset({"A.f", "g"}),
        "2 → 3": frozenset({"<module>"}),
    }


def test_a_change_has_its_name_for_itself_wherever_its_line_stands() -> None:
    for file in CORE:
        source = (ROOT / file).read_text()
        names = [change.name for change in changes(source)[1]]
        assert len(set(names)) == len(names) > 0
        assert [change.name for change in changes(f"\n\n{source}")[1]] == names


def test_a_function_belongs_to_the_outermost_one() -> None:
    source = "class A:\n    class B:\n        def f(self):\n            def g(): ...\n\ndef h(): ...\n"
    assert [(name, function.name) for name, function in functions(ast.parse(source))] == [
        ("A.B.f", "f"),
        ("A.B.f", "g"),
        ("h", "h"),
    ]


def test_each_reason_is_one_of_a_change_that_there_is() -> None:
    for file, told in reasons(ROOT / ledger.REASONS).items():
        names = {change.name for change in changes((ROOT / file).read_text())[1]}
        assert set(told) - names == set(), f"{file} has changed: its survivors are others now"
        assert all(told.values())


def test_what_moved_to_another_file_is_no_new_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=n", "-c", "user.email=n@example.org", *words], cwd=tmp_path, check=True)

    monkeypatch.chdir(tmp_path)
    (tmp_path / "delfim").mkdir()
    (tmp_path / "delfim/helm.py").write_text("def f(x):\n    return x + 1\n\ndef g(x):\n    return x * 2\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "before")
    (tmp_path / "delfim/helm.py").write_text("def f(x):\n    return x + 1\n")
    (tmp_path / "delfim/orders.py").write_text("LIMIT = 3\n\ndef g(x):\n    return x * 2\n")
    git("add", ".")
    git("commit", "-qm", "after")
    assert drawn(["delfim/helm.py", "delfim/orders.py"], "HEAD~1", None) == {"delfim/helm.py": [], "delfim/orders.py": [0]}
    assert drawn(["delfim/orders.py"], "HEAD", None) == {"delfim/orders.py": []}
    with pytest.raises(ConfigError, match="no such commit"):
        drawn(["delfim/orders.py"], "0123456", None)


def test_the_commit_up_to_which_all_was_tried_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "survivors.toml"
    path.write_text('# Why.\nmeasured = "abc"\n\n["delfim/gate.py"]\n"f | return" = "the same"\n')
    assert (measured(path), reasons(path)) == ("abc", {"delfim/gate.py": {"f | return": "the same"}})
    measured_now("def", path)
    assert path.read_text() == '# Why.\nmeasured = "def"\n\n["delfim/gate.py"]\n"f | return" = "the same"\n'


def test_the_commit_up_to_which_all_was_tried_is_one_of_this_history() -> None:
    git = ["git", "-C", str(ROOT), "merge-base", "--is-ancestor", measured(), "HEAD"]
    assert subprocess.run(git, check=False).returncode == 0, "a rebase renamed it: write that into tests/survivors.toml"


def row(**calls: list[str]) -> dict[str, Any]:
    """A test that takes so long, by what it calls of one file."""
    return {"calls": {"delfim/vehicle/propulsion/gate.py": calls["calls"]}, "cpu_s": float(calls["cpu_s"][0])}


def test_the_files_own_tests_are_asked_first_and_within_a_time(tmp_path: Path) -> None:
    own, other = tmp_path / "test_own.py", tmp_path / "test_other.py"
    own.write_text("from delfim.vehicle.propulsion.gate import limited\n")
    other.write_text("import delfim\n")
    known = {
        str(other): {"imported": {}, "tests": {f"{other}::quick": row(calls=["limited"], cpu_s=["0.1"])}},
        str(own): {
            "imported": {"delfim/vehicle/propulsion/gate.py": ["table"]},
            "tests": {
                f"{own}::long": row(calls=["limited"], cpu_s=["2"]),
                f"{own}::short": row(calls=["limited", "_turned"], cpu_s=["1"]),
            },
        },
    }
    choice = Choice("delfim/vehicle/propulsion/gate.py", known, 3.2)
    assert choice.tests(frozenset({"limited"})) == [f"{own}::short", f"{own}::long", f"{other}::quick"]
    assert choice.fresh(frozenset({"limited"})) == [f"{own}::short"], "each file has to be imported, too"
    assert choice.tests(frozenset({"_turned"})) == [f"{own}::short"]
    assert choice.tests(frozenset({"table"})) == [f"{own}::short", f"{own}::long"], "what is called when they are imported"
    choice.noticed(frozenset({"limited"}), f"{other}::quick")
    assert choice.tests(frozenset({"limited"}))[0] == f"{other}::quick"
    gate = Choice("delfim/vehicle/propulsion/gate.py", known, 0.5)
    assert gate.tests(frozenset({"limited"})) == [f"{own}::short"], "never none"


class Played:
    """A worker in whose surroundings some tests fail, the one of them without any change."""

    def __init__(self, file: str) -> None:
        self.fails, self.asked = {f"{file}::waits", f"{file}::limits"}, list[object]()

    def ask(self, number: int | None, tests: list[str], fresh: list[str], cpu_s: float) -> dict[str, str]:
        self.asked.append(number)
        by = next((each for each in tests if each in self.fails and (number == 7 or each.endswith("waits"))), "")
        return {"result": "noticed" if by else "survived", "by": by}


def test_what_fails_without_a_change_has_not_noticed_it(tmp_path: Path) -> None:
    file, calls = tmp_path / "test_programs.py", row(calls=["limited"], cpu_s=["0.1"])
    known = {str(file): {"imported": {}, "tests": {f"{file}::{name}": calls for name in ("passes", "waits", "limits")}}}
    for text, asked, by in (("import subprocess", [7, None, 7, None], "limits"), ("", [7], "limits")):
        file.write_text(text)
        choice = Choice("delfim/vehicle/propulsion/gate.py", known, 3.0)
        worker, asks = Played(str(file)), frozenset({"limited"})
        choice.noticed(asks, f"{file}::waits" if text else f"{file}::limits")
        tests, answer = answered(worker, 7, asks, choice)  # type: ignore[arg-type]
        assert (answer["by"], worker.asked) == (f"{file}::{by}", asked)
        assert (f"{file}::waits" in tests) == (not text)


def test_tests_are_watched_again_where_they_changed_or_were_not_asked_about_a_file(tmp_path, monkeypatch):
    asked = list[dict[str, Any]]()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(choice, "TESTS", ("test_*.py",))
    monkeypatch.setattr(choice, "REACH", tmp_path / "reach.jsonl")
    monkeypatch.setattr(choice, "alone", tuple)
    monkeypatch.setattr(choice.subprocess, "run", lambda *_, **how: asked.append(json.loads(how["input"])))
    for name, files in (("test_a.py", ["gate.py", "kills.py"]), ("test_b.py", ["gate.py"]), ("test_c.py", ["gate.py"])):
        (tmp_path / name).write_text("new")
        row = {"file": name, "digest": "old" if name == "test_c.py" else reach.digest(tmp_path / name), "files": files}
        with (tmp_path / "reach.jsonl").open("a") as log:
            log.write(f"{json.dumps(row | {'tests': {}, 'imported': {}})}\n")
    for files, stale in ((["gate.py"], ["test_c.py"]), (["gate.py", "kills.py"], ["test_b.py", "test_c.py"])):
        choice.refreshed(frozenset(files))
        assert asked.pop() == {"output": str(tmp_path / "reach.jsonl"), "tests": stale, "files": files}
    program = [sys.executable, "-c", "input()"]
    monkeypatch.setattr(choice.subprocess, "run", lambda _, **how: subprocess_run(program, timeout=how["timeout"]))
    with pytest.raises(TimeIsOver):
        choice.refreshed(frozenset(["gate.py"]), until_s=0.0)
    for name in ("test_b.py", "test_c.py"):
        (tmp_path / name).write_text("import subprocess")
    assert [*choice.refreshed(frozenset(["gate.py"]), until_s=0.0)] == ["test_a.py"], "nobody waits for programs"


def test_tests_are_about_a_file_that_they_import_or_that_a_table_gives_them() -> None:
    assert {*ABOUT} <= {*CORE}
    for file, tests in ABOUT.items():
        for name in tests:
            assert not choice._is_about("", (ROOT / name).read_text(), file), f"{name} imports {file}: it needs no row"
            assert choice._is_about(name, "", file)


def test_in_a_hurry_only_the_files_own_tests_are_asked_and_what_is_left_open_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ledger, "FOLDER", tmp_path)
    (tmp_path / "a.py").write_text("def f(x):\n    return x + 1\n")
    (tmp_path / "b.py").write_text("def g(x):\n    return x\n")
    monkeypatch.setattr(command, "reasons", lambda: {"a.py": {"f | return x + 1 | 1 → 2": "why"}})
    monkeypatch.setattr(
        command,
        "refreshed",
        lambda watched, file, until_s: {"test_a.py": {"imported": {}, "tests": {}}} if file == "a.py" else {},
    )

    def tried(file: str, found: Any, numbers: list[int], asked: Choice, book: Ledger, jobs: int, until_s: float) -> None:
        assert (file, numbers, jobs) == ("a.py", [0, 1, 2], 2)
        for number, result in enumerate(("noticed", "survived", "survived")):
            book.write(found[number], [], {"result": result, "by": "it ends"})
        raise TimeIsOver("the time is over")

    (tmp_path / "test_a.py").write_text("import a\n")
    monkeypatch.setattr(command, "tried", tried)
    command.hurried({"a.py": [0, 1, 2], "b.py": [0], "c.py": []}, 2, 5.0, 0.0)
    assert capsys.readouterr().out.splitlines() == [
        "the time is over",
        "a.py:2: no test about its file notices 'f | return x + 1 | + → -'",
        "b.py:2: there was no time, or no test about its file, for 'g | return x | return None'",
        "of 4 new changes 1 are noticed, 1 cannot be, 2 are left open",
        "all tests are asked by: make mutants ARGS=--new",
    ]


def test_what_was_tried_is_known_until_the_file_or_its_tests_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger, "FOLDER", tmp_path)
    tests = [f"{tmp_path / name}::test" for name in ("test_a.py", "test_b.py")]
    for name in ("test_a.py", "test_b.py"):
        (tmp_path / name).write_text("old")
    source = "x = 1\ny = 2\n"
    noticed, survivor = changes(source)[1]
    book = Ledger("delfim/x.py", source)
    book.write(noticed, tests, {"result": "noticed", "by": tests[0]})
    book.write(survivor, tests, {"result": "survived", "by": ""})
    again = Ledger("delfim/x.py", source)
    assert [again.knows(change, tests) for change in (noticed, survivor)] == [True, True]
    assert [again.survived(change) for change in (noticed, survivor)] == [False, True]
    (tmp_path / "test_b.py").write_text("new")
    assert [again.knows(change, tests) for change in (noticed, survivor)] == [True, False], "it may be noticed now"
    (tmp_path / "test_a.py").write_text("new")
    assert not again.knows(noticed, tests)
    (tmp_path / "test_a.py").unlink()
    assert not again.knows(noticed, tests), "who noticed it is not there any more"
    assert not Ledger("delfim/x.py", f"{source}z = 3\n").knows(noticed, tests)


def test_the_table_does_not_count_what_cannot_be_noticed() -> None:
    lines = shown([Figures("a.py", 10, 10, 2, 1), Figures("b.py", 5, 0, 0, 0)]).splitlines()
    assert lines[2:] == [
        "| `a.py` | 10 | 10 | 8 | 1 | 88.9 % |",
        "| `b.py` | 5 | 0 | 0 | 0 | – |",
        "| `all` | 15 | 10 | 8 | 1 | 88.9 % |",
    ]


PROGRAM = (
    "LIMIT = 3\n\n\ndef limited(x):\n    if x > LIMIT:\n        return LIMIT\n    return x\n\n\ndef table():\n    return 5\n"
)
TESTS = """from sample import LIMIT, limited, table

FIVE = table()


def test_limit():
    assert LIMIT == 3
    assert limited(4) == 3


def test_table():
    assert FIVE == 5
"""


def test_changes_are_tried_in_functions_that_are_there_and_by_importing_them_again(tmp_path: Path) -> None:
    (tmp_path / "sample.py").write_text(PROGRAM)
    (tmp_path / "test_sample.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = long\n")
    tests, found = ["test_sample.py::test_limit", "test_sample.py::test_table"], changes(PROGRAM)[1]
    (tmp_path / "test_other.py").write_text("raise ValueError")
    questions = [{"number": number, "tests": tests, "fresh": tests, "cpu_s": 9.0} for number in (None, *range(len(found)))]
    questions += [{"number": number, "tests": [], "fresh": [], "cpu_s": 9.0} for number in (0, 2)]
    command = [sys.executable, "-m", "bench.mutants.trial", "sample.py", "test_sample.py"]
    environment = dict(os.environ, PYTHONPATH=f"{tmp_path}:{ROOT}")
    asked = "".join(f"{json.dumps(question)}\n" for question in questions)
    answers = subprocess.run(command, cwd=tmp_path, env=environment, input=asked, capture_output=True, text=True, check=True)
    first, *others = map(json.loads, answers.stdout.splitlines())
    assert [each["result"] for each in (first, *others[-2:])] == ["survived"] * 3, "whom no test asks survives"
    assert {change.name: answer["by"].rpartition("::")[2] for change, answer in zip(found, others[:-2], strict=True)} == {
        "<module> | LIMIT = 3 | 3 → 4": "test_limit",
        "limited | if x > LIMIT: | > → >=": "",
        "limited | if x > LIMIT: | > → <=": "test_limit",
        "limited | return LIMIT | return None": "test_limit",
        "limited | return x | return None": "",
        "table | return 5 | return None": "test_table",
        "table | return 5 | 5 → 6": "test_table",
    }
    assert (tmp_path / "sample.py").read_text() == PROGRAM


def test_nobody_waits_for_an_answer_longer_than_there_is_time(tmp_path: Path) -> None:
    for name in ("bench", "delfim"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "sample.py").write_text(PROGRAM)
    (tmp_path / "test_sample.py").write_text(TESTS)
    with Worker(tmp_path, "sample.py", ["test_sample.py"], until_s=0.0) as worker, pytest.raises(TimeIsOver):
        worker.ask(None, [], [], 9.0)


def test_tests_that_hide_the_functions_of_a_file_are_refused(tmp_path: Path) -> None:
    for name in ("bench", "delfim"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "sample.py").write_text(PROGRAM)
    (tmp_path / "test_sample.py").write_text(f"{TESTS}\nimport gc\ngc.freeze()\n")
    with (
        Worker(tmp_path, "sample.py", ["test_sample.py"]) as worker,
        pytest.raises(RuntimeError, match=r"none of the functions of .*/sample\.py were found, though it is imported"),
    ):
        worker.ask(None, [], [], 9.0)


def test_calls_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "seen.py"
    path.write_text('def f():\n    """Words."""\n    return f.__doc__\n')
    loader = reach.Loader("seen", str(path))
    loader.file = "delfim/seen.py"
    names: dict[str, Any] = {}
    monkeypatch.setattr(reach, "SEEN", seen := set[tuple[str, str]]())
    exec(loader.get_code("seen"), names)
    assert (names["f"](), seen) == ("Words.", {("delfim/seen.py", "f")})
