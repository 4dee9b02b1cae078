"""The operator's computer may run macOS or Windows: nothing of the desk's part needs what only Linux has. No such computer is
here, so `anywhere.py` takes from a process what it would lack there."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.base.eventloop import new_event_loop
from delfim.commands import GROUPS, LINUX

ROOT = Path(__file__).parents[2]
IMPORT = """import importlib, sys
from tests.console import anywhere
anywhere.hide()
for name in sys.argv[1:]:
    importlib.import_module(name)
"""
READERS = ["candump", "liblog", "reading", "statelog", *(f"ashore.{name}" for name in ("canexport", "export", "fetch", "plot"))]
READERS += [f"ashore.{name}" for name in ("progress", "repair", "summary", "systemlines", "table", "tree")]
COMMANDS = [f"description.{name}" for name in ("check", "commission", "describe", "new", "password")]
COMMANDS += ["operation.can", "operation.console", "operation.log", "simulation.sim"]
TESTS = ["console/test_fleet.py", "console/test_charts.py", "logging/test_candump.py"]
DESK = (
    "sim --lockstep --for 5",
    "sim --scenario etc/scenarios/kill.toml",
    "new boat.toml --yes",
    "check boat.toml",
    "check --sea etc/delfimx-sea.toml",
    "commission etc/delfimx-sea.toml --yes --users ana",
    "describe",
    "log ls run/sim",
    "log info run/sim",
    "log cat run/sim --fields t1 --to +1",
    "log plot run/sim --output plots",
    "log export csv run/sim --output day.csv",
    "log export gpx run/sim --output day.gpx",
    "log export mcap run/sim --output day.mcap",
    "log repair run/sim",
)


def there(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """A child that has lost what Windows lacks."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False
    )


def test_the_desks_part_is_imported_without_what_only_linux_has() -> None:
    files = sorted(path.relative_to(ROOT).with_suffix("") for path in (ROOT / "delfim/console").rglob("[!_]*.py"))
    modules = [".".join(file.parts) for file in files if file.stem != "tabletd"]  # which is the boat's
    modules += ["delfim.simulator.lockstep", "delfim.simulator.replay.rerun"]
    modules += [f"delfim.logging.{name}" for name in READERS] + [f"delfim.commands.{name}" for name in COMMANDS]
    child = there(ROOT, "-c", IMPORT, *modules)
    assert child.returncode == 0, child.stderr


@pytest.mark.long
def test_unit_tests_of_the_ground_part_pass_there() -> None:
    words = ["-p", "tests.console.anywhere", "-p", "no:cacheprovider", "-n", "0", "-q"]
    child = there(ROOT, "-m", "pytest", *words, *(f"tests/{name}" for name in TESTS))
    assert child.returncode == 0, child.stdout + child.stderr


@pytest.mark.long
def test_the_desks_commands_work_there(tmp_path: Path) -> None:
    """A mission in lock step, its log read and exported, a boat's files made and checked."""
    child = there(tmp_path, str(ROOT / "tests/console/anywhere.py"), *DESK)
    codes = [line for line in child.stdout.splitlines() if line[2:] in DESK]
    assert codes == [f"0 {line}" for line in DESK], child.stdout[-2000:] + child.stderr
    assert (tmp_path / "day.gpx").stat().st_size > 1000


def test_what_needs_the_boats_computer_says_so(tmp_path: Path) -> None:
    words = sorted(LINUX - {"actuate"})
    child = there(tmp_path, str(ROOT / "tests/console/anywhere.py"), "sim", "sim --console", *words)
    told = child.stderr.splitlines()
    real = "delfim: in real time the boat's own programs run, and need Linux (on Windows: WSL 2); --lockstep sails here"
    assert told[:2] == [real, real], child.stderr
    assert [line.split()[1:4] for line in told[2:]] == [[word, "needs", "Linux,"] for word in words]
    assert set(GROUPS["On the boat"]) <= LINUX


def test_the_console_goes_on_hearing_when_a_boat_was_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows' own loop stops reading a UDP socket for good when one datagram finds nobody; the one that selects does not."""
    monkeypatch.setitem(sys.modules, "uvloop", None)
    loop = new_event_loop()
    loop.close()
    assert isinstance(loop, asyncio.SelectorEventLoop)
