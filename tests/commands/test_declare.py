"""`delfim declare`: a form of each boat, of which what the file does not know is blank."""

from pathlib import Path

import pytest

from delfim import config
from delfim.__main__ import main
from delfim.desk.declaration import OWNERS, UNKNOWN, form, notice

ROOT = Path(__file__).parents[2]
BOATS = sorted((ROOT / "etc/boats").glob("*.toml"))


@pytest.mark.parametrize("boat", [*BOATS, ROOT / "etc/delfimx.toml"], ids=lambda boat: boat.stem)
def test_each_boat_has_its_form(boat: Path, tmp_path: Path) -> None:
    assert main(["declare", str(boat), "--output", str(tmp_path / "form.html")]) == 0
    page, its = (tmp_path / "form.html").read_text(), config.load(boat).boat
    assert f"{its.name}: " in page
    assert f"Length overall {its.length_m} m" in page
    assert "http" not in page


@pytest.mark.parametrize(
    ("length_m", "which"), [(0.8, "MGN 702"), (2.49, "MGN 702"), (2.5, "MGN 705"), (4.49, "MGN 705"), (4.5, ""), (12.0, "")]
)
def test_the_length_says_which_notice(length_m: float, which: str) -> None:
    assert notice(length_m) == which


def test_what_the_file_does_not_know_is_blank_and_says_so() -> None:
    page = form(config.load(ROOT / "etc/boats/otter.toml"), "1.2.3")
    assert page.count("the vehicle&#x27;s file does not know it") >= len(OWNERS)
    assert UNKNOWN.startswith("____")


def test_a_boat_that_could_be_too_fast_is_told() -> None:
    boat = ROOT / "etc/boats/skiff.toml"
    assert "not above 6 kn" in form(config.load(boat, ["boat.full_mps=3.0"]), "1")
    assert "could be faster than 6 kn" in form(config.load(boat, ["boat.full_mps=3.2"]), "1")
