"""Files over SSH: SFTP and SCP inside of a jail, read and written by two workers."""

import contextlib
import errno
import io
import logging
import os
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import asyncssh

from delfim.base.errors import DelfimError
from delfim.services.files.jail import Jail
from delfim.services.files.threads import worked
from delfim.services.files.uploads import NoRoom, Uploads

READ_BYTES: Final = 32 << 10  # of a file, at once: more drives the vehicle out of the processor's cache

asyncssh.sftp.MAX_SFTP_READ_LEN = READ_BYTES  # the answer to clients; the protocol has no other
log = logging.getLogger(__name__)


def _in_worker(name: str) -> Any:
    """Run asyncssh's own method, which blocks, in a worker."""
    do = getattr(asyncssh.SFTPServer, name)

    async def method(files: "SftpFiles", *arguments: Any) -> Any:
        return await files.work(do, files, *arguments)

    return method


@contextlib.contextmanager
def _as_refusal() -> Iterator[None]:
    """Turn a refusal into SFTP's form: an OSError."""
    try:
        yield
    except DelfimError as error:
        raise OSError(errno.ENOSPC if isinstance(error, NoRoom) else errno.EACCES, str(error)) from None


def _apply(fd: int, attrs: asyncssh.SFTPAttrs) -> None:
    """Set size, rights and times of a file. Raises OSError."""
    if attrs.uid is not None or attrs.gid is not None:
        raise PermissionError(errno.EACCES, "the owner of a file cannot be changed")
    if attrs.size is not None:
        os.truncate(f"/proc/self/fd/{fd}", attrs.size)
    if attrs.permissions is not None:
        os.fchmod(fd, attrs.permissions & 0o777)
    if attrs.mtime is not None:
        os.utime(fd, (attrs.mtime if attrs.atime is None else attrs.atime, attrs.mtime))


class _File(io.FileIO):
    """An open file. Once a write has failed all fail: clients send many at once and overlook a failure between successes."""

    failure = ""


class SftpFiles(asyncssh.SFTPServer):
    """SFTP and SCP inside of the jail. Every call is a worker's; no link can be made, and links that lead out are hidden."""

    def __init__(self, channel: Any, jail: Jail, uploads: Uploads, workers: ThreadPoolExecutor) -> None:
        super().__init__(channel, chroot=os.fsencode(jail.root))
        self._jail, self._uploads, self._workers = jail, uploads, workers
        self._visitor = str(channel.get_connection().get_owner())

    def note(self, did: str, *what: object) -> None:
        log.warning("sshd: %s: %s %s", self._visitor, did, " ".join(repr(_normal(w)) for w in what if isinstance(w, bytes)))

    def exit(self) -> None:
        """End a session, with the exit status that scp waits for."""
        self.channel.exit(0)

    async def work(self, do: Callable[..., Any], *arguments: Any) -> Any:
        return await worked(self._workers, do, *arguments)

    def map_path(self, path: bytes) -> bytes:
        """Map a client's path to a real one, in a worker. Raises OSError."""
        with _as_refusal():
            return os.fsencode(self._jail.real(_normal(path)))

    def _opened(self, path: bytes, pflags: int, attrs: asyncssh.SFTPAttrs) -> object:
        reads, writes = pflags & asyncssh.FXF_READ, pflags & (asyncssh.FXF_WRITE | asyncssh.FXF_APPEND)
        flags = os.O_RDWR if reads and writes else os.O_WRONLY if writes else os.O_RDONLY
        for asked, flag in (
            (asyncssh.FXF_APPEND, os.O_APPEND),
            (asyncssh.FXF_CREAT, os.O_CREAT),
            (asyncssh.FXF_EXCL, os.O_EXCL),
        ):
            flags |= flag if pflags & asked else 0
        mode = 0o600 | (0o644 if attrs.permissions is None else attrs.permissions) & 0o777  # no set-user-id
        with _as_refusal():
            fd = (self._uploads if flags != os.O_RDONLY else self._jail).open(_normal(path), flags, mode)
        if pflags & asyncssh.FXF_TRUNC:
            os.ftruncate(fd, 0)
        return _File(fd, "r+b" if reads and writes else "wb" if writes else "rb")

    def _closed(self, file: Any) -> None:
        if file.writable():
            os.fsync(file.fileno())
        file.close()
        if file.failure:
            raise OSError(errno.ENOSPC, file.failure)

    def _named(self, path: bytes) -> list[asyncssh.SFTPName]:
        found = []
        for name in (b".", b"..", *sorted(os.listdir(self.map_path(path)))):
            with contextlib.suppress(OSError):  # links that lead out, and files just deleted
                status = os.stat(self.map_path(os.path.join(path, name)))
                found.append(asyncssh.SFTPName(name, attrs=asyncssh.SFTPAttrs.from_local(status)))
        return found

    async def scandir(self, path: bytes) -> AsyncIterator[asyncssh.SFTPName]:
        for name in await self.work(self._named, path):
            yield name

    async def open(self, path: bytes, pflags: int, attrs: asyncssh.SFTPAttrs) -> object:
        file = await self.work(self._opened, path, pflags, attrs)
        self.note("writes" if pflags & (asyncssh.FXF_WRITE | asyncssh.FXF_APPEND) else "reads", path)
        return file

    async def close(self, file_obj: object) -> None:
        await self.work(self._closed, file_obj)

    async def read(self, file_obj: Any, offset: int, size: int) -> bytes:
        found: bytes = await self.work(os.pread, file_obj.fileno(), size, offset)
        return found

    async def write(self, file_obj: Any, offset: int, data: bytes) -> int:
        with _as_refusal():
            if file_obj.failure:
                raise NoRoom(file_obj.failure)
            try:
                await self.work(self._uploads.write, file_obj.fileno(), data, offset)
            except NoRoom as error:
                file_obj.failure = str(error)
                raise
        return len(data)

    async def _change(self, did: str, do: Callable[..., None], *paths: bytes) -> None:
        """Change something in the folder of uploads. Raises OSError."""
        with _as_refusal():
            await self.work(do, *map(_normal, paths))
        self.note(did, *paths)

    async def remove(self, path: bytes) -> None:
        await self._change("remove", self._uploads.remove, path)

    async def mkdir(self, path: bytes, attrs: asyncssh.SFTPAttrs) -> None:
        await self._change("mkdir", self._uploads.make_folder, path)

    async def rmdir(self, path: bytes) -> None:
        await self._change("rmdir", self._uploads.remove_folder, path)

    async def posix_rename(self, oldpath: bytes, newpath: bytes) -> None:
        await self._change("rename", self._uploads.rename, oldpath, newpath)

    async def rename(self, oldpath: bytes, newpath: bytes) -> None:
        """Rename as `posix_rename` does, but replace nothing."""
        if await self.work(lambda: os.path.lexists(self.map_path(newpath))):
            raise asyncssh.SFTPFileAlreadyExists("a file of this name exists")
        await self.posix_rename(oldpath, newpath)

    def symlink(self, oldpath: bytes, newpath: bytes) -> None:
        raise PermissionError(errno.EACCES, "no links here")

    def link(self, oldpath: bytes, newpath: bytes) -> None:
        self.symlink(oldpath, newpath)

    def readlink(self, path: bytes) -> bytes:
        raise PermissionError(errno.EACCES, "no links here")

    stat, lstat, fstat, realpath = _in_worker("stat"), _in_worker("lstat"), _in_worker("fstat"), _in_worker("realpath")

    async def setstat(self, path: bytes, attrs: asyncssh.SFTPAttrs) -> None:
        await self._change("setstat", lambda name: self._uploads.apply(name, lambda fd: _apply(fd, attrs)), path)

    async def fsetstat(self, file_obj: Any, attrs: asyncssh.SFTPAttrs) -> None:
        if not file_obj.writable():
            raise PermissionError(errno.EACCES, "opened for reading")
        await self.work(_apply, file_obj.fileno(), attrs)

    lsetstat = setstat
    statvfs, fstatvfs, fsync = _in_worker("statvfs"), _in_worker("fstatvfs"), _in_worker("fsync")


def _normal(path: bytes) -> str:
    """The client's path, from the root; ".." ends there."""
    return os.path.normpath(os.path.join("/", os.fsdecode(path)))
