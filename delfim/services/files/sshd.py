"""sshd: programs on the boat with their input and output here, a shell, files (the thesis' rshd, 2.8, 3.3; RFC 4251-4254).

It stands on asyncssh. Public keys only; the host key is ed25519, made at the first start and kept; of key exchanges those that
cost the loop little. All runs as one user of the system; the process becomes that user before it serves a client. Nothing is
forwarded. Every login and every command is logged. Files are read and written by two workers, inside of a jail. How to use
it: docs/sshd.md.
"""

import asyncio
import contextlib
import functools
import logging
import os
import pwd
import re
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import asyncssh

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import PermanentFailure
from delfim.base.ranges import address
from delfim.services.access.connection_limits import ConnectionLimits, Patience, bulk
from delfim.services.files.jail import Jail
from delfim.services.files.sshfiles import SftpFiles
from delfim.services.files.sshprograms import Programs, SshProcess
from delfim.services.files.uploads import Uploads
from delfim.services.runtime import Runtime
from delfim.services.supervision.nocan import forbid_can
from delfim.services.tables import Sshd

KEX: Final = ("mlkem768x25519-sha256", "curve25519-sha256", "curve25519-sha256@libssh.org", "ecdh-sha2-nistp256")
LOGIN_S: Final = 30.0  # from the connection to the login
STALL_S: Final = 60.0  # a client that reads nothing for so long is gone
ALIVE_S: Final = 15.0  # a client is asked whether it is there ...
ALIVE_MAX: Final = 4  # ... and is not when it did not answer so often
WRONG_MAX: Final = 6  # keys of one connection
SFTP_VERSION: Final = 3

log = logging.getLogger(__name__)


class Daemon:
    """The data that all connections share."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        table = settings.of(Sshd)
        self.table, self.clock_s = table, clock.monotonic_s
        self.keys = {name: _public(name, user.keys) for name, user in table.users.items()}
        self.jail, self.uploads = Jail(table.root), Uploads(table.root, settings.log)
        self.workers = ThreadPoolExecutor(2, "sshd")
        self.door, self.patience = ConnectionLimits(table.connections, table.connections_per_address), Patience()
        self.programs = Programs(table)
        self._visitors: set[Visitor] = set()

    def figures(self) -> dict[str, object]:
        return {
            "connections": self.door.inside.total(),
            "refused": self.door.refused,
            "wrong_keys": self.patience.failures,
            "sessions": self.programs.sessions,
            "commands": self.programs.commands,
        }

    async def listen(self) -> asyncssh.SSHAcceptor:
        """Listen for connections. Raises OSError, PermanentFailure."""
        loop, table = asyncio.get_running_loop(), self.table
        host_key = await loop.run_in_executor(self.workers, _host_key, table.host_key)
        await loop.run_in_executor(self.workers, self.uploads.prepare)
        acceptor = await asyncssh.create_server(
            self._visitor,
            *address(table.listen),
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
        await self.programs.close()
        self.workers.shutdown(wait=False, cancel_futures=True)

    def session(self) -> SshProcess:
        files = functools.partial(SftpFiles, jail=self.jail, uploads=self.uploads, workers=self.workers)
        return SshProcess(self.programs.run, files, SFTP_VERSION, True)


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

    def session_requested(self) -> SshProcess:
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


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    status = runtime.status.get("sshd")
    if settings.of(Sshd).user and status is not None and status.place == "runtime":
        raise PermanentFailure("sshd.user: the vehicle cannot become another user; write services.sshd.place = 'process'")
    daemon = Daemon(settings, runtime.clock)
    acceptor = await daemon.listen()
    address = "ssh://{}:{}".format(*acceptor.sockets[0].getsockname()[:2])
    log.warning("sshd: %s", address)
    try:
        with runtime.publishing("sshd", lambda: {"address": address, **daemon.figures()}):
            await asyncio.Event().wait()
    finally:
        acceptor.close()
        await daemon.close()


def _public(name: str, lines: tuple[str, ...]) -> frozenset[bytes]:
    """Parse public keys. Raises PermanentFailure for a line that is not one."""
    try:
        return frozenset(asyncssh.import_public_key(line).public_data for line in lines)
    except asyncssh.KeyImportError as error:
        raise PermanentFailure(f"sshd.users.{name}.keys: {error}") from None


def _host_key(path: str) -> asyncssh.SSHKey:
    """Read the boat's key, or make one. Raises OSError, PermanentFailure for a file that is not a key."""
    try:
        return asyncssh.read_private_key(path)
    except FileNotFoundError:
        pass
    except (asyncssh.KeyImportError, ValueError, re.error) as error:  # it turns the text into patterns
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
    """Become this user, and give him the folder of uploads, but CAN sockets only where the vehicle's file says so. Raises
    PermanentFailure where there is no such user or this one may not."""
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
        log.warning("sshd: every user with a shell can send on the CAN buses: %s", error.strerror)
