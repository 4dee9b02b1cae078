"""The same seed gives the same digest on every interpreter that this machine has."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.campaign import sailing
from delfim.campaign.runplan import read
from tests.campaign.test_runplan import ETC, written
from tests.services.test_interpreters import interpreters

ROOT = ETC.parent
RUNS = ((0, 1), (0, 2), (1, 1), (1, 17))
PROGRAM = f"""
import json, sys
from delfim.campaign import sailing
from delfim.campaign.runplan import read
plan = read(sys.argv[1])[1]
print(json.dumps([sailing.one(plan, 0, point, seed)["digest"] for point, seed in {RUNS}]))
"""


def campaign(folder: Path) -> Path:
    return written(folder, 'scenario = "mixed"', "seeds = {count = 20}", "[vary]", '"simulation.sea.wind_mps" = [0.0, 6.0]')


@pytest.mark.long
@pytest.mark.parametrize(("version", "python"), interpreters().items())
def test_the_same_seed_gives_the_same_digest_on(version: str, python: Path, tmp_path: Path) -> None:
    """Needs the compiled packages of each version, which `make test-long` puts beside this one's."""
    path = campaign(tmp_path)
    _, plan = read(path)
    here = [sailing.one(plan, 0, point, seed)["digest"] for point, seed in RUNS]
    assert len(set(here)) == len(RUNS)
    if f"3.{sys.version_info.minor}" == version:
        python, kept = Path(sys.executable), ROOT
    else:
        kept = Path(sys.prefix) / "builds" / version
    settings = {"PYTHONPATH": f"{ROOT}:{kept}", "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([python, "-c", PROGRAM, path], capture_output=True, text=True, env=settings, timeout=100)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == here
