"""Build the boat's root file system, and from it the image that is booted: kernel and initramfs (thesis 2.3 to 2.5).

    python docker/image.py run/image                 all of it; prints how large each part is
    python docker/image.py run/image --arch arm64    the same for another computer, such as a Raspberry Pi
    python docker/image.py run/image --root-only     the root file system alone, which is also the container
    python docker/image.py run/image --part WHEEL    with a laboratory's own part

Debian packages are named, never addressed: they come from where this machine's own apt gets them. They are unpacked, not
installed: no maintainer's script runs, no root is needed, and the same packages give the same bytes. Python packages are
those of requirements/, pinned and hashed, and the wheels of a laboratory's own parts that are given. Dates of files are
SOURCE_DATE_EPOCH, owners root, order alphabetical. How it is used, and what is in it: docs/image.md.
"""

import argparse
import gzip
import hashlib
import lzma
import os
import re
import shutil
import stat
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import BinaryIO, Final

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from delfim import __version__
from delfim.base.errors import FormatError, did_you_mean
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.parts import GROUP
from delfim.services.image.imagefile import PARTS, pack

SOURCES: Final = Path(__file__).parents[1]
EPOCH_S: Final = int(os.environ.get("SOURCE_DATE_EPOCH", "1767225600"))  # of every file in the image
MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}  # Debian's name of an architecture; the kernel's, Python's and QEMU's
PACKAGES: Final = ("busybox", "python3-minimal", "libpython3-stdlib", "e2fsprogs", "iproute2")
# What those packages depend on for work that is not done on a boat: installing packages, Kerberos, NIS, databases.
LEFT_OUT: Final = re.compile(
    r"dpkg|tar|debconf|gcc-.*-base|readline-common|libacl1|libcap2-bin|libdb5.*|libgssapi.*|libk5crypto.*|libkeyutils.*|libkrb5.*|libnsl.*"
    r"|libpam.*|libsqlite3.*|libtirpc.*|logsave"
)
PROGRAMS: Final = {"busybox", "e2fsck", "ip", "mke2fs", "tc", "tune2fs"}  # beside Python; the shell and the rest are Busybox
PRUNED: Final = {  # in these, what no boat needs
    ".": ("usr/share", "usr/lib/*/gconv", "usr/lib/*/perl*", "usr/lib/tmpfiles.d", "usr/lib/systemd", "var", "etc/*"),
    "usr/lib/*/tc": ("q_atm.so",),  # wants libatm
    "usr/lib/python3*": ("ensurepip", "idlelib", "lib2to3", "tkinter", "turtledemo", "test", "unittest", "distutils", "pydoc*"),
    "usr/lib/python3.*": ("sqlite3", "dbm"),
    "usr/lib/python3*/lib-dynload": ("nis.*", "_dbm.*", "_sqlite3.*", "_test*", "_xxtestfuzz*", "_ctypes_test*"),
    "usr/lib/python3/dist-packages": ("bin", "lxml*", "delfim/console/page"),
    "usr/lib/python3/dist-packages/frozenlist": ("_frozenlist.*",),  # wants libstdc++; it is there in Python, too
    "usr/lib/python3/dist-packages/*.dist-info": ("RECORD", "direct_url.json", "INSTALLER", "REQUESTED", "licenses"),
}
KEPT: Final = {  # and nothing else in these: of MAVLink the messages that are spoken, not the generator of all
    "usr/lib/python3/dist-packages/pymavlink": {"__init__.py", "dialects"},
    "usr/lib/python3/dist-packages/pymavlink/dialects": {"__init__.py", "v20"},
    "usr/lib/python3/dist-packages/pymavlink/dialects/v20": {"__init__.py", "common.py", "development.py"},
}
PIP: Final = [sys.executable, "-m", "pip", "-qq", "--disable-pip-version-check"]
DIRECTORIES: Final = "boot dev etc log proc root run sys tmp usr/bin usr/sbin usr/lib usr/lib64"
FILES: Final = {
    "etc/passwd": "root:x:0:0:root:/root:/bin/sh\nnobody:x:65534:65534:nobody:/:/bin/false\n",
    "etc/group": "root:x:0:\nnogroup:x:65534:\n",
    "etc/shadow": "root:*:0:0:::::\n",  # nobody has a password: who comes in comes by key
    "etc/hosts": "127.0.0.1 localhost\n::1 localhost\n",
    "etc/nsswitch.conf": "passwd: files\ngroup: files\nhosts: files dns\n",
    "usr/bin/delfim": "#!/usr/bin/python3 -P\nimport sys\n\nfrom delfim.__main__ import main\n\nsys.exit(main())\n",
}
MODES: Final = {"root": 0o700, "tmp": 0o1777, "etc/shadow": 0o600}  # others by what they are


def main() -> int:
    asked = argparse.ArgumentParser(description="Build the boat's image.")
    asked.add_argument("output", type=Path)
    asked.add_argument("--arch", choices=MACHINES, default=own_architecture(), help="the boat's processor (%(default)s)")
    asked.add_argument("--root-only", action="store_true", help="no kernel, no initramfs: what a container runs")
    asked.add_argument(
        "--kernel",
        action="append",
        metavar="DIRECTORY",
        help='modules of another kernel; "debian": the stock one (%(default)s)',
    )
    asked.add_argument("--sign", type=Path, metavar="KEY", help="also pack what is uploaded to boats; ssh-keygen's ed25519 key")
    asked.add_argument("--vehicle", type=Path, default=SOURCES / "etc/delfimx.toml", help="the vehicle's file (%(default)s)")
    ask_for_parts(asked)
    words = asked.parse_args()
    began_s = time.monotonic()
    check_parts(words.parts, words.vehicle)
    output = words.output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    parts = build_root(output / "root", output / "cache", words.vehicle, words.arch, words.parts)
    for kernel in [] if words.root_only else words.kernel or ["debian"]:
        parts |= build_image(output, kernel, words.arch)
    if words.sign:
        pack(output / f"delfim-{__version__}.image", {name: output / name for name in PARTS}, __version__, words.sign)
    for name, size in parts.items():
        print(f"{size / 1e6:8.1f} MB  {name}")
    print(f"{output}: {time.monotonic() - began_s:.0f} s")
    return 0


def own_architecture() -> str:
    return subprocess.run(["dpkg", "--print-architecture"], check=True, capture_output=True, text=True).stdout.strip()


def build_image(output: Path, kernel: str, arch: str) -> dict[str, int]:
    """The initramfs for a kernel; Debian's own is laid beside it. Returns the bytes of its parts."""
    parts, name = {}, "initramfs.gz"
    if kernel == "debian":
        source = unpack_kernel(output / "cache", output / "kernel", output / "vmlinuz", arch)
        parts[f"vmlinuz ({source.name})"] = (output / "vmlinuz").stat().st_size
    else:
        source = Path(kernel)
        name = f"initramfs-{source.name}.gz"
    lacking = copy_modules(source, output / "modules", arch)
    if lacking:
        print(f"the kernel {source.name} lacks {', '.join(lacking)}: a boat that needs one of them: docs/image.md")
    parts[f"modules of {source.name}"] = tree_bytes(output / "modules")
    write_initramfs(output / name, output / "root", output / "modules")
    digest = hashlib.sha256((output / name).read_bytes()).hexdigest()
    parts[f"{name}, sha256 {digest[:16]}..."] = (output / name).stat().st_size
    return parts


# The root file system.


def build_root(root: Path, cache: Path, vehicle: Path, arch: str, parts: list[Path]) -> dict[str, int]:
    """Lay it out anew. Returns the bytes of its parts."""
    shutil.rmtree(root, ignore_errors=True)
    for name in DIRECTORIES.split():
        (root / name).mkdir(parents=True)
    for name in ("bin", "sbin", "lib", "lib64"):
        (root / name).symlink_to(f"usr/{name}")
    packages = fetch(PACKAGES, cache / "debian", LEFT_OUT, arch)
    for package in packages:
        extract(package, root)
    for folder in ("usr/bin", "usr/sbin"):
        for path in (root / folder).iterdir():
            if path.name not in PROGRAMS and not re.fullmatch(r"python3[.\d]*", path.name):
                path.unlink()
    library = max((root / "usr/lib").glob("python3.*"))
    site = root / "usr/lib/python3/dist-packages"
    version = library.name.removeprefix("python")
    install_python(site, version, MACHINES[arch], cache, "boat.txt", "services.txt")
    install_parts(site, version, MACHINES[arch], parts)
    pruned = [path for folder, names in PRUNED.items() for name in names for path in root.glob(f"{folder}/{name}")]
    pruned += [path for folder, names in KEPT.items() for path in (root / folder).iterdir() if path.name not in names]
    for path in pruned:
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)
    check_needs(site, version, MACHINES[arch], parts)
    configure(root, vehicle, [*packages, *parts])
    compile_python(root, library)
    complete(root)
    return {
        "Python": tree_bytes(library),
        "Python packages": tree_bytes(site) - tree_bytes(site / "delfim"),
        "delfim": tree_bytes(site / "delfim"),
        "libraries and programs of Debian": tree_bytes(root) - tree_bytes(library) - tree_bytes(site),
        "root file system, unpacked": tree_bytes(root),
    }


def fetch(names: tuple[str, ...], cache: Path, left_out: re.Pattern[str], arch: str) -> list[Path]:
    """These packages and those that they depend on, as files, in the order of their names. apt verifies their signatures."""
    apt = apt_for(arch, cache)
    plan = subprocess.run([*apt, "-s", "install", *names], check=True, capture_output=True, text=True).stdout
    wanted = sorted(
        f"{name}={version}" for name, version in re.findall(r"^Inst (\S+) \((\S+)", plan, re.M) if not left_out.fullmatch(name)
    )
    files = [cache / each.replace("=", "_").replace(":", "%3a") for each in wanted]
    present = {path.name.rpartition("_")[0]: path for ending in (arch, "all") for path in cache.glob(f"*_{ending}.deb")}
    missing = [each for each, file in zip(wanted, files, strict=True) if file.name not in present]
    if missing:
        subprocess.run([*apt, "download", *missing], check=True, cwd=cache)
        present |= {path.name.rpartition("_")[0]: path for ending in (arch, "all") for path in cache.glob(f"*_{ending}.deb")}
    return [present[file.name] for file in files]


def apt_for(arch: str, cache: Path) -> list[str]:
    """apt-get as if nothing were installed. For another architecture than this machine's it has lists of its own, from the same
    places, and reads them anew where it can."""
    state = cache / "apt"
    (state / "lists/partial").mkdir(parents=True, exist_ok=True)
    (state / "nothing").touch()  # the packages that are installed: none
    settings = {"Dir::State::Status": state / "nothing", "APT::Install-Recommends": "false", "APT::Sandbox::User": ""}
    if arch == own_architecture():
        return apt_get(settings)
    apt = apt_get(settings | {"APT::Architecture": arch, "APT::Architectures": arch, "Dir::State": state, "Dir::Cache": state})
    subprocess.run([*apt, "update"], stdout=subprocess.DEVNULL)
    return apt


def apt_get(settings: dict[str, Path | str]) -> list[str]:
    return ["apt-get", "-qq"] + [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]


def extract(package: Path, root: Path, *only: str) -> None:
    """Its files, into a tree whose /bin, /sbin and /lib are links."""
    with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", package], stdout=subprocess.PIPE) as archive:
        words = ["tar", "-x", "--keep-directory-symlink", "--no-same-owner", "--no-same-permissions", "-C", str(root), *only]
        subprocess.run(words, stdin=archive.stdout, check=True)
    if archive.returncode:
        raise SystemExit(f"{package.name} cannot be unpacked")


def install_python(site: Path, version: str, machine: str, cache: Path, *locks: str) -> None:
    """delfim as a wheel, and what it needs by these files of requirements/, for the target's Python; every file by its hash."""
    source, wheels = cache / "source", cache / "wheel"
    for folder in (source, wheels):
        shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(SOURCES / "delfim", source / "delfim", ignore=shutil.ignore_patterns("__pycache__", "etc"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(SOURCES / name, source)
    subprocess.run([*PIP, "wheel", "--no-deps", "--no-build-isolation", "-w", wheels, source], check=True, env=environment())
    install = install_words(site, version, machine)
    pinned = [f"--requirement={SOURCES / 'requirements' / name}" for name in locks]
    subprocess.run([*install, "--require-hashes", *pinned], check=True)
    subprocess.run([*install, *wheels.glob("delfim-*.whl")], check=True)


def install_words(site: Path, version: str, machine: str) -> list[str]:
    """pip's, for wheels of this Python of the target's and its processor, and nothing that they need."""
    target = [f"--target={site}", f"--python-version={version}", "--implementation=cp", "--only-binary=:all:"]
    platforms = [f"--platform=manylinux_2_{minor}_{machine}" for minor in (5, 12, 17, 24, 26, 27, 28, 31, 34)]
    return [*PIP, "install", *target, "--no-deps", "--no-compile", *platforms]


def configure(root: Path, vehicle: Path, packages: list[Path]) -> None:
    """What is the boat's own: the first program, the vehicle's file, Busybox under all its names, what is in here."""
    for name, text in FILES.items():
        (root / name).write_text(text)
    for name, mode in MODES.items():
        (root / name).chmod(mode)
    (root / "usr/bin/delfim").chmod(0o755)
    shutil.copy(SOURCES / "etc/init", root / "init")
    (root / "init").chmod(0o755)
    shutil.copy(vehicle, root / "etc/delfimx.toml")
    shutil.copytree(vehicle.parent / "missions", root / "etc/missions")
    for name in (Path(line) for line in run_inside(root, str(root / "usr/bin/busybox"), "--list-full").split()):
        applet = root / "usr" / name.parent.name / name.name
        if name.name not in PROGRAMS and name.parent.name in ("bin", "sbin"):
            applet.symlink_to("/usr/bin/busybox")
    (root / "etc/packages").write_text("".join(f"{package.stem}\n" for package in packages))


def compile_python(root: Path, library: Path) -> None:
    """Bytecode that names the hash of its source instead of a date, made by the image's own interpreter."""
    words = ["-m", "compileall", "-q", "-f", "--invalidation-mode", "unchecked-hash", "-s", str(root), "-p", "/"]
    trees = [str(library), str(root / "usr/lib/python3/dist-packages")]
    run_inside(root, str(root / "usr/bin/python3"), "-S", *words, *trees, PYTHONHOME=str(root / "usr"))


def complete(root: Path) -> None:
    """No program and no library may miss a library, nor find it only because this machine has it."""
    objects = [path for path in sorted(root.rglob("*")) if path.is_file() and not path.is_symlink() and is_dynamic(path)]
    for path in objects:
        listing = run_inside(root, "--list", str(path))
        found = re.findall(r"(?:=> |^\t)(/.*) \(0x", listing, re.M)
        if strange := [each for each in found if not each.startswith(f"{root}/") and "/ld-linux-" not in each]:
            raise SystemExit(f"{path.relative_to(root)} misses {', '.join(strange)}")


def is_dynamic(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF" and (".so" in path.name or path.parent.name in ("bin", "sbin"))


def run_inside(root: Path, *words: str, **variables: str) -> str:
    """Run a program of the image with the image's libraries, on this machine; one for another processor in QEMU's emulation of
    it. Returns what it says."""
    libraries = next((root / "usr/lib").glob("*-linux-gnu"))
    machine = libraries.name.removesuffix("-linux-gnu")
    emulator = [] if machine == os.uname().machine else [f"qemu-{machine}"]
    loader = next((root / "usr").glob("lib*/ld-linux-*"), None) or next(libraries.glob("ld-linux-*"))
    path = ["--inhibit-cache", "--library-path", str(libraries)]
    done = subprocess.run([*emulator, loader, *path, *words], capture_output=True, text=True, env=environment(**variables))
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: {done.stdout}{done.stderr}")
    return done.stdout


def environment(**variables: str) -> dict[str, str]:
    return {
        "PATH": os.environ["PATH"],
        "PYTHONHASHSEED": "0",
        "SOURCE_DATE_EPOCH": str(EPOCH_S),
        "LC_ALL": "C.UTF-8",
        **variables,
    }


# Parts of a laboratory's own.


def ask_for_parts(asked: argparse.ArgumentParser) -> None:
    about = "with a laboratory's own part, or what one needs; again for each"
    asked.add_argument("--part", action="append", type=Path, default=[], dest="parts", metavar="WHEEL", help=about)


def check_parts(wheels: list[Path], vehicle: Path | None = None) -> None:
    """Each wheel must have a part or be needed by one that has; the parts that the vehicle's file names must be among them."""
    packages = {wheel: package_of(wheel) for wheel in wheels}
    needed = {canonicalize_name(each.name) for package in packages.values() for each in needs(package)}
    aboard: dict[str, Path] = {}
    for wheel, package in packages.items():
        names = package.entry_points.select(group=GROUP).names
        if not names and canonicalize_name(package.name) not in needed:
            raise SystemExit(f"{wheel.name} has no part (entry point in the group {GROUP}), and no other wheel needs it")
        for name in names:
            if (other := aboard.setdefault(name, wheel)) is not wheel:
                raise SystemExit(f"{wheel.name} and {other.name} both have a part {name}: leave one out")
    for name, version in named_parts(vehicle).items() if vehicle else ():
        if name not in aboard:
            raise SystemExit(f"{vehicle}: parts.{name}: no wheel of --part has it{did_you_mean(name, aboard)}")
        if (there := packages[aboard[name]].version) != version:
            raise SystemExit(f"{vehicle}: parts.{name}: the file is made for {version}, and {aboard[name].name} is {there}")


def named_parts(vehicle: Path) -> dict[str, object]:
    """The versions of those that the file names. What else is wrong with it, `delfim check` tells."""
    try:
        named = parse_toml(read_text(vehicle)).get("parts")
    except (OSError, FormatError) as error:
        raise SystemExit(f"{vehicle}: {error}") from None
    return named if isinstance(named, dict) else {}


def package_of(wheel: Path) -> Distribution:
    packages = list(distributions(path=[str(wheel)])) if wheel.suffix == ".whl" and zipfile.is_zipfile(wheel) else []
    if len(packages) != 1:
        raise SystemExit(f"{wheel} is no wheel that can be read: pip wheel --no-deps ./FOLDER makes one")
    return packages[0]


def needs(package: Distribution) -> Iterable[Requirement]:
    return map(Requirement, package.requires or ())


def install_parts(site: Path, version: str, machine: str, wheels: list[Path]) -> None:
    """These wheels alone; nothing is fetched."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            tops = {name.partition("/")[0] for name in archive.namelist()}
        if taken := sorted(name for name in tops if (site / name).exists()):  # pip would leave these out in silence
            raise SystemExit(f"{wheel.name} brings {', '.join(taken)}, which another package has brought already")
        if subprocess.run([*install_words(site, version, machine), "--no-index", wheel]).returncode:
            raise SystemExit(f"{wheel.name} cannot be installed for Python {version} on {machine}")


def check_needs(site: Path, version: str, machine: str, wheels: list[Path]) -> None:
    """What these wheels need must be there, once all is laid out and pruned."""
    present = {canonicalize_name(each.name): each.version for each in distributions(path=[str(site)])}
    target = {"python_version": version, "platform_machine": machine, "extra": ""}
    for wheel in wheels:
        for need in needs(package_of(wheel)):
            there = present.get(canonicalize_name(need.name))
            if need.marker and not need.marker.evaluate(target):
                continue
            if there is None or not need.specifier.contains(there, prereleases=True):
                found = f"version {there} is there" if there else "it is not there; give its wheel by --part, too"
                raise SystemExit(f"{wheel.name} needs {need}: {found}")


# The kernel.


def unpack_kernel(cache: Path, folder: Path, image: Path, arch: str) -> Path:
    """Debian's stock kernel, of which nothing is changed. Returns the directory of its modules."""
    everything_else = re.compile(r"(?!linux-image-\d).*")
    package = fetch((f"linux-image-{arch}",), cache / "debian", everything_else, arch)[0]
    if not (folder / package.stem).exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        extract(package, folder, "./boot", "./lib/modules")
        (folder / package.stem).touch()
    shutil.copy(next(folder.glob("boot/vmlinuz-*")), image)
    return next(folder.glob("lib/modules/*"))


def copy_modules(source: Path, modules: Path, arch: str) -> list[str]:
    """Those of modules.txt, with those they need, and an index of them. Returns the ones that this kernel does not have."""
    shutil.rmtree(modules, ignore_errors=True)
    target = modules / "usr/lib/modules" / source.name
    target.mkdir(parents=True)
    (modules / "lib").symlink_to("usr/lib")  # where depmod looks
    paths = {module_name(path.name): path for path in source.rglob("*.ko*")}
    built_in = {module_name(line.rpartition("/")[2]) for line in (source / "modules.builtin").read_text().splitlines()}
    lines = [line.rpartition(":") for line in (SOURCES / "docker/modules.txt").read_text().splitlines()]
    asked = [name for only, _, names in lines if not names.startswith("#") and only in ("", arch) for name in names.split()]
    ahead, copied = [module_name(name) for name in asked], set[str]()
    while ahead:
        name = ahead.pop()
        if name in copied or name not in paths:
            continue
        copied.add(name)
        content, place = paths[name].read_bytes(), target / paths[name].relative_to(source)
        if place.suffix == ".xz":  # the archive is compressed as a whole
            content, place = lzma.decompress(content), place.with_suffix("")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        needed = re.search(rb"\0depends=([^\0]*)\0", b"\0" + content)
        ahead += [module_name(each) for each in needed[1].decode().split(",") if each] if needed else []
    for name in ("modules.order", "modules.builtin", "modules.builtin.modinfo"):
        if (source / name).exists():
            shutil.copy(source / name, target)
    depmod = shutil.which("depmod", path=f"{os.environ['PATH']}:/usr/sbin:/sbin")
    subprocess.run([str(depmod), "-b", modules, source.name], check=True)
    for index in target.glob("modules.*"):
        if index.suffix == ".bin" or index.name in ("modules.order", "modules.builtin.modinfo"):
            index.unlink()
    (modules / "lib").unlink()
    return [name for name in asked if module_name(name) not in copied | built_in]


def module_name(file: str) -> str:
    """As the kernel has it: sdhci-pci.ko.xz is sdhci_pci."""
    return file.partition(".")[0].replace("-", "_")


# The archive.


def write_initramfs(image: Path, *trees: Path) -> None:
    """The trees in one compressed archive, a later one over the earlier. As `gzip -n` of a sorted newc archive:
    `-9` takes five times as long and saves 0.7 %."""
    entries = {str(path.relative_to(tree)): path for tree in trees for path in tree.rglob("*")}
    with image.open("wb") as file, gzip.GzipFile("", "wb", 6, file, mtime=0) as packed:
        for number, name in enumerate(sorted(entries), 1):
            write_entry(packed, number, name, entries[name])
        packed.write(header(0, "TRAILER!!!", 0, 0, 1))


def write_entry(archive: BinaryIO | gzip.GzipFile, number: int, name: str, path: Path) -> None:
    if path.is_symlink():
        mode, content = stat.S_IFLNK | 0o777, os.fsencode(os.readlink(path))
    elif path.is_dir():
        mode, content = stat.S_IFDIR | MODES.get(name, 0o755), b""
    else:
        executable = path.stat().st_mode & stat.S_IXUSR
        mode, content = stat.S_IFREG | MODES.get(name, 0o755 if executable else 0o644), path.read_bytes()
    archive.write(header(number, name, mode, len(content), 2 if path.is_dir() else 1))
    archive.write(content + bytes(-len(content) % 4))


def header(number: int, name: str, mode: int, size: int, links: int) -> bytes:
    """Of the "newc" format (Documentation/driver-api/early-userspace/buffer-format.rst): owner root, date EPOCH_S."""
    encoded = os.fsencode(name) + b"\0"
    fields = (number, mode, 0, 0, links, EPOCH_S if mode else 0, size, 0, 0, 0, 0, len(encoded), 0)
    words = b"070701" + b"".join(b"%08x" % field for field in fields) + encoded
    return words + bytes(-len(words) % 4)


def tree_bytes(tree: Path) -> int:
    return sum(path.stat().st_size for path in files(tree))


def files(tree: Path) -> Iterator[Path]:
    return (path for path in tree.rglob("*") if path.is_file() and not path.is_symlink())


if __name__ == "__main__":
    sys.exit(main())
