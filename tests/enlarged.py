"""Delfim with something added to it: a copy of the package, a new file, a new row, as CONTRIBUTING.md says."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


class Enlarged:
    """The copy. `place` holds its folder `delfim`; with `env` as its environment, `python -m delfim` is this copy."""

    def __init__(self, place: Path) -> None:
        self.place, self.env = place, os.environ | {"PYTHONPATH": str(place)}
        shutil.copytree(ROOT / "delfim", place / "delfim", ignore=shutil.ignore_patterns("node_modules", "__pycache__"))

    def file(self, path: str, text: str) -> None:
        """A file that was not there."""
        assert not (self.place / path).exists()
        (self.place / path).write_text(text)

    def row(self, path: str, beside: str, row: str, *, behind: bool = False) -> None:
        """Something in front of a text that stands there once, or behind it."""
        text = (self.place / path).read_text()
        assert text.count(beside) == 1, f"{path} has {text.count(beside)} times {beside!r}"
        (self.place / path).write_text(text.replace(beside, beside + row if behind else row + beside))

    def told(self, *words: str) -> str:
        """What `delfim WORDS` prints."""
        command = [sys.executable, "-m", "delfim", *words]
        end = subprocess.run(command, env=self.env, capture_output=True, text=True, timeout=120)
        assert end.returncode == 0, end.stdout + end.stderr
        return end.stdout
