"""Files over FTP: lists, reading, and uploads that are whole or not there. Methods are named as the commands of the RFC."""

import contextlib
import fnmatch
import logging
import os
import stat
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from itertools import islice
from pathlib import PurePosixPath
from typing import Any, Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.services.files.ftpdata import BLOCK_BYTES, carried
from delfim.services.files.jail import Jail
from delfim.services.files.uploads import PART, Uploads
from delfim.services.tables import Ftpd

ENTRIES_MAX: Final = 20_000  # of a directory
MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
HALF_A_YEAR_S: Final = 180 * 86_400

log = logging.getLogger(__name__)


class FtpFiles:
    """The commands for files inside of a jail, for all connections. `work` runs blocking calls in a worker. Raises DelfimError,
    OSError."""

    def __init__(self, settings: config.Vehicle, clock: Clock, work: Callable[..., Awaitable[Any]]) -> None:
        self.uploads = Uploads(settings.of(Ftpd).root, settings.log)
        self.sent_bytes = self.received_bytes = 0
        self._boat, self._users, self._clock, self._work = settings.boat.name, settings.of(Ftpd).users, clock, work
        self._jail = Jail(settings.of(Ftpd).root)
        self.commands = {
            "appe": self.appe, "cdup": self.cdup, "cwd": self.cwd, "dele": self.dele, "list": self.ls, "mdtm": self.mdtm,
            "mkd": self.mkd, "mlsd": self.mlsd, "mlst": self.mlst, "nlst": self.nlst, "retr": self.retr, "rmd": self.rmd,
            "rnfr": self.rnfr, "rnto": self.rnto, "size": self.size, "stat": self.stat, "stor": self.stor,
            "xcup": self.cdup, "xcwd": self.cwd, "xmkd": self.mkd, "xrmd": self.rmd,
        }  # fmt: skip

    async def cwd(self, connection: Any, rest: Any) -> bool:
        connection.current_directory = PurePosixPath(await self._work(self._folder, self._path(connection, str(rest))))
        connection.response("250", "ok")
        return True

    async def cdup(self, connection: Any, rest: Any) -> bool:
        return await self.cwd(connection, "..")

    async def size(self, connection: Any, rest: str) -> bool:
        status = await self._work(self._status, self._path(connection, rest))
        if not stat.S_ISREG(status.st_mode):
            raise DelfimError("not a plain file")
        connection.response("213", str(status.st_size))
        return True

    async def mdtm(self, connection: Any, rest: str) -> bool:
        status = await self._work(self._status, self._path(connection, rest))
        connection.response("213", _stamp(status.st_mtime))
        return True

    async def mlst(self, connection: Any, rest: Any) -> bool:
        path = self._path(connection, rest)
        status = await self._work(self._status, path)
        connection.response("250", ("Facts:", _facts_line(path, status), "End"), True)
        return True

    async def ls(self, connection: Any, rest: str) -> bool:
        return await self._list(connection, _without_options(rest), self._list_line)

    async def nlst(self, connection: Any, rest: str) -> bool:
        return await self._list(connection, _without_options(rest), lambda name, status: name)

    async def mlsd(self, connection: Any, rest: Any) -> bool:
        return await self._list(connection, rest, _facts_line)

    async def _list(self, connection: Any, rest: str, line: Callable[[str, os.stat_result], str]) -> bool:
        folder, _, names = rest.rpartition("/")
        if set(names) & set("*?["):  # clients leave it to the server which names are meant
            path = self._path(connection, folder or ("/" if rest.startswith("/") else ""))
            before = f"{folder}/" if "/" in rest else ""
            lines = await self._work(self._listed, path, lambda name, status: line(before + name, status), names)
        else:
            lines = await self._work(self._listed, self._path(connection, rest), line)
        text = "".join(f"{each}\r\n" for each in lines).encode("utf-8", "surrogateescape")
        async with carried(connection) as stream:
            for start in range(0, len(text), BLOCK_BYTES):
                await stream.write(text[start : start + BLOCK_BYTES])
        return True

    async def stat(self, connection: Any, rest: str) -> bool:
        if rest:
            lines = await self._work(self._listed, self._path(connection, _without_options(rest)), self._list_line)
            connection.response("213", ("Status:", *lines, "End"), True)
        else:
            connection.response("211", f"{self._boat}: {connection.user.login} is logged in")
        return True

    async def retr(self, connection: Any, rest: Any) -> bool:
        offset = self._offset(connection)
        sent = offset
        with contextlib.ExitStack() as closing:
            fd = await self._work(self._opened, closing, self._path(connection, rest))
            try:
                async with carried(connection) as stream:
                    while block := await self._work(os.pread, fd, BLOCK_BYTES, sent):
                        await stream.write(block)
                        sent += len(block)
            finally:
                self.sent_bytes += sent - offset
                log.info("ftpd: %s read %r, %d bytes", connection.user.login, rest, sent - offset)
        return True

    async def stor(self, connection: Any, rest: Any, append: bool = False) -> bool:
        """Store into a part file, renamed when all of it is on the disk. A broken upload leaves its part, to be resumed."""
        path, offset = self._writable(connection, rest), self._offset(connection)
        with contextlib.ExitStack() as closing:
            fd, began = await self._work(_part, closing, self.uploads, path, offset, append)
            at = began
            try:
                async with carried(connection) as stream:
                    while block := await stream.read(BLOCK_BYTES):
                        await self._work(self.uploads.write, fd, block, at)
                        at += len(block)
                    await self._work(os.fsync, fd)
                    if connection.aborted or connection.command_connection.reader.at_eof():  # both look like the end
                        raise ConnectionAbortedError
                    await self._work(self.uploads.finish, fd, path)
            finally:
                self.received_bytes += at - began
                log.warning("ftpd: %s wrote %r, %d bytes", connection.user.login, path, at - began)
        return True

    async def appe(self, connection: Any, rest: Any) -> bool:
        return await self.stor(connection, rest, append=True)

    async def dele(self, connection: Any, rest: Any) -> bool:
        return await self._changed(connection, self.uploads.remove, self._writable(connection, rest))

    async def mkd(self, connection: Any, rest: Any) -> bool:
        path = self._writable(connection, rest)
        await self._work(self.uploads.make_folder, path)
        connection.response("257", f'"{path}"')
        return True

    async def rmd(self, connection: Any, rest: Any) -> bool:
        return await self._changed(connection, self.uploads.remove_folder, self._writable(connection, rest))

    async def rnfr(self, connection: Any, rest: Any) -> bool:
        path = self._writable(connection, rest)
        await self._work(self.uploads.apply, path, os.fstat)
        connection.rename_from = path
        connection.response("350", "send RNTO")
        return True

    async def rnto(self, connection: Any, rest: Any) -> bool:
        if not connection.future.rename_from.done():
            connection.response("503", "send RNFR first")
            return True
        source = connection.rename_from
        del connection.rename_from
        return await self._changed(connection, self.uploads.rename, source, self._writable(connection, rest))

    async def _changed(self, connection: Any, do: Callable[..., None], *paths: str) -> bool:
        await self._work(do, *paths)
        log.warning("ftpd: %s: %s %s", connection.user.login, do.__name__, " ".join(map(repr, paths)))
        connection.response("250", "ok")
        return True

    def _path(self, connection: Any, rest: str) -> str:
        """The client's path, from the root."""
        return os.path.normpath(os.path.join("/", str(connection.current_directory), rest))

    def _writable(self, connection: Any, rest: str) -> str:
        """The client's path, from the root, for users who may write. Raises DelfimError."""
        if not self._users[connection.user.login or ""].upload:
            raise DelfimError("this user may not write")
        return self._path(connection, rest)

    def _offset(self, connection: Any) -> int:
        """The offset that REST set; it counts once."""
        offset: int = connection.offset if connection.future.offset.done() else 0
        connection.offset = 0
        return offset

    # Blocking calls, run by a worker.

    def _opened(self, closing: contextlib.ExitStack, path: str) -> int:
        fd = self._jail.open(path)
        closing.callback(os.close, fd)
        return fd

    def _folder(self, path: str) -> str:
        """The path of a folder as clients see it, links followed."""
        with self._jail.folder(path):
            return self._jail.shown(self._jail.real(path))

    def _status(self, path: str) -> os.stat_result:
        """The status of a file, or of its part until the rest comes."""
        try:
            return self._jail.status(path)
        except FileNotFoundError:
            if self.uploads.has(path):
                return self._jail.status(path + PART)
            raise

    def _listed(self, path: str, line: Callable[[str, os.stat_result], str], pattern: str = "*") -> list[str]:
        """List a line for each entry, or for the file itself. Links that lead out are left out."""
        status = self._jail.status(path)
        if not stat.S_ISDIR(status.st_mode):
            return [line(os.path.basename(path), status)]
        found = []
        with self._jail.folder(path) as folder:
            names = sorted(name for name in fnmatch.filter(os.listdir(folder), pattern) if not set(name) & {"\r", "\n"})
            for name in islice((name for name in names if name[0] != "."), ENTRIES_MAX):
                with contextlib.suppress(OSError, DelfimError):
                    status = os.stat(name, dir_fd=folder, follow_symlinks=False)
                    is_link = stat.S_ISLNK(status.st_mode)
                    found.append(line(name, self._jail.status(os.path.join(path, name)) if is_link else status))
        return found

    def _list_line(self, name: str, status: os.stat_result) -> str:
        """Format an entry as `ls -l` does, for programs that parse it: the time of day for half a year, then the year."""
        at = datetime.fromtimestamp(status.st_mtime, UTC)
        is_new = abs(self._clock.time_ns() / 1e9 - status.st_mtime) < HALF_A_YEAR_S
        when = f"{at:%H:%M}" if is_new else f" {at:%Y}"
        date = f"{MONTHS[at.month - 1]} {at.day:2} {when}"
        return f"{stat.filemode(status.st_mode)} {status.st_nlink:3} boat boat {status.st_size:12} {date} {name}"


def _part(closing: contextlib.ExitStack, uploads: Uploads, path: str, offset: int, append: bool) -> tuple[int, int]:
    """Open the part of an upload for this client alone, closed by `closing`; returns it and where to go on writing. A file of
    that name stays until all of the new one is there. Raises DelfimError, OSError."""
    fd = uploads.open(path + PART, os.O_RDWR | os.O_CREAT, alone=True)
    closing.callback(os.close, fd)
    if (append or offset) and not os.fstat(fd).st_size:
        with contextlib.suppress(FileNotFoundError):
            uploads.copy(path, fd)
    size = os.fstat(fd).st_size
    if offset > size:
        raise DelfimError(f"there are only {size} bytes of it")
    at = size if append else offset
    os.ftruncate(fd, at)
    return fd, at


def _without_options(rest: str) -> str:
    """Strip options, as of `LIST -la folder`: clients speak to servers as if they were `ls`."""
    words = rest.split(" ")
    while words and words[0].startswith("-"):
        words.pop(0)
    return " ".join(words)


def _facts_line(name: str, status: os.stat_result) -> str:
    """Format the facts of an entry (RFC 3659, 7.2)."""
    kind = "dir" if stat.S_ISDIR(status.st_mode) else "file"
    return f"type={kind};size={status.st_size};modify={_stamp(status.st_mtime)}; {name}"


def _stamp(time_s: float) -> str:
    """Format a time (RFC 3659, 2.3)."""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y%m%d%H%M%S}"
