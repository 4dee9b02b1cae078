"""What came of the changes that were tried, kept in run/mutants, and the reasons for those that survive."""

import hashlib
import json
import threading
import tomllib
from pathlib import Path
from typing import Final, NamedTuple

from bench.mutants.changes import Change
from bench.mutants.reach import digest

FOLDER: Final = Path("run/mutants")
REASONS: Final = Path("tests/survivors.toml")


class Figures(NamedTuple):
    """Of one file."""

    file: str
    possible: int
    tried: int
    survived: int
    equivalent: int


def reasons(path: Path = REASONS) -> dict[str, dict[str, str]]:
    """File: name of a change: why no test can notice it."""
    return {file: told for file, told in tomllib.loads(path.read_text()).items() if file != "measured"}


def measured(path: Path = REASONS) -> str:
    """The commit up to which all changes of the core were tried."""
    return str(tomllib.loads(path.read_text())["measured"])


def measured_now(commit: str, path: Path = REASONS) -> None:
    text = path.read_text()
    path.write_text(text.replace(f'measured = "{measured(path)}"', f'measured = "{commit}"'))


def shown(rows: list[Figures]) -> str:
    """The table of the figures. A change with a reason is not one that could be noticed."""
    total = Figures("all", *(sum(column) for column in zip(*(row[1:] for row in rows), strict=True)))
    lines = ["| file | possible | tried | noticed | equivalent | of those that are not |", "|---|---|---|---|---|---|"]
    for row in [*rows, total]:
        noticed, differ = row.tried - row.survived, row.tried - row.equivalent
        part = f"{100.0 * noticed / differ:.1f} %" if differ else "–"
        lines.append(f"| `{row.file}` | {row.possible} | {row.tried} | {noticed} | {row.equivalent} | {part} |")
    return "\n".join(lines)


class Ledger:
    """Of one file, as it is: of another version nothing is known."""

    def __init__(self, file: str, source: str) -> None:
        self._path = FOLDER / f"{file.replace('/', '.')}l"
        self._version, self._lock = hashlib.sha256(source.encode()).hexdigest()[:16], threading.Lock()
        text = self._path.read_text().splitlines() if self._path.exists() else []
        rows = [row for row in map(json.loads, text) if row["version"] == self._version]
        self._rows = {row["name"]: row for row in rows}
        self.count = 0

    def knows(self, change: Change, tests: list[str]) -> bool:
        """Whether it was tried by these tests; one that was noticed, by the one that noticed it."""
        row = self._rows.get(change.name)
        if row is None:
            return False
        asked = [row["by"]] if row["result"] == "noticed" and "::" in row["by"] else tests
        is_same = bool(row["digest"] == _digest(asked))
        self.count += is_same
        return is_same

    def write(self, change: Change, tests: list[str], answer: dict[str, str]) -> None:
        asked = [answer["by"]] if answer["result"] == "noticed" and "::" in answer["by"] else tests
        row = {"version": self._version, "name": change.name, "digest": _digest(asked), **answer}
        with self._lock:
            self._rows[change.name] = row
            self.count += 1
            with self._path.open("a") as file:
                file.write(json.dumps(row) + "\n")

    def survived(self, change: Change) -> bool:
        return self.outcome(change) == "survived"

    def outcome(self, change: Change) -> str:
        """What came of it: noticed, survived, or nothing where it was not tried."""
        return str(self._rows.get(change.name, {"result": ""})["result"])


def _digest(tests: list[str]) -> str:
    """Of these tests and their files; of the order, which depends on what was tried before, nothing."""
    files = sorted({test.partition("::")[0].partition(", ")[0] for test in tests})
    text = " ".join([*sorted(tests), *(digest(Path(file)) for file in files)])
    return hashlib.sha256(text.encode()).hexdigest()[:16]
