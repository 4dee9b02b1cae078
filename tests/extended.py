"""A copy of the program to which something was added as CONTRIBUTING.md says: files, and rows in the files that are there."""

import os
import shutil
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "delfim"


def extended(folder: Path, files: dict[str, str], rows: dict[str, dict[str, str]]) -> dict[str, str]:
    """The environment in which `python -m delfim` is this copy. `rows`: by file, a text that is there once and the row behind
    it."""
    shutil.copytree(PACKAGE, folder / "delfim", ignore=shutil.ignore_patterns("__pycache__", "node_modules"))
    for name, text in files.items():
        path = folder / "delfim" / name
        assert not path.exists()
        path.write_text(text)
    for name, added in rows.items():
        path = folder / "delfim" / name
        text = path.read_text()
        for there, row in added.items():
            assert text.count(there) == 1, (name, there)
            text = text.replace(there, there + row)
        path.write_text(text)
    return {**os.environ, "PYTHONPATH": str(folder)}
