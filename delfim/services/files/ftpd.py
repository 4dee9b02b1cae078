"""ftpd: the logs over FTP, and files for the boat into a staging area (RFC 959, 2428, 3659, 4217; thesis 2.8, 3.3).

It stands on aioftp, which brings connections, replies and passive sockets, and adds what clients need and aioftp does not
have (AUTH, FEAT, SIZE, MDTM, NLST, NOOP, OPTS, options of LIST), a jail, uploads that are whole or not there, hashed passwords,
delays after wrong passwords, and bounds. Files are read and written by two workers. Active mode is not spoken: a server that
connects where a client tells it to can be sent anywhere. How to use it: docs/ftpd.md.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

import aioftp

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.base.ranges import address
from delfim.services.access.certificates import server_tls
from delfim.services.access.connection_limits import ConnectionLimits, Patience, bulk, hashed, matches
from delfim.services.files import ftpdata
from delfim.services.files.ftpfiles import FtpFiles
from delfim.services.files.threads import worked
from delfim.services.files.uploads import NoRoom
from delfim.services.runtime import Runtime
from delfim.services.tables import Ftpd, FtpUser

IDLE_S: Final = 300.0  # without a command of a client that is logged in
HANDSHAKE_S: Final = 10.0  # of TLS
LOGIN_S: Final = 30.0  # from the connection to the login
WRONG_MAX: Final = 3  # passwords of one connection
LINE_BYTES: Final = 4096
BEFORE_LOGIN: Final = ("user", "pass", "quit", "auth", "feat", "help", "noop", "opts", "pbsz", "prot", "clnt", "syst")
FEATURES: Final = ("EPSV", "MDTM", "MLST type*;size*;modify*;", "PASV", "REST STREAM", "SIZE", "TVFS", "UTF8")
NOBODY: Final = hashed("", b"nobody")  # compared with if the user is unknown: both take the same time

log = logging.getLogger(__name__)
T = TypeVar("T")
Words = Callable[[Any, str], Awaitable[bool]]


class Users(aioftp.AbstractUserManager):
    """The users of the vehicle's file. The refusal of an unknown name takes as long as that of a wrong password."""

    def __init__(self, users: dict[str, FtpUser], work: Callable[..., Awaitable[Any]]) -> None:
        super().__init__()
        self._users, self._work = users, work
        self._known = {name: aioftp.User(name, base_path="/") for name in users}
        self._unknown = aioftp.User("", base_path="/")

    async def get_user(self, login: str) -> tuple[Any, aioftp.User | None, str]:
        return self.GetUserResponse.PASSWORD_REQUIRED, self._known.get(login, self._unknown), "password required"

    async def authenticate(self, user: aioftp.User, password: str) -> bool:
        known = self._users.get(user.login or "")
        is_right: bool = await self._work(matches, password, known.password if known else NOBODY)
        return is_right and known is not None


class FtpServer(aioftp.Server):
    """The server of all connections. The first words of a method are those of the RFC; each answers with a reply code."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        table = settings.of(Ftpd)
        self._table, self._clock = table, clock
        self._workers = ThreadPoolExecutor(2, "ftpd")
        self._users = Users(table.users, self._work)
        super().__init__(
            self._users,
            socket_timeout=ftpdata.STALL_S,
            wait_future_timeout=ftpdata.DATA_S,
            block_size=ftpdata.BLOCK_BYTES,
            welcome_message=f"{settings.boat.name}",
        )
        self._tls = server_tls(table.certificate, "ftpd.certificate")
        if self._tls is not None:
            self._tls.num_tickets = 0  # unread ones make an uploader's close a reset, which loses the end of his file
        self._files = FtpFiles(settings, clock, self._work)
        self.door, self.patience = ConnectionLimits(table.connections, table.connections_per_address), Patience()
        self._is_closing = False
        added: dict[str, Words] = {
            "feat": self.feat, "help": self.help, "noop": self.noop, "opts": self.opts, "allo": self.noop, "clnt": self.noop,
            "mode": self.noop, "pbsz": self.noop, "stru": self.noop, "xpwd": self.pwd, "auth": self.auth,
        }  # fmt: skip
        known: dict[str, Any] = {**self.commands_mapping, **added, **self._files.commands}
        turns = {name: self._in_turn(name, command) for name, command in known.items() if name != "abor"}
        self.commands_mapping = {**turns, "abor": ftpdata.abor, "": self._gone}

    def figures(self) -> dict[str, object]:
        return {
            "connections": self.door.inside.total(),
            "refused": self.door.refused,
            "wrong_passwords": self.patience.failures,
            "sent_bytes": self._files.sent_bytes,
            "received_bytes": self._files.received_bytes,
        }

    async def open(self) -> str:
        """Listen. Returns the address. Raises OSError."""
        await self._work(self._files.uploads.prepare)
        await self.start(*address(self._table.listen), limit=LINE_BYTES, backlog=16)
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
        bulk(writer.get_extra_info("socket"), ftpdata.STALL_S)
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
        """Read the next command, "" at the end. All but ABOR wait until the one before is done."""
        connection = self.connections[stream]
        if not connection.future.logged.done():
            await connection.idle.wait()
        line = await self._line(connection, stream)
        if not line:
            return "", ""
        telnet = b"\xff\xf2\xf4"  # some clients send this ahead of ABOR
        name, _, rest = line.lstrip(telnet).decode("utf-8", "surrogateescape").strip("\r\n").partition(" ")
        name = name.lower() or "?"
        if name != "abor":
            await connection.idle.wait()
            if name in self.commands_mapping:
                connection.idle.clear()
        return name, rest

    async def _line(self, connection: Any, stream: Any) -> bytes:
        """Read a line; empty if there is none: the client left, was silent for too long, or sends nonsense."""
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
                    connection.response("421", "no command for too long")
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
        """Carry out a command in its turn, and answer its failures in words."""

        async def carried_out(connection: Any, rest: Any) -> bool:
            try:
                if name in ("user", "pass") and not connection.is_secret:
                    connection.response("530", "send AUTH TLS first: no password in the clear")
                    return True
                if name not in BEFORE_LOGIN and not connection.future.logged.done():
                    connection.response("530", "log in first")
                    return True
                return await command(connection, rest)
            except ftpdata.Answered:
                return True
            except (DelfimError, OSError) as error:
                code = "452" if isinstance(error, NoRoom) else "550"
                connection.response(code, getattr(error, "strerror", None) or str(error) or "failed")
                return True
            finally:
                connection.idle.set()

        return carried_out

    async def user(self, connection: Any, rest: str) -> bool:
        connection.name = rest[:64]
        return await super().user(connection, rest)

    async def pass_(self, connection: Any, rest: str) -> bool:
        if not connection.future.user.done() or connection.future.logged.done():
            connection.response("503", "send USER first")
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

    # Small commands.

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

    async def rest(self, connection: Any, rest: str) -> bool:
        connection.offset = int(rest) if rest.isdecimal() and len(rest) < 19 else 0
        connection.response(*("350", f"from {connection.offset}") if rest.isdecimal() else ("501", "not a number of bytes"))
        return True

    async def auth(self, connection: Any, rest: str) -> bool:
        """Begin TLS. Commands that came before must not be taken for commands within it."""
        if self._tls is None or connection.is_secret or rest.upper() not in ("TLS", "TLS-C", "SSL"):
            connection.response(*("502", "TLS is not set up") if self._tls is None else ("503", "AUTH TLS, only once"))
            return True
        stream = connection.command_connection
        stream.writer.transport.pause_reading()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0):
                await stream.reader.read(1)
                stream.writer.transport.abort()
                return False
        try:
            await self.write_response(stream, "234", "begin TLS")
            await stream.writer.start_tls(self._tls, ssl_handshake_timeout=HANDSHAKE_S)
        except OSError as error:
            log.warning("ftpd: no TLS with %s: %s", connection.client_host, error)
            return False
        connection.is_secret = True
        return True

    async def prot(self, connection: Any, rest: Any) -> bool:
        wanted = "P" if self._tls else "C"
        connection.response(*("200", "ok") if rest.upper() == wanted else ("536", f"only PROT {wanted}"))
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

    async def _start_passive_server(self, connection: Any, handler_callback: Any) -> asyncio.Server:
        """Listen for the data connection; only the client of the control connection may connect."""

        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if _address(writer) != connection.client_host:
                writer.transport.abort()
                return
            bulk(writer.get_extra_info("socket"), ftpdata.STALL_S)
            await handler_callback(reader, writer)

        patience: Any = {"ssl_handshake_timeout": HANDSHAKE_S} if self._tls else {}
        return await asyncio.start_server(
            connected, connection.server_host, 0, ssl=self._tls, limit=ftpdata.BLOCK_BYTES, backlog=2, **patience
        )

    async def _work(self, do: Callable[..., T], *arguments: Any) -> T:
        return await worked(self._workers, do, *arguments)


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    server = FtpServer(runtime.config, runtime.clock)
    address = await server.open()
    log.warning("ftpd: %s", address)
    try:
        with runtime.publishing("ftpd", lambda: {"address": address, **server.figures()}):
            await asyncio.Event().wait()
    finally:
        await server.close()


def _address(writer: asyncio.StreamWriter) -> str:
    return str((writer.get_extra_info("peername") or ("",))[0])
