"""Tries changes of one file in a copy of the checkout; `python -m bench.mutants.trial` asks it, one line of JSON each way.

pytest and the tests are imported once. A change of a function is put into the functions that are there already, in a fork; a
change of what ran while the files were imported is written into the copy's file and imported by another fork, which has none of
the boat's files yet. The changed file stands in the copy both times: programs that a test starts see it, too.
"""

import ast
import contextlib
import gc
import importlib
import json
import os
import resource
import select
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final, TextIO

import pytest

from bench.mutants.changes import MODULE, changed, changes
from bench.mutants.reach import OPTIONS, SEEN, Finder

LATE_S: Final = 120.0  # of waiting, for a test that waits for what does not come
IMPORT_S: Final = 20.0  # of a processor, for all of the boat
BYTES_MAX: Final = 4 << 30  # of a test's memory
PRELOADED: Final = "-W", "ignore::pytest.PytestAssertRewriteWarning"  # hypothesis and the like are imported before pytest looks
UNIQUE_S: Final = 1_000_000_000  # a time of change for each change: compiled files are known by it


Codes = dict[tuple[str, int], CodeType]


class Listener:
    """A plugin that ends the tests at the first failure, and knows which it was."""

    by = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.by:
            self.by = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.by:
            self.by = f"{report.nodeid}, imported"


class Some(Listener):
    """The same for these tests alone. pytest is told their files: where a change gives a test another name, it complains."""

    def __init__(self, tests: list[str]) -> None:
        self._tests = {test: at for at, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((item for item in items if item.nodeid in self._tests), key=lambda item: self._tests[item.nodeid])


class Server(Listener):
    """A plugin that, with everything imported, answers questions instead of running the tests.

    What is called while everything is imported may stand in some table: its change needs a fresh import.
    """

    def __init__(self, target: Path, questions: TextIO, answers: TextIO) -> None:
        self._target, self._questions, self._answers = target, questions, answers
        sys.meta_path.insert(0, Finder([str(target)]))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        called = {function for _, function in SEEN}
        items, path, source = (
            {item.nodeid: item for item in session.items},
            str(self._target.resolve()),
            self._target.read_text(),
        )
        functions = [each for each in gc.get_objects() if isinstance(each, FunctionType) and each.__code__.co_filename == path]
        if refused := _none_found(functions, _codes(ast.parse(source), path), path):
            _say(self._answers, {"refused": refused})
            return True
        _put(functions, _codes(ast.parse(source), path))  # they need not say any more that they are called
        _say(self._answers, {"modules": _from_elsewhere()})
        gc.collect()
        gc.freeze()
        for question in map(json.loads, self._questions):
            number = question["number"]
            function = "" if number is None else changes(source)[1][number].function
            if function in called or function == MODULE:
                _say(self._answers, {"result": "fresh"})
                continue
            codes = {} if number is None else _codes(changed(source, number), path)
            chosen = [items[test] for test in question["tests"] if test in items]
            _say(self._answers, _forked(partial(self._run, chosen, functions, codes), question["cpu_s"]))
        return True

    def _run(self, items: list[pytest.Item], functions: list[FunctionType], codes: Codes) -> str:
        """Runs tests until one fails; which it was."""
        _put(functions, codes)
        for item, after in zip(items, [*items[1:], None], strict=False):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.by:
                break
        return self.by


def _from_elsewhere() -> list[str]:
    """What was imported, and is no file of the checkout: it is the same after a change."""
    here, modules = f"{Path.cwd()}/", list(sys.modules.items())
    files = {name: getattr(module, "__file__", None) or "" for name, module in modules}
    return [name for name, file in files.items() if not file.startswith(here) and name != "__main__"]


def _none_found(functions: list[FunctionType], codes: Codes, path: str) -> str:
    """Why no change of this file can be tried: it was imported, and who keeps functions out of sight makes each a survivor."""
    imported = any(getattr(module, "__file__", None) == path for module in list(sys.modules.values()))
    return f"none of the functions of {path} were found, though it is imported" if imported and codes and not functions else ""


def _codes(tree: ast.Module, path: str) -> Codes:
    """The code of all functions of a file, by name and line."""
    return {(code.co_qualname, code.co_firstlineno): code for code in _within(compile(tree, path, "exec"))}


def _put(functions: list[FunctionType], codes: Codes) -> None:
    for function in functions:
        code = codes.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
        if code is not None and code != function.__code__:
            function.__code__ = code


def _within(code: CodeType) -> Iterator[CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _within(part)


def _forked(run: Callable[[], str], cpu_s: float) -> dict[str, str]:
    """What came of tests in a process of its own: it may hang, end, or need more time or memory than there is."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s) + 1, int(cpu_s) + 2))
        resource.setrlimit(resource.RLIMIT_DATA, (BYTES_MAX, BYTES_MAX))
        try:
            by = run()
        except BaseException as error:  # whatever a changed program raises through pytest
            by = f"{type(error).__name__}: {error}"
        os.write(writing, f"={by}".encode())
        os._exit(0)
    os.close(writing)
    pid = os.pidfd_open(child)
    is_over = bool(select.select([pid], [], [], LATE_S + 10.0 * cpu_s)[0])
    os.close(pid)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.set_blocking(reading, False)  # what a test left behind may hold the other end
    said = b""
    with contextlib.suppress(BlockingIOError):
        said = os.read(reading, 65536)
    os.close(reading)
    if not said:
        return {"result": "noticed", "by": "it ends" if is_over else "it hangs"}
    by = said.decode()[1:]
    return {"result": "noticed" if by else "survived", "by": by}


def _fresh(tests: list[str]) -> str:
    """Imports the changed file, and all that imports it, and runs tests until one fails; which it was."""
    if not tests:
        return ""  # pytest would take all that there are
    some, files = Some(tests), sorted({test.partition("::")[0] for test in tests})
    ended = pytest.main([*OPTIONS, *PRELOADED, f"--basetemp={_room()}", "-x", *files], plugins=[some])
    return some.by or ("" if ended in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED) else f"pytest ends with {ended}")


def _room() -> Path:
    return Path.cwd().with_name(f"{Path.cwd().name}-tmp")


def _say(answers: TextIO, what: dict[str, Any]) -> None:
    answers.write(json.dumps(what) + "\n")
    answers.flush()


def _served(target: Path, files: list[str]) -> tuple[TextIO, TextIO]:
    """Starts the server with these files of tests; where it is asked, and where it answers."""
    questions, asking = os.pipe()
    answering, answers = os.pipe()
    if os.fork() == 0:
        os.close(asking)
        os.close(answering)
        server = Server(target, os.fdopen(questions), os.fdopen(answers, "w"))
        pytest.main([*OPTIONS, f"--basetemp={_room()}", *files], plugins=[server])
        os._exit(0)
    os.close(questions)
    os.close(answers)
    return os.fdopen(asking, "w"), os.fdopen(answering)


def main(target: Path, files: list[str]) -> int:
    said, original = os.fdopen(os.dup(1), "w"), target.read_text()
    silence = os.open(os.devnull, os.O_RDWR)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    asking, answering = _served(target, files)
    told = json.loads(answering.readline() or '{"modules": []}')
    if "refused" in told:
        _say(said, told)
        return 1
    for name in told["modules"]:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    gc.freeze()
    for count, line in enumerate(sys.stdin):
        question = json.loads(line)
        number = question["number"]
        _write(target, original if number is None else ast.unparse(changed(original, number)), count)
        _say(asking, question)
        answer = json.loads(answering.readline())
        if answer["result"] == "fresh" or (number is None and answer["result"] == "survived"):
            answer = _forked(partial(_fresh, question["fresh"]), question["cpu_s"] + IMPORT_S)
        _write(target, original, -1)
        _say(said, answer)
    return 0


def _write(target: Path, text: str, count: int) -> None:
    target.write_text(text)
    os.utime(target, (UNIQUE_S + count, UNIQUE_S + count))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
