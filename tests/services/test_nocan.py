"""A filter cannot be taken off again: each test has a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.getuid() != 0, reason="only root may filter system calls")
BEFORE = f"""
import ctypes, errno, os, socket, subprocess, sys, threading
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from delfim.services.supervision.nocan import forbid_can

def refused():
    "How each kind of CAN socket is answered."
    answers = set()
    for kind, protocol in ((3, 1), (2, 2), (2, 6), (2, 7), (3, 0), (2 | socket.SOCK_CLOEXEC, 1)):
        try:
            socket.socket(29, kind, protocol).close()
            answers.add("open")
        except OSError as error:
            answers.add(errno.errorcode[error.errno])
    return answers
"""


def tried(program: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f'{BEFORE}{program}print("well")'], capture_output=True, text=True, timeout=200
    )
    assert done.stdout == "well\n", done.stderr


def test_no_can_socket_can_be_opened_and_every_other_can() -> None:
    tried("""
forbid_can()
assert refused() == {"EACCES"}, refused()
for family in (socket.AF_INET, socket.AF_INET6, socket.AF_UNIX, socket.AF_NETLINK):
    socket.socket(family, socket.SOCK_DGRAM).close()
""")


def test_threads_that_run_already_programs_that_are_started_and_other_users_are_held_too() -> None:
    tried("""
go, found = threading.Event(), []
thread = threading.Thread(target=lambda: (go.wait(), found.append(refused())))
thread.start()
forbid_can()
go.set()
thread.join()
assert found == [{"EACCES"}], found
program = "import socket\\ntry: socket.socket(29, 3, 1)\\nexcept PermissionError: print('no')"
assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "no\\n"
os.setuid(65534)
assert refused() == {"EACCES"}
""")


def test_there_is_no_way_round_by_other_numbers() -> None:
    """io_uring, x86-64's second set of system calls, and the first argument's upper half, which the kernel overlooks."""
    tried("""
forbid_can()
from delfim.services.supervision.nocan import MACHINES
libc = ctypes.CDLL(None, use_errno=True)
_, number, _ = MACHINES[os.uname().machine]
for call in (
    lambda: libc.syscall(ctypes.c_long(425), 4, ctypes.create_string_buffer(120)),
    lambda: libc.syscall(ctypes.c_long(number), ctypes.c_long(29 | 1 << 32), 3, 1),
    lambda: libc.syscall(ctypes.c_long(0x40000000 | number), 29, 3, 1),
):
    assert call() == -1 and ctypes.get_errno() == errno.EACCES, errno.errorcode[ctypes.get_errno()]
""")


def test_a_machine_that_is_not_known_is_said() -> None:
    tried("""
os.uname = lambda: type("Name", (), {"machine": "i686"})
try:
    forbid_can()
except OSError as error:
    assert error.strerror == "not known for i686"
""")


def test_the_shell_of_another_user_has_none() -> None:
    tried("""
from delfim.services.files.sshd import _become
_become("nobody", "/nowhere", can=False)
assert refused() == {"EACCES"}
""")
