"""Packages of a laboratory, installed as pip would: a folder on the path, and beside it what says that it is installed."""

import shutil
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.base import parts
from delfim.base.modes import OF_PARTS, Mode
from delfim.vehicle.control.control import MODES
from delfim.vehicle.failsafe.troubles import NUMBERS

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "etc/parts"


def installed(place: Path, *kinds: str, version: str = "1.0") -> None:
    """Put the examples of these kinds there."""
    for kind in kinds:
        name = f"example_{kind}"
        shutil.copytree(EXAMPLES / kind / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        known(place, name, f"{name}:PART", version)


def known(place: Path, name: str, entry: str, version: str = "1.0", package: str = "") -> None:
    """What an installer writes of a package with this part."""
    package = package or name
    info = place / f"{package}-{version}.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(f"[delfim.parts]\n{name} = {entry}\n")


def wheel(folder: Path, name: str, *needs: str, version: str = "1.0", part: str = "") -> Path:
    """Write one of a package of this name: a module, and the part if it has one. Returns its path."""
    path = folder / f"{name}-{version}-py3-none-any.whl"
    info = f"{name}-{version}.dist-info"
    texts = {
        f"{name}.py": "",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        + "".join(f"Requires-Dist: {need}\n" for need in needs),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    if part:
        texts[f"{info}/entry_points.txt"] = f"[{parts.GROUP}]\n{part} = {name}:PART\n"
    with zipfile.ZipFile(path, "w") as archive:
        for file, text in texts.items():
            archive.writestr(file, text)
        archive.writestr(f"{info}/RECORD", "".join(f"{file},,\n" for file in [*texts, f"{info}/RECORD"]))
    return path


@pytest.fixture
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path of this process for packages that are forgotten afterwards."""
    place = tmp_path / "laboratory"
    place.mkdir()
    monkeypatch.syspath_prepend(str(place))
    before = set(sys.modules)
    yield place
    for name in set(sys.modules) - before:
        if str(place) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
    parts.forget()
    for mode in [mode for mode in Mode if mode in OF_PARTS]:  # which a program of one boat never has to forget
        Mode._member_names_.remove(mode.name)
        del Mode._member_map_[mode.name], Mode._value2member_map_[mode.value]
        MODES.pop(mode, None)
    for name in [name for name, number in NUMBERS.items() if number in parts.TROUBLES]:
        del NUMBERS[name]
