"""ftpd: the logs over FTP, and files for the boat into a staging area (RFC 959, 2428, 3659, 4217; thesis 2.8, 3.3).

It stands on aioftp, which brings connections, replies and passive sockets, and adds what clients ask for and aioftp does not
have (AUTH, FEAT, SIZE, MDTM, NLST, NOOP, OPTS, options of LIST), a jail, uploads that are whole or not there, hashed passwords,
patience with those who guess, and bounds. Files are read and written by two workers. Active mode is not spoken: a server that
connects to where it is told can be sent anywhere. How it is used: docs/ftpd.md.
"""

import asyncio
import contextlib
import fcntl
import fnmatch
import logging
import os
import ssl
import stat
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from itertools import islice
from pathlib import PurePosixPath
from typing import Any, Final, TypeVar

import aioftp

from delfim import config
from delfim.clock import Clock
from delfim.errors import DelfimError, PermanentFailure
from delfim.services.door import Door, Patience, bulk, hashed, matches
from delfim.services.jail import Jail
from delfim.services.runtime import Runtime
from delfim.services.uploads import NoRoom, Uploads

DATA_S: Final = 30.0  # for the client to open a data connection; a radio is slow
IDLE_S: Final = 300.0  # without a word from somebody who is logged in
HANDSHAKE_S: Final = 10.0  # of TLS
LOGIN_S: Final = 30.0  # from the connection to the login
STALL_S: Final = 60.0  # a client that neither reads nor sends for so long is gone
WRONG_MAX: Final = 3  # passwords of one connection
BLOCK_BYTES: Final = 64 << 10
LINE_BYTES: Final = 4096
ENTRIES_MAX: Final = 20_000  # of a directory
PART: Final = ".part"
BEFORE_LOGIN: Final = ("user", "pass", "quit", "auth", "feat", "help", "noop", "opts", "pbsz", "prot", "clnt", "syst")
FEATURES: Final = ("EPSV", "MDTM", "MLST type*;size*;modify*;", "PASV", "REST STREAM", "SIZE", "TVFS", "UTF8")
MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
HALF_A_YEAR_S: Final = 180 * 86_400
NOBODY: Final = hashed("", b"nobody")  # compared with where there is no such user: both take the same time

log = logging.getLogger(__name__)
T = TypeVar("T")
Words = Callable[[Any, str], Awaitable[bool]]


class Users(aioftp.AbstractUserManager):
    """Those of the vehicle's file. That a name is unknown is said as late as that a password is wrong."""

    def __init__(self, users: dict[str, config.FtpUser], work: Callable[..., Awaitable[Any]]) -> None:
        super().__init__()
        self._users, self._work = users, work
        self._known = {name: aioftp.User(name, base_path="/") for name in users}
        self._unknown = aioftp.User("", base_path="/")

    async def get_user(self, login: str) -> tuple[Any, aioftp.User | None, str]:
        return self.GetUserResponse.PASSWORD_REQUIRED, self._known.get(login, self._unknown), "password, please"

    async def authenticate(self, user: aioftp.User, password: str) -> bool:
        known = self._users.get(user.login or "")
        is_right: bool = await self._work(matches, password, known.password if known else NOBODY)
        return is_right and known is not None

    def may_upload(self, user: aioftp.User) -> bool:
        return self._users[user.login or ""].upload


class FtpServer(aioftp.Server):
    """One instance, all connections. The first words of a method are those of the RFC; each answers with a reply code."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        table = settings.ftpd
        self._table, self._clock = table, clock
        self._workers = ThreadPoolExecutor(2, "ftpd")
        self._users = Users(table.users, self._work)
        super().__init__(
            self._users,
            socket_timeout=STALL_S,
            wait_future_timeout=DATA_S,
            block_size=BLOCK_BYTES,
            welcome_message=f"{settings.boat.name}",
        )
        self._tls = _tls(table.certificate)
        self._jail = Jail(table.root)
        self._uploads = Uploads(table.root, settings.log)
        self.door, self.patience = Door(table.connections, table.connections_per_address), Patience()
        self.sent_bytes = self.received_bytes = 0
        self._is_closing = False
        added: dict[str, Words] = {
            "feat": self.feat, "help": self.help, "mdtm": self.mdtm, "nlst": self.nlst, "noop": self.noop, "opts": self.opts,
            "size": self.size, "list": self.ls, "stat": self.stat, "allo": self.noop, "clnt": self.noop, "mode": self.noop,
            "pbsz": self.noop, "stru": self.noop, "xcup": self.cdup, "xcwd": self.cwd, "xmkd": self.mkd, "xpwd": self.pwd,
            "xrmd": self.rmd, "auth": self.auth,
        }  # fmt: skip
        known: dict[str, Any] = {**self.commands_mapping, **added}
        turns = {name: self._in_turn(name, command) for name, command in known.items() if name != "abor"}
        self.commands_mapping = {**turns, "abor": self.abor, "": self._gone}

    def figures(self) -> dict[str, object]:
        return {
            "connections": self.door.inside.total(),
            "refused": self.door.refused,
            "wrong_passwords": self.patience.failures,
            "sent_bytes": self.sent_bytes,
            "received_bytes": self.received_bytes,
        }

    async def open(self) -> str:
        """Listen. Returns the address. Raises OSError."""
        await self._work(self._uploads.prepare)
        host, _, port = self._table.listen.rpartition(":")
        await self.start(host, int(port), limit=LINE_BYTES, backlog=16)
        return "ftp://{}:{}/".format(*self.server.sockets[0].getsockname()[:2])

    async def close(self) -> None:
        self._is_closing = True
        self.server.close()
        for connection in list(self.connections.values()):
            connection.command_connection.writer.transport.abort()
            connection._dispatcher.cancel()
        running = [connection._dispatcher for connection in self.connections.values()]
        if running:
            await asyncio.wait(running, timeout=0.5)
        self._workers.shutdown(wait=False, cancel_futures=True)

    # The control connection.

    async def dispatcher(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address = _address(writer)
        if not self.door.enter(address):
            writer.write(b"421 Too many connections\r\n")
            writer.close()
            return
        bulk(writer.get_extra_info("socket"), STALL_S)
        try:
            await super().dispatcher(reader, writer)
        except asyncio.CancelledError:  # by `close`; the stream that made this task would report it as a defect
            if not self._is_closing:
                raise
        finally:
            self.door.leave(address)

    async def greeting(self, connection: Any, rest: Any) -> bool:
        connection.idle = asyncio.Event()  # no command is being carried out
        connection.idle.set()
        connection.since_s = self._clock.monotonic_s()
        connection.wrong = 0
        connection.is_secret = connection.is_data_secret = self._tls is None  # or need not be
        connection.awaited = False
        return await super().greeting(connection, rest)

    async def parse_command(self, stream: Any, censor_commands: Any = ("pass",)) -> tuple[str, str]:
        """The next command, "" at the end. All but ABOR wait until the one before is done."""
        connection = self.connections[stream]
        if not connection.future.logged.done():
            await connection.idle.wait()
        line = await self._line(connection, stream)
        if not line:
            return "", ""
        telnet = b"\xff\xf2\xf4"  # what some clients send ahead of ABOR
        name, _, rest = line.lstrip(telnet).decode("utf-8", "surrogateescape").strip("\r\n").partition(" ")
        name = name.lower() or "?"
        if name != "abor":
            await connection.idle.wait()
            if name in self.commands_mapping:
                connection.idle.clear()
        return name, rest

    async def _line(self, connection: Any, stream: Any) -> bytes:
        """Empty when there is none: the client went away, said nothing for too long, or talks nonsense."""
        while True:
            is_in = connection.future.logged.done()
            left_s = IDLE_S if is_in else connection.since_s + LOGIN_S - self._clock.monotonic_s()
            try:
                async with asyncio.timeout(left_s):
                    while stream.writer.transport.get_write_buffer_size():  # answers are not read: no more questions
                        await stream.writer.drain()
                        await asyncio.sleep(0.05)
                    line: bytes = await stream.reader.readline()
                    return line
            except TimeoutError:
                if connection.idle.is_set():
                    connection.response("421", "nothing was said for too long")
                    return b""
            except (ValueError, OSError):  # a line without end; a broken connection
                return b""

    async def write_line(self, stream: Any, line: str) -> None:
        await stream.write(line.encode("utf-8", "surrogateescape") + b"\r\n")

    async def response_writer(self, stream: Any, response_queue: Any) -> None:
        while True:
            words = await response_queue.get()
            with contextlib.suppress(OSError):  # the client is gone, and its reader will see it
                await self.write_response(stream, *words)
            response_queue.task_done()

    async def _gone(self, connection: Any, rest: Any) -> bool:
        return False

    def _in_turn(self, name: str, command: Words) -> Words:
        """A command with its turn, and with words for what can go wrong."""

        async def carried_out(connection: Any, rest: Any) -> bool:
            try:
                if name in ("user", "pass") and not connection.is_secret:
                    connection.response("530", "first AUTH TLS: no password in the clear")
                    return True
                if name not in BEFORE_LOGIN and not connection.future.logged.done():
                    connection.response("530", "log in first")
                    return True
                return await command(connection, rest)
            except _Answered:
                return True
            except (DelfimError, OSError) as error:
                code = "452" if isinstance(error, NoRoom) else "550"
                connection.response(code, getattr(error, "strerror", None) or str(error) or "it broke off")
                return True
            finally:
                connection.idle.set()

        return carried_out

    async def user(self, connection: Any, rest: str) -> bool:
        connection.name = rest[:64]
        return await super().user(connection, rest)

    async def pass_(self, connection: Any, rest: str) -> bool:
        if not connection.future.user.done() or connection.future.logged.done():
            connection.response("503", "first a name")
            return True
        address, name = connection.client_host, connection.name
        await asyncio.sleep(self.patience.pause_s(address, self._clock.monotonic_s()))
        if await self._users.authenticate(connection.user, rest):
            self.patience.succeeded(address)
            connection.logged = True
            log.warning("ftpd: %s logged in from %s", name, address)
            connection.response("230", "welcome aboard")
            return True
        self.patience.failed(address, self._clock.monotonic_s())
        connection.wrong += 1
        log.warning("ftpd: wrong password for %r from %s", name, address)
        connection.response("530", "wrong name or password")
        return bool(connection.wrong < WRONG_MAX)

    # Small words.

    async def feat(self, connection: Any, rest: str) -> bool:
        connection.response("211", ("Features:", *FEATURES, *(("AUTH TLS", "PBSZ", "PROT") if self._tls else ()), "End"), True)
        return True

    async def noop(self, connection: Any, rest: str) -> bool:
        connection.response("200", "ok")
        return True

    async def help(self, connection: Any, rest: str) -> bool:
        connection.response("214", ("Commands:", " ".join(sorted(self.commands_mapping)).upper().strip(), "End"), True)
        return True

    async def opts(self, connection: Any, rest: str) -> bool:
        known = rest.upper().startswith(("UTF8", "UTF-8", "MLST"))
        connection.response(*("200", "ok") if known else ("501", "no such option"))
        return True

    async def stat(self, connection: Any, rest: str) -> bool:
        if rest:
            lines = await self._work(self._listed, self._real(connection, _without_options(rest)), self._list_line)
            connection.response("213", ("Status:", *lines, "End"), True)
        else:
            connection.response("211", f"{self.welcome_message}: {connection.user.login} is logged in")
        return True

    async def rest(self, connection: Any, rest: str) -> bool:
        connection.offset = int(rest) if rest.isdecimal() and len(rest) < 19 else 0
        connection.response(*("350", f"from {connection.offset}") if rest.isdecimal() else ("501", "how many bytes?"))
        return True

    async def auth(self, connection: Any, rest: str) -> bool:
        """From here on it is TLS. What was said before must not be taken for something said within it."""
        if self._tls is None or connection.is_secret or rest.upper() not in ("TLS", "TLS-C", "SSL"):
            connection.response(*("502", "there is no TLS here") if self._tls is None else ("503", "once, AUTH TLS"))
            return True
        stream = connection.command_connection
        stream.writer.transport.pause_reading()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0):
                await stream.reader.read(1)
                stream.writer.transport.abort()
                return False
        try:
            await self.write_response(stream, "234", "go on")
            await stream.writer.start_tls(self._tls, ssl_handshake_timeout=HANDSHAKE_S)
        except OSError as error:
            log.warning("ftpd: no TLS with %s: %s", connection.client_host, error)
            return False
        connection.is_secret = True
        return True

    async def prot(self, connection: Any, rest: Any) -> bool:
        wanted = "P" if self._tls else "C"
        connection.response(*("200", "ok") if rest.upper() == wanted else ("536", f"only {wanted}"))
        connection.is_data_secret |= rest.upper() == "P"
        return True

    async def epsv(self, connection: Any, rest: Any) -> bool:
        if rest.strip() == "ALL":
            connection.response("200", "ok")
            return True
        if rest.strip() not in ("", "1", "2"):
            connection.response("522", "unknown protocol (1,2)")
            return True
        return await super().epsv(connection, "")

    # What is there.

    async def cwd(self, connection: Any, rest: Any) -> bool:
        real = self._real(connection, str(rest))
        if not await self._work(os.path.isdir, real):
            raise DelfimError("no such directory")
        connection.current_directory = PurePosixPath(self._jail.shown(real))
        connection.response("250", "ok")
        return True

    async def size(self, connection: Any, rest: str) -> bool:
        status = await self._work(self._status, self._real(connection, rest))
        if not stat.S_ISREG(status.st_mode):
            raise DelfimError("not a plain file")
        connection.response("213", str(status.st_size))
        return True

    async def mdtm(self, connection: Any, rest: str) -> bool:
        status = await self._work(self._status, self._real(connection, rest))
        connection.response("213", _stamp(status.st_mtime))
        return True

    async def mlst(self, connection: Any, rest: Any) -> bool:
        real = self._real(connection, rest)
        status = await self._work(self._status, real)
        connection.response("250", ("Facts:", _facts_line(self._jail.shown(real), status), "End"), True)
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
            real, before = (
                self._real(connection, folder or ("/" if rest.startswith("/") else "")),
                f"{folder}/" if "/" in rest else "",
            )
            lines = await self._work(self._listed, real, lambda name, status: line(before + name, status), names)
        else:
            lines = await self._work(self._listed, self._real(connection, rest), line)
        text = "".join(f"{each}\r\n" for each in lines).encode("utf-8", "surrogateescape")
        async with self._data(connection) as stream:
            for start in range(0, len(text), BLOCK_BYTES):
                await stream.write(text[start : start + BLOCK_BYTES])
        return True

    # Files.

    async def retr(self, connection: Any, rest: Any) -> bool:
        offset = self._offset(connection)
        fd = await self._work(self._jail.open, self._path(connection, rest))
        sent = offset
        try:
            async with self._data(connection) as stream:
                while block := await self._work(os.pread, fd, BLOCK_BYTES, sent):
                    await stream.write(block)
                    sent += len(block)
        finally:
            os.close(fd)
            self.sent_bytes += sent - offset
            log.info("ftpd: %s read %r, %d bytes", connection.user.login, rest, sent - offset)
        return True

    async def stor(self, connection: Any, rest: Any, mode: str = "wb") -> bool:
        """Into a file beside, and under its name when all of it is on the disk. What breaks off stays beside, to be resumed."""
        path, offset = self._writable(connection, rest), self._offset(connection)
        fd, at = await self._work(_part, self._uploads, path, offset, mode == "ab")
        began = at
        try:
            async with self._data(connection) as stream:
                while block := await stream.read(BLOCK_BYTES):
                    await self._work(self._uploads.write, fd, block, at)
                    at += len(block)
                if connection.aborted:  # which looks like the end
                    raise ConnectionAbortedError
                await self._work(os.fsync, fd)
                await self._work(self._uploads.rename, path + PART, path)
        finally:
            os.close(fd)
            self.received_bytes += at - began
            log.warning("ftpd: %s wrote %r, %d bytes", connection.user.login, path, at - began)
        return True

    async def dele(self, connection: Any, rest: Any) -> bool:
        return await self._changed(connection, self._uploads.remove, self._writable(connection, rest))

    async def mkd(self, connection: Any, rest: Any) -> bool:
        path = self._writable(connection, rest)
        await self._work(self._uploads.make_folder, path)
        connection.response("257", f'"{path}"')
        return True

    async def rmd(self, connection: Any, rest: Any) -> bool:
        return await self._changed(connection, self._uploads.remove_folder, self._writable(connection, rest))

    async def rnfr(self, connection: Any, rest: Any) -> bool:
        path = self._writable(connection, rest)
        await self._work(self._uploads.apply, path, os.fstat)
        connection.rename_from = path
        connection.response("350", "to what?")
        return True

    async def rnto(self, connection: Any, rest: Any) -> bool:
        if not connection.future.rename_from.done():
            connection.response("503", "first RNFR")
            return True
        source = connection.rename_from
        del connection.rename_from
        return await self._changed(connection, self._uploads.rename, source, self._writable(connection, rest))

    async def abor(self, connection: Any, rest: Any) -> bool:
        """End the transfer that is under way; its own answer comes first."""
        if not connection.idle.is_set():
            connection.aborted = True
            if connection.future.carrying.done():
                connection.carrying.writer.transport.abort()
            elif connection.awaited and not connection["data_connection"].done():
                connection["data_connection"].set_exception(ConnectionAbortedError("aborted"))
            await connection.idle.wait()
        connection.response("226", "ok")
        return True

    async def _changed(self, connection: Any, do: Callable[..., None], *paths: str) -> bool:
        await self._work(do, *paths)
        log.warning("ftpd: %s: %s %s", connection.user.login, do.__name__, " ".join(map(repr, paths)))
        connection.response("250", "ok")
        return True

    # The data connection.

    async def _start_passive_server(self, connection: Any, handler_callback: Any) -> asyncio.Server:
        """Only who holds the control connection may connect."""

        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if _address(writer) != connection.client_host:
                writer.transport.abort()
                return
            bulk(writer.get_extra_info("socket"), STALL_S)
            await handler_callback(reader, writer)

        patience: Any = {"ssl_handshake_timeout": HANDSHAKE_S} if self._tls else {}
        return await asyncio.start_server(
            connected, connection.server_host, 0, ssl=self._tls, limit=BLOCK_BYTES, backlog=2, **patience
        )

    @contextlib.asynccontextmanager
    async def _data(self, connection: Any) -> AsyncIterator[Any]:
        """A transfer: announced, carried by the data connection, and told how it ended."""
        if not connection.is_data_secret:
            connection.response("521", "first PROT P")
            raise _Answered
        if not connection.future.passive_server.done():
            connection.response("425", "first PASV or EPSV")
            raise _Answered
        connection.response("150", "here it comes")
        connection.aborted, connection.awaited = False, True
        try:
            async with asyncio.timeout(DATA_S):
                stream = connection.carrying = await connection["data_connection"]
        except (TimeoutError, ConnectionAbortedError):
            connection.response("425", "no data connection")
            raise _Answered from None
        finally:
            connection.awaited = False
            del connection.data_connection
        try:
            yield stream
            stream.writer.close()
            async with asyncio.timeout(STALL_S):
                await stream.writer.wait_closed()
            connection.response("226", "that was all")
        except (DelfimError, OSError) as error:
            full = isinstance(error, NoRoom)
            connection.response("452" if full else "426", str(error) if full else "it broke off")
            raise _Answered from None
        finally:
            stream.writer.transport.abort()
            del connection.carrying

    # Paths.

    def _path(self, connection: Any, rest: str) -> str:
        """What the client means, from the root."""
        return os.path.normpath(os.path.join("/", str(connection.current_directory), rest))

    def _real(self, connection: Any, rest: str) -> str:
        return self._jail.real(self._path(connection, rest))

    def _writable(self, connection: Any, rest: str) -> str:
        """What the client means, from the root, for those who may write. Raises DelfimError."""
        if not self._users.may_upload(connection.user):
            raise DelfimError("you may not write")
        return self._path(connection, rest)

    def _offset(self, connection: Any) -> int:
        """What REST said, once."""
        offset: int = connection.offset if connection.future.offset.done() else 0
        connection.offset = 0
        return offset

    # What blocks, and is done by a worker.

    async def _work(self, do: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._workers, do, *arguments)

    def _status(self, real: str) -> os.stat_result:
        """Of a file, or of its part that is here until the rest comes."""
        try:
            return os.stat(real)
        except FileNotFoundError:
            if real.startswith(self._uploads.folder + "/"):
                return os.stat(real + PART)
            raise

    def _listed(self, real: str, line: Callable[[str, os.stat_result], str], pattern: str = "*") -> list[str]:
        """A line for each entry, or for the file itself. Links that lead out are not there."""
        if not os.path.isdir(real):
            return [line(os.path.basename(real), os.stat(real))]
        found = []
        names = (name for name in sorted(fnmatch.filter(os.listdir(real), pattern)) if not set(name) & {"\r", "\n"})
        for name in islice(names, ENTRIES_MAX):
            with contextlib.suppress(OSError, DelfimError):
                found.append(line(name, os.stat(self._jail.real(os.path.join(self._jail.shown(real), name)))))
        return found

    def _list_line(self, name: str, status: os.stat_result) -> str:
        """As `ls -l` writes it, which is what programs expect: the time of day for half a year, then the year."""
        at = datetime.fromtimestamp(status.st_mtime, UTC)
        is_new = abs(self._clock.time_ns() / 1e9 - status.st_mtime) < HALF_A_YEAR_S
        when = f"{at:%H:%M}" if is_new else f" {at:%Y}"
        date = f"{MONTHS[at.month - 1]} {at.day:2} {when}"
        return f"{stat.filemode(status.st_mode)} {status.st_nlink:3} boat boat {status.st_size:12} {date} {name}"


class _Answered(DelfimError):
    """The client was told."""


async def serve(runtime: Runtime) -> None:
    """The service."""
    server = FtpServer(runtime.config, runtime.clock)
    address = await server.open()
    runtime.board["ftpd"] = lambda: {"address": address, **server.figures()}
    log.warning("ftpd: %s", address)
    try:
        await asyncio.Event().wait()
    finally:
        del runtime.board["ftpd"]
        await server.close()


def _part(uploads: Uploads, path: str, offset: int, append: bool) -> tuple[int, int]:
    """The part of an upload, open and locked, and where to go on writing. What is there under the name stays until all of the
    new is. Raises DelfimError, OSError."""
    fd = uploads.open(path + PART, os.O_RDWR | os.O_CREAT)
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DelfimError("somebody else is writing it") from None
        if (append or offset) and not os.fstat(fd).st_size:
            with contextlib.suppress(FileNotFoundError):
                uploads.copy(path, fd)
        size = os.fstat(fd).st_size
        if offset > size:
            raise DelfimError(f"there are only {size} bytes of it")
        at = size if append else offset
        os.ftruncate(fd, at)
    except BaseException:
        os.close(fd)
        raise
    return fd, at


def _without_options(rest: str) -> str:
    """`LIST -la folder`: clients speak to servers as if they were ls."""
    words = rest.split(" ")
    while words and words[0].startswith("-"):
        words.pop(0)
    return " ".join(words)


def _facts_line(name: str, status: os.stat_result) -> str:
    """RFC 3659, 7.2."""
    kind = "dir" if stat.S_ISDIR(status.st_mode) else "file"
    return f"type={kind};size={status.st_size};modify={_stamp(status.st_mtime)}; {name}"


def _stamp(time_s: float) -> str:
    """RFC 3659, 2.3."""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y%m%d%H%M%S}"


def _address(writer: asyncio.StreamWriter) -> str:
    return str((writer.get_extra_info("peername") or ("",))[0])


def _tls(certificate: str) -> ssl.SSLContext | None:
    """Raises PermanentFailure where the file is not there or is none."""
    if not certificate:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate)
    except (OSError, ssl.SSLError) as error:
        raise PermanentFailure(f"ftpd.certificate: {certificate}: {error.strerror or error}") from None
    return context
