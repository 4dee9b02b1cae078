"""Delfim with something added to it: a copy of the package, a new file, a new row, as CONTRIBUTING.md says."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


class Enlarged:
    """The copy. `place` holds its folder `delfim`."""

    def __init__(self, place: Path) -> None:
        self.place = place
        shutil.copytree(ROOT / "delfim", place / "delfim", ignore=shutil.ignore_patterns("node_modules", "__pycache__"))

    def file(self, path: str, text: str) -> None:
        """A file that was not there."""
        assert not (self.place / path).exists()
        (self.place / path).write_text(text)

    def row(self, path: str, before: str, row: str) -> None:
        """Something in front of what stands there once."""
        text = (self.place / path).read_text()
        assert text.count(before) == 1, f"{path} has {text.count(before)} times {before!r}"
        (self.place / path).write_text(text.replace(before, row + before))

    def told(self, *words: str) -> str:
        """What `delfim WORDS` prints."""
        there = os.environ | {"PYTHONPATH": str(self.place)}
        command = [sys.executable, "-m", "delfim", *words]
        return subprocess.run(command, env=there, check=True, stdout=subprocess.PIPE, text=True, timeout=120).stdout
