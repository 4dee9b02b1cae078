"""The page of keys and the shipped vehicle files agree with the code."""

from pathlib import Path

import pytest

from delfim.config import load
from delfim.console.terminal.describe import describe

ROOT = Path(__file__).parent.parent


def test_the_page_is_what_the_command_writes():
    assert (ROOT / "docs/vehicle-file.md").read_text() == describe(), "run: delfim describe > docs/vehicle-file.md"


@pytest.mark.parametrize("file", sorted((ROOT / "etc").glob("*.toml")), ids=lambda file: file.name)
def test_shipped_vehicles_are_fit(file):
    vehicle = load(file)
    assert not vehicle.simulation.mission or (file.parent / vehicle.simulation.mission).exists()


def test_every_key_says_what_it_means():
    rows = [row for row in describe().splitlines() if row.startswith("| `")]
    assert rows
    assert not [row for row in rows if row.endswith("|  |")]
