"""sshd: programs on the boat with their input and output here, a shell, files (the thesis' rshd, 2.8, 3.3; RFC 4251-4254).

It stands on asyncssh. Public keys only; the host key is ed25519, made at the first start and kept; of key exchanges those that
cost the loop little. All is done as one user of the system, whom the process becomes before it serves anybody. Nothing is
forwarded. Whoever comes and whatever is run is logged. Files are read and written by two workers, inside of a jail. How it is
used: docs/sshd.md.
"""

import asyncio
import contextlib
import errno
import fcntl
import functools
import io
import logging
import os
import pwd
import re
import signal
import struct
import sys
import termios
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import asyncssh

from delfim import config
from delfim.clock import Clock
from delfim.errors import DelfimError, PermanentFailure
from delfim.services.door import Door, Patience, bulk
from delfim.services.jail import Jail
from delfim.services.nocan import forbid_can
from delfim.services.runtime import Runtime
from delfim.services.uploads import NoRoom, Uploads

KEX: Final = ("mlkem768x25519-sha256", "curve25519-sha256", "curve25519-sha256@libssh.org", "ecdh-sha2-nistp256")
LOGIN_S: Final = 30.0  # from the connection to the login
STALL_S: Final = 60.0  # a client that reads nothing for so long is gone
ALIVE_S: Final = 15.0  # a client is asked whether it is there ...
ALIVE_MAX: Final = 4  # ... and is not when it did not answer so often
HANG_UP_S: Final = 2.0  # that programs have to end when their client went away or the first of them has ended
LEAVE_S: Final = 2.0  # before SIGHUP: `setsid program &` on a slow computer has not left the session when its shell ends
LOOK_S: Final = 0.02  # between two looks whether they have
BLOCK_BYTES: Final = 64 << 10
READ_BYTES: Final = 32 << 10  # of a file, at once: more drives the vehicle out of the processor's cache
WRONG_MAX: Final = 6  # keys of one connection
SFTP_VERSION: Final = 3
SIGNALS: Final = signal.Signals.__members__  # by name
PATH: Final = f"/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin:{Path(sys.executable).parent}"  # delfim, too
# The first terminal that the leader of a session opens becomes that session's.
ON_TERMINAL: Final = ("/bin/sh", "-c", 'exec <"$0" >"$0" 2>&1; exec "$@"')

asyncssh.sftp.MAX_SFTP_READ_LEN = READ_BYTES  # what clients are told; there is no other way to say it
log = logging.getLogger(__name__)


class Daemon:
    """What all connections share."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        table = settings.sshd
        self.table, self.clock_s = table, clock.monotonic_s
        self.keys = {name: _public(name, user.keys) for name, user in table.users.items()}
        self.jail, self.uploads = Jail(table.root), Uploads(table.root, settings.log)
        self.workers = ThreadPoolExecutor(2, "sshd")
        self.door, self.patience = Door(table.connections, table.connections_per_address), Patience()
        self.sessions = self.commands = 0
        self._visitors: set[Visitor] = set()
        self._children: set[asyncio.subprocess.Process] = set()

    def figures(self) -> dict[str, object]:
        return {
            "connections": self.door.inside.total(),
            "refused": self.door.refused,
            "wrong_keys": self.patience.failures,
            "sessions": self.sessions,
            "commands": self.commands,
        }

    async def listen(self) -> asyncssh.SSHAcceptor:
        """Raises OSError, PermanentFailure."""
        loop, table = asyncio.get_running_loop(), self.table
        host_key = await loop.run_in_executor(self.workers, _host_key, table.host_key)
        await loop.run_in_executor(self.workers, self.uploads.prepare)
        host, _, port = table.listen.rpartition(":")
        acceptor = await asyncssh.create_server(
            self._visitor,
            host,
            int(port),
            backlog=16,
            server_host_keys=[host_key],
            kex_algs=KEX,
            encoding=None,
            line_editor=False,
            password_auth=False,
            kbdint_auth=False,
            host_based_auth=False,
            gss_host=None,
            agent_forwarding=False,
            x11_forwarding=False,
            login_timeout=LOGIN_S,
            keepalive_interval=ALIVE_S,
            keepalive_count_max=ALIVE_MAX,
            server_version="Delfim",
        )
        try:
            if table.user:
                _become(table.user, self.uploads.folder, can=table.can)
        except PermanentFailure:
            acceptor.close()
            raise
        return acceptor

    def _visitor(self) -> "Visitor":
        return Visitor(self, self._visitors)

    async def close(self) -> None:
        """Hang up, and see to it that no program stays behind."""
        for visitor in list(self._visitors):
            visitor.hang_up()
        for child in self._children:
            _end(child.pid, signal.SIGKILL)
        await asyncio.gather(*(child.wait() for child in self._children))
        self.workers.shutdown(wait=False, cancel_futures=True)

    def session(self) -> "Process":
        return Process(self.run, lambda channel: Files(channel, self.jail, self.uploads, self.workers), SFTP_VERSION, True)

    async def run(self, process: "asyncssh.SSHServerProcess[bytes]") -> None:
        """A program, or the shell, from its start to its exit status."""
        assert isinstance(process, Process)
        visitor = process.channel.get_connection().get_owner()
        name = (
            "a shell" if process.command is None else repr(process.command)
        )  # so that no command looks like a line of the log
        if process.subsystem is not None or self.sessions >= self.table.sessions:
            process.stderr.write(b"too many programs are running\n" if process.subsystem is None else b"there is only sftp\n")
            process.exit(1)
            return
        self.sessions += 1
        self.commands += 1
        log.warning("sshd: %s runs %s", visitor, name)
        try:
            code = await (self._on_terminal if process.term_type else self._on_pipes)(process)
            log.warning("sshd: %s: %s ended with %d", visitor, name, code)
            if 0 < -code <= signal.SIGSYS:  # the last one that has a name
                process.exit_with_signal(signal.Signals(-code).name.removeprefix("SIG"))
            else:
                process.exit(code if code >= 0 else 128 - code)
        except OSError as error:
            log.warning("sshd: %s: %s: %s", visitor, name, error.strerror)
            process.stderr.write(f"{error.strerror}\n".encode())
            process.exit(127)
        finally:
            self.sessions -= 1

    def _words(self, process: "Process") -> tuple[tuple[str, ...], dict[str, str], str]:
        """(program and arguments, environment, directory)."""
        account = pwd.getpwuid(os.getuid())
        words = (self.table.shell, "-l") if process.command is None else (self.table.shell, "-c", process.command)
        names = {"USER": account.pw_name, "LOGNAME": account.pw_name, "HOME": account.pw_dir, "SHELL": self.table.shell}
        more = {"TERM": process.term_type} if process.term_type else {}
        home = account.pw_dir if os.path.isdir(account.pw_dir) else "/"
        return words, {"PATH": PATH, "LANG": "C.UTF-8", **names, **more}, home

    async def _on_pipes(self, process: "Process") -> int:
        words, names, home = self._words(process)
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
            feed, stdin = _pipe(ours, theirs, reads=False)
            out, stdout = _pipe(ours, theirs, reads=True)
            err, stderr = _pipe(ours, theirs, reads=True)
            child = await asyncio.create_subprocess_exec(
                *words, env=names, cwd=home, stdin=stdin, stdout=stdout, stderr=stderr, start_new_session=True
            )
            theirs.close()
            return await self._attended(process, child, feed, {out: process.stdout, err: process.stderr}, theirs)

    async def _on_terminal(self, process: "Process") -> int:
        words, names, home = self._words(process)
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
            fd, slave = os.openpty()
            terminal = ours.enter_context(_Pipe(fd))
            theirs.callback(os.close, slave)  # when the program has ended: a terminal that nobody has open is over
            _resize(terminal, process.term_size)
            process.on_resize = functools.partial(_resize, terminal)
            null = asyncio.subprocess.DEVNULL
            child = await asyncio.create_subprocess_exec(
                *ON_TERMINAL, os.ttyname(slave), *words,
                env=names, cwd=home, stdin=null, stdout=null, stderr=null, start_new_session=True,
            )  # fmt: skip
            return await self._attended(process, child, terminal, {terminal: process.stdout}, theirs)

    async def _attended(
        self,
        process: "Process",
        child: asyncio.subprocess.Process,
        stdin: "_Pipe",
        sinks: "dict[_Pipe, asyncssh.SSHWriter[bytes]]",
        theirs: contextlib.ExitStack,
    ) -> int:
        """What the client says goes in and what the program says comes out, until the program has ended and all of it is sent,
        or the client has gone. Returns the exit status, or the negative number of the signal that ended the program."""
        self._children.add(child)
        process.on_signal = functools.partial(_signal, child)
        try:
            async with asyncio.TaskGroup() as group:
                gone = group.create_task(process.channel.wait_closed())
                feeding = group.create_task(_feed(process, child, stdin, is_terminal=stdin in sinks))
                over = group.create_task(_over(child, sinks, theirs))
                await asyncio.wait((gone, over), return_when=asyncio.FIRST_COMPLETED)
                for task in (gone, feeding, over):
                    task.cancel()
            await _empty(child.pid, LEAVE_S)
            _end(child.pid, signal.SIGHUP)
            await _empty(child.pid, HANG_UP_S)
        finally:
            _end(child.pid, signal.SIGKILL)
            self._children.discard(child)
        return await child.wait()


class _Pipe:
    """Our end of a pipe or of a terminal. Nothing is read before it can go on, so that a slow client slows the program."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        os.set_blocking(fd, False)

    def __enter__(self) -> "_Pipe":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    async def read(self) -> bytes:
        """Empty when all who could write have closed it."""
        while True:
            try:
                return os.read(self.fd, BLOCK_BYTES)
            except BlockingIOError:
                loop = asyncio.get_running_loop()
                await _once(loop.add_reader, loop.remove_reader, self.fd)
            except OSError:  # EIO: a terminal says it so
                return b""

    async def write(self, data: bytes) -> None:
        """Raises OSError when nobody reads any more."""
        while data:
            try:
                data = data[os.write(self.fd, data) :]
            except BlockingIOError:
                loop = asyncio.get_running_loop()
                await _once(loop.add_writer, loop.remove_writer, self.fd)


def _pipe(ours: contextlib.ExitStack, theirs: contextlib.ExitStack, *, reads: bool) -> tuple[_Pipe, int]:
    """(our end, the program's)."""
    reading, writing = os.pipe()
    mine, other = (reading, writing) if reads else (writing, reading)
    theirs.callback(os.close, other)
    return ours.enter_context(_Pipe(mine)), other


async def _once(add: Callable[..., Any], remove: Callable[[int], object], fd: int) -> None:
    """Until the descriptor is ready."""
    ready = asyncio.Event()
    add(fd, ready.set)
    try:
        await ready.wait()
    finally:
        remove(fd)


async def _over(
    child: asyncio.subprocess.Process, sinks: "dict[_Pipe, asyncssh.SSHWriter[bytes]]", theirs: contextlib.ExitStack
) -> None:
    """The program has ended, and all that it and its children wrote is sent."""
    async with asyncio.TaskGroup() as group:
        for pipe, sink in sinks.items():
            group.create_task(_pour(pipe, sink))
        await child.wait()
        theirs.close()


async def _pour(pipe: _Pipe, sink: "asyncssh.SSHWriter[bytes]") -> None:
    with contextlib.suppress(OSError, asyncssh.Error):  # the client has gone: `_attended` sees it
        while data := await pipe.read():
            sink.write(data)
            await sink.drain()


async def _feed(process: "Process", child: asyncio.subprocess.Process, pipe: _Pipe, *, is_terminal: bool) -> None:
    """What the client says. What the program does not want to read is thrown away."""
    while True:
        try:
            data = await process.stdin.read(BLOCK_BYTES)
            if not data:
                break
            if pipe.fd >= 0:
                await pipe.write(data)
        except asyncssh.Error:
            break
        except OSError:
            if is_terminal:
                break
            pipe.close()
    if not is_terminal:
        pipe.close()


class Process(asyncssh.SSHServerProcess[bytes]):
    """A session. The window's size and signals are heeded at once: asyncssh would keep each until what was typed before it is
    read, however many they are."""

    on_resize: Callable[[tuple[int, int, int, int]], None] = staticmethod(lambda size: None)
    on_signal: Callable[[int], None] = staticmethod(lambda number: None)

    def terminal_size_changed(self, width: int, height: int, pixwidth: int, pixheight: int) -> None:
        self.on_resize((width, height, pixwidth, pixheight))

    def signal_received(self, signal: str) -> None:
        self.on_signal(SIGNALS.get(f"SIG{signal}", SIGNALS["SIGTERM"]))

    def break_received(self, msec: int) -> bool:
        self.on_signal(SIGNALS["SIGINT"])
        return True


class Visitor(asyncssh.SSHServer):
    """One connection."""

    def __init__(self, daemon: Daemon, all_of_them: "set[Visitor]") -> None:
        self._daemon, self._all = daemon, all_of_them
        self._connection: asyncssh.SSHServerConnection | None = None
        self._address = self._name = ""
        self._wrong, self._is_in = 0, False

    def __str__(self) -> str:
        return f"{self._name} from {self._address}"

    def connection_made(self, conn: asyncssh.SSHServerConnection) -> None:
        address = str(conn.get_extra_info("peername")[0])
        if not self._daemon.door.enter(address):
            conn.abort()
            return
        self._connection, self._address = conn, address
        self._all.add(self)
        bulk(conn.get_extra_info("socket"), STALL_S)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._connection is None:
            return
        self._all.discard(self)
        daemon = self._daemon
        daemon.door.leave(self._address)
        if self._wrong and not self._is_in:
            daemon.patience.failed(self._address, daemon.clock_s())

    def hang_up(self) -> None:
        if self._connection is not None:
            self._connection.abort()

    def session_requested(self) -> "Process":
        return self._daemon.session()

    async def begin_auth(self, username: str) -> bool:
        self._name = username[:64]
        await asyncio.sleep(self._daemon.patience.pause_s(self._address, self._daemon.clock_s()))
        return True

    def public_key_auth_supported(self) -> bool:
        return True

    def validate_public_key(self, username: str, key: asyncssh.SSHKey) -> bool:
        if key.public_data in self._daemon.keys.get(username, ()):
            return True
        self._wrong += 1
        log.warning("sshd: wrong key %s for %r from %s", key.get_fingerprint(), self._name, self._address)
        if self._wrong >= WRONG_MAX and self._connection is not None:
            self._connection.disconnect(asyncssh.DISC_NO_MORE_AUTH_METHODS_AVAILABLE, "too many keys")
        return False

    def auth_completed(self) -> None:
        self._is_in = True
        self._daemon.patience.succeeded(self._address)
        log.warning("sshd: %s logged in", self)


def _in_worker(name: str) -> Any:
    """asyncssh's own method, which blocks, in a worker."""
    do = getattr(asyncssh.SFTPServer, name)

    async def method(files: "Files", *arguments: Any) -> Any:
        return await files.work(do, files, *arguments)

    return method


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """A refusal as SFTP can say it: an OSError."""
    try:
        yield
    except DelfimError as error:
        raise OSError(errno.ENOSPC if isinstance(error, NoRoom) else errno.EACCES, str(error)) from None


def _apply(fd: int, attrs: asyncssh.SFTPAttrs) -> None:
    """Size, rights and times of a file. Raises OSError."""
    if attrs.uid is not None or attrs.gid is not None:
        raise PermissionError(errno.EACCES, "files stay their owner's")
    if attrs.size is not None:
        os.truncate(f"/proc/self/fd/{fd}", attrs.size)
    if attrs.permissions is not None:
        os.fchmod(fd, attrs.permissions & 0o777)
    if attrs.mtime is not None:
        os.utime(fd, (attrs.mtime if attrs.atime is None else attrs.atime, attrs.mtime))


class _File(io.FileIO):
    """An open file. Once a write has failed all fail: clients send many at once and overlook a failure between successes."""

    failure = ""


class Files(asyncssh.SFTPServer):
    """SFTP and SCP inside of the jail. Every call is a worker's; no link can be made, and those that lead out are not there."""

    def __init__(self, channel: Any, jail: Jail, uploads: Uploads, workers: ThreadPoolExecutor) -> None:
        super().__init__(channel, chroot=os.fsencode(jail.root))
        self._jail, self._uploads, self._workers = jail, uploads, workers
        self._visitor = str(channel.get_connection().get_owner())

    def note(self, did: str, *what: object) -> None:
        log.warning("sshd: %s: %s %s", self._visitor, did, " ".join(repr(_normal(w)) for w in what if isinstance(w, bytes)))

    def exit(self) -> None:
        """At the end of a session, with the exit status that scp waits for."""
        self.channel.exit(0)

    async def work(self, do: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._workers, do, *arguments)

    def map_path(self, path: bytes) -> bytes:
        """In a worker. Raises OSError."""
        with _told():
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
        with _told():
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
            with contextlib.suppress(OSError):  # what leads out, and what just went
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
        with _told():
            if file_obj.failure:
                raise NoRoom(file_obj.failure)
            try:
                await self.work(self._uploads.write, file_obj.fileno(), data, offset)
            except NoRoom as error:
                file_obj.failure = str(error)
                raise
        return len(data)

    async def _change(self, did: str, do: Callable[..., None], *paths: bytes) -> None:
        """In the folder of uploads. Raises OSError."""
        with _told():
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
        """As `posix_rename`, but nothing is replaced."""
        if await self.work(lambda: os.path.lexists(self.map_path(newpath))):
            raise asyncssh.SFTPFileAlreadyExists("there is such a file")
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


async def serve(runtime: Runtime) -> None:
    """The service."""
    settings = runtime.config
    status = runtime.status.get("sshd")
    if settings.sshd.user and status is not None and status.place == "runtime":
        raise PermanentFailure("sshd.user: the vehicle cannot become another user; say services.sshd.place = 'process'")
    daemon = Daemon(settings, runtime.clock)
    acceptor = await daemon.listen()
    address = "ssh://{}:{}".format(*acceptor.sockets[0].getsockname()[:2])
    runtime.board["sshd"] = lambda: {"address": address, **daemon.figures()}
    log.warning("sshd: %s", address)
    try:
        await asyncio.Event().wait()
    finally:
        del runtime.board["sshd"]
        acceptor.close()
        await daemon.close()


def _normal(path: bytes) -> str:
    """What a client means, from the root; ".." ends there."""
    return os.path.normpath(os.path.join("/", os.fsdecode(path)))


def _public(name: str, lines: tuple[str, ...]) -> frozenset[bytes]:
    """Raises PermanentFailure for what is no public key."""
    try:
        return frozenset(asyncssh.import_public_key(line).public_data for line in lines)
    except asyncssh.KeyImportError as error:
        raise PermanentFailure(f"sshd.users.{name}.keys: {error}") from None


def _host_key(path: str) -> asyncssh.SSHKey:
    """The boat's key; made where there is none. Raises OSError, PermanentFailure for a file that is no key."""
    try:
        return asyncssh.read_private_key(path)
    except FileNotFoundError:
        pass
    except (asyncssh.KeyImportError, ValueError, re.error) as error:  # it makes patterns of what it reads
        raise PermanentFailure(f"sshd.host_key: {path}: {error}") from None
    key = asyncssh.generate_private_key("ssh-ed25519")
    os.makedirs(os.path.dirname(path), mode=0o700, exist_ok=True)
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    try:
        os.write(fd, key.export_private_key("openssh"))
        os.fsync(fd)
    finally:
        os.close(fd)
    log.warning("sshd: made a host key, %s", key.get_fingerprint())
    return key


def _become(name: str, folder: str, *, can: bool) -> None:
    """And give this user the folder of uploads, but CAN sockets only where the vehicle's file says so. Raises PermanentFailure
    where there is no such user or this one may not."""
    try:
        account = pwd.getpwnam(name)
        if account.pw_uid != os.getuid():
            with contextlib.suppress(FileNotFoundError):
                os.chown(folder, account.pw_uid, account.pw_gid, follow_symlinks=False)
            if not can:
                _without_can()
            os.initgroups(name, account.pw_gid)
            os.setgid(account.pw_gid)
            os.setuid(account.pw_uid)
    except (KeyError, PermissionError):
        raise PermanentFailure(f"sshd.user: {name}: there is no such user, or this one cannot become it") from None


def _without_can() -> None:
    try:
        forbid_can()
    except OSError as error:
        log.warning("sshd: whoever has a shell can send on the CAN buses: %s", error.strerror)


def _resize(terminal: _Pipe, size: tuple[int, int, int, int]) -> None:
    """`size` as SSH has it: columns, rows, width, height."""
    columns, rows, width, height = (min(each, 0xFFFF) for each in size)
    if terminal.fd >= 0:
        fcntl.ioctl(terminal.fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, width, height))


def _signal(child: asyncio.subprocess.Process, number: int) -> None:
    """To a program and what it runs in the foreground."""
    if child.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)


def _end(session: int, number: int) -> None:
    """To all of a session, in the background too, and when the program that began it has ended."""
    for pid in _session(session):
        with contextlib.suppress(ProcessLookupError, PermissionError):  # one that has become another user is not ours to end
            os.kill(pid, number)


async def _empty(session: int, within_s: float) -> None:
    """Until nobody lives in a session any more, at most so long."""
    for _ in range(round(within_s / LOOK_S)):
        if not _session(session):
            return
        await asyncio.sleep(LOOK_S)


def _session(session: int) -> list[int]:
    """Processes that live in a session."""
    found = []
    for name in os.listdir("/proc"):
        with contextlib.suppress(OSError, ValueError):  # gone meanwhile, or no process
            state, _, _, sid, *_ = Path("/proc", str(int(name)), "stat").read_text().rpartition(")")[2].split()
            if int(sid) == session and state != "Z":
                found.append(int(name))
    return found
