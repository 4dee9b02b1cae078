"""Where clients of FTP, SFTP and SCP may write: one folder, with a share of the disk of its own.

The logs keep the rest (delfim.logging.free_space). Room is looked for before each new name and every LOOK_BYTES over all files
together, because many small files fill a disk as well as one large one, and folders take its inodes. Everything here blocks on
the disk: call it in a worker.

A file that is being written is locked (flock), by every daemon. Nobody else removes, renames or replaces it meanwhile: what is
still written into a file without a name would be counted nowhere, and two that write one file would make a third.
"""

import contextlib
import fcntl
import logging
import os
import stat
import threading
from collections.abc import Callable, Iterator
from typing import Final

from delfim import config
from delfim.base.errors import DelfimError
from delfim.logging.free_space import free_bytes, upload_room, used
from delfim.services.files.jail import Jail

PART: Final = ".part"  # behind the name of what is not all here yet
LOOK_BYTES: Final = 1 << 20
INODES_SHARE: Final = 0.25  # of the disk's inodes stay with the logs
BEING_WRITTEN: Final = "another client is writing it"

log = logging.getLogger(__name__)


class NoRoom(DelfimError):
    """The disk, or the uploads' share of it, is full."""


class Uploads:
    """The folder, changed by name, and its room. Paths are as clients see them. Raises DelfimError for paths elsewhere."""

    def __init__(self, root: str, limits: config.LogTable) -> None:
        self._limits = limits
        self.folder = os.path.join(os.path.realpath(root), limits.upload_folder)
        self._jail = Jail(self.folder)
        self._lock = threading.Lock()
        self._left_bytes = 0  # that may be written before the next look
        self._pending_bytes = 0  # being written by others just now, and not seen by a look

    def prepare(self) -> None:
        """Make the folder. Users who may only read do not need it."""
        try:
            os.makedirs(self.folder, exist_ok=True)
        except OSError as error:
            log.warning("no uploads: %s: %s", self.folder, error.strerror)

    def open(self, path: str, flags: int, mode: int = 0o644, *, alone: bool = False) -> int:
        """Open a plain file, locked: `alone` or beside others who are not. Raises OSError as os.open does."""
        inner = self._inner(path)
        if flags & os.O_CREAT:
            self._name(inner)
        self._take(0)
        fd = self._jail.open(inner, flags, mode)
        try:
            _lock(fd, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
            if not os.path.samestat(os.fstat(fd), self._jail.status(inner)):  # it became another file before it was locked
                raise DelfimError(BEING_WRITTEN)
        except BaseException:
            os.close(fd)
            raise
        return fd

    def make_folder(self, path: str) -> None:
        inner = self._inner(path)
        self._name(inner)
        self._take(0)
        with self._jail.at(inner) as (folder, name):
            os.mkdir(name, 0o755, dir_fd=folder)

    def remove(self, path: str) -> None:
        with self._jail.at(self._inner(path)) as (folder, name), _idle(folder, name):
            os.unlink(name, dir_fd=folder)

    def remove_folder(self, path: str) -> None:
        with self._jail.at(self._inner(path)) as (folder, name):
            os.rmdir(name, dir_fd=folder)

    def rename(self, source: str, target: str) -> None:
        """Rename a file; the new name is on the disk when this returns, and replaces a file of that name."""
        with (
            self._jail.at(self._inner(source)) as (old, name),
            self._jail.at(self._inner(target)) as (new, new_name),
            _idle(old, name),
            _idle(new, new_name) as is_free,
        ):
            _move(old, name, new, new_name, is_free)
            os.fsync(new)

    def finish(self, fd: int, path: str) -> None:
        """Give the part of a file, all of it on the disk and open, the file's name. Raises OSError."""
        with self._jail.at(self._inner(path)) as (folder, name), _idle(folder, name) as is_free:
            if not os.path.samestat(os.fstat(fd), os.stat(name + PART, dir_fd=folder, follow_symlinks=False)):
                raise DelfimError("its part is another file now")  # its folder was renamed, and another one put there
            _move(folder, name + PART, folder, name, is_free)
            os.fsync(folder)

    def apply(self, path: str, do: Callable[[int], object]) -> None:
        """Do something with a file or folder that is there, open for reading."""
        with self._jail.at(self._inner(path)) as (folder, name):
            fd = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
            try:
                _lock(fd, fcntl.LOCK_SH)
                do(fd)
            finally:
                os.close(fd)

    def write(self, fd: int, data: bytes, offset: int) -> None:
        """Write all of the data. Raises NoRoom."""
        size = len(data)
        self._take(size)
        try:
            while data:
                written = os.pwrite(fd, data, offset)
                data, offset = data[written:], offset + written
        except OSError as error:
            raise NoRoom(error.strerror) from None
        finally:
            with self._lock:
                self._pending_bytes -= size

    def copy(self, path: str, fd: int) -> None:
        """Copy a file's content into a new one. Raises NoRoom, OSError."""
        source = self._jail.open(self._inner(path))
        try:
            at = 0
            while data := os.pread(source, LOOK_BYTES, at):
                self.write(fd, data, at)
                at += len(data)
        finally:
            os.close(source)

    def has(self, path: str) -> bool:
        """Whether a path is in the folder."""
        return path.startswith(f"/{self._limits.upload_folder}/")

    def _inner(self, path: str) -> str:
        """The path within the folder."""
        path = os.path.normpath(path)
        if not self.has(path):
            raise DelfimError(f"you can only write in /{self._limits.upload_folder}")
        if not path.isprintable():  # no program that lists it could show it
            raise DelfimError("a name must be of printable characters, in UTF-8")
        return path.removeprefix(f"/{self._limits.upload_folder}/")

    def _name(self, inner: str) -> None:
        """Take room for a name. Raises NoRoom."""
        if os.path.lexists(self._jail.real(inner)):
            return
        disk = os.statvfs(self.folder)
        if used(self.folder)[1] >= self._limits.upload_names_max:
            raise NoRoom(f"there are {self._limits.upload_names_max} uploads already: delete some")
        if disk.f_files and disk.f_favail < disk.f_files * INODES_SHARE:
            raise NoRoom("the disk has no room for more files")

    def _take(self, size: int) -> None:
        """Take room for so many bytes; with 0, for anything. Raises NoRoom."""
        with self._lock:
            if not 0 < size <= self._left_bytes:
                self._look(max(size, 1))
            self._left_bytes = max(self._left_bytes - size, 0)
            self._pending_bytes += size

    def _look(self, size: int) -> None:
        """Measure the disk itself."""
        self._left_bytes = 0
        free = free_bytes(self.folder) - self._limits.free_bytes_min
        room = upload_room(self.folder, self._limits.upload_bytes_max)
        left = min(free, room) - self._pending_bytes
        if left < size:
            raise NoRoom("the disk is full" if free < size else "the uploads have used up their room: delete some")
        self._left_bytes = min(left, max(size, LOOK_BYTES))


@contextlib.contextmanager
def _idle(folder: int, name: str) -> Iterator[bool]:
    """Hold a name that nobody writes until the end of the block; whether it is free. Raises DelfimError."""
    try:
        fd = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    except OSError as error:  # none, a link, or a file of somebody else: whoever changes it will be told
        yield isinstance(error, FileNotFoundError)
        return
    try:
        _lock(fd, fcntl.LOCK_EX)
        yield False
    finally:
        os.close(fd)


def _move(old: int, name: str, new: int, new_name: str, is_free: bool) -> None:
    """Rename. A free name is not held: what has it meanwhile is somebody's upload, whose place a rename would take. Raises
    DelfimError then, OSError."""
    if is_free and stat.S_ISREG(os.stat(name, dir_fd=old, follow_symlinks=False).st_mode):
        try:
            os.link(name, new_name, src_dir_fd=old, dst_dir_fd=new, follow_symlinks=False)
        except FileExistsError:
            raise DelfimError(BEING_WRITTEN) from None
        except OSError:
            pass  # a disk without second names
        else:
            os.unlink(name, dir_fd=old)
            return
    os.rename(name, new_name, src_dir_fd=old, dst_dir_fd=new)


def _lock(fd: int, kind: int) -> None:
    """Lock a file until the descriptor is closed. Raises DelfimError."""
    try:
        fcntl.flock(fd, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DelfimError(BEING_WRITTEN) from None
