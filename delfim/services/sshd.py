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
import logging
import os
import pwd
import signal
import struct
import termios
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import asyncssh

from delfim import config
from delfim.clock import Clock
from delfim.errors import DelfimError, PermanentFailure
from delfim.logging.guard import free_bytes
from delfim.services.door import Door, Patience, bulk
from delfim.services.jail import Jail
from delfim.services.runtime import Runtime

KEX: Final = ("mlkem768x25519-sha256", "curve25519-sha256", "curve25519-sha256@libssh.org", "ecdh-sha2-nistp256")
LOGIN_S: Final = 30.0  # from the connection to the login
STALL_S: Final = 60.0  # a client that reads nothing for so long is gone
ALIVE_S: Final = 15.0  # a client is asked whether it is there ...
ALIVE_MAX: Final = 4  # ... and is not when it did not answer so often
HANG_UP_S: Final = 2.0  # that a program has to end when its client went away
BLOCK_BYTES: Final = 64 << 10
READ_BYTES: Final = 32 << 10  # of a file, at once: more drives the vehicle out of the processor's cache
WRONG_MAX: Final = 6  # keys of one connection
PATH: Final = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
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
        self.jail, self.free_bytes_min = Jail(table.root), settings.log.free_bytes_min
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
        host, _, port = table.listen.rpartition(":")
        acceptor = await asyncssh.create_server(
            self._visitor,
            host,
            int(port),
            backlog=16,
            server_host_keys=[host_key],
            process_factory=self.run,
            sftp_factory=lambda channel: Files(channel, self.jail, self.workers, self.free_bytes_min),
            allow_scp=True,
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
                _become(table.user)
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
            _signal(child, signal.SIGKILL)
        await asyncio.gather(*(child.wait() for child in self._children))
        self.workers.shutdown(wait=False, cancel_futures=True)

    async def run(self, process: "asyncssh.SSHServerProcess[bytes]") -> None:
        """A program, or the shell, from its start to its exit status."""
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

    def _words(self, process: "asyncssh.SSHServerProcess[bytes]") -> tuple[tuple[str, ...], dict[str, str], str]:
        """(program and arguments, environment, directory)."""
        account = pwd.getpwuid(os.getuid())
        words = (self.table.shell, "-l") if process.command is None else (self.table.shell, "-c", process.command)
        names = {"USER": account.pw_name, "LOGNAME": account.pw_name, "HOME": account.pw_dir, "SHELL": self.table.shell}
        more = {"TERM": process.term_type} if process.term_type else {}
        home = account.pw_dir if os.path.isdir(account.pw_dir) else "/"
        return words, {"PATH": PATH, "LANG": "C.UTF-8", **names, **more}, home

    async def _on_pipes(self, process: "asyncssh.SSHServerProcess[bytes]") -> int:
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

    async def _on_terminal(self, process: "asyncssh.SSHServerProcess[bytes]") -> int:
        words, names, home = self._words(process)
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
            fd, slave = os.openpty()
            terminal = ours.enter_context(_Pipe(fd))
            theirs.callback(os.close, slave)  # when the program has ended: a terminal that nobody has open is over
            _resize(fd, process.term_size)
            null = asyncio.subprocess.DEVNULL
            child = await asyncio.create_subprocess_exec(
                *ON_TERMINAL, os.ttyname(slave), *words,
                env=names, cwd=home, stdin=null, stdout=null, stderr=null, start_new_session=True,
            )  # fmt: skip
            return await self._attended(process, child, terminal, {terminal: process.stdout}, theirs)

    async def _attended(
        self,
        process: "asyncssh.SSHServerProcess[bytes]",
        child: asyncio.subprocess.Process,
        stdin: "_Pipe",
        sinks: "dict[_Pipe, asyncssh.SSHWriter[bytes]]",
        theirs: contextlib.ExitStack,
    ) -> int:
        """What the client says goes in and what the program says comes out, until the program has ended and all of it is sent,
        or the client has gone. Returns the exit status, or the negative number of the signal that ended the program."""
        self._children.add(child)
        try:
            async with asyncio.TaskGroup() as group:
                gone = group.create_task(process.channel.wait_closed())
                feeding = group.create_task(_feed(process, child, stdin, is_terminal=stdin in sinks))
                over = group.create_task(_over(child, sinks, theirs))
                await asyncio.wait((gone, over), return_when=asyncio.FIRST_COMPLETED)
                for task in (gone, feeding, over):
                    task.cancel()
            if child.returncode is None:
                _signal(child, signal.SIGHUP)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(HANG_UP_S):
                        await child.wait()
        finally:
            _signal(child, signal.SIGKILL)
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


async def _feed(
    process: "asyncssh.SSHServerProcess[bytes]", child: asyncio.subprocess.Process, pipe: _Pipe, *, is_terminal: bool
) -> None:
    """Bytes, signals, and the size of the client's window. What the program does not want to read is thrown away."""
    while True:
        try:
            data = await process.stdin.read(BLOCK_BYTES)
            if not data:
                break
            if pipe.fd >= 0:
                await pipe.write(data)
        except asyncssh.TerminalSizeChanged as changed:
            if is_terminal:
                _resize(pipe.fd, changed.term_size)
        except asyncssh.SignalReceived as told:
            _signal(child, signal.Signals.__members__.get(f"SIG{told.signal}", signal.SIGTERM))
        except asyncssh.BreakReceived:
            _signal(child, signal.SIGINT)
        except asyncssh.Error:
            break
        except OSError:
            if is_terminal:
                break
            pipe.close()
    if not is_terminal:
        pipe.close()


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


def _in_worker(name: str, *, changes: bool = False) -> Any:
    """asyncssh's own method, which blocks, in a worker. What changes something is logged."""
    do = getattr(asyncssh.SFTPServer, name)

    async def method(files: "Files", *arguments: Any) -> Any:
        done = await files.work(do, files, *arguments)
        if changes:
            files.note(name, *arguments)
        return done

    return method


class Files(asyncssh.SFTPServer):
    """SFTP and SCP inside of the jail. Every call is a worker's; no link can be made, and those that lead out are not there."""

    def __init__(self, channel: Any, jail: Jail, workers: ThreadPoolExecutor, free_bytes_min: int) -> None:
        super().__init__(channel, chroot=os.fsencode(jail.root))
        self._jail, self._workers, self._free_bytes_min = jail, workers, free_bytes_min
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
        try:
            return os.fsencode(self._jail.real(_normal(path)))
        except DelfimError as error:
            raise PermissionError(errno.EACCES, str(error)) from None

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
        try:
            fd = self._jail.open(_normal(path), flags, mode)
        except DelfimError as error:
            raise PermissionError(errno.EACCES, str(error)) from None
        if pflags & asyncssh.FXF_TRUNC:
            os.ftruncate(fd, 0)
        return os.fdopen(fd, "r+b" if reads and writes else "wb" if writes else "rb", buffering=0)

    def _closed(self, file: Any) -> None:
        if file.writable():
            os.fsync(file.fileno())
        file.close()

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
        return int(await self.work(self._written, file_obj.fileno(), data, offset))

    def _written(self, fd: int, data: bytes, offset: int) -> int:
        """Raises OSError where the logs need the room."""
        if free_bytes(self._jail.root) < self._free_bytes_min:
            raise OSError(errno.ENOSPC, "the disk is full")
        written = 0
        while written < len(data):
            written += os.pwrite(fd, data[written:], offset + written)
        return written

    def symlink(self, oldpath: bytes, newpath: bytes) -> None:
        raise PermissionError(errno.EACCES, "no links here")

    def link(self, oldpath: bytes, newpath: bytes) -> None:
        self.symlink(oldpath, newpath)

    def readlink(self, path: bytes) -> bytes:
        raise PermissionError(errno.EACCES, "no links here")

    stat, lstat, fstat, realpath = _in_worker("stat"), _in_worker("lstat"), _in_worker("fstat"), _in_worker("realpath")
    statvfs, fstatvfs, fsync, fsetstat = (_in_worker(name) for name in ("statvfs", "fstatvfs", "fsync", "fsetstat"))
    setstat, lsetstat = _in_worker("setstat", changes=True), _in_worker("lsetstat", changes=True)
    remove, mkdir, rmdir = (_in_worker(name, changes=True) for name in ("remove", "mkdir", "rmdir"))
    rename, posix_rename = _in_worker("rename", changes=True), _in_worker("posix_rename", changes=True)


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
    except asyncssh.KeyImportError as error:
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


def _become(name: str) -> None:
    """Raises PermanentFailure where there is no such user or this one may not."""
    try:
        account = pwd.getpwnam(name)
        if account.pw_uid != os.getuid():
            os.initgroups(name, account.pw_gid)
            os.setgid(account.pw_gid)
            os.setuid(account.pw_uid)
    except (KeyError, PermissionError):
        raise PermanentFailure(f"sshd.user: {name}: there is no such user, or this one cannot become it") from None


def _resize(fd: int, size: tuple[int, int, int, int]) -> None:
    """`size` as SSH has it: columns, rows, width, height."""
    columns, rows, width, height = (min(each, 0xFFFF) for each in size)
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, width, height))


def _signal(child: asyncio.subprocess.Process, number: int) -> None:
    """To the whole session of a program, while it runs."""
    if child.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)
