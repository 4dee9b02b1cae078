"""The boat's images for the tests: each built once under run/, and again when something that goes into it has changed."""

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.guest.harness import PATH, ROOT

FOLDER = ROOT / "run" / "test-image"  # not that of `make image`, which may be for another boat
FOLDER_ARM64 = FOLDER.with_name("test-image-arm64")
KERNELS = Path("/usr/lib/uml/modules")  # of User-Mode Linux
BUILD_S = 900.0
SOURCES = ("delfim", "docker", "etc", "requirements", "pyproject.toml", "README.md")


def missing(*more: str) -> str | None:
    """Why no image can be built and booted on this machine, or None."""
    programs = ("apt-get", "dpkg-deb", "depmod", "linux.uml", "qemu-system-x86_64", "grub-mkimage", "mke2fs", *more)
    absent = [program for program in programs if not shutil.which(program, path=PATH)]
    return f"no image without {', '.join(absent)} (make system installs them on Debian)" if absent else None


def build() -> Path:
    """The folder with vmlinuz, initramfs.gz for it and initramfs-guest.gz for User-Mode Linux."""
    return _once(FOLDER, "--kernel", "debian", "--kernel", str(next(KERNELS.iterdir())))


def build_arm64() -> Path:
    """The folder with vmlinuz, initramfs.gz and `said`, what its building printed."""
    return _once(FOLDER_ARM64, "--arch", "arm64")


def kernel_options(image: Path) -> set[str]:
    """The lines of Debian's configuration: CONFIG_HZ=250."""
    return set(next(image.glob("kernel/boot/config-*")).read_text().splitlines())


def _once(folder: Path, *words: str) -> Path:
    """Takes a minute; who comes meanwhile waits for it."""
    mark, inputs = folder / "inputs", _inputs()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not mark.exists() or mark.read_text() != inputs:
            mark.unlink(missing_ok=True)
            (folder / "said").write_text(make(folder, *words))
            for path in folder.glob("initramfs-*.gz"):
                path.replace(folder / "initramfs-guest.gz")
            mark.write_text(inputs)
    return folder


def make(folder: Path, *words: str) -> str:
    """What docker/image.py says. It asks the registries for packages: in the network of the program that started this worker,
    where it is one of several."""
    outside = ["nsenter", f"--net=/proc/{os.getppid()}/ns/net"] if "PYTEST_XDIST_WORKER" in os.environ else []
    command = [*outside, sys.executable, ROOT / "docker" / "image.py", folder, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_S, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _inputs() -> str:
    listing = ["git", "ls-files", "-coz", "--exclude-standard", *SOURCES]
    names = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True, text=True).stdout.split("\0")
    digest = hashlib.sha256()
    for path in sorted(ROOT / name for name in names if name and (ROOT / name).is_file()):
        digest.update(f"{path.relative_to(ROOT)} {path.stat().st_size}\n".encode() + path.read_bytes())
    return digest.hexdigest()
