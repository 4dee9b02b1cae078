"""Replaces files whole: after a fault, a kill or a power cut a file is the old one or the new one."""

import contextlib
import os
import shutil
from pathlib import Path
from typing import Final

PART: Final = ".part"  # behind the name of what is not all here yet


def replace_file(path: str | os.PathLike[str], content: bytes | str, times_ns: tuple[int, int] | None = None) -> None:
    """Put this content, a text as UTF-8, in the place of a file, and wait for the disk. What a link leads to is replaced, and
    the rights of the old file stay. `times_ns`: of its last access and change. Raises OSError; the old file is there then."""
    place = Path(os.path.realpath(path))
    part = place.with_name(place.name + PART)
    with part.open("wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())
    with contextlib.suppress(FileNotFoundError):
        shutil.copymode(place, part)
    if times_ns is not None:
        os.utime(part, ns=times_ns)
    part.replace(place)
    sync_directory(place.parent)


def sync_directory(path: str | os.PathLike[str]) -> None:
    """Make names that were made or changed in a directory survive a power cut. Raises OSError. Windows has no call for it."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
