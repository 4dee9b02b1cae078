"""Copies of the checkout, and the programs that try changes in them, each in a network and among processes of its own."""

import json
import os
import select
import shutil
import subprocess
import sys
import time
from functools import cache
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Final, Self

FOLDER: Final = Path("run/mutants")
ALONE: Final = ("unshare", "--pid", "--fork", "--kill-child", "--mount-proc", "--net")


def copied(index: int) -> Path:
    """A copy of all files of the checkout, as they are now."""
    folder = (FOLDER / f"tree-{index}").resolve()
    listing = subprocess.run(["git", "ls-files", "-coz", "--exclude-standard"], capture_output=True, check=True).stdout.decode()
    for name in filter(None, listing.split("\0")):
        source, target = Path(name), folder / name
        if source.is_symlink() and not target.is_symlink():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.symlink_to(source.readlink())
        elif not source.is_symlink() and source.is_file() and not _is_same(source, target):
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
    return folder


def _is_same(source: Path, target: Path) -> bool:
    if not target.exists():
        return False
    ours, theirs = source.stat(), target.stat()
    return (ours.st_size, ours.st_mtime_ns) == (theirs.st_size, theirs.st_mtime_ns)


@cache
def alone() -> tuple[str, ...]:
    """What gives a program its own processes and network: a changed supervisor ends nobody else. Nothing, if not permitted."""
    permitted = subprocess.run([*ALONE, "true"], capture_output=True).returncode == 0
    return (*ALONE, "sh", "-c", 'ip link set lo up; exec "$@"', "sh") if permitted else ()


class TimeIsOver(Exception):
    """Nobody waits longer for an answer."""


class Worker:
    """A program that tries changes of one file (trial.py). It ends at `until_s`, a monotonic time."""

    def __init__(self, folder: Path, file: str, tests: list[str], until_s: float = inf) -> None:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment |= {"PYTHONPATH": str(folder), "PYTHONSAFEPATH": "1"}
        command = [*alone(), sys.executable, "-m", "bench.mutants.trial", file, *tests]
        self._until_s, pipe = until_s, subprocess.PIPE
        self._program = subprocess.Popen(
            command, cwd=folder, env=environment, stdin=pipe, stdout=pipe, text=True, start_new_session=True
        )

    def ask(self, number: int | None, tests: list[str], fresh: list[str], cpu_s: float) -> dict[str, str]:
        """Tries one change, or, without a number, that the tests pass as the file is. Raises TimeIsOver; RuntimeError where
        nothing can be tried."""
        assert self._program.stdin is not None
        assert self._program.stdout is not None
        print(
            json.dumps({"number": number, "tests": tests, "fresh": fresh, "cpu_s": cpu_s}), file=self._program.stdin, flush=True
        )
        left_s = None if self._until_s == inf else max(self._until_s - time.monotonic(), 0.0)
        if not select.select([self._program.stdout], [], [], left_s)[0]:
            raise TimeIsOver("the time is over")
        answer: dict[str, str] = json.loads(self._program.stdout.readline())
        if "refused" in answer:
            raise RuntimeError(answer["refused"])
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._program:  # waits, and closes its pipes
            self._program.kill()
