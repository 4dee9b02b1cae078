"""Writes a Raspberry Pi's card: boot loader's words, two slots with a signed image, and
the boat's own files on its log partition.

MBR with four partitions (raspberry.PARTITIONS). Programs of Debian make the file systems, each at its place on the card:
mkfs.vfat (dosfstools), mcopy (mtools), mke2fs (e2fsprogs). Nothing is mounted.
"""

import hashlib
import os
import shutil
import stat
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from delfim.base.errors import Refused
from delfim.services.image import raspberry
from delfim.services.image.imagefile import MANIFEST, PARTS, SIGNATURE, verify
from delfim.services.image.raspberry import Fitting, PiBoard
from delfim.services.image.slots import Slots

MIB: Final = 1 << 20
FIRST_MIB, WORDS_MIB, SLOT_MIB, LOG_MIN_MIB = 1, 64, 256, 256  # where the first partition begins, and sizes
FAT, LINUX = 0x0C, 0x83  # kinds of partitions
BOOT_FILES: Final = ("bootcode.bin", "start*.elf", "fixup*.dat", "*.dtb", "overlays/*.dtbo", "overlays/overlay_map.dtb")
PROGRAMS: Final = {"mkfs.vfat": "dosfstools", "mcopy": "mtools", "mke2fs": "e2fsprogs"}
PATH: Final = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
BOAT: Final = ".boat"  # on the log partition, as `delfim commission` says


class Extent(NamedTuple):
    """A partition: its place on the card."""

    kind: int
    first_mib: int
    size_mib: int


class Fitted(NamedTuple):
    """A boat's computer, and its words for /init."""

    board: PiBoard
    hat: Fitting
    clock: Fitting
    words: str


def extents(card_bytes: int) -> list[Extent]:
    """The partitions of a card of this size. Raises Refused for one that is too small."""
    found, at = list[Extent](), FIRST_MIB
    for kind, size in ((FAT, WORDS_MIB), (FAT, SLOT_MIB), (FAT, SLOT_MIB)):
        found.append(Extent(kind, at, size))
        at += size
    rest = min(card_bytes // MIB - at, (1 << 32) // 2048 - at - 1)  # an MBR counts sectors of 512 bytes in 32 bits
    if rest < LOG_MIN_MIB:
        raise Refused(f"the card has {card_bytes // MIB} MiB, and {at + LOG_MIN_MIB} are needed")
    return [*found, Extent(LINUX, at, rest)]


def master_boot_record(parts: list[Extent]) -> bytes:
    """The first sector. Cylinders and heads are those of a partition that has none."""
    rows = b"".join(
        struct.pack("<B3sB3sII", 0, b"\xfe\xff\xff", each.kind, b"\xfe\xff\xff", each.first_mib * 2048, each.size_mib * 2048)
        for each in parts
    )
    return bytes(446) + rows.ljust(64, b"\0") + b"\x55\xaa"


# Which card.


def size_of(card: Path) -> int:
    """The bytes of a card, or of a file in its place. Raises Refused for whatever must not be overwritten, OSError."""
    status = os.stat(card)
    if stat.S_ISREG(status.st_mode):
        return status.st_size
    if not stat.S_ISBLK(status.st_mode):
        raise Refused(f"{card} is neither a card nor a file")
    name = card.resolve().name
    node = Path("/sys/class/block") / name
    if (node / "partition").exists():
        raise Refused(f"{card} is a part of a disk: name the whole one")
    if used := list(users(name, status.st_rdev)):
        raise Refused(f"{card} is in use: {', '.join(used)}")
    return int((node / "size").read_text()) * 512


def users(name: str, number: int, proc: Path = Path("/proc"), block: Path = Path("/sys/class/block")) -> Iterator[str]:
    """Who uses a disk or one of its partitions: mount points, swap, and what stands on it (RAID, encryption, volumes)."""
    nodes = [block / name, *sorted((block / name).glob(f"{name}*"))]
    numbers = {(node / "dev").read_text().strip(): node.name for node in nodes if (node / "dev").exists()}
    numbers.setdefault(f"{os.major(number)}:{os.minor(number)}", name)
    for line in (proc / "self/mountinfo").read_text().splitlines():
        fields = line.split()
        if fields[2] in numbers:
            yield f"{numbers[fields[2]]} is mounted at {fields[4]}"
    for line in (proc / "swaps").read_text().splitlines()[1:]:
        if Path(line.split()[0]).name in numbers.values():
            yield f"{line.split()[0]} is swap"
    for node in nodes:
        for holder in (node / "holders").glob("*"):
            yield f"{holder.name} stands on {node.name}"


# Writing it.


def write_card(card: Path, bundle: Path, signers: tuple[str, ...], boot: Path, boat: Path, fitted: Fitted) -> list[str]:
    """Write all of it. Returns what was read back from the card, in words. Raises Refused, FormatError, OSError; the card is
    touched only after all that is to be written was found whole."""
    missing = {package for program, package in PROGRAMS.items() if not shutil.which(program, path=PATH)}
    if missing:
        raise Refused(f"this computer lacks {', '.join(sorted(missing))}: apt install {' '.join(sorted(missing))}")
    if os.geteuid():
        raise Refused("the boat's keys are to belong to root aboard: write the card as root (sudo)")
    parts = extents(size_of(card))
    with tempfile.TemporaryDirectory() as folder:
        slots, log = Path(folder) / "slot", Path(folder) / "log"
        lay_slot(slots, bundle, signers, boot, fitted)
        lay_log(log, boat)
        with card.open("r+b") as file:
            file.write(master_boot_record(parts))
            file.flush()
            os.fsync(file.fileno())
        words = Path(folder) / "words"
        words.mkdir()
        (words / raspberry.AUTOBOOT).write_bytes(raspberry.autoboot_txt("a", "", ""))
        for name in ("bootcode.bin", "start.elf", "fixup.dat"):
            if (slots / name).exists() and name in fitted.board.files:
                shutil.copy(slots / name, words)
        for slot in raspberry.PARTITIONS:
            (words / slot).mkdir()
        put_fat(card, parts[0], "DELFIM", words)
        for slot, number in raspberry.PARTITIONS.items():
            text = raspberry.cmdline_txt(slot, *fitted)
            (slots / "cmdline.txt").write_text(text)
            put_fat(card, parts[number - 1], f"SLOT-{slot.upper()}", slots)
        last = parts[-1]
        made = ["mke2fs", "-q", "-F", "-t", "ext2", "-L", "log", "-d", str(log), "-E", f"offset={last.first_mib * MIB}"]
        _run(*made, str(card), f"{last.size_mib}M")
        return read_back(card, parts, slots)


def lay_slot(folder: Path, bundle: Path, signers: tuple[str, ...], boot: Path, fitted: Fitted) -> None:
    """What both slots hold, but for cmdline.txt. Raises Refused where the boot files lack something."""
    names = {str(path.relative_to(boot)): path for pattern in BOOT_FILES for path in boot.glob(pattern)}
    lacks = raspberry.lacking(set(names), fitted.board, fitted.hat, fitted.clock)
    if lacks:
        raise Refused(f"{boot} lacks {', '.join(lacks)}: name the first partition of Raspberry Pi OS (64 bit)")
    (folder / "overlays").mkdir(parents=True)
    for name, path in names.items():
        shutil.copyfile(path, folder / name)
    image = verify(bundle, signers, folder)
    (folder / MANIFEST).write_bytes(image.paper)
    (folder / SIGNATURE).write_bytes(image.signature)
    (folder / "config.txt").write_text(raspberry.config_txt(fitted.hat, fitted.clock))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > SLOT_MIB * MIB * 9 // 10:
        raise Refused(f"image and boot files have {size // MIB} MiB, and a slot {SLOT_MIB}")


def lay_log(folder: Path, boat: Path) -> None:
    """The log partition: the boat's files, that only root can read."""
    shutil.copytree(boat, folder / BOAT)
    for path in [folder / BOAT, *(folder / BOAT).rglob("*")]:
        path.chmod(0o700 if path.is_dir() else 0o600)


def put_fat(card: Path, part: Extent, label: str, content: Path) -> None:
    """FAT32 of 131,072 clusters: with fewer than 65,525 others take it for FAT16."""
    at = part.first_mib * MIB
    made = ["mkfs.vfat", "-F", "32", "-s", str(part.size_mib // 64), "-n", label, f"--offset={at // 512}"]
    _run(*made, str(card), str(part.size_mib * 1024))
    _run("mcopy", "-s", "-Q", "-i", f"{card}@@{at}", *map(str, sorted(content.iterdir())), "::/")


def read_back(card: Path, parts: list[Extent], slots: Path) -> list[str]:
    """What lies on the card, read from it. Raises Refused where that is not what was written."""
    fd = os.open(card, os.O_RDONLY)
    os.posix_fadvise(fd, 0, 0, os.POSIX_FADV_DONTNEED)
    os.close(fd)
    said = list[str]()
    with tempfile.TemporaryDirectory() as folder:
        for slot, number in raspberry.PARTITIONS.items():
            place = Path(folder) / slot
            place.mkdir()
            at = parts[number - 1].first_mib * MIB
            names = [f"::/{name}" for name in (*PARTS, MANIFEST, "config.txt", "cmdline.txt")]
            _run("mcopy", "-i", f"{card}@@{at}", *names, str(place))
            damage = Slots(Path(folder)).damage(slot)
            same = _digest(place / "config.txt") == _digest(slots / "config.txt")
            if damage or not same:
                raise Refused(
                    f"slot {slot}: {damage or 'config.txt is not what was written'}: the card does not keep what is written"
                )
            said.append(f"slot {slot}: whole")
    return said


def _digest(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, env={"PATH": PATH, "MTOOLS_SKIP_CHECK": "1"})
    if done.returncode:
        raise Refused(f"{words[0]}: {done.stderr.strip() or done.stdout.strip()}")
