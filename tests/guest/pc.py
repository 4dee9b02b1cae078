"""A boat's computer in an emulator: a PC with a BIOS, GRUB on its disk, a boot partition with two slots, another for /log; or a
board of the arm64 architecture.

The disk is laid out without root: boot loader in its first sectors, the file system after the first MiB.
"""

import os
import selectors
import shutil
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATH = f"{os.environ['PATH']}:/usr/sbin:/sbin"
SECTOR, FIRST = 512, 2048  # bytes; sector at which the partition begins
GRUB = Path("/usr/lib/grub/i386-pc")
MODULES = "biosdisk part_msdos ext2 linux loadenv normal configfile test echo sleep reboot serial terminal"
EARLY = """
serial --unit=0 --speed=115200
terminal_output serial
set prefix=(hd0,msdos1)/grub
"""


def make_disk(disk: Path, boot: Path, options: str, size_mib: int = 128) -> None:
    """A disk whose partition holds the files of `boot`, with the project's boot loader. `options` are for the kernel."""
    (boot / "grub").mkdir(exist_ok=True)
    shutil.copy(ROOT / "docker" / "grub.cfg", boot / "grub")
    (boot / "grub" / "boat.cfg").write_text(f'set options="{options}"\n')
    early, core = disk.with_suffix(".cfg"), disk.with_suffix(".core")
    early.write_text(EARLY)
    words = ["grub-mkimage", "-O", "i386-pc", "-c", early, "-p", "(hd0,msdos1)/grub", "-o", core, *MODULES.split()]
    subprocess.run(words, check=True, env={"PATH": PATH})
    with disk.open("wb") as file:
        file.truncate((size_mib << 20) + FIRST * SECTOR)
    place = ["-E", f"offset={FIRST * SECTOR}", disk, f"{size_mib}M"]
    subprocess.run(["mke2fs", "-q", "-t", "ext2", "-d", boot, *place], check=True, env={"PATH": PATH})
    partition = struct.pack("<B3sB3sII", 0x80, b"\xfe\xff\xff", 0x83, b"\xfe\xff\xff", FIRST, (size_mib << 20) // SECTOR)
    with disk.open("r+b") as file:
        file.write((GRUB / "boot.img").read_bytes()[:446] + partition + bytes(48) + b"\x55\xaa")
        file.write(core.read_bytes())


class Pc:
    """A running one, seen through its serial port."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._console = ""
        self.said = ""  # all that was read

    def wait_for(self, words: str, timeout_s: float) -> str:
        """Read on past these words. Returns what it said before them. Raises AssertionError with that when they do not come."""
        assert self._process.stdout is not None
        deadline_s = time.monotonic() + timeout_s
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while words not in self._console:
                assert selector.select(max(0.0, deadline_s - time.monotonic())), f"no {words!r}:\n{self._console[-4000:]}"
                piece = os.read(self._process.stdout.fileno(), 65536)
                assert piece, f"it ended before {words!r}:\n{self._console[-4000:]}"
                self._console += (text := piece.decode(errors="replace"))
                self.said += text
        said, _, self._console = self._console.partition(words)
        return said

    def type(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        self._process.stdin.flush()


@contextmanager
def pc(*disks: Path, words: tuple[str, ...] = (), memory_mib: int = 768) -> Iterator[Pc]:
    """Power on; at the end the power is cut."""
    machine = "qemu-system-x86_64 -accel tcg,thread=multi -cpu max"
    with emulated(f"{machine} -m {memory_mib}", disks, words) as computer:
        yield computer


@contextmanager
def board(image: Path, disk: Path, options: str) -> Iterator[Pc]:
    """A computer of the arm64 architecture with two CAN cards on one bus, booted into an image without a boot loader.

    Its clock counts its instructions, 1 ns each: however busy this machine is, it is a computer of a thousand million
    instructions a second. While all wait for the disk, the clock runs on."""
    machine = "qemu-system-aarch64 -M virt -cpu cortex-a72 -icount shift=0,sleep=off -rtc clock=vm -m 768"
    cards = "-object can-bus,id=bus -device kvaser_pci,canbus=bus -device kvaser_pci,canbus=bus"
    parts = ("-kernel", str(image / "vmlinuz"), "-initrd", str(image / "initramfs.gz"), "-append", options)
    with emulated(f"{machine} {cards}", (disk,), parts) as computer:
        yield computer


@contextmanager
def emulated(machine: str, disks: tuple[Path, ...], words: tuple[str, ...]) -> Iterator[Pc]:
    drives = [word for disk in disks for word in ("-drive", f"file={disk},format=raw,if=virtio")]
    process = subprocess.Popen(
        [*machine.split(), "-nographic", "-nic", "none", *drives, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={"PATH": PATH},
    )
    try:
        yield Pc(process)
    finally:
        process.kill()
        process.communicate()
