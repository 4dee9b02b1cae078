"""The operator's computer may run macOS or Windows: nothing of the console needs what only Linux has."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import importlib, signal, socket, sys
import aiohttp, matplotlib.pyplot, PIL, serial  # which have halves of their own for each system
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


READERS = ["candump", "canexport", "export", "fetch", "liblog", "plot", "progress", "reading", "repair", "statelog", "summary"]
READERS += ["systemlines", "table", "tree"]
COMMANDS = ["can", "check", "commission", "console", "describe", "drive", "fault", "log", "new", "password", "shore"]
TESTS = ["tests/console/test_fleet.py", "tests/logging/test_candump.py"]


def test_the_console_is_imported_without_what_only_linux_has() -> None:
    names = sorted(path.stem for path in (ROOT / "delfim/console").glob("[!_]*.py"))
    modules = [f"delfim.console.{name}" for name in names] + ["delfim.simulator.lockstep"]
    modules += [f"delfim.logging.{name}" for name in READERS] + [f"delfim.commands.{name}" for name in COMMANDS]
    child = subprocess.run([sys.executable, "-c", PROGRAM, *modules], capture_output=True, text=True, timeout=100, check=False)
    assert child.returncode == 0, child.stderr


def test_unit_tests_of_the_ground_part_pass_there() -> None:
    words = ["-p", "tests.console.anywhere", "-p", "no:cacheprovider", "-n", "0", "-q", *TESTS]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pytest", *words]
    child = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=100, check=False)
    assert child.returncode == 0, child.stdout + child.stderr


def test_a_command_of_the_boat_says_that_it_needs_linux() -> None:
    program = "import sys; sys.modules['fcntl'] = None\nfrom delfim.__main__ import main\nsys.exit(main(['sim']))"
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (child.returncode, child.stderr) == (2, "delfim: sim needs Linux: this system has no fcntl\n")
