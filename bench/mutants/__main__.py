"""Changes the safety core, one place at a time, and asks its tests: `make mutants` (docs/mutants.md).

    python -m bench.mutants [FILE.py ...] [--since REVISION | --new] [--at-most N] [--within SECONDS] [-j N] [--cpu SECONDS]

Without files, the whole core. With --since only changes that could not be made in that revision. The tests that import the file
are asked first, and all others about what is left. What was tried of the same file by the same tests is not tried again
(run/mutants). It fails at a change that no test notices and that has no reason in
tests/survivors.toml, and at a reason for a change that does not survive any more. With --within only tests that are about a
changed file are asked, so long; it names what is left open, and does not fail at that.
"""

import argparse
import hashlib
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from math import inf
from pathlib import Path
from typing import Final

from bench.mutants.changes import MODULE, Change, changes
from bench.mutants.choice import Choice, refreshed
from bench.mutants.core import CORE
from bench.mutants.ledger import Figures, Ledger, measured, measured_now, reasons, shown
from bench.mutants.workers import TimeIsOver, Worker, copied
from delfim.base.errors import ConfigError

ALL: Final = frozenset({MODULE})
SAMPLE: Final = 9  # tests that have to pass without a change, before any is made
CPU_S: Final = 10.0  # of tests for a change, those that are most likely to notice it first


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], capture_output=True, check=True, text=True).stdout


def known(since: str) -> tuple[set[str], set[str]]:
    """The files that are not as they were in that revision, and the names of all changes that could be made there: a function
    that moved to another file is no new one. Raises ConfigError for a revision that there is not."""
    if subprocess.run(["git", "cat-file", "-e", f"{since}^{{commit}}"], capture_output=True, check=False).returncode:
        raise ConfigError("--since", since, "there is no such commit in this checkout")
    differs, names = ("diff", "--name-only", "--no-renames", since), set[str]()
    for path in _git(*differs, "--diff-filter=MD", "--", "delfim/*.py").splitlines():
        names |= {each.name for each in changes(_git("show", f"{since}:{path}"))[1]}
    return set(_git(*differs, "--diff-filter=AM", "--", "delfim").splitlines()), names


def tried(
    file: str, found: list[Change], numbers: list[int], choice: Choice, ledger: Ledger, jobs: int, until_s: float = inf
) -> None:
    """Tries the changes that the ledger does not know yet, side by side, and writes down what came of each. Raises TimeIsOver
    at a monotonic time."""
    open_ones = [number for number in numbers if not ledger.knows(found[number], choice.tests(found[number].asks))]
    if not open_ones:
        return
    questions = iter(open_ones)
    files = choice.files({found[number].asks for number in open_ones})

    def work(index: int) -> None:
        with Worker(copied(index), file, files, until_s) as worker:
            while by := worker.ask(None, tests := choice.fresh(ALL)[:SAMPLE], tests, choice.cpu_s(tests))["by"]:
                if not choice.starts(by):
                    raise RuntimeError(f"{by} fails without any change of {file}")
                choice.drop(by)
            for number in questions:  # shared: each takes the next one
                change = found[number]
                tests, answer = answered(worker, number, change.asks, choice)
                choice.noticed(change.asks, answer["by"])
                ledger.write(change, tests, answer)
                by = answer["by"] or "SURVIVES"
                print(f"{ledger.count}/{len(numbers)} {file}:{change.line}: {change.name}: {by}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(work, range(min(jobs, len(open_ones)))))


def answered(worker: Worker, number: int, asks: frozenset[str], choice: Choice) -> tuple[list[str], dict[str, str]]:
    """Who was asked about a change, and what came of it. A test that starts programs, and fails here without any change, too,
    is asked no more."""
    while True:
        tests = choice.tests(asks)
        answer = worker.ask(number, tests, choice.fresh(asks), choice.cpu_s(tests))
        by = answer["by"]
        if not (choice.starts(by) and worker.ask(None, [by], [by], choice.cpu_s([by]))["by"]):
            return tests, answer
        choice.drop(by)


def drawn(files: Sequence[str], since: str | None, at_most: int | None) -> dict[str, list[int]]:
    """The changes to try of each file; where there are too many, always the same ones of them."""
    names = list[tuple[str, int, str]]()
    differ, old = (set(files), set[str]()) if since is None else known(since)
    for file in differ.intersection(files):
        found = enumerate(changes(Path(file).read_text())[1])
        names += [(file, number, each.name) for number, each in found if each.name not in old]
    if at_most is not None and len(names) > at_most:
        print(f"of {len(names)} changes {at_most} are tried", flush=True)
        names = sorted(sorted(names, key=lambda it: hashlib.sha256(f"{it[0]} {it[2]}".encode()).digest())[:at_most])
    return {file: [number for name, number, _ in names if name == file] for file in files}


def run(numbers: dict[str, list[int]], jobs: int, cpu_s: float, *, whole: bool, others: bool) -> int:
    """Tries all, prints the figures and what has no reason, or no survivor; 1 if there is any. `others`: the changes that are
    not among these were tried before, and count."""
    rows, complaints = list[Figures](), list[str]()
    why, watched = reasons(), frozenset((*CORE, *numbers))
    for file, those in numbers.items():
        source = Path(file).read_text()
        _, found = changes(source)
        ledger, told = Ledger(file, source), why.get(file, {})
        if those:
            own = refreshed(watched, file)
            tried(file, found, those, Choice(file, own or refreshed(watched), cpu_s), ledger, jobs)
            if left := [n for n in those if ledger.survived(found[n]) and found[n].name not in told]:
                tried(file, found, left, Choice(file, refreshed(watched), cpu_s), ledger, jobs)
        survivors = [found[n] for n in those if ledger.survived(found[n])]
        names = {found[n].name for n in those}
        before, kept = (len(found) - len(those), len(told.keys() - names)) if others else (0, 0)
        named = sum(each.name in told for each in survivors)
        rows.append(Figures(file, len(found), before + len(those), kept + len(survivors), kept + named))
        complaints += [f"{file}:{each.line}: no test notices '{each.name}'" for each in survivors if each.name not in told]
        alive = {each.name for each in survivors}
        gone = [name for name in told if name not in alive and (whole or name in names)]
        complaints += [f"{file}: tests/survivors.toml has a reason for '{name}', which does not survive" for name in gone]
    print(shown(rows))
    print(*complaints, sep="\n")
    return 1 if complaints else 0


def hurried(numbers: dict[str, list[int]], jobs: int, cpu_s: float, until_s: float) -> None:
    """Asks only the tests that are about each file, until a monotonic time, and says what all tests must be asked about."""
    left, noticed, told = list[str](), 0, reasons()
    changed = {file: those for file, those in numbers.items() if those}
    for file, those in changed.items():
        found, ledger = changes(Path(file).read_text())[1], Ledger(file, Path(file).read_text())
        try:
            if own := refreshed(frozenset(changed), file, until_s):
                tried(file, found, those, Choice(file, own, cpu_s), ledger, jobs, until_s)
        except (TimeIsOver, RuntimeError) as error:
            print(error)
        for change in (found[number] for number in those):
            noticed += (outcome := ledger.outcome(change)) == "noticed"
            if outcome != "noticed" and change.name not in told.get(file, {}):
                why = "no test about its file notices" if outcome else "there was no time, or no test about its file, for"
                left.append(f"{file}:{change.line}: {why} '{change.name}'")
    count = sum(map(len, changed.values()))
    named = count - noticed - len(left)
    print(*left, f"of {count} new changes {noticed} are noticed, {named} cannot be, {len(left)} are left open", sep="\n")
    if left:
        print("all tests are asked by: make mutants ARGS=--new")


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.mutants", description=__doc__.split("\n\n")[0])
    parser.add_argument("files", nargs="*", default=list(CORE), metavar="FILE.py")
    parser.add_argument("--since", metavar="REVISION", help="only changes of lines that differ from it")
    parser.add_argument("--new", action="store_true", help="the same, since the revision in tests/survivors.toml")
    parser.add_argument("--at-most", type=int, metavar="N", help="of more changes, a sample that is always the same")
    parser.add_argument("--within", type=float, metavar="SECONDS", help="only the tests about each file; it fails at nothing")
    parser.add_argument("-j", type=int, default=2, help="so many side by side (%(default)s)")
    parser.add_argument("--cpu", type=float, default=CPU_S, help="seconds of tests for a change (%(default)s)")
    began_s, told = time.monotonic(), parser.parse_args(words)
    since = measured() if told.new else told.since
    numbers = drawn(told.files, since, told.at_most)
    if told.within is not None:
        hurried(numbers, told.j, told.cpu, began_s + told.within)
        return 0
    others = told.new and told.at_most is None
    failed = run(numbers, told.j, told.cpu, whole=since is None and told.at_most is None, others=others)
    if told.new and not failed and told.at_most is None and told.files == list(CORE) and not _git("status", "--porcelain"):
        measured_now(_git("rev-parse", "HEAD").strip())
    return failed


if __name__ == "__main__":
    sys.exit(main())
