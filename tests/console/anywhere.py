"""A process as on Windows, as far as one can be made on Linux: it has lost what only Linux and its kin have, and its event loop
what Windows' lacks. A plug-in of pytest; and `python tests/console/anywhere.py "WORD ..." ...` runs each `delfim WORD ...`."""

import asyncio
import importlib
import os
import select
import shutil
import signal
import socket
import sys
import time
from functools import partial
from types import ModuleType
from typing import Final

# These have halves of their own for each system, and are imported as they are here.
HALVES: Final = ("aiohttp", "asyncssh", "can", "matplotlib.pyplot", "numpy", "PIL.Image", "rich.live", "serial", "webbrowser")
MODULES: Final = ("fcntl", "termios", "resource", "pwd", "grp", "tty", "pty", "syslog", "readline", "curses", "uvloop")
WORDS: Final[dict[ModuleType, tuple[str, ...]]] = {
    os: (
        *("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_SYNC", "chown", "eventfd", "fchmod", "fchown"),
        *(
            "fdatasync",
            "fork",
            "geteuid",
            "getgid",
            "getloadavg",
            "killpg",
            "memfd_create",
            "mkfifo",
            "nice",
            "openpty",
        ),
        *("pipe2", "posix_fadvise", "pread", "pwrite", "readv", "sched_getaffinity", "sched_param", "sched_setaffinity"),
        *("sched_setscheduler", "setsid", "setuid", "statvfs", "sysconf", "ttyname", "uname", "writev"),
    ),
    select: ("epoll", "poll"),
    signal: ("SIGHUP", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGCHLD", "pthread_sigmask"),
    socket: ("AF_UNIX", "SO_REUSEPORT", "send_fds", "recv_fds", "MSG_DONTWAIT", "MSG_NOSIGNAL", "CMSG_LEN", "CMSG_SPACE"),
    time: ("clock_gettime", "clock_gettime_ns", "clock_settime", "tzset"),
}
OF_SOCKETS: Final = ("recvmsg", "recvmsg_into", "sendmsg")
OF_LOOPS: Final = ("add_signal_handler", "remove_signal_handler")
OF_LOOPS_TOO: Final = (
    "create_unix_connection",
    "create_unix_server",
    "connect_read_pipe",
    "connect_write_pipe",
    "subprocess_exec",
)


def hide() -> None:
    for name in HALVES:
        importlib.import_module(name)
    usage = shutil.disk_usage("/")
    shutil.disk_usage = lambda path: usage  # which asks os.statvfs here
    socket.socketpair = partial(socket.socketpair, socket.AF_UNIX)
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for name in [name for name in dir(socket) if "CAN" in name or "PACKET" in name]:
        delattr(socket, name)
    for place, names in WORDS.items():
        for name in names:
            if hasattr(place, name):  # not each version of Python has all of them
                delattr(place, name)
    for name in OF_SOCKETS:
        setattr(socket.socket, name, property(_missing))
    for name in (*OF_LOOPS, *OF_LOOPS_TOO):
        setattr(asyncio.SelectorEventLoop, name, getattr(asyncio.AbstractEventLoop, name))  # which raise


def _missing(_: object) -> None:
    raise AttributeError


def pytest_collection(session: object) -> None:
    hide()


if __name__ == "__main__":
    hide()
    from delfim.__main__ import main

    for line in sys.argv[1:]:
        code = main(line.split())
        print(f"{code} {line}", flush=True)
