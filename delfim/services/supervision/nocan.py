"""Forbids CAN sockets to this process and all that it starts, for good: a filter of system calls (seccomp).

Linux lets every user send on every CAN bus, and there is no right to take away: so anyone with a shell could command the
propellers. Here `socket(AF_CAN)` is answered with "permission denied". Standard library only.
"""

import ctypes
import errno
import os
import struct
from typing import Final

AF_CAN: Final = 29
IO_URING_SETUP: Final = 425  # the same everywhere; io_uring opens sockets past every filter
X32: Final = 0x4000_0000  # x86-64's second set of numbers
# machine: architecture in the kernel's numbers (linux/audit.h), the numbers of socket and seccomp
MACHINES: Final = {
    "x86_64": (0xC000_003E, 41, 317),
    "aarch64": (0xC000_00B7, 198, 277),
    "riscv64": (0xC000_00F3, 198, 277),
    "armv7l": (0x4000_0028, 281, 383),
}
ALLOW: Final = 0x7FFF_0000
DENY: Final = 0x0005_0000 | errno.EACCES
KILL: Final = 0x8000_0000  # programs of another architecture have other numbers
LOAD, EQUAL, AT_LEAST, RETURN = 0x20, 0x15, 0x35, 0x06  # instructions (linux/bpf_common.h)
NUMBER, ARCHITECTURE, FIRST_ARGUMENT = 0, 4, 16  # offsets (linux/seccomp.h), on machines with the low byte first
SET_MODE_FILTER, ALL_THREADS = 1, 1


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def forbid_can() -> None:
    """Install the filter. Needs CAP_SYS_ADMIN. Raises OSError."""
    machine = os.uname().machine
    if machine not in MACHINES or (struct.calcsize("P") == 8) != machine.endswith("64"):
        raise OSError(errno.ENOSYS, f"not known for {machine}")
    architecture, socket_number, seccomp_number = MACHINES[machine]
    text = b"".join(
        struct.pack("=HBBI", code, jump, skip, value)
        for code, jump, skip, value in (
            (LOAD, 0, 0, ARCHITECTURE),
            (EQUAL, 1, 0, architecture),
            (RETURN, 0, 0, KILL),
            (LOAD, 0, 0, NUMBER),
            (AT_LEAST, 5, 0, X32),
            (EQUAL, 4, 0, IO_URING_SETUP),
            (EQUAL, 0, 2, socket_number),
            (LOAD, 0, 0, FIRST_ARGUMENT),
            (EQUAL, 1, 0, AF_CAN),
            (RETURN, 0, 0, ALLOW),
            (RETURN, 0, 0, DENY),
        )
    )
    program = _Program(len(text) // 8, text)
    libc = ctypes.CDLL(None, use_errno=True)
    words = (ctypes.c_long(seccomp_number), ctypes.c_uint(SET_MODE_FILTER), ctypes.c_uint(ALL_THREADS), ctypes.byref(program))
    if libc.syscall(*words):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
