"""The guard beside the helm of MOOS-IvP: what a helm says is steered, one that ends is told, the table has what was sailed."""

import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from bench import avoiding
from delfim.base.errors import DelfimError
from delfim.config import Vehicle
from delfim.simulator.scenarios.encounters import Staged
from delfim.simulator.tables import Sea

VEHICLE = "etc/delfimx.toml"
TO_THE_EAST = """
import sys
print(len(sys.argv[1:]), file=sys.stderr)
for line in sys.stdin:
    words = line.split()
    assert len(words) == 5 + 4 * int(sys.argv[2]), words
    print("90 1.5", flush=True)
"""


@pytest.fixture
def short() -> Staged:
    """The first minute of a case."""
    case = avoiding.cases(quick=True)[0]
    return case._replace(scenario=msgspec.structs.replace(case.scenario, seconds=70.0))


def helm(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "helm"
    file.write_text(f"#!{sys.executable}\n{text}")
    file.chmod(0o755)
    return file


def test_what_the_helm_decides_is_steered(short: Staged, tmp_path: Path) -> None:
    away = avoiding.sailed(short, VEHICLE, helm(tmp_path, TO_THE_EAST), avoiding.DEFAULT)
    on = avoiding.sailed(short, VEHICLE, None, None)
    assert away.late_s > 40.0
    assert abs(on.late_s) < 10.0
    assert (away.collisions, on.entered, len(on.nearest)) == (0, 0, 1)


def test_all_pilots_sail_in_a_calm(short: Staged, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[Sea]()
    started = avoiding.settings_of

    def checked(*words: Any) -> Vehicle:
        settings = started(*words)
        seen.append(settings.simulation.sea)
        return settings

    monkeypatch.setattr(avoiding, "settings_of", checked)
    avoiding.sailed(short, VEHICLE, None, None)
    assert [(each.current_mps, each.wind_mps) for each in seen] == [(0.0, 0.0)]


def test_a_helm_that_ends_is_told(short: Staged, tmp_path: Path) -> None:
    with pytest.raises(DelfimError, match="moosavoid ended"):
        avoiding.sailed(short, VEHICLE, helm(tmp_path, "import sys; sys.stdin.readline()"), avoiding.DEFAULT)


def test_without_moos_there_is_no_helm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert avoiding.built(tmp_path) is None


def test_the_table_has_a_line_for_each_pilot() -> None:
    rows = [avoiding.Avoided("a", 1, 1, (0.5, 1.5), 60.0, 4, ("8a",)), avoiding.Avoided("b", 0, 0, (2.0,), 20.0, 3, ())]
    assert avoiding.table({"one": rows}).splitlines()[-1] == "| one | 3 | 1 | 1 | 0.50, 1.50 | 40 s (60) | 6 of 7 |"
