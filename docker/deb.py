"""Build the Debian packages: delfim, which a boat needs, and delfim-ground, which adds what console and pictures need.

    python docker/deb.py run/deb                 for this machine's release of Debian and its processor
    python docker/deb.py run/deb --debian 13     for another release, whose Python is another one
    python docker/deb.py run/deb --arch arm64    for another processor
    python docker/deb.py run/deb --part WHEEL    with a laboratory's own part aboard
    python docker/deb.py run/deb --try           and try them in new roots of that release, below both inits; needs root

Both are one environment of Python in /opt/delfim: the wheel of delfim and the wheels of requirements/, pinned and hashed, as
their makers built them; no program of the target is run, so any machine builds for any other. Dates of files are
SOURCE_DATE_EPOCH, owners root: the same sources give the same bytes. Why so: docs/decisions/0010-debian-package.md; how
it is used: docs/install.md.
"""

import argparse
import gzip
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

from image import (
    EPOCH_S,
    KEPT,
    MACHINES,
    SOURCES,
    ask_for_parts,
    check_needs,
    check_parts,
    environment,
    files,
    install_parts,
    install_python,
    own_architecture,
    tree_bytes,
)
from uml import preload

from delfim import __version__

PARTS: Final = Path(__file__).parent / "debian"
RELEASES: Final = {"12": "3.11", "13": "3.13"}  # Debian's; the Python of each, for which the wheels are
SUITES: Final = {"12": "bookworm", "13": "trixie"}
NO_USE: Final = ("bin", "share", "lxml*")  # programs that pip wrote, their manuals, and what only MAVLink's generator needs
TRIAL_S: Final = 1800
LIBRARIES: Final = "libc6, libgcc-s1, libstdc++6, zlib1g"  # which the wheels leave to the system
KERNEL: Final = (  # of User-Mode Linux, its console on our output
    *("linux.uml", "mem=640M", "root=/dev/ubda", "rw", "init=/lib/systemd/systemd", "quiet", "selinux=0", "con=null"),
    *("con0=null,fd:1", "console=tty0", "systemd.getty_auto=no", "systemd.show_status=no"),
)
LIFE: Final = """\
[Unit]
After=multi-user.target
[Service]
Type=oneshot
ExecStart=/bin/sh /boot.sh {words}
"""
LAUNCHER: Final = """\
#!/opt/delfim/bin/python -P
import sys

from delfim.__main__ import main

sys.exit(main())
"""
CONTROL: Final = """\
Package: {name}
Version: {version}
Architecture: {arch}
Maintainer: The Delfim developers <delfim@example.org>
Installed-Size: {kilobytes}
Depends: {depends}
Section: misc
Priority: optional
Description: {description}
"""
WHEELS: Final = """\
The Python packages below /opt/delfim are their makers' wheels, unchanged; the licence
of each is in its folder *.dist-info there. This is the licence of delfim:

"""
BOAT: Final = """\
complete onboard software of an autonomous surface vehicle
 The program that sails the boat, its services and supervisor, an init script
 and a unit of systemd, and the simulator. The boat is described by
 /etc/delfim/vehicle.toml; without that file nothing is started."""
GROUND: Final = """\
console and pictures of the boats that run delfim
 What the operator's computer needs beside delfim: the gateway with its page
 in the browser, the view in the terminal, plots and exports of logs."""


def main() -> int:
    asked = argparse.ArgumentParser(description="Build the Debian packages.")
    asked.add_argument("output", type=Path)
    asked.add_argument("--arch", choices=MACHINES, default=own_architecture(), help="the processor (%(default)s)")
    asked.add_argument("--debian", choices=RELEASES, default=own_release(), help="the release (%(default)s)")
    asked.add_argument("--try", dest="trial", action="store_true", help="try them, as docker/debian/life.sh and boot.sh say")
    ask_for_parts(asked)
    words = asked.parse_args()
    began_s = time.monotonic()
    check_parts(words.parts)
    output = words.output.resolve()
    work = output / "work"
    shutil.rmtree(work, ignore_errors=True)
    boat, ground = work / "delfim", work / "delfim-ground"
    lay_out(boat, ground, RELEASES[words.debian], MACHINES[words.arch], output / "cache", words.parts)
    packages = [packed(tree, output, words.debian, words.arch) for tree in (boat, ground)]
    for package in packages:
        digest = hashlib.sha256(package.read_bytes()).hexdigest()
        print(f"{package.stat().st_size / 1e6:8.1f} MB  {package}, sha256 {digest[:16]}...")
    if words.trial:
        newer = packed(boat, work, words.debian, words.arch, ".1")
        clean = output / f"root-{words.debian}-{words.arch}"
        live(clean, work / "root", words.debian, words.arch, [*packages, newer])
        if words.arch == own_architecture():
            boot(clean, work / "booted", [packages[0], newer])
    shutil.rmtree(work)
    print(f"{output}: {time.monotonic() - began_s:.0f} s")
    return 0


def packed(tree: Path, output: Path, release: str, arch: str, newer: str = "") -> Path:
    """One of the packages, made of its tree."""
    version = f"{__version__}+deb{release}{newer}"
    depends, description = {
        "delfim": (f"{interpreter(RELEASES[release])}, iproute2, passwd", BOAT),
        "delfim-ground": (f"delfim (= {version})", GROUND),
    }[tree.name]
    describe(tree, version, arch, f"{depends}, {LIBRARIES}", description)
    return build(tree, output / f"{tree.name}_{version}_{arch}.deb")


def own_release() -> str:
    """This machine's, or the oldest where it has none of them."""
    told = platform.freedesktop_os_release().get("VERSION_ID", "")
    return told if told in RELEASES else min(RELEASES)


def interpreter(version: str) -> str:
    """The one Python that has the wheels' binary interface."""
    major, minor = version.split(".")
    return f"python3 (>= {version}), python3 (<< {major}.{int(minor) + 1})"


def lay_out(boat: Path, ground: Path, version: str, machine: str, cache: Path, parts: list[Path]) -> None:
    """The files of both packages: ashore, what the boat does not have."""
    library = Path("opt/delfim/lib") / f"python{version}" / "site-packages"
    site = boat / library
    cache.mkdir(parents=True, exist_ok=True)
    install_python(site, version, machine, cache, "boat.txt", "services.txt")
    install_parts(site, version, machine, parts)
    install_python(ground / library, version, machine, cache, "ground.txt")
    for path in list(files(ground)):
        if (boat / path.relative_to(ground)).exists():
            path.unlink()
    for top in (site, ground / library):
        for path in [path for pattern in NO_USE for path in top.glob(pattern)]:
            shutil.rmtree(path)
        for name in ("RECORD", "direct_url.json", "INSTALLER", "REQUESTED"):  # they tell of the machine that built it
            for path in top.glob(f"*.dist-info/{name}"):
                path.unlink()
    check_needs(site, version, machine, parts)
    for folder in sorted((path for path in ground.rglob("*") if path.is_dir()), reverse=True):
        if not any(folder.iterdir()):
            folder.rmdir()
    shutil.copytree(SOURCES / "etc", site / "delfim/etc")
    for name, kept in KEPT.items():  # of MAVLink the messages that are spoken, as in the image
        for path in (site / name.removeprefix("usr/lib/python3/dist-packages/")).iterdir():
            if path.name not in kept:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    lay_out_system(boat, version)


def lay_out_system(boat: Path, version: str) -> None:
    """What makes an environment of the folder, the command, the service and its settings."""
    put(boat / "opt/delfim/pyvenv.cfg", f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {version}\n")
    put(boat / "opt/delfim/bin/delfim", LAUNCHER, 0o755)
    (boat / "opt/delfim/bin/python").symlink_to("/usr/bin/python3")
    (boat / "usr/bin").mkdir(parents=True)
    (boat / "usr/bin/delfim").symlink_to("/opt/delfim/bin/delfim")
    put(boat / "usr/share/bash-completion/completions/delfim", 'eval "$(delfim completion)"\n')  # at the first Tab
    put(boat / "etc/init.d/delfim", (SOURCES / "etc/init.d/delfim").read_text(), 0o755)
    put(boat / "etc/default/delfim", (PARTS / "default").read_text())
    put(boat / "usr/lib/systemd/system/delfim.service", (PARTS / "delfim.service").read_text())
    (boat / "etc/delfim").mkdir()


def describe(tree: Path, version: str, arch: str, depends: str, description: str) -> None:
    """What dpkg and lintian want to know of a package, and the scripts that dpkg runs."""
    name, kind = tree.name, tree.name.removeprefix("delfim").removeprefix("-")
    doc = tree / "usr/share/doc" / name
    put(doc / "copyright", WHEELS + (SOURCES / "LICENSE").read_text())
    date = time.strftime("%a, %d %b %Y %H:%M:%S +0000", time.gmtime(EPOCH_S))
    entry = f"{name} ({version}) unstable; urgency=medium\n\n  * See CHANGELOG.md of the sources.\n\n"
    entry += f" -- The Delfim developers <delfim@example.org>  {date}\n"
    (doc / "changelog.gz").write_bytes(gzip.compress(entry.encode(), mtime=0))
    put(tree / "usr/share/lintian/overrides" / name, (PARTS / "overrides").read_text().replace("PACKAGE", name))
    kilobytes = tree_bytes(tree) // 1024
    control = CONTROL.format(
        name=name, version=version, arch=arch, kilobytes=kilobytes, depends=depends, description=description
    )
    put(tree / "DEBIAN/control", control)
    for script in ("postinst", "prerm", "postrm"):
        source = PARTS / (f"{kind}.{script}" if kind else script)
        if source.exists():
            put(tree / "DEBIAN" / script, source.read_text(), 0o755)
    inside = sorted(path.relative_to(tree) for path in files(tree) if "DEBIAN" not in path.relative_to(tree).parts)
    settings = [path for path in inside if path.parts[0] == "etc"]
    if settings:
        put(tree / "DEBIAN/conffiles", "".join(f"/{path}\n" for path in settings))
    sums = (f"{hashlib.md5((tree / path).read_bytes()).hexdigest()}  {path}\n" for path in inside if path not in settings)
    put(tree / "DEBIAN/md5sums", "".join(sums))


def put(path: Path, text: str, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)


def build(tree: Path, package: Path) -> Path:
    """The package, of which nothing depends on who built it, when, and on how many processors."""
    for path in [tree, *tree.rglob("*")]:
        if not path.is_symlink():
            program = path.is_dir() or (path.parent.name in ("bin", "init.d", "DEBIAN") and path.stat().st_mode & 0o100)
            path.chmod(0o755 if program else 0o644)
    for path in [*tree.rglob("*"), tree]:
        os.utime(path, (EPOCH_S, EPOCH_S), follow_symlinks=False)
    words = ["dpkg-deb", "--root-owner-group", "--threads-max=1", "-Zxz", "-z3", "--build", str(tree), str(package)]
    subprocess.run(words, check=True, env=environment(), stdout=subprocess.DEVNULL)
    return package


def live(clean: Path, root: Path, release: str, arch: str, packages: list[Path]) -> None:
    """Tries delfim, delfim-ground and a newer delfim in a copy of a clean root that debootstrap makes once; lintian reads them.
    The root has a network and processes of its own. For another processor the kernel needs an emulator: docs/install.md."""
    subprocess.run(["lintian", "--fail-on", "error", "--allow-root", *packages[:2]], check=True)
    if not (clean / "lib/systemd/systemd").exists():
        needed = (
            f"python3,iproute2,passwd,sysvinit-core,systemd,{LIBRARIES.replace(' ', '')}"  # so that apt fetches nothing later
        )
        made = clean.with_suffix(".part")
        shutil.rmtree(made, ignore_errors=True)
        debootstrap = ["debootstrap", "--variant=minbase", f"--arch={arch}", f"--include={needed}", SUITES[release], str(made)]
        subprocess.run(debootstrap, check=True, stdout=subprocess.DEVNULL)
        shutil.rmtree(clean, ignore_errors=True)
        made.rename(clean)
    furnish(clean, root, PARTS / "life.sh", *packages)
    space = ["unshare", "--net", "--mount", "--pid", "--fork", "--kill-child", "chroot", str(root)]
    subprocess.run([*space, "/bin/sh", "/life.sh", *(f"/{package.name}" for package in packages)], check=True, timeout=TRIAL_S)


def boot(clean: Path, root: Path, packages: list[Path]) -> None:
    """Tries delfim and a newer one below systemd, in a copy of the same root on a disk: booted twice, by User-Mode Linux."""
    furnish(clean, root, PARTS / "boot.sh", *packages)
    put(root / "etc/machine-id", f"{1:032x}\n")
    (root / "var/log/journal").mkdir(exist_ok=True)  # so that the second boot reads what the first one said
    units = root / "etc/systemd/system"
    put(units / "life.service", LIFE.format(words=" ".join(f"/{package.name}" for package in packages)))
    (units / "multi-user.target.wants").mkdir(exist_ok=True)
    (units / "multi-user.target.wants/life.service").symlink_to("../life.service")
    disk = root.with_suffix(".ext4")
    subprocess.run(["mke2fs", "-q", "-t", "ext4", "-d", root, disk, "1500M"], check=True)
    more = os.environ | preload(root.parent)
    for _ in range(2):
        words = ["timeout", str(TRIAL_S), *KERNEL, f"ubd0={disk}", f"uml_dir={root.parent}"]
        with subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace", env=more
        ) as kernel:
            said = ""
            for line in kernel.stdout or ():
                said += line
                print(line, end="", flush=True)
        if "boot: as it should be" not in said:
            raise SystemExit("below systemd it is not as it should be")


def furnish(clean: Path, root: Path, *more: Path) -> None:
    """A copy of the clean root, with these files and a boat's."""
    subprocess.run(["cp", "-a", clean, root], check=True)
    put(root / "etc/dpkg/dpkg.cfg.d/quick", "force-unsafe-io\n")
    for file in (SOURCES / "etc/delfimx.toml", *more):
        shutil.copy(file, root)


if __name__ == "__main__":
    sys.exit(main())
