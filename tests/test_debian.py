"""The Debian packages, as far as they can be looked at without the wheels that are in them and without installing them: fields,
files, scripts. `make deb ARGS=--try` does the rest."""

import configparser
import hashlib
import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from delfim import __version__
from tests.parts.laboratory import wheel

ROOT = Path(__file__).parents[1]
PARTS = ROOT / "docker/debian"
SITE = "opt/delfim/lib/python3.13/site-packages"
SCRIPTS = sorted([*PARTS.glob("*inst"), *PARTS.glob("*rm"), *PARTS.glob("*.sh"), PARTS / "default", ROOT / "etc/init.d/delfim"])
PROGRAMS = {"opt/delfim/bin/delfim", "etc/init.d/delfim", f"{SITE}/delfim/etc/init.d/delfim"}
WHEELS = {  # as pip would install them
    "boat.txt": """delfim/__init__.py msgspec/__init__.py msgspec-1.dist-info/METADATA msgspec-1.dist-info/RECORD
        bin/delfim share/man/x.1 lxml/etree.py lxml-1.dist-info/METADATA
        pymavlink/__init__.py pymavlink/generator/mavgen.py pymavlink/dialects/__init__.py
        pymavlink/dialects/v10/common.py pymavlink/dialects/v20/__init__.py pymavlink/dialects/v20/common.py""",
    "ground.txt": """delfim/__init__.py msgspec/__init__.py msgspec-1.dist-info/METADATA pymavlink/generator/mavgen.py
        bin/fonttools matplotlib/__init__.py matplotlib-1.dist-info/METADATA matplotlib-1.dist-info/RECORD""",
}


def installed(site: Path, _version: str, _machine: str, _cache: Path, *locks: str) -> None:
    """In place of what asks PyPI."""
    for name in WHEELS[locks[0]].split():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(f"Name: {name.partition('-')[0]}\nVersion: 1\n" if name.endswith("METADATA") else "")


def unpacked(site: Path, _version: str, _machine: str, wheels: list[Path]) -> None:
    """In place of pip, whose work on a part tests/parts has."""
    for each in wheels:
        shutil.unpack_archive(each, site, "zip")


@pytest.fixture(scope="module")
def deb() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docker")
        module = importlib.import_module("deb")
        patch.setattr(module, "install_python", installed)
        patch.setattr(module, "install_parts", unpacked)
        yield module


def made(deb: ModuleType, folder: Path, release: str = "13", arch: str = "arm64", needs: str = "msgspec") -> tuple[Path, Path]:
    boat, ground = folder / "delfim", folder / "delfim-ground"
    deb.lay_out(
        boat, ground, deb.RELEASES[release], deb.MACHINES[arch], folder / "cache", [wheel(folder, "lab", needs, part="acme")]
    )
    return deb.packed(boat, folder, release, arch), deb.packed(ground, folder, release, arch)


@pytest.fixture(scope="module")
def packages(deb: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return made(deb, tmp_path_factory.mktemp("packages"))


def ask(*words: str | Path) -> str:
    return subprocess.run(["dpkg-deb", *words], check=True, capture_output=True, text=True).stdout


def contents(package: Path) -> dict[str, tuple[str, str]]:
    """Mode and owner by name, links with where they lead."""
    rows = [line.split(maxsplit=5) for line in ask("--contents", package).splitlines()]
    return {name.removeprefix("./"): (mode, owner) for mode, owner, _size, _day, _time, name in rows}


def test_the_fields_say_what_dpkg_needs_to_know(deb: ModuleType, packages: tuple[Path, Path]) -> None:
    boat, ground = packages
    version = f"{__version__}+deb13"
    assert (boat.name, ground.name) == (f"delfim_{version}_arm64.deb", f"delfim-ground_{version}_arm64.deb")
    assert ask("--field", boat, "Version", "Architecture") == f"Version: {version}\nArchitecture: arm64\n"
    assert ask("--field", boat, "Depends").startswith("python3 (>= 3.13), python3 (<< 3.14), iproute2, passwd, libc6")
    assert ask("--field", ground, "Depends").startswith(f"delfim (= {version}), libc6")
    assert deb.interpreter(deb.RELEASES["12"]) == "python3 (>= 3.11), python3 (<< 3.12)"
    for older, newer in (
        (f"{__version__}+deb12", version),
        (version, f"{__version__}+deb13.1"),
        (version, f"{__version__}.1+deb12"),
    ):
        subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=True)


def test_the_boats_package_holds_the_environment_the_command_the_service_and_its_settings(packages: tuple[Path, Path]) -> None:
    names = contents(packages[0])
    assert {owner for _, owner in names.values()} == {"root/root"}
    assert {mode for mode, _ in names.values()} == {"drwxr-xr-x", "-rw-r--r--", "-rwxr-xr-x", "lrwxrwxrwx"}
    assert {name for name, (mode, _) in names.items() if mode == "-rwxr-xr-x"} == PROGRAMS
    assert {
        "usr/bin/delfim -> /opt/delfim/bin/delfim",
        "opt/delfim/bin/python -> /usr/bin/python3",
        "etc/delfim/",
    } <= names.keys()
    assert {"opt/delfim/pyvenv.cfg", "usr/lib/systemd/system/delfim.service", "etc/default/delfim"} <= names.keys()
    assert "usr/share/bash-completion/completions/delfim" in names
    assert f"{SITE}/delfim/etc/delfimx.toml" in names
    assert f"{SITE}/pymavlink/dialects/v20/common.py" in names
    assert not [name for name in names if any(each in name for each in ("lxml", "share/man", "generator", "v10", "RECORD"))]
    assert not [name for name in names if name.startswith("log") or "vehicle.toml" in name], "those are the owner's"
    assert {f"{SITE}/lab.py", f"{SITE}/lab-1.0.dist-info/entry_points.txt"} <= names.keys(), "a part that was given"
    assert ask("--info", packages[0], "conffiles") == "/etc/default/delfim\n/etc/init.d/delfim\n"


def test_the_grounds_package_adds_what_the_boat_does_not_have(packages: tuple[Path, Path]) -> None:
    names = {name for name, (mode, _) in contents(packages[1]).items() if mode[0] == "-" and name.startswith("opt")}
    assert names == {
        f"{SITE}/matplotlib/__init__.py",
        f"{SITE}/matplotlib-1.dist-info/METADATA",
    }


def test_a_part_that_needs_what_is_left_out_is_refused(deb: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="needs lxml: it is not there"):
        made(deb, tmp_path, needs="lxml")


def test_every_file_has_its_sum(packages: tuple[Path, Path], tmp_path: Path) -> None:
    ask("--raw-extract", packages[0], tmp_path / "tree")
    subprocess.run(["md5sum", "--check", "--quiet", "DEBIAN/md5sums"], cwd=tmp_path / "tree", check=True)


def test_made_again_it_is_the_same(deb: ModuleType, packages: tuple[Path, Path], tmp_path: Path) -> None:
    mask = os.umask(0o077)
    try:
        again = made(deb, tmp_path)
    finally:
        os.umask(mask)
    for first, second in zip(packages, again, strict=True):
        assert hashlib.sha256(first.read_bytes()).digest() == hashlib.sha256(second.read_bytes()).digest()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_the_scripts_are_posix_shell(script: Path) -> None:
    subprocess.run(["dash", "-n", script], check=True)
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "--shell=dash", "--severity=warning", "--exclude=SC1091,SC2034", script], check=True)


def test_make_starts_it() -> None:
    """Whose Python takes no module from the folder of the program, unless it is told to."""
    make = ["make", "-s", f"--old-file={sys.prefix}/.ready", f"VENV={sys.prefix}", "deb", "ARGS=--help"]
    done = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, check=False)
    assert "Build the Debian packages." in done.stdout, done.stderr


UNDER_WAY = "the boat is under way, in mode goto"


@pytest.mark.parametrize(
    ("answer", "service", "after", "status", "words"),
    [
        (UNDER_WAY, 0, 0, 1, UNDER_WAY),
        ("", 0, 1, 0, "stop"),
        ("", 3, 1, 0, "stop"),
        ("", 3, 0, 1, "was not started as a service"),
        (None, 0, 0, 1, "cannot find out"),  # the file is wrong, or Python is gone
        (None, 3, 1, 0, "stop"),
    ],
    ids=["under way", "idle", "not running", "run by hand", "who knows, running", "who knows, not running"],
)
def test_a_boat_under_way_keeps_its_package(tmp_path, answer, service, after, status, words):
    """The script that dpkg runs before it replaces or removes the files. answer: of the boat, None where it cannot be asked;
    service: the exit code of its status; after: that of `delfim drive state` once it was stopped."""
    programs = {
        "boats-python": "exit 1" if answer is None else f"echo '{answer}'",
        "invoke-rc.d": f'[ "$2" = status ] && exit {service}; echo "$2"',
        "delfim": f"exit {after}",
        "dpkg": "exit 0",
    }
    for name, text in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    (tmp_path / "vehicle.toml").touch()
    script = (PARTS / "prerm").read_text().replace("/opt/delfim/bin/python", "boats-python").replace("/etc/", f"{tmp_path}/")
    script = script.replace(f"{tmp_path}/delfim/vehicle.toml", f"{tmp_path}/vehicle.toml")
    path = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["dash", "-c", script, "prerm", "upgrade"], env=os.environ | path, capture_output=True, text=True, check=False
    )
    assert done.returncode == status, done.stderr
    assert words in done.stdout + done.stderr
    assert ("stop\n" in done.stdout) == (answer != UNDER_WAY and words != "cannot find out")


def test_the_unit_does_what_the_init_script_does() -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[method-assign,assignment]
    unit.read_string((PARTS / "delfim.service").read_text())
    settings = dict(line.split("=") for line in (PARTS / "default").read_text().splitlines() if "=" in line)
    assert unit["Service"]["Environment"] == " ".join(f"{name}={value}" for name, value in settings.items())
    assert unit["Service"]["EnvironmentFile"] == "-/etc/default/delfim"
    assert unit["Service"]["KillMode"] == "control-group", "all are asked to end, when the supervisor is killed, too"
    assert unit["Service"]["OOMPolicy"] == "continue", "one program that needs too much memory does not end the boat"
    assert {"AF_CAN", "AF_NETLINK"} <= set(unit["Service"]["RestrictAddressFamilies"].split())
    needed = "RestrictRealtime", "ProtectClock", "ProtectControlGroups", "PrivateDevices", "PrivateMounts", "NoNewPrivileges"
    assert not set(needed).intersection(unit["Service"]), "priorities, clock, limits, buses, /log, and sudo in a shell"
    script = (ROOT / "etc/init.d/delfim").read_text()
    for command in ("supervise", "check"):
        assert f"/usr/bin/delfim {command} ${{VEHICLE}}" in (PARTS / "delfim.service").read_text()
        assert f'$DELFIM {command} "$VEHICLE"' in script
    assert unit["Service"]["TimeoutStopSec"] == script.partition("STOP_S=")[2].split()[0]
