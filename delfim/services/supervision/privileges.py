"""Requests of a process to the kernel: scheduler, processors, memory. A refused one costs one warning."""

import ctypes
import logging
import os
import sys
from collections.abc import Callable
from typing import Final

from delfim import config

SWITCH_S: Final = 0.0001  # that a thread may keep the interpreter from the loop; the interpreter's own choice is 5 ms

log = logging.getLogger(__name__)


def set_privileges(settings: config.RuntimeTable) -> None:
    """The requests that hold from the start."""
    sys.setswitchinterval(SWITCH_S)
    if settings.nice:
        requested(f"nice = {settings.nice}", lambda: os.setpriority(os.PRIO_PROCESS, 0, settings.nice))
    if settings.cpus:
        requested(f"cpus = {list(settings.cpus)}", lambda: os.sched_setaffinity(0, settings.cpus))
    if settings.mlockall:
        requested("mlockall", _mlockall)


def requested(name: str, do: Callable[[], object]) -> None:
    """Make a request; if permission is missing, warn and go on."""
    try:
        do()
    except OSError as error:
        log.warning("runtime.%s: %s; going on without it", name, error.strerror)


def _mlockall() -> None:
    current, future = 1, 2  # sys/mman.h
    if ctypes.CDLL(None, use_errno=True).mlockall(current | future):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def real_time(priority: int) -> None:
    """Make this process real time; children and threads start with the ordinary scheduler. Raises OSError."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
