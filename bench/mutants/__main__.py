"""Changes the safety core, one place at a time, and asks its tests: `make mutants` (docs/mutants.md).

    python -m bench.mutants [FILE.py ...] [--since REVISION | --new] [--at-most N] [-j N] [--cpu SECONDS]

Without files, the whole core. With --since only changes that could not be made in that revision. The tests that import the file
are asked first, and all others about what is left. What was tried of the same file by the same tests is not tried again
(run/mutants). It fails at a change that no test notices and that has no reason in
tests/survivors.toml, and at a reason for a change that does not survive any more.
"""

import argparse
import hashlib
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from bench.mutants.changes import MODULE, Change, changes
from bench.mutants.choice import Choice, refreshed
from bench.mutants.core import CORE
from bench.mutants.ledger import Figures, Ledger, measured, measured_now, reasons, shown
from bench.mutants.workers import Worker, copied
from delfim.base.errors import ConfigError

ALL: Final = frozenset({MODULE})
SAMPLE: Final = 9  # tests that have to pass without a change, before any is made
CPU_S: Final = 5.0  # of tests for a change, those that are most likely to notice it first


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


def tried(file: str, found: list[Change], numbers: list[int], choice: Choice, ledger: Ledger, jobs: int) -> None:
    """Tries the changes that the ledger does not know yet, side by side, and writes down what came of each."""
    open_ones = [number for number in numbers if not ledger.knows(found[number], choice.tests(found[number].asks))]
    if not open_ones:
        return
    questions = iter(open_ones)
    files = choice.files({found[number].asks for number in open_ones})

    def work(index: int) -> None:
        with Worker(copied(index), file, files) as worker:
            tests = choice.fresh(ALL)[:SAMPLE]
            answer = worker.ask(None, tests, tests, choice.cpu_s(tests))
            if answer["by"]:
                raise RuntimeError(f"{answer['by']} fails without any change of {file}")
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


def run(numbers: dict[str, list[int]], jobs: int, cpu_s: float, *, whole: bool) -> int:
    """Tries all, prints the figures and what has no reason, or no survivor; 1 if there is any."""
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
        rows.append(Figures(file, len(found), len(those), len(survivors), sum(each.name in told for each in survivors)))
        complaints += [f"{file}:{each.line}: no test notices '{each.name}'" for each in survivors if each.name not in told]
        alive, names = {each.name for each in survivors}, {found[n].name for n in those}
        gone = [name for name in told if name not in alive and (whole or name in names)]
        complaints += [f"{file}: tests/survivors.toml has a reason for '{name}', which does not survive" for name in gone]
    print(shown(rows))
    print(*complaints, sep="\n")
    return 1 if complaints else 0


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.mutants", description=__doc__.split("\n\n")[0])
    parser.add_argument("files", nargs="*", default=list(CORE), metavar="FILE.py")
    parser.add_argument("--since", metavar="REVISION", help="only changes of lines that differ from it")
    parser.add_argument("--new", action="store_true", help="the same, since the revision in tests/survivors.toml")
    parser.add_argument("--at-most", type=int, metavar="N", help="of more changes, a sample that is always the same")
    parser.add_argument("-j", type=int, default=2, help="so many side by side (%(default)s)")
    parser.add_argument("--cpu", type=float, default=CPU_S, help="seconds of tests for a change (%(default)s)")
    told = parser.parse_args(words)
    since = measured() if told.new else told.since
    numbers = drawn(told.files, since, told.at_most)
    failed = run(numbers, told.j, told.cpu, whole=since is None and told.at_most is None)
    if told.new and not failed and told.at_most is None and told.files == list(CORE) and not _git("status", "--porcelain"):
        measured_now(_git("rev-parse", "HEAD").strip())
    return failed


if __name__ == "__main__":
    sys.exit(main())
