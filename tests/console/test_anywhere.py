"""The operator's computer may run macOS or Windows: nothing of the console needs what only Linux has."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import importlib, signal, socket, sys
import aiohttp, PIL, serial  # which have halves of their own for each system
for name in ("fcntl", "termios", "resource", "pwd", "grp", "tty", "pty", "syslog"):
    sys.modules[name] = None
for name in [name for name in dir(socket) if "CAN" in name or name == "AF_UNIX"]:
    delattr(socket, name)
import os
for name in ("sched_setaffinity", "getuid", "fork", "O_DIRECTORY", "posix_fadvise"):
    if hasattr(os, name):
        delattr(os, name)
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def test_the_console_is_imported_without_what_only_linux_has() -> None:
    names = sorted(path.stem for path in (ROOT / "delfim/console").glob("[!_]*.py"))
    modules = [f"delfim.console.{name}" for name in names] + ["delfim.simulator.lockstep"]
    child = subprocess.run([sys.executable, "-c", PROGRAM, *modules], capture_output=True, text=True, timeout=100, check=False)
    assert child.returncode == 0, child.stderr
