"""Becomes a payload program, confined:
`python -m delfim.services.supervision.confine GROUP USER MEMORY-MB CPU PROCESSES NETWORK PROGRAM WORD...`

Limits, an unprivileged user, no network (unless NETWORK is "network"), no CAN sockets, no way to more rights; then the program
takes the place of this one. It is a program of its own because a process with threads may do nothing of this between fork and
exec.
"""

import contextlib
import ctypes
import logging
import os
import pwd
import resource
import signal
import sys
from pathlib import Path
from typing import Final

from delfim.base.errors import PermanentFailure, in_words
from delfim.services.supervision import processes
from delfim.services.supervision.cgroup import Limits
from delfim.services.supervision.nocan import forbid_can

FILES: Final = 256  # open at once
FIRST_TO_GO: Final = "1000"  # when the computer's memory is full
PARENT_DEATH_SIGNAL, NO_NEW_PRIVILEGES = 1, 38  # sys/prctl.h
CLONE_NEWUSER, CLONE_NEWNET = 0x1000_0000, 0x4000_0000  # linux/sched.h
NETWORK, ALONE = "network", "alone"  # words of the command line


def confine(group: str, user: str, memory_bytes: int, cpu: float, processes_max: int, network: bool) -> dict[str, str]:
    """Confine this process for good; returns the program's environment. Raises OSError, PermanentFailure."""
    logging.disable()  # the service has said once whether there are control groups
    held = Limits(memory_bytes, cpu).hold(group, os.getpid())
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    if not network:
        _leave_networks()
    _prctl(NO_NEW_PRIVILEGES, 1)
    forbid_can()
    account = _become(user)
    _prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)  # after the change of user, which would clear it
    _at_most(resource.RLIMIT_NPROC, processes.threads(account.pw_uid) + processes_max)
    _at_most(resource.RLIMIT_NOFILE, FILES)
    _at_most(resource.RLIMIT_CORE, 0)
    if not held:
        _at_most(resource.RLIMIT_AS, memory_bytes)
    os.umask(0o077)
    os.chdir("/")
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    names = {"USER": account.pw_name, "LOGNAME": account.pw_name, "HOME": account.pw_dir}
    return {"PATH": "/usr/local/bin:/usr/bin:/bin", "LANG": "C.UTF-8", **names}


def _leave_networks() -> None:
    """Move to a network namespace of its own, where there is nothing, not even the loopback. Without root this needs a user
    namespace, in which the user stays the same. Raises PermanentFailure."""
    uid, gid = os.getuid(), os.getgid()
    try:
        _call("unshare", CLONE_NEWNET | (CLONE_NEWUSER if uid else 0))
        if uid:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"{uid} {uid} 1")
            Path("/proc/self/gid_map").write_text(f"{gid} {gid} 1")
    except OSError as error:
        why = f"this kernel keeps no program from the network: {error.strerror}"
        raise PermanentFailure(f"{why}; its table needs network = true, and then it reaches the boat's doors") from None


def _become(name: str) -> pwd.struct_passwd:
    """Become the user who runs the program. Raises PermanentFailure."""
    if os.getuid():
        return pwd.getpwuid(os.getuid())  # a simulation on somebody's desk
    try:
        account = pwd.getpwnam(name)
    except KeyError:
        raise PermanentFailure(f"user: there is no {name}") from None
    if account.pw_uid == 0:
        raise PermanentFailure(f"user: {name} has the rights of root")
    os.initgroups(name, account.pw_gid)
    os.setgid(account.pw_gid)
    os.setuid(account.pw_uid)
    return account


def _at_most(what: int, limit: int) -> None:
    _, most = resource.getrlimit(what)
    limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
    resource.setrlimit(what, (limit, limit))


def _prctl(what: int, value: int) -> None:
    _call("prctl", what, value, 0, 0, 0)


def _call(name: str, *numbers: int) -> None:
    """A function of the C library that Python lacks. Raises OSError."""
    if ctypes.CDLL(None, use_errno=True)[name](*numbers):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def main(group: str, user: str, memory_mb: str, cpu: str, processes_max: str, network: str, *command: str) -> int:
    """Confine this process and run the program. Returns only where that fails; standard error says why."""
    try:
        names = confine(group, user, int(memory_mb) << 20, float(cpu), int(processes_max), network == NETWORK)
        os.execve(command[0], command, names)
    except (OSError, PermanentFailure) as error:
        os.write(2, f"{in_words(error)}\n".encode())
        if isinstance(error, PermanentFailure):
            from delfim.services.supervision.supervisor import EXIT_PERMANENT  # loaded only for a mistake

            return EXIT_PERMANENT
    return 127


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
