"""A laboratory's own parts in what a boat runs from, its image or its Debian package: wheels, as docker/image.py takes them."""

import platform
import re
import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from delfim.base.parts import GROUP
from tests.parts.laboratory import EXAMPLES, ROOT, wheel
from tests.parts.test_parts_command import delfim

VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
TARGET = VERSION, platform.machine()


@pytest.fixture
def image(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROOT / "docker")
    import image

    return image


@pytest.mark.long
def test_a_part_that_was_installed_as_the_image_does_is_a_part_of_the_boat(image: Any, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "source", tmp_path / "source")
    words = ["--no-deps", "--no-build-isolation", "--no-index", "-w", tmp_path, tmp_path / "source"]
    subprocess.run([*image.PIP, "wheel", *words], check=True)
    (made,) = tmp_path.glob("*.whl")
    file = tmp_path / "boat.toml"
    file.write_text('[parts]\nexample_source = "1.0"\n')
    site = tmp_path / "site"
    image.check_parts([made], file)
    image.install_parts(site, *TARGET, [made])
    for name in ("RECORD", "direct_url.json", "INSTALLER", "REQUESTED"):  # which no boat has
        next(site.glob("*.dist-info")).joinpath(name).unlink(missing_ok=True)
    assert "example_source       1.0        of the package delfim-example-source" in delfim("parts", "list", place=site).stdout
    with pytest.raises(SystemExit, match=r"example_source-1\.0.* brings .*example_source, which another package has brought"):
        image.install_parts(site, *TARGET, [made])
    with pytest.raises(SystemExit, match=r"example_source-1\.0.* needs delfim: it is not there; give its wheel by --part, too"):
        image.check_needs(site, *TARGET, [made])


@pytest.mark.parametrize(
    ("given", "named", "words"),
    [
        ([], 'acme = "1.0"', "boat.toml: parts.acme: no wheel of --part has it"),
        ([("lab", "acme", "1.0")], 'acne = "1.0"', "boat.toml: parts.acne: no wheel of --part has it; did you mean acme?"),
        ([("lab", "acme", "1.1")], 'acme = "1.0"', "acme: the file is made for 1.0, and lab-1.1-py3-none-any.whl is 1.1"),
        ([("lab", "", "1.0")], "", f"lab-1.0-py3-none-any.whl has no part (entry point in the group {GROUP})"),
        ([("lab", "acme", "1.0"), ("bay", "acme", "1.0")], "", "bay-1.0-py3-none-any.whl and lab-1.0-py3-none-any.whl both"),
        ([], "acme = ", "boat.toml: not TOML"),
        ([("lab", "acme", "1.0"), ("bay", "winch", "2")], 'acme = "1.0"\nwinch = "2"', ""),
    ],
)
def test_an_image_has_the_parts_that_its_file_names(image, tmp_path, given, named, words):
    (tmp_path / "boat.toml").write_text(f"[parts]\n{named}\n")
    wheels = [wheel(tmp_path, name, part=part, version=version) for name, part, version in given]
    with pytest.raises(SystemExit, match=re.escape(words)) if words else nullcontext():
        image.check_parts(wheels, tmp_path / "boat.toml")


def test_what_a_part_needs_is_aboard_or_given(image: Any, tmp_path: Path) -> None:
    site = tmp_path / "site"
    for name, version in (("delfim", "0.1"), ("msgspec", "0.22")):
        shutil.unpack_archive(wheel(tmp_path, name, version=version), site, "zip")
    port = wheel(tmp_path, "Some_port")
    aboard = ["delfim", "msgspec>=0.2", "nothing; python_version<'3'", "nothing; extra=='test'"]
    image.check_needs(site, *TARGET, [wheel(tmp_path, "lab", *aboard)])
    lab = wheel(tmp_path, "lab", "msgspec<0.20", part="acme")
    with pytest.raises(SystemExit, match=r"lab-1\.0-py3-none-any\.whl needs msgspec<0\.20: version 0\.22 is there"):
        image.check_needs(site, *TARGET, [lab])
    lab = wheel(tmp_path, "lab", "some-port", part="acme")
    image.check_parts([port, lab])
    shutil.unpack_archive(port, site, "zip")
    image.check_needs(site, *TARGET, [lab])


@pytest.mark.parametrize("name", ["lab.whl", "lab.tar.gz", "absent.whl", "."])
def test_what_is_no_wheel_is_refused(image: Any, tmp_path: Path, name: str) -> None:
    (tmp_path / "lab.whl").write_text("no archive")
    wheel(tmp_path, "lab").rename(tmp_path / "lab.tar.gz")
    with pytest.raises(SystemExit, match=r"is no wheel that can be read: pip wheel --no-deps \./FOLDER makes one"):
        image.check_parts([tmp_path / name])
