"""Where clients of FTP, SFTP and SCP may write: one folder, with a share of the disk of its own.

The logs keep the rest (delfim.logging.guard). Room is looked for before each new name and every LOOK_BYTES over all files
together, because many small files fill a disk as well as one large one, and folders take its inodes. Everything here blocks on
the disk: call it in a worker.
"""

import logging
import os
import threading
from collections.abc import Callable
from typing import Final

from delfim import config
from delfim.errors import DelfimError
from delfim.logging.guard import free_bytes, upload_room, used
from delfim.services.jail import Jail

LOOK_BYTES: Final = 1 << 20
INODES_SHARE: Final = 0.25  # of the disk's inodes stay with the logs

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

    def open(self, path: str, flags: int, mode: int = 0o644) -> int:
        """A descriptor of a plain file. Raises OSError as os.open does."""
        inner = self._inner(path)
        if flags & os.O_CREAT:
            self._name(inner)
        self._take(0)
        return self._jail.open(inner, flags, mode)

    def make_folder(self, path: str) -> None:
        inner = self._inner(path)
        self._name(inner)
        self._take(0)
        with self._jail.at(inner) as (folder, name):
            os.mkdir(name, 0o755, dir_fd=folder)

    def remove(self, path: str) -> None:
        with self._jail.at(self._inner(path)) as (folder, name):
            os.unlink(name, dir_fd=folder)

    def remove_folder(self, path: str) -> None:
        with self._jail.at(self._inner(path)) as (folder, name):
            os.rmdir(name, dir_fd=folder)

    def rename(self, source: str, target: str) -> None:
        """The new name is on the disk when this returns, and replaces a file of that name."""
        with self._jail.at(self._inner(source)) as (old, name), self._jail.at(self._inner(target)) as (new, new_name):
            os.rename(name, new_name, src_dir_fd=old, dst_dir_fd=new)
            os.fsync(new)

    def apply(self, path: str, do: Callable[[int], object]) -> None:
        """Do something with a file or folder that is there, open for reading."""
        with self._jail.at(self._inner(path)) as (folder, name):
            fd = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
            try:
                do(fd)
            finally:
                os.close(fd)

    def write(self, fd: int, data: bytes, offset: int) -> None:
        """All of it. Raises NoRoom."""
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
        """A file's content into a new one. Raises NoRoom, OSError."""
        source = self._jail.open(self._inner(path))
        try:
            at = 0
            while data := os.pread(source, LOOK_BYTES, at):
                self.write(fd, data, at)
                at += len(data)
        finally:
            os.close(source)

    def _inner(self, path: str) -> str:
        """The path within the folder."""
        before = f"/{self._limits.upload_folder}/"
        path = os.path.normpath(path)
        if not path.startswith(before):
            raise DelfimError(f"you can only write in {before.rstrip('/')}")
        if not path.isprintable():  # no program that lists it could show it
            raise DelfimError("a name must be of printable characters, in UTF-8")
        return path.removeprefix(before)

    def _name(self, inner: str) -> None:
        """Room for a name. Raises NoRoom."""
        if os.path.lexists(self._jail.real(inner)):
            return
        disk = os.statvfs(self.folder)
        if used(self.folder)[1] >= self._limits.upload_names_max:
            raise NoRoom(f"there are {self._limits.upload_names_max} uploads already: delete some")
        if disk.f_files and disk.f_favail < disk.f_files * INODES_SHARE:
            raise NoRoom("the disk has no room for more files")

    def _take(self, size: int) -> None:
        """Room for so many bytes; with 0, for anything. Raises NoRoom."""
        with self._lock:
            if not 0 < size <= self._left_bytes:
                self._look(max(size, 1))
            self._left_bytes = max(self._left_bytes - size, 0)
            self._pending_bytes += size

    def _look(self, size: int) -> None:
        """At the disk itself."""
        self._left_bytes = 0
        free = free_bytes(self.folder) - self._limits.free_bytes_min
        room = upload_room(self.folder, self._limits.upload_bytes_max)
        left = min(free, room) - self._pending_bytes
        if left < size:
            raise NoRoom("the disk is full" if free < size else "the uploads have used up their room: delete some")
        self._left_bytes = min(left, max(size, LOOK_BYTES))
