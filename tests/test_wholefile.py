"""A file that is replaced is the old one or the new one, whatever happens meanwhile."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from delfim.base import wholefile
from delfim.base.wholefile import PART, replace_file

OLD, NEW = b"old\n", b"new\n" * 1000


class Killed(BaseException):
    """Nothing is tidied up after it."""


def fails(error: BaseException) -> Callable[..., Any]:
    def call(*_: object, **__: object) -> Any:
        raise error

    return call


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Killed()], ids=str)
@pytest.mark.parametrize(
    ("at", "name", "left"),
    [(Path, "open", OLD), (os, "fsync", OLD), (Path, "replace", OLD), (wholefile, "sync_directory", NEW)],
)
def test_a_fault_at_any_step_leaves_the_old_file_or_the_new_one(
    at: Any, name: str, left: bytes, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(OLD)
    with monkeypatch.context() as patch:
        patch.setattr(at, name, fails(error))
        with pytest.raises((OSError, Killed)):
            replace_file(file, NEW)
    assert file.read_bytes() == left
    replace_file(file, "then\n")
    assert file.read_text() == "then\n"
    assert not file.with_name(file.name + PART).exists(), "what was left is taken"


def test_a_new_file_a_link_rights_and_times(tmp_path: Path) -> None:
    file, link = tmp_path / "a.toml", tmp_path / "boat.toml"
    replace_file(file, OLD, (1_000, 2_000))
    assert file.stat().st_mtime_ns == 2_000
    file.chmod(0o640)
    link.symlink_to(file)
    replace_file(link, NEW)
    assert link.is_symlink()
    assert file.read_bytes() == NEW
    assert file.stat().st_mode & 0o777 == 0o640
