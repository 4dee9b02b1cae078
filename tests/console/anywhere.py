"""A plug-in of pytest: takes from the process what only Linux and its kin have, before the tests are imported."""

import os
import signal
import socket
import sys

import aiohttp
import matplotlib.pyplot as drawing
import numpy
import PIL
import pytest
import serial

HALVES = (aiohttp, drawing, numpy, PIL, serial)  # these have halves of their own for each system: imported before
MODULES = ("fcntl", "termios", "resource", "pwd", "grp", "tty", "pty", "syslog")
WORDS = ("sched_setaffinity", "fork", "O_DIRECTORY", "posix_fadvise", "killpg", "setsid")


def hide() -> None:
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for name in [name for name in dir(socket) if "CAN" in name or name == "AF_UNIX"]:
        delattr(socket, name)
    for name in WORDS:
        delattr(os, name)
    del signal.SIGHUP


def pytest_collection(session: pytest.Session) -> None:
    hide()
