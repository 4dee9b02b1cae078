"""What seeds notice: which changes are drawn, what is kept of them, and the table."""

from bench.mutants import power
from bench.mutants.changes import changes
from bench.mutants.power import Ledger, Told, drawn, shown

SOURCE = "def far(a, b):\n    return a + b < 10 and not a or b > 3\n"


def test_more_changes_are_these_and_others():
    _, found = changes(SOURCE)
    few, more = drawn(found, 3, 1, "a.py"), drawn(found, 5, 1, "a.py")
    assert len(few) == 3
    assert set(few) < set(more)
    assert drawn(found, 1000, 1, "a.py") == list(range(len(found)))


def test_the_ledger_knows_a_change_of_the_same_program_and_of_another_one_the_seed_that_told_it(tmp_path, monkeypatch):
    monkeypatch.setattr(power, "LEDGER", tmp_path / "power.jsonl")
    Ledger("now").write("a.py", "a change", Told(7, "adrift", 3))
    assert Ledger("now").known("a.py", "a change") == Told(7, "adrift", 3)
    later = Ledger("later")
    assert later.known("a.py", "a change") is None
    assert later.order("a.py", "a change", range(10))[0] == 7
    assert sorted(later.order("a.py", "another", range(10))) == list(range(10))


def test_the_table_names_what_altered_a_run_and_was_not_told():
    _, found = changes(SOURCE)
    table = shown(
        [("a.py", found[0], Told(1, "adrift", 1)), ("a.py", found[1], Told(-1, "", 4)), ("b.py", found[2], Told(-1, "", -1))]
    )
    assert "| `a.py` | 2 | 1 | 1 | 0 | 50 % |" in table
    assert "| `b.py` | 1 | 0 | 0 | 1 | – |" in table
    assert table.endswith(f"\n\na.py:2: {found[1].name}")
