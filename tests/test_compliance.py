"""The page of what rules ask for: its records name tests that exist, and it is what they say."""

import re
from collections import Counter
from pathlib import Path

import pytest

from compliance import records
from compliance.records import PAGE, holes, page, read, results

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_each_test_that_is_named_exists_and_what_is_shown_has_one() -> None:
    assert holes(read()) == []


def test_the_page_is_what_the_records_and_the_last_results_say() -> None:
    assert PAGE.read_text() == page(read(), results()), "make compliance, or python -m compliance --page"


def test_what_was_run_passed() -> None:
    """What was not run says so on the page."""
    outcomes = results()
    assert outcomes.keys() == set(records.tests(read()))
    assert {test: came for test, came in outcomes.items() if came not in ("passed", "not run")} == {}


def test_of_41_capabilities_at_least_35_are_shown_or_reasoned_away() -> None:
    count = Counter(clause.met for clause in read()["e27"].clauses)
    assert count.total() == 41
    assert count["shown"] + count["reasoned"] >= 35


def test_no_clause_has_a_number_that_nobody_has_read() -> None:
    numbered = [
        clause.asks for rule in read().values() for clause in rule.clauses if re.search(r"\b\d+\.\d+\.\d+\b|§", clause.asks)
    ]
    assert numbered == []


def test_there_is_a_contact_with_times() -> None:
    text = (ROOT / "SECURITY.md").read_text()
    assert "Report a vulnerability" in text
    assert re.findall(r"^\| (\d+) days \|", text, re.MULTILINE) == ["3", "14", "90"]


def test_the_safety_case_is_there() -> None:
    assert "unsafe actions of" in (ROOT / "docs/safety-case.md").read_text()
