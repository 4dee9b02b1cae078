"""`make release`: the wheel and the source package of the tagged commit, checked, with checksums, bill of materials, changes.

Both are made from what git has, not from the working folder, and with the commit's time for all times: whoever builds the tag
again gets the same bytes. With --sign the checksums are signed:

    ssh-keygen -Y verify -f allowed_signers -I WHO -n delfim-release -s SHA256SUMS.sig < SHA256SUMS
"""

import argparse
import gzip
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]
NAMESPACE = "delfim-release"  # so that no signature of a boat's image is taken for one of a release
WHEEL_BYTES = 3_000_000
ALSO = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "delfim/console/web/build.mjs"}  # in the source package
SHIPPED = "boat", "services", "ground", "formats", "campaign", "fleet", "foxglove", "ros"  # the files of requirements
NOT_SHIPPED = ("delfim/console/web/",)  # sources of the page, which is shipped built


def main() -> None:
    asked = argparse.ArgumentParser(prog="make release", description=__doc__.partition(":")[0])
    asked.add_argument("--output", type=Path, default=ROOT / "dist", metavar="DIRECTORY", help="(default: dist)")
    asked.add_argument("--sign", type=Path, metavar="KEY", help="sign the checksums with this key of ssh-keygen")
    words = asked.parse_args()
    version = tagged(ROOT)
    shutil.rmtree(words.output, ignore_errors=True)
    made = built(ROOT, words.output)
    check(ROOT, *made)
    notes = words.output / f"delfim-{version}.md"
    notes.write_text(changes(ROOT, version), encoding="utf-8")
    bill = words.output / f"delfim-{version}.cdx.json"
    bill.write_text(materials(ROOT, version), encoding="utf-8")
    sums, told = words.output / "SHA256SUMS", (*made, notes, bill)
    sums.write_text("".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in told))
    if words.sign:
        subprocess.run(["ssh-keygen", "-q", "-Y", "sign", "-n", NAMESPACE, "-f", words.sign, sums], check=True)
    print(sums.read_text(), end="")
    print(f"delfim {version} is in {words.output}{'' if words.sign else ', its checksums unsigned (--sign KEY signs them)'}")


def git(root: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", root, *words], capture_output=True, text=True, check=True).stdout


def tagged(root: Path) -> str:
    """The version of this commit. Raises SystemExit where a release could not be made again from its tag."""
    if changed := git(root, "status", "--porcelain").splitlines():
        raise SystemExit(f"make release: these files are not as git has them: {', '.join(line[3:] for line in changed[:5])}")
    tags = [tag for tag in git(root, "tag", "--points-at", "HEAD").split() if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    if len(tags) != 1:
        raise SystemExit("make release: this commit needs one tag vX.Y.Z: git tag -a vX.Y.Z")
    version = re.search(r'__version__ = "(.*)"', (root / "delfim/__init__.py").read_text())
    if version is None or f"v{version[1]}" != tags[0]:
        told = version[1] if version else "none"
        raise SystemExit(f"make release: the tag is {tags[0]}, and the version in delfim/__init__.py is {told}")
    return version[1]


def built(root: Path, output: Path) -> tuple[Path, Path]:
    """The wheel and the source package of HEAD, in a folder; the wheel is made from the source package."""
    output.mkdir(parents=True, exist_ok=True)
    epoch = int(git(root, "log", "-1", "--format=%ct"))
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "source")
        archive = subprocess.run(["git", "-C", root, "archive", "HEAD"], capture_output=True, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
            tar.extractall(source, filter="tar")
        environment = os.environ | {"SOURCE_DATE_EPOCH": str(epoch), "PYTHONHASHSEED": "0", "PYTHONWARNINGS": "ignore"}
        words = [sys.executable, "-m", "build", "--no-isolation", "--outdir", output, source]
        done = subprocess.run(words, env=environment, umask=0o022, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    (wheel,), (packed,) = output.glob("*.whl"), output.glob("*.tar.gz")
    repack(packed, epoch)
    return wheel, packed


def repack(file: Path, epoch: int) -> None:
    """Takes from a source package what differs from one computer to the next: times, owners, the order of its files."""
    out = io.BytesIO()
    with tarfile.open(file) as old, tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as new:
        for member in sorted(old.getmembers(), key=lambda each: each.name):
            member.mtime, member.uid, member.gid, member.uname, member.gname = epoch, 0, 0, "", ""
            member.mode, member.pax_headers = 0o755 if member.isdir() or member.mode & 0o100 else 0o644, {}
            new.addfile(member, old.extractfile(member) if member.isfile() else None)
    file.write_bytes(gzip.compress(out.getvalue(), mtime=epoch))


def check(root: Path, wheel: Path, packed: Path) -> None:
    """Raises SystemExit for a package that lacks a file, has one too many, is too large, or that an index would refuse."""
    tracked = set(git(root, "ls-files", "-z", "delfim", "etc").split("\0")) - {"", "delfim/etc"}
    wanted = {f"delfim/{name}" if name.startswith("etc/") else name for name in tracked if not name.startswith(NOT_SHIPPED)}
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    with tarfile.open(packed) as archive:
        within = {str(PurePosixPath(*PurePosixPath(name).parts[1:])) for name in archive.getnames()}
    faults = [f"the wheel lacks {name}" for name in sorted(wanted - inside)]
    faults += [f"the wheel has {name}, which git has not" for name in sorted(inside - wanted)]
    faults += [f"the source package lacks {name}" for name in sorted((wanted | ALSO) - within)]
    if (size := wheel.stat().st_size) > WHEEL_BYTES:
        faults.append(f"the wheel has {size} bytes, more than {WHEEL_BYTES}")
    if faults:
        raise SystemExit("\n".join(f"make release: {fault}" for fault in faults))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", wheel, packed], check=True)


def materials(root: Path, version: str) -> str:
    """The bill of materials (CycloneDX 1.5): the packages that are pinned for what is shipped, and those that the page is built
    of. It has no time and no number of its own: whoever makes it again gets the same bytes."""
    pinned = (re.findall(r"^([\w.-]+)==([^\s;]+)", (root / f"requirements/{name}.txt").read_text(), re.M) for name in SHIPPED)
    purls = {f"pkg:pypi/{name.lower().replace('_', '-')}@{release}" for each in pinned for name, release in each}
    page = json.loads((root / "delfim/console/web/package-lock.json").read_text(encoding="utf-8"))["packages"]
    purls |= {
        f"pkg:npm/{place.rpartition('node_modules/')[2].replace('@', '%40')}@{each['version']}"
        for place, each in page.items()
        if place and not each.get("dev") and not each.get("peer")
    }
    parts = [(purl, *purl.partition("/")[2].replace("%40", "@").rsplit("@", 1)) for purl in sorted(purls)]
    delfim = {"type": "application", "bom-ref": "delfim", "name": "delfim", "version": version}
    return json.dumps(
        {
            "bomFormat": "CycloneDX",
            "specVersion": "1.5",
            "version": 1,
            "metadata": {"component": delfim},
            "components": [
                {"type": "library", "bom-ref": purl, "name": name, "version": release, "purl": purl}
                for purl, name, release in parts
            ],
        },
        indent=1,
    )


def changes(root: Path, version: str) -> str:
    """The changelog's section of this version; before there is one, that of what is unreleased."""
    sections = re.split(r"^## \[(.+?)\].*\n", (root / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    texts = dict(zip(sections[::2], sections[1::2], strict=True))
    if version not in texts and "Unreleased" not in texts:
        raise SystemExit(f"make release: CHANGELOG.md has no section [{version}]")
    return f"# Delfim {version}\n\n{texts.get(version, texts.get('Unreleased', '')).strip()}\n"


if __name__ == "__main__":
    main()
