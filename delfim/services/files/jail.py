"""A directory that no path leads out of: not by `..`, not by a link, not by a link that is put there between check and opening.

A file is opened, made and removed by its name in a folder that is open already: a path that is walked twice may lead elsewhere
the second time, and this process may have more rights than the user who puts links there.

Names with a dot in front are hidden: keys may lie beside the logs. httpd, ftpd and sshd open files through it. Everything here
blocks on the disk: call it in a worker.
"""

import contextlib
import os
import stat
from collections.abc import Iterator

from delfim.base.errors import DelfimError


class Jail:
    """Turns paths of clients, "/" being the directory itself, into real ones. Raises DelfimError for those that lead out."""

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = os.path.realpath(root)

    def real(self, path: str) -> str:
        """The real path, which need not exist. A link is followed as long as it stays inside."""
        if "\0" in path:
            raise DelfimError("no such file")
        try:
            real = os.path.realpath(os.path.join(self.root, path.lstrip("/")))
        except RecursionError:
            raise DelfimError("a chain of links") from None
        if not self._holds(real):
            raise DelfimError("outside of what may be seen")
        if "/." in real[len(self.root.rstrip("/")) :]:
            raise DelfimError("no such file")
        return real

    def open(self, path: str, flags: int = os.O_RDONLY, mode: int = 0o644) -> int:
        """Open a plain file. Raises OSError as os.open does."""
        with self.at(path) as (folder, name):
            fd = os.open(name, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, mode, dir_fd=folder)
        try:
            if not stat.S_ISREG(os.fstat(fd).st_mode):
                raise DelfimError("not a plain file")
            os.posix_fadvise(fd, 0, 0, os.POSIX_FADV_RANDOM)  # reading megabytes ahead, a kernel gives its processor to nobody
        except BaseException:
            os.close(fd)
            raise
        return fd

    def status(self, path: str) -> os.stat_result:
        """The status of a file or folder. Raises OSError."""
        with self.at(path) as (folder, name):
            return os.stat(name, dir_fd=folder, follow_symlinks=False)

    @contextlib.contextmanager
    def at(self, path: str) -> Iterator[tuple[int, str]]:
        """Open the folder of a path; returns it and the name in it. Raises OSError."""
        real = self.real(path)
        folder, name = (real, ".") if real == self.root else os.path.split(real)
        with self._opened(folder) as fd:
            yield fd, name

    @contextlib.contextmanager
    def folder(self, path: str) -> Iterator[int]:
        """Open a folder. Raises OSError."""
        with self._opened(self.real(path)) as fd:
            yield fd

    @contextlib.contextmanager
    def _opened(self, folder: str) -> Iterator[int]:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            if not self._holds(os.readlink(f"/proc/self/fd/{fd}")):  # a link was put there between check and opening
                raise DelfimError("outside of what may be seen")
            yield fd
        finally:
            os.close(fd)

    def shown(self, real: str) -> str:
        """A real path as clients see it."""
        return "/" + os.path.relpath(real, self.root).removeprefix(".")

    def _holds(self, real: str) -> bool:
        return real == self.root or real.startswith(self.root.rstrip("/") + "/")
