"""The records, the results of their tests, and the page that is made of both."""

import json
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Literal

import msgspec

RECORDS: Final = Path("compliance/clauses.toml")
RESULTS: Final = Path("compliance/results.json")
PAGE: Final = Path("docs/compliance.md")
Met = Literal["shown", "reasoned", "owner", "not met", "not read"]


class Clause(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    asks: str  # in our words: the text of a rule is not copied
    met: Met
    says: str
    tests: tuple[str, ...] = ()  # file::function, which fail without it


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    name: str
    read: str  # what of it was read
    clauses: tuple[Clause, ...]


def read() -> dict[str, Rule]:
    told = tomllib.loads(RECORDS.read_text(encoding="utf-8"))
    return msgspec.convert(told["rules"], dict[str, Rule])


def tests(rules: dict[str, Rule]) -> list[str]:
    """All tests, each once."""
    return sorted({test for rule in rules.values() for clause in rule.clauses for test in clause.tests})


def results() -> dict[str, str]:
    """By test what came of it when it was run last: passed, failed, or skipped."""
    return dict(json.loads(RESULTS.read_text(encoding="utf-8"))) if RESULTS.exists() else {}


def holes(rules: dict[str, Rule]) -> list[str]:
    """What is wrong with the records, in words."""
    found = [f"{test}: there is no such test" for test in tests(rules) if not _is_there(test)]
    bare = ((rule, each) for rule in rules.values() for each in rule.clauses if each.met == "shown" and not each.tests)
    found += [f"{rule.name}: {each.asks}: shown by no test" for rule, each in bare]
    return found


def _is_there(test: str) -> bool:
    file, _, name = test.partition("::")
    return Path(file).exists() and f"def {name}(" in Path(file).read_text(encoding="utf-8")


def page(rules: dict[str, Rule], outcomes: dict[str, str]) -> str:
    return "\n".join(_lines(rules, outcomes)) + "\n"


def _lines(rules: dict[str, Rule], outcomes: dict[str, str]) -> Iterator[str]:
    yield "# What rules ask for\n"
    yield "What is asked of a boat like this one, clause by clause: our answer, the tests that fail without it, and what"
    yield "came of them when they were run last. It is made of [its records](../compliance/clauses.toml).\n"
    yield "**No authority has signed this, and no lawyer has read it.** What is asked is told in our words, not in the"
    yield "rule's. Where a text was not at hand the page says so, and quotes no clause of it.\n"
    yield "Forms for a boat: `delfim declare FILE`. The tests are run and the page is written by:\n"
    yield "<!-- not run: it runs tests of the whole boat -->\n"
    yield "    make compliance\n"
    yield "| word | meaning |\n|---|---|"
    yield "| shown | tests fail without it |\n| reasoned | in words: it does not arise, or another thing is in its place |"
    yield "| owner | a matter of the boat, its yard or its seller, not of the program |"
    yield "| not met | it is not done |\n| not read | the text was not at hand |\n"
    yield "| rule | shown | reasoned | owner | not met | not read |"
    yield "|---|---:|---:|---:|---:|---:|"
    for rule in rules.values():
        count = Counter(clause.met for clause in rule.clauses)
        each = " | ".join(str(count[met]) for met in ("shown", "reasoned", "owner", "not met", "not read"))
        yield f"| {rule.name} | {each} |"
    for rule in rules.values():
        yield f"\n## {rule.name}\n\n*Read of it:* {rule.read}.\n"
        yield "| asked | | our answer | tests |\n|---|---|---|---|"
        for clause in rule.clauses:
            shown = "<br>".join(_shown(each, outcomes) for each in clause.tests)
            yield f"| {clause.asks} | **{clause.met}** | {clause.says} | {shown} |"


def _shown(test: str, outcomes: dict[str, str]) -> str:
    file, _, name = test.partition("::")
    return f"[`{name.removeprefix('test_')}`](../{file}): {outcomes.get(test, 'not run')}"
