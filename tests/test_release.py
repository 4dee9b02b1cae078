"""What people download: `make release` of a scratch repository, and its wheel in an environment that has nothing else."""

import importlib.metadata
import json
import lzma
import os
import pty
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from delfim import __version__

ROOT = Path(__file__).parents[1]
NOBODY = {f"GIT_{who}_{what}": "nobody@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
TAG = f"v{__version__}"


def git(folder: Path, *words: str) -> str:
    command = ["git", "-C", folder, *words]
    return subprocess.run(command, env=os.environ | NOBODY, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository of one tagged commit: the files as they are here."""
    folder = tmp_path_factory.mktemp("source")
    names = git(
        ROOT,
        "ls-files",
        "-coz",
        "--exclude-standard",
        "delfim",
        "etc",
        ".ci",
        "requirements",
        "*.toml",
        "*.md",
        "*.in",
        "LICENSE",
    )
    for name in names.split("\0"):
        if name and (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    git(folder, "init", "--quiet")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "All of it")
    git(folder, "tag", TAG)
    return folder


def release(source: Path, output: Path, *words: str | Path, **more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, source / ".ci/release.py", "--output", output, *words]
    return subprocess.run(command, env=os.environ | more, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def made(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / "yard"], check=True)
    done = release(source, folder / "dist", "--sign", folder / "yard")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.long
def test_it_holds_wheel_source_changes_and_signed_checksums(made: Path) -> None:
    dist = made / "dist"
    wheel, packed, notes = f"delfim-{__version__}-py3-none-any.whl", f"delfim-{__version__}.tar.gz", f"delfim-{__version__}.md"
    bill = f"delfim-{__version__}.cdx.json"
    its = wheel, packed, notes, bill, "SHA256SUMS", "SHA256SUMS.sig"
    assert sorted(file.name for file in dist.iterdir()) == sorted(its)
    parts = {part["purl"] for part in json.loads((dist / bill).read_text())["components"]}
    assert {name.partition("/")[2].partition("@")[0] for name in parts} >= {"msgspec", "asyncssh", "numpy", "ol"}
    assert not [name for name in parts if "pytest" in name or "esbuild" in name], "tools are not shipped"
    assert (dist / wheel).stat().st_size < 3_000_000
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=dist, check=True)
    (made / "signers").write_text(f"yard {(made / 'yard.pub').read_text()}")
    verify = ["ssh-keygen", "-Y", "verify", "-f", "../signers", "-I", "yard", "-n", "delfim-release", "-s", "SHA256SUMS.sig"]
    subprocess.run(verify, cwd=dist, input=(dist / "SHA256SUMS").read_bytes(), check=True, capture_output=True)
    assert (dist / notes).read_text().startswith(f"# Delfim {__version__}\n\n### ")
    assert "\n## [" not in (dist / notes).read_text()


@pytest.mark.long
def test_the_bill_of_materials_is_one_by_the_schema_of_its_format(made: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="make formats brings it")
    referencing = pytest.importorskip("referencing", reason="make formats brings it")
    schema = json.loads(lzma.decompress((ROOT / "tests/data/cyclonedx/bom-1.5.schema.json.xz").read_bytes()))
    others = ("spdx.SNAPSHOT.schema.json", "jsf-0.82.SNAPSHOT.schema.json")  # of licences and signatures: it has none
    base = schema["$id"].rpartition("/")[0]
    anything = referencing.Resource.from_contents({"$schema": schema["$schema"], "definitions": {"signature": {}}})
    known = referencing.Registry().with_resources([(f"{base}/{other}", anything) for other in others])
    held = jsonschema.Draft7Validator(schema, registry=known)
    bill = json.loads((made / f"dist/delfim-{__version__}.cdx.json").read_text())
    assert not list(held.iter_errors(bill))
    assert list(held.iter_errors(bill | {"components": [{"name": "of no type"}]})), "the schema is looked at"


@pytest.mark.long
def test_the_wheel_holds_examples_and_page_and_no_tests(made: Path) -> None:
    (wheel,), (packed,) = (made / "dist").glob("*.whl"), (made / "dist").glob("*.tar.gz")
    names = set(zipfile.ZipFile(wheel).namelist())
    for name in ("delfimx.toml", "boats/otter.toml", "missions/doca.toml", "scenarios/kill.toml", "delfimx.dbc"):
        assert f"delfim/etc/{name}" in names
    assert "delfim/console/page/console.js" in names
    assert not [name for name in names if name.startswith(("tests", "delfim/console/web"))]
    with tarfile.open(packed) as archive:
        assert {"CHANGELOG.md", "delfim", "README.md"} <= {name.split("/")[1] for name in archive.getnames() if "/" in name}
        assert not [name for name in archive.getnames() if "/tests/" in name and "/etc/parts/" not in name], (
            "but for those of the examples"
        )


@pytest.mark.long
def test_whoever_makes_it_again_gets_the_same_bytes(source: Path, made: Path, tmp_path: Path) -> None:
    git(source, "clone", "--quiet", str(source), str(tmp_path / "elsewhere"))
    done = release(tmp_path / "elsewhere", tmp_path / "dist", TZ="Asia/Tokyo", LC_ALL="C")
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "dist/SHA256SUMS").read_text() == (made / "dist/SHA256SUMS").read_text()


def test_it_refuses_what_could_not_be_made_again_from_a_tag(source: Path, tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    git(source, "clone", "--quiet", str(source), str(clone))
    (clone / "README.md").write_text("changed")
    dirty = release(clone, tmp_path / "dist")
    git(clone, "checkout", "--quiet", "README.md")
    git(clone, "tag", "--delete", TAG)
    untagged = release(clone, tmp_path / "dist")
    git(clone, "tag", "v99.0.0")
    other = release(clone, tmp_path / "dist")
    assert [each.returncode for each in (dirty, untagged, other)] == [1, 1, 1]
    assert dirty.stderr == "make release: these files are not as git has them: README.md\n"
    assert untagged.stderr == "make release: this commit needs one tag vX.Y.Z: git tag -a vX.Y.Z\n"
    assert other.stderr == f"make release: the tag is v99.0.0, and the version in delfim/__init__.py is {__version__}\n"
    assert not (tmp_path / "dist").exists()


@pytest.fixture(scope="module")
def installed(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of a new environment: the wheel, and of other packages those that a boat needs, as they are
    pinned and installed here; so nothing is fetched."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder)
    site = next(folder.glob("lib/python*/site-packages"))
    for name in re.findall(r"^([\w.-]+)==", (ROOT / "requirements/boat.txt").read_text(), re.MULTILINE):
        package = importlib.metadata.distribution(name)
        for file in package.files or ():
            if ".." not in file.parts:  # its programs
                (site / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(str(package.locate_file(file)), site / file)
    (wheel,) = (made / "dist").glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", folder / "bin/python", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--quiet", "--no-index", wheel], check=True, cwd=folder, env=alone())
    return folder / "bin"


def alone(**more: str) -> dict[str, str]:
    """An environment in which the checkout is not found."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP"))} | more


def typed(installed: Path, folder: Path, *words: str) -> tuple[int, str]:
    done = subprocess.run(
        [installed / "delfim", *words],
        cwd=folder,
        env=alone(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.long
def test_without_a_file_it_sails_delfimx(installed: Path, tmp_path: Path) -> None:
    ports = [word for name in ("httpd", "ftpd", "sshd") for word in ("--set", f'simulation.{name}="127.0.0.1:0"')]
    bus = ("--set", f'simulation.interface="canloop:wheel-{os.getpid()}"', "--set", 'cantcpd.listen=["127.0.0.1:0"]')
    code, said = typed(installed, tmp_path, "sim", *ports, *bus, "--for", "3")
    assert code == 0, said
    assert "boat 2 (DelfimX) in run/sim" in said
    assert "time: 3 s sailed" in said
    assert "no pictures without" in said
    assert "pip install 'delfim[ground]'" in said


@pytest.mark.long
def test_examples_are_found_by_the_names_of_the_documents(installed: Path, tmp_path: Path) -> None:
    words = ("--lockstep", "--for", "5")
    for more in ([], ["etc/boats/otter.toml"], ["etc/delfimx.toml", "--mission", "etc/missions/lawnmower.toml"]):
        code, said = typed(installed, tmp_path, "sim", *more, *words)
        assert (code, "delfim: time" in said) == (0, True), said
    code, said = typed(installed, tmp_path, "sim", "--scenario", "etc/scenarios/kill.toml")
    assert (code, "all as it must be" in said) == (0, True), said
    assert typed(installed, tmp_path, "check", "etc/delfimx.toml")[0] == 0


@pytest.mark.long
def test_a_new_boat_sails_and_no_boat_runs_with_an_example(installed: Path, tmp_path: Path) -> None:
    assert typed(installed, tmp_path, "new", "myboat.toml", "--yes")[0] == 0
    assert typed(installed, tmp_path, "check", "myboat.toml")[0] == 0
    code, said = typed(installed, tmp_path, "sim", "myboat.toml", "--lockstep", "--for", "5")
    assert (code, "delfim: time" in said) == (0, True), said
    for command in ("supervise", "run", "shutdown"):
        code, said = typed(installed, tmp_path, command, "etc/delfimx.toml")
        assert (code, said) == (2, "delfim: etc/delfimx.toml: file: No such file or directory\n")


@pytest.fixture(scope="module")
def sailed(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sailed")
    assert typed(installed, folder, "sim", "--lockstep", "--for", "5")[0] == 0
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("console", "ground"),
        ("sim --console", "ground"),
        ("log plot run/sim", "ground"),
        ("log export csv run/sim", "ground"),
        ("can dump canloop:x --dbc etc/delfimx.dbc", "ground"),
        ("campaign etc/campaigns/mixed.toml", "campaign"),
        ("commission --yes --users ana", "ground"),
    ],
)
@pytest.mark.long
def test_what_a_command_lacks_is_told_with_the_words_that_install_it(installed, sailed, words, extra):
    code, said = typed(installed, sailed, *words.split())
    assert code == 2
    assert re.search(rf"needs [\w.]+, which is not installed: pip install 'delfim\[{extra}\]'", said), said
    assert "Traceback" not in said


@pytest.mark.long
def test_a_terminal_without_the_live_view_shows_lines_instead(installed: Path, tmp_path: Path) -> None:
    """On a terminal, as a person starts it."""
    ports = [word for name in ("httpd", "ftpd", "sshd") for word in ("--set", f'simulation.{name}="127.0.0.1:0"')]
    words = [installed / "delfim", "sim", "--for", "1", *ports, "--set", 'cantcpd.listen=["127.0.0.1:0"]']
    words += ["--set", f'simulation.interface="canloop:lines-{os.getpid()}"']
    told = bytearray()

    def read(terminal: int) -> bytes:
        told.extend(data := os.read(terminal, 1024))
        return data

    here = os.getcwd()
    os.chdir(tmp_path)
    try:
        pty.spawn([str(word) for word in words], read)
    finally:
        os.chdir(here)
    assert b"the live view needs delfim[ground]" in told
    assert b"  distance " in told, told.decode()
