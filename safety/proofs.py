"""The proofs: that a test fails when its code is changed was seen once, of sources that are known by their hashes.

A proof is of a function as it stands, and of a test with all of its file that it uses. When either is another one, the proof is
stale, and `make safety` tries the change again. What a test uses of other files is not looked at: `make safety ARGS=--all`.
"""

import ast
import hashlib
import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from bench.mutants.changes import Change, changes, functions
from bench.mutants.reach import OPTIONS
from bench.mutants.workers import Worker, copied
from safety.case import Link

PROOFS: Final = Path("safety/proofs.json")
CPU_S: Final = 20.0  # of a processor, for one test
TREE: Final = 90  # the number of the copy of the checkout: `make mutants` may run beside this, in others
Proofs = dict[str, str]  # link: hash of the sources


class Source(NamedTuple):
    """A file of Python."""

    lines: list[str]
    tree: ast.Module

    def text(self, node: ast.stmt) -> str:
        first = min([node.lineno, *(each.lineno for each in getattr(node, "decorator_list", []))])
        return "\n".join(self.lines[first - 1 : node.end_lineno])


@cache
def source(file: str) -> Source:
    """Raises FileNotFoundError."""
    text = Path(file).read_text()
    return Source(text.splitlines(), ast.parse(text))


@cache
def changes_of(file: str) -> list[Change]:
    """All changes of a file, in the order of `make mutants`."""
    return changes(Path(file).read_text())[1]


def key(link: Link) -> str:
    return f"{link.code} | {link.change} | {link.test}"


def missing(link: Link) -> str:
    """What of a link is not there, in words; empty: it is all there."""
    test, _, function = link.test.partition("::")
    absent = next((file for file in (link.code, test) if not Path(file).is_file()), "")
    if absent:
        return f"there is no file {absent}"
    if not any(name == link.function for name, _ in functions(source(link.code).tree)):
        return f"{link.code} has no function {link.function}"
    if link.change not in (each.name for each in changes_of(link.code)):
        return f"{link.code} has no change '{link.change}'"
    if not function.startswith("test_") or function not in _named(source(test).tree):
        return f"{test} has no test {function or '(none is named)'}"
    return ""


def digest(link: Link) -> str:
    """Of the function and the test, for a link that is there."""
    code, (file, _, function) = source(link.code), link.test.partition("::")
    texts = [code.text(node) for name, node in functions(code.tree) if name == link.function]
    return hashlib.sha256("\n".join([*texts, *_used(source(file), function)]).encode()).hexdigest()[:16]


def _named(tree: ast.Module) -> dict[str, list[ast.stmt]]:
    """The statements of a file that give a name something, by this name."""
    found = defaultdict[str, list[ast.stmt]](list)
    for statement in tree.body:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found[statement.name].append(statement)
        elif not isinstance(statement, ast.Import | ast.ImportFrom):
            for each in ast.walk(statement):
                if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
                    found[each.id].append(statement)
    return found


def _used(of: Source, function: str) -> Iterator[str]:
    """The texts of a test and of all that it uses of its own file, fixtures and tables included."""
    named, ahead, seen = _named(of.tree), [function], set[str]()
    while ahead:
        name = ahead.pop()
        if name in seen or name not in named:
            continue
        seen.add(name)
        for statement in named[name]:
            yield of.text(statement)
            used = {each.id for each in ast.walk(statement) if isinstance(each, ast.Name)}
            used |= {each.arg for each in ast.walk(statement) if isinstance(each, ast.arg)}
            ahead += sorted(used)


def kept() -> Proofs:
    """None of a file that cannot be read."""
    try:
        found: Proofs = json.loads(PROOFS.read_text())
    except (OSError, ValueError) as error:
        print(f"{PROOFS}: {error}: after a merge take one of both sides, and make safety")
        return {}
    return found


def keep(proofs: Proofs) -> None:
    PROOFS.write_text(json.dumps(proofs, indent=0, sort_keys=True, ensure_ascii=False) + "\n")


def unproven(links: list[Link], proofs: Proofs) -> list[Link]:
    """Those whose sources are not the ones of their proof, or that have none."""
    return [link for link in links if proofs.get(key(link)) != digest(link)]


def prove(links: list[Link]) -> Iterator[tuple[Link, str]]:
    """Tries each change with its test alone. What speaks against the link, in words; empty: it is proven."""
    by_file = defaultdict[str, list[Link]](list)
    if not links:
        return
    for link in links:
        by_file[link.code].append(link)
    folder = copied(TREE)
    items = _items(folder, sorted({link.test.partition("::")[0] for link in links}))
    for file, wanted in by_file.items():
        numbers = {each.name: number for number, each in enumerate(changes_of(file))}
        with Worker(folder, file, sorted({link.test.partition("::")[0] for link in wanted})) as worker:
            for link in wanted:
                tests = [each for each in items if each.partition("[")[0] == link.test]
                before = worker.ask(None, tests, tests, CPU_S)
                if before["by"] or not tests:
                    yield link, f"without any change {before['by'] or 'pytest finds no such test'} fails"
                    continue
                by = worker.ask(numbers[link.change], tests, tests, CPU_S)["by"]
                yield link, "" if by in tests else f"the test does not notice the change{f': {by}' if by else ''}"


def _items(folder: Path, files: list[str]) -> list[str]:
    """The names of all tests in these files, with their parameters."""
    command = [sys.executable, "-m", "pytest", "--collect-only", *OPTIONS, *files]
    told = subprocess.run(command, cwd=folder, capture_output=True, text=True).stdout
    return [line for line in told.splitlines() if "::" in line]
