"""The core without its parts: all of delfim/parts is taken away but the boat's own nodes, the thesis' bus, and the tables: any
vehicle's file is checked. The boat hears of no other vessels."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.base.parts import OWN_NODES
from delfim.logging.ashore.table import table
from delfim.logging.ashore.tree import files
from delfim.services.supervision.supervisorfile import last_deadman
from delfim.vehicle.operator.link import Link
from tests.afloat import running

ROOT = Path(__file__).parents[2]
SAIL = """import pathlib, sys, delfim
from tests.logging.sailing import sailed
sailed(pathlib.Path(sys.argv[1]), "traffic.hears=[]").end()
print(delfim.__file__)"""


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("core")
    shutil.copytree(ROOT / "delfim", place / "delfim", ignore=shutil.ignore_patterns("__pycache__", "web", "page.js", "etc"))
    (place / "delfim/etc").symlink_to(ROOT / "etc")
    for part in (place / "delfim/parts").iterdir():
        if part.is_dir() and part.name != OWN_NODES:
            for file in part.iterdir():
                if file.is_dir():
                    shutil.rmtree(file)
                elif file.name not in ("__init__.py", "table.py"):
                    file.unlink()
    return place


def test_it_sails_in_lock_step_and_logs_as_with_them(core, tmp_path):
    logs = list[bytes]()
    for package in (core, ROOT):
        out = tmp_path / package.name
        there = os.environ | {"PYTHONPATH": f"{package}:{ROOT}", "PYTHONSAFEPATH": "1"}
        done = subprocess.run([sys.executable, "-c", SAIL, str(out)], env=there, capture_output=True, text=True)
        assert done.stdout.strip() == str(package / "delfim/__init__.py"), done.stderr
        (log,) = (file for file in files([out]) if file.id == "state")
        columns, _ = table([log])
        logs.append(b"".join(columns[name].tobytes() for name in ("t0", "heading", "port_command", "starboard_command")))
    assert logs[0] == logs[1]


@pytest.mark.long
def test_it_sails_in_real_time_and_the_dead_man_stops_it(core, tmp_path):
    def ask(command: str, **words: object) -> dict:
        while True:
            try:
                with Link(tmp_path / "command", 60.0) as link:
                    return link.ask(command, **words)
            except DelfimError:  # it does not run yet, or is not ready
                continue

    with running(tmp_path, 14550, "mavlink.enabled=false", "traffic.hears=[]", "supervisor.deadman_s=1.0", package=core):
        ask("heading", heading_deg=90.0, speed_mps=1.0)
        while not ask("state")["thrusters"]["starboard"]["thrust"]:
            pass
        supervisor = tmp_path / "supervisor.json"
        os.kill(json.loads(supervisor.read_text())["programs"]["runtime"]["pid"], signal.SIGSTOP)
        while not (event := last_deadman(supervisor)):
            pass
    assert "beat stopped" in str(event["reason"])
    (first, *_) = (file for file in files([tmp_path / "log"]) if file.id == "state")
    columns, _ = table([first])
    assert len(columns["t1"]) > 0
