"""The free-space guard: whole days of logs are deleted, oldest first, until enough of the disk is free.

Uploads have room of their own: the bytes that they may still take count as taken. So which days go, and when, depends on the
logs alone, and no upload costs a log.

Never deleted: the days that the caller names, a day with a file named KEEP in it, a day in which a log is being written. The
writer of a log holds a shared lock (flock) on the day's directory, and the kernel releases it however the writer ends.
"""

import contextlib
import os
import re
import shutil
from collections.abc import Collection
from typing import Final

with contextlib.suppress(ImportError):  # there is none on Windows, where only lock step writes logs
    import fcntl

LOCKS: Final = "fcntl" in globals()
KEEP: Final = "KEEP"
UPLOAD_SHARE: Final = 0.25  # of a disk, at most
NAMES_MAX: Final = 10_000  # that are counted in a folder
_DAY: Final = re.compile(r"[0-9]{8}")


def free_bytes(directory: str) -> int:
    """The bytes that an unprivileged program may still write on the disk of this directory. Raises OSError."""
    return shutil.disk_usage(directory).free


def hold(day: str) -> int:
    """Open a descriptor that keeps a day from being deleted; -1 where there are no locks, and nothing is deleted. Raises
    OSError."""
    if not LOCKS:
        return -1
    fd = os.open(day, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        os.close(fd)
        raise
    return fd


def upload_room(folder: str, bytes_max: int) -> int:
    """The bytes that uploads may still take; 0 where there is no folder for them. Raises OSError."""
    try:
        total = shutil.disk_usage(folder).total
    except FileNotFoundError:
        return 0
    return max(min(bytes_max, int(total * UPLOAD_SHARE)) - used(folder)[0], 0)


def used(folder: str) -> tuple[int, int]:
    """The bytes and names of a folder with all that is in it. Counts NAMES_MAX names at most. Raises OSError."""
    size = count = 0
    folders = [folder]
    while folders:
        with contextlib.suppress(FileNotFoundError), os.scandir(folders.pop()) as scan:
            for entry in scan:
                if count == NAMES_MAX:
                    return size, count
                with contextlib.suppress(FileNotFoundError):
                    status = entry.stat(follow_symlinks=False)
                    size += max(status.st_blocks * 512, status.st_size)  # some give a file its blocks later
                    count += 1
                    if entry.is_dir(follow_symlinks=False):
                        folders.append(entry.path)
    return size, count


def make_room(directory: str, free_bytes_min: int, spared: Collection[str]) -> None:
    """Delete days (directories YYYYMMDD) until so many bytes are free or no day is left to delete. Raises OSError.

    Blocks for as long as the disk takes, and while another process makes room in the same directory.
    """
    if not LOCKS:
        return
    lock = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two at a time would delete a day too many
        for day in sorted(filter(_DAY.fullmatch, os.listdir(directory))):
            if free_bytes(directory) >= free_bytes_min:
                break
            if day not in spared:
                _delete(os.path.join(directory, day))
    finally:
        os.close(lock)


def _delete(day: str) -> None:
    if any(KEEP in files for _, _, files in os.walk(day)):
        return
    with contextlib.suppress(OSError):  # it is no directory, or a log is being written in it
        lock = os.open(day, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(day, ignore_errors=True)
        finally:
            os.close(lock)
