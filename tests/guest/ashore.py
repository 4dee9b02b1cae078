"""The boat's image as a guest, with a wire to the shore: a network of its own for the test, its disk, its start."""

import contextlib
import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tests.guest.harness import uml
from tests.guest.pc import PATH, Pc

SHORE, BOAT = "10.77.0.1", "10.77.0.2"
_CLONE_NEWNET = 0x40000000


@contextlib.contextmanager
def network() -> Iterator[None]:
    """This thread in a network of its own, with one end of a wire to the guest in it: tap0."""
    with alone():
        for words in ("tuntap add tap0 mode tap", f"address add {SHORE}/24 dev tap0", "link set tap0 up"):
            subprocess.run(["ip", *words.split()], check=True, env={"PATH": PATH})
        yield


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """This thread, and the programs that it starts, in a network of its own."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/thread-self/ns/net") as ours:
        if libc.unshare(_CLONE_NEWNET):
            pytest.skip(f"a network of its own needs root: {os.strerror(ctypes.get_errno())}")
        try:
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True, env={"PATH": PATH})
            yield
        finally:
            assert libc.setns(ours.fileno(), _CLONE_NEWNET) == 0


def disk(path: Path, content: Path, size_mib: int = 64) -> Path:
    """An ext2 disk with these files."""
    path.touch()
    os.truncate(path, size_mib << 20)
    subprocess.run(["mke2fs", "-q", "-t", "ext2", "-d", content, path], check=True, env={"PATH": PATH})
    return path


@contextlib.contextmanager
def started(folder: Path, initrd: Path, log: Path, words: Sequence[str]) -> Iterator[tuple[Pc, "subprocess.Popen[bytes]"]]:
    """User-Mode Linux with the image, its disk for /log, its end of the wire, and more words for kernel and /init."""
    console = ["con=null", "con0=fd:0,fd:1", "quiet", "selinux=0", f"uml_dir={folder}"]
    wire = ["vec0:transport=tap,ifname=tap0,depth=128", "NET=vec0", f"ADDRESS={BOAT}/24"]
    kernel = [str(shutil.which("linux.uml", path=PATH)), "mem=768M", f"initrd={initrd}"]
    process = subprocess.Popen(
        [*kernel, f"ubd0={log}", "LOG=/dev/ubda", *wire, *words, *console],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env={"PATH": PATH, "HOME": str(folder), "TMPDIR": str(folder)} | uml.preload(folder),
    )
    try:
        yield Pc(process), process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)
        process.communicate()
