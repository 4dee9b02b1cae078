"""`delfim parts`: what `new` writes works and keeps the contract, and what does not keep it is named in words."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from delfim.commands.description.parts import KINDS, USED
from tests.parts.laboratory import ROOT, installed, known

long = partial(pytest.param, marks=pytest.mark.long)  # the second and further ones of a kind


def delfim(*words: str, place: Path) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PYTHONPATH": f"{place}:{ROOT}"}
    return subprocess.run([sys.executable, "-m", "delfim", *words], env=env, capture_output=True, text=True, timeout=200)


@pytest.mark.parametrize("kind", KINDS)
def test_what_it_writes_is_installed_and_keeps_the_contract(tmp_path, kind):
    told = delfim("parts", "new", kind, "acme", "--output", str(tmp_path / "packages"), place=tmp_path)
    assert told.returncode == 0, told.stderr
    assert USED.get(kind, "[parts]").format("acme") in told.stdout, "where the vehicle's file uses it"
    package = tmp_path / "packages/delfim-acme"
    assert not [path for path in package.rglob("*") if path.is_file() and "example" in path.read_text() + path.name]
    (tmp_path / "acme").symlink_to(package / "acme")
    known(tmp_path, "acme", "acme:PART")
    assert "acme                 1.0        of the package acme (acme:PART)" in delfim("parts", "list", place=tmp_path).stdout
    checked = delfim("parts", "check", "acme", place=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert checked.stdout.endswith("acme: nothing is wrong with this part\n")
    assert delfim("parts", "new", kind, "acme", "--output", str(tmp_path / "packages"), place=tmp_path).returncode == 2


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        ("motor/driver.py", "self._thrust = dict", "line.write(b'hi'); self._thrust = dict", "it spoke"),
        ("motor/driver.py", 'raise OSError("example_motor: the line takes no stop")', "pass", "stop did not raise OSError"),
        long("motor/driver.py", "sum(not self.input.write(", "sum(not not self.input.write(", "returned 1, not 0"),
        long(
            "motor/driver.py",
            "except (ValueError, KeyError)",
            "except KeyError",
            "garbage where its reports come: it raised ValueError",
        ),
        long(
            "motor/driver.py",
            '{"thrust": {name: self._thrust[address]',
            '{"thrust": {name: self',
            "report can be JSON: it raised TypeError",
        ),
        long("motor/driver.py", 'self.input.write(b"\\nthrust %d 0\\n" % address)', "True", "stop is sent: nothing came"),
        ("source/source.py", "fix = None", "fix = Fix(None, 0, 0.0)", "silence: it returned something"),
        ("source/source.py", "self._rest = self._rest[-LINE_MAX:]", "self._rest = b''", "byte by byte: it was not understood"),
        ("sensor/sensor.py", "except ValueError", "except KeyError", "garbage: it raised ValueError"),
        (
            "service/service.py",
            "async def serve",
            "def nothing(): ...\n\n\nserve = nothing\n\n\nasync def other",
            "is no coroutine",
        ),
        (
            "order/winch.py",
            "    fastest_mps, mo",
            "    while True: pass\n    fastest_mps, mo",
            "order pay_out: TimeoutError: it took",
        ),
        (
            "order/winch.py",
            "    fastest_mps, mo",
            "    from time import perf_counter\n\n    end_s = perf_counter() + 0.03\n"
            "    while perf_counter() < end_s:\n        pass\n    fastest_mps, mo",
            "order pay_out: ",  # a call took 30 ms; on a busy machine perhaps more than the 0.1 s after which it is broken off
        ),
        ("trouble/sees.py", "if navigation is None or ", "if ", "cannot tell: AttributeError"),
    ],
)
def test_what_does_not_keep_it_is_named(tmp_path, file, before, after, words):
    kind, name = file.split("/")
    installed(tmp_path, kind)
    text = (tmp_path / f"example_{kind}" / name).read_text()
    assert text.count(before) == 1
    (tmp_path / f"example_{kind}" / name).write_text(text.replace(before, after))
    checked = delfim("parts", "check", f"example_{kind}", place=tmp_path)

    assert checked.returncode == 1, checked.stdout + checked.stderr
    assert words in checked.stdout
    assert "wrong" in checked.stdout.splitlines()[-1]


def test_a_part_that_is_not_installed_and_a_name_that_is_none(tmp_path):
    assert "no installed package has a part of the name acme" in delfim("parts", "check", "acme", place=tmp_path).stderr
    assert "is no name for a part" in delfim("parts", "new", "motor", "Acme!", place=tmp_path).stderr
    assert "writes one to begin with" in delfim("parts", "list", place=tmp_path).stdout


@pytest.mark.parametrize(
    ("name", "whose"), [("vesc", "the boat's"), ("boat", "the boat's"), ("json", "Python's"), ("class", "Python's")]
)
def test_a_name_that_could_never_be_used_is_refused_before_a_package_is_written(tmp_path, name, whose):
    told = delfim("parts", "new", "motor", name, "--output", str(tmp_path), place=tmp_path)
    assert (told.returncode, f"{name} is a name of {whose} own" in told.stderr) == (2, True), told.stderr
    assert not [*tmp_path.glob("**/delfim-*")]
