"""Programs and shells over SSH: on pipes or on a terminal; each ends when its client has gone."""

import asyncio
import contextlib
import fcntl
import functools
import logging
import os
import pwd
import signal
import struct
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import asyncssh

from delfim.services.supervision import processes
from delfim.services.tables import Sshd

HANG_UP_S: Final = 2.0  # for programs to end after their client left or the first of them ended
LEAVE_S: Final = 2.0  # before SIGHUP: `setsid program &` on a slow computer has not left the session when its shell ends
BLOCK_BYTES: Final = 64 << 10
SIGNALS: Final = signal.Signals.__members__  # by name
PATH: Final = f"/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin:{Path(sys.executable).parent}"  # delfim, too
# The first terminal that the leader of a session opens becomes that session's.
ON_TERMINAL: Final = ("/bin/sh", "-c", 'exec <"$0" >"$0" 2>&1; exec "$@"')

log = logging.getLogger(__name__)


class SshProcess(asyncssh.SSHServerProcess[bytes]):
    """The session of a program. The window's size and signals are passed on at once: asyncssh would keep each until what was
    typed before it is read, however many they are."""

    on_resize: Callable[[tuple[int, int, int, int]], None] = staticmethod(lambda size: None)
    on_signal: Callable[[int], None] = staticmethod(lambda number: None)

    def terminal_size_changed(self, width: int, height: int, pixwidth: int, pixheight: int) -> None:
        self.on_resize((width, height, pixwidth, pixheight))

    def signal_received(self, signal: str) -> None:
        self.on_signal(SIGNALS.get(f"SIG{signal}", SIGNALS["SIGTERM"]))

    def break_received(self, msec: int) -> bool:
        self.on_signal(SIGNALS["SIGINT"])
        return True


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
        """Read; empty when all writers have closed it."""
        while True:
            try:
                return os.read(self.fd, BLOCK_BYTES)
            except BlockingIOError:
                loop = asyncio.get_running_loop()
                await _once(loop.add_reader, loop.remove_reader, self.fd)
            except OSError:  # EIO: a terminal says it so
                return b""

    async def write(self, data: bytes) -> None:
        """Write. Raises OSError when nobody reads any more."""
        while data:
            try:
                data = data[os.write(self.fd, data) :]
            except BlockingIOError:
                loop = asyncio.get_running_loop()
                await _once(loop.add_writer, loop.remove_writer, self.fd)


class Programs:
    """All programs that run for clients."""

    def __init__(self, table: Sshd) -> None:
        self.sessions = self.commands = 0  # that run now; that were started
        self._table = table
        self._children: set[asyncio.subprocess.Process] = set()

    async def close(self) -> None:
        """End all programs, so that none stays behind."""
        for child in self._children:
            processes.end(child.pid, signal.SIGKILL)
        await asyncio.gather(*(child.wait() for child in self._children))

    async def run(self, process: "asyncssh.SSHServerProcess[bytes]") -> None:
        """Run a program, or the shell, from its start to its exit status."""
        assert isinstance(process, SshProcess)
        visitor = process.channel.get_connection().get_owner()
        name = (
            "a shell" if process.command is None else repr(process.command)
        )  # so that no command looks like a line of the log
        if process.subsystem is not None or self.sessions >= self._table.sessions:
            process.stderr.write(b"too many programs are running\n" if process.subsystem is None else b"only sftp is there\n")
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

    async def _on_pipes(self, process: SshProcess) -> int:
        words, names, home = _words(self._table.shell, process)
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
            feed, stdin = _pipe(ours, theirs, reads=False)
            out, stdout = _pipe(ours, theirs, reads=True)
            err, stderr = _pipe(ours, theirs, reads=True)
            start = asyncio.create_subprocess_exec(
                *words, env=names, cwd=home, stdin=stdin, stdout=stdout, stderr=stderr, start_new_session=True
            )
            child = await processes.started(start)
            theirs.close()
            return await self._attended(process, child, feed, {out: process.stdout, err: process.stderr}, theirs)

    async def _on_terminal(self, process: SshProcess) -> int:
        words, names, home = _words(self._table.shell, process)
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
            fd, slave = os.openpty()
            terminal = ours.enter_context(_Pipe(fd))
            theirs.callback(os.close, slave)  # when the program has ended: a terminal that nobody has open is over
            _resize(terminal, process.term_size)
            process.on_resize = functools.partial(_resize, terminal)
            null = asyncio.subprocess.DEVNULL
            start = asyncio.create_subprocess_exec(
                *ON_TERMINAL, os.ttyname(slave), *words,
                env=names, cwd=home, stdin=null, stdout=null, stderr=null, start_new_session=True,
            )  # fmt: skip
            child = await processes.started(start)
            return await self._attended(process, child, terminal, {terminal: process.stdout}, theirs)

    async def _attended(
        self,
        process: SshProcess,
        child: asyncio.subprocess.Process,
        stdin: _Pipe,
        sinks: dict[_Pipe, "asyncssh.SSHWriter[bytes]"],
        theirs: contextlib.ExitStack,
    ) -> int:
        """Carry input and output between client and program, until the program has ended and all its output is sent, or the
        client has gone. Returns the exit status, or the negative number of the signal that ended the program."""
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
            await processes.empty(child.pid, LEAVE_S)
            processes.end(child.pid, signal.SIGHUP)
            await processes.empty(child.pid, HANG_UP_S)
        finally:
            processes.end(child.pid, signal.SIGKILL)
            self._children.discard(child)
        return await child.wait()


def _words(shell: str, process: SshProcess) -> tuple[tuple[str, ...], dict[str, str], str]:
    """(program and arguments, environment, directory)."""
    account = pwd.getpwuid(os.getuid())
    words = (shell, "-l") if process.command is None else (shell, "-c", process.command)
    names = {"USER": account.pw_name, "LOGNAME": account.pw_name, "HOME": account.pw_dir, "SHELL": shell}
    more = {"TERM": process.term_type} if process.term_type else {}
    home = account.pw_dir if os.path.isdir(account.pw_dir) else "/"
    return words, {"PATH": PATH, "LANG": "C.UTF-8", **names, **more}, home


def _pipe(ours: contextlib.ExitStack, theirs: contextlib.ExitStack, *, reads: bool) -> tuple[_Pipe, int]:
    """(our end, the program's)."""
    reading, writing = os.pipe()
    mine, other = (reading, writing) if reads else (writing, reading)
    theirs.callback(os.close, other)
    return ours.enter_context(_Pipe(mine)), other


async def _once(add: Callable[..., Any], remove: Callable[[int], object], fd: int) -> None:
    """Wait until the descriptor is ready."""
    ready = asyncio.Event()
    add(fd, ready.set)
    try:
        await ready.wait()
    finally:
        remove(fd)


async def _over(
    child: asyncio.subprocess.Process, sinks: dict[_Pipe, "asyncssh.SSHWriter[bytes]"], theirs: contextlib.ExitStack
) -> None:
    """Wait until the program has ended, and all that it and its children wrote is sent."""
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


async def _feed(process: SshProcess, child: asyncio.subprocess.Process, pipe: _Pipe, *, is_terminal: bool) -> None:
    """Feed the client's input. Input that the program does not read is dropped."""
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


def _resize(terminal: _Pipe, size: tuple[int, int, int, int]) -> None:
    """Set the window's size. `size` as SSH has it: columns, rows, width, height."""
    columns, rows, width, height = (min(each, 0xFFFF) for each in size)
    if terminal.fd >= 0:
        fcntl.ioctl(terminal.fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, width, height))


def _signal(child: asyncio.subprocess.Process, number: int) -> None:
    """Send a signal to a program and its foreground children."""
    if child.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)
