"""Which tests are asked about a change: those that call its function, the file's own ones first, short before long."""

import json
import re
import subprocess
import sys
import time
from collections import defaultdict
from functools import cache
from math import inf
from pathlib import Path
from typing import Any, Final

from bench.mutants.changes import MODULE
from bench.mutants.core import ABOUT, NOT_ASKED, TESTS
from bench.mutants.reach import digest
from bench.mutants.workers import TimeIsOver, alone

REACH: Final = Path("run/mutants/reach.jsonl")
FILE_S: Final = 0.5  # to import one more file of tests
STARTS: Final = re.compile(r"\b(subprocess|Popen)\b")  # programs, in which calls are not seen

Reach = dict[str, dict[str, Any]]  # file of tests: what is called when it is imported, and each test's time and what it calls


@cache
def refreshed(watched: frozenset[str], about: str = "", until_s: float = inf) -> Reach:
    """The map of all tests, or of those that import a file, after those that are new, have changed, or were not asked about
    the watched files have been run once. Raises TimeIsOver where that lasts beyond a monotonic time; tests that start programs,
    for which they wait, are left out then."""
    files = [str(path) for words in TESTS for path in sorted(Path().glob(words)) if path.name not in NOT_ASKED]
    texts = {name: Path(name).read_text() for name in files}
    files = [name for name, text in texts.items() if not about or _is_about(name, text, about)]
    if until_s < inf:
        files = [name for name in files if not STARTS.search(texts[name])]
    known = {file: row for file, row in _known().items() if watched <= set(row.get("files", ()))}
    stale = [file for file in files if file not in known or known[file]["digest"] != digest(Path(file))]
    if stale:
        print(f"watching {len(stale)} files of tests once: {REACH}", flush=True)
        REACH.parent.mkdir(parents=True, exist_ok=True)
        told = json.dumps({"output": str(REACH), "tests": stale, "files": sorted(watched)})
        command, quiet = [*alone(), sys.executable, "-m", "bench.mutants.reach"], subprocess.DEVNULL
        left_s = None if until_s == inf else max(until_s - time.monotonic(), 0.0)
        try:
            subprocess.run(command, input=told, text=True, check=True, stdout=quiet, timeout=left_s)
        except subprocess.TimeoutExpired:
            raise TimeIsOver("the time is over") from None
        known = _known()
    return {file: known[file] for file in files if file in known}


def _known() -> dict[str, Any]:
    """The newest line of each file."""
    return {row["file"]: row for row in map(json.loads, REACH.read_text().splitlines())} if REACH.exists() else {}


class Choice:
    """The tests for the changes of one file, within a time."""

    def __init__(self, file: str, reach: Reach, cpu_s: float) -> None:
        self._cpu_s, self._times_s = cpu_s, dict[str, float]()
        for row in reach.values():
            self._times_s |= {test: each["cpu_s"] for test, each in row["tests"].items()}
        texts = {name: Path(name).read_text() for name in reach}
        own = {name for name, text in texts.items() if _is_about(name, text, file)}
        self._starting = {name for name, text in texts.items() if STARTS.search(text)}
        self._calls, blind = defaultdict[str, list[str]](list), list[str]()
        for name, row in reach.items():
            imported = row["imported"].get(file, []) if name in own else []
            for test, each in row["tests"].items():
                functions = [*each["calls"].get(file, []), *imported]
                for function in {*functions, MODULE} if functions else ():
                    self._calls[function].append(test)
                if not functions and name in own & self._starting:
                    blind.append(test)
        self._order = {test: (_file(test) not in own, self._times_s[test], test) for test in self._times_s}
        self._blind = sorted(blind, key=self._order.__getitem__)
        self._hints = dict[frozenset[str], str]()

    def tests(self, functions: frozenset[str]) -> list[str]:
        """Those that call one of them, the likeliest first, as many as there is time for."""
        return self._within(functions, 0.0)

    def fresh(self, functions: frozenset[str]) -> list[str]:
        """The same where each file has to be imported again."""
        return self._within(functions, FILE_S)

    def _within(self, functions: frozenset[str], file_s: float) -> list[str]:
        chosen, files, left_s = list[str](), set[str](), self._cpu_s
        callers = {test for function in functions for test in self._calls[function]}
        for test in (*sorted(callers, key=self._order.__getitem__), *self._blind):
            left_s -= self._times_s[test] + (0.0 if _file(test) in files else file_s)
            if left_s < 0.0 and chosen:
                break
            chosen.append(test)
            files.add(_file(test))
        hint = self._hints.get(functions)
        return chosen if hint not in chosen else [hint, *(test for test in chosen if test != hint)]

    def files(self, asked: set[frozenset[str]]) -> list[str]:
        return sorted({_file(test) for functions in asked for test in self.tests(functions)})

    def cpu_s(self, tests: list[str]) -> float:
        """What they may take: a change that makes them much slower is noticed."""
        return 5.0 + 3.0 * sum(self._times_s[test] for test in tests)

    def noticed(self, functions: frozenset[str], by: str) -> None:
        """Who noticed a change of a function is likely to notice the next one."""
        if by in self._times_s:
            self._hints[functions] = by

    def starts(self, test: str) -> bool:
        """Whether it may start programs, for which it waits in real time."""
        return _file(test) in self._starting

    def drop(self, test: str) -> None:
        """It is asked no more."""
        for functions, tests in self._calls.items():
            self._calls[functions] = [each for each in tests if each != test]
        self._blind = [each for each in self._blind if each != test]


def _file(test: str) -> str:
    return test.partition("::")[0]


def _is_about(name: str, text: str, file: str) -> bool:
    """Whether a file of tests imports this file, or has its tests."""
    if name in ABOUT.get(file, ()):
        return True
    dotted = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    parent, _, stem = dotted.rpartition(".")
    return re.search(rf"\b{dotted}\b(?!\.)|from {parent} import [^#\n]*\b{stem}\b", text) is not None
