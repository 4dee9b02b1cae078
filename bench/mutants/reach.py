"""Which test calls which functions of the safety core, and how long it takes: a file of tests is run once, watched.

    echo '{"output": FILE, "tests": [FILE.py ...], "files": [FILE.py ...]}' | python -m bench.mutants.reach

A function is known by its name, so that the map stays true when lines move. While it is made, each function of the core begins
with a line that writes its name down. What runs while a file is imported is not a call of a test, and a program that a test
starts is not seen.
"""

import ast
import hashlib
import importlib.machinery
import importlib.util
import json
import os
import sys
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from types import CodeType
from typing import Any, Final

import pytest

from bench.mutants.changes import functions

OPTIONS: Final = ("-q", "-p", "no:cacheprovider", "-m", "not long", "--no-header", "-o", "addopts=--import-mode=importlib")
SEEN: Final = set[tuple[str, str]]()  # file and function, since the last test began


def digest(path: Path) -> str:
    """Of a file as it is; empty where there is none any more."""
    return "" if not path.exists() else hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def module(file: str) -> str:
    """The name by which a file of the checkout is imported."""
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


class Loader(importlib.machinery.SourceFileLoader):
    """Loads a file whose functions write down that they are called."""

    file = ""

    def get_code(self, fullname: str) -> CodeType:
        tree = ast.parse(Path(self.path).read_text())
        for name, function in functions(tree):
            said = ast.parse(f"__import__('{__name__}', fromlist=['SEEN']).SEEN.add(({self.file!r}, {name!r}))").body
            function.body[1 if ast.get_docstring(function) else 0 : 0] = said
        return compile(ast.fix_missing_locations(tree), self.path, "exec")


class Finder:
    """Finds the files of the core for Python before its own finders do."""

    def __init__(self, files: Sequence[str]) -> None:
        self._files = {module(file): file for file in files}

    def find_spec(self, name: str, path: object, target: object = None) -> importlib.machinery.ModuleSpec | None:
        file = self._files.get(name)
        if file is None:
            return None
        loader = Loader(name, str(Path(file).resolve()))
        loader.file = file
        return importlib.util.spec_from_file_location(name, loader.path, loader=loader)


class Map:
    """A plugin of pytest that writes down what each test that passed has called."""

    def __init__(self) -> None:
        self._failed = set[str]()
        self.imported = dict[str, list[str]]()  # what is called while the file of tests is imported, its tables perhaps
        self.tests = dict[str, dict[str, Any]]()

    def pytest_collection_finish(self) -> None:
        self.imported = _called()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        began_s = time.process_time()
        SEEN.clear()
        answer = yield
        if item.nodeid not in self._failed:
            self.tests[item.nodeid] = {"cpu_s": round(time.process_time() - began_s, 4), "calls": _called()}
        return answer

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self._failed.add(report.nodeid)


def _called() -> dict[str, list[str]]:
    """File: functions, since they were forgotten last."""
    calls = dict[str, list[str]]()
    for file, function in sorted(SEEN):
        calls.setdefault(file, []).append(function)
    return calls


def main(output: str, tests: list[str], files: list[str]) -> int:
    """Runs each file of tests in a process of its own: what one leaves behind is not another's."""
    sys.meta_path.insert(0, Finder(files))
    for name in tests:
        child = os.fork()
        if child == 0:
            plugin = Map()
            pytest.main([*OPTIONS, name], plugins=[plugin])
            row: dict[str, object] = {"file": name, "digest": digest(Path(name)), "files": files}
            row |= {"imported": plugin.imported, "tests": plugin.tests}
            with open(output, "a") as log:
                log.write(json.dumps(row) + "\n")
            os._exit(0)
        os.waitpid(child, 0)
    return 0


if __name__ == "__main__":
    from bench.mutants import reach  # the one that the functions of the core know

    sys.exit(reach.main(**json.load(sys.stdin)))
