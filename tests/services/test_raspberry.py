"""A Raspberry Pi: its boot files, its two slots by autoboot.txt, and its card, written into a file."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.errors import FormatError, Refused
from delfim.services.image import card, raspberry
from delfim.services.image.slots import Environment, Slots
from delfim.services.supervision import shutdown
from tests.services.test_slots import Yard

LACKING = [name for name in card.PROGRAMS if not shutil.which(name, path=card.PATH)]
needs_programs = pytest.mark.skipif(bool(LACKING or os.geteuid()), reason=f"as root, with {', '.join(card.PROGRAMS)}")
CARD_MIB = 900
slots = st.sampled_from(["a", "b"])
words = st.sampled_from(["", "a", "b"])


# The words of the boot loader.


@given(slots, words, words)
def test_the_words_are_one_sector_and_come_back(slot: str, trial: str, tried: str) -> None:
    text = raspberry.autoboot_txt(slot, trial, tried)
    assert len(text) == 512
    assert raspberry.parse_autoboot(text) == (slot, trial, tried)
    lines = text.decode().split()
    at = lines.index("[tryboot]")
    assert lines[at - 1] == f"boot_partition={raspberry.PARTITIONS[slot]}"
    assert lines[at + 1] == f"boot_partition={5 - raspberry.PARTITIONS[slot]}", "the other one"


@given(
    st.one_of(st.binary(max_size=600), st.integers(0, 511).map(lambda at: _damaged(raspberry.autoboot_txt("a", "b", ""), at)))
)
def test_a_damaged_file_is_refused(text: bytes) -> None:
    with pytest.raises(FormatError):
        raspberry.parse_autoboot(text)


def _damaged(text: bytes, at: int) -> bytes:
    return text[:at] + bytes((text[at] ^ 8,)) + text[at + 1 :]


@pytest.fixture
def yard(tmp_path: Path) -> Yard:
    """A yard whose boat has a Raspberry Pi's words in the place of GRUB's, and version 1.0 in slot a."""
    yard = Yard(tmp_path)
    yard.slots.install(yard.bundle("1.0"), yard.signers)
    shutil.rmtree(yard.boot / "grub")
    (yard.boot / raspberry.AUTOBOOT).write_bytes(raspberry.autoboot_txt("a", "", ""))
    return yard


def started(yard: Yard, *, tryboot: bool) -> str:
    """The slot that the boot loader starts: it reads its own lines, and writes nothing."""
    text = (yard.boot / raspberry.AUTOBOOT).read_text()
    numbers = re.findall(r"^boot_partition=(\d)$", text, re.M)
    return {number: slot for slot, number in raspberry.PARTITIONS.items()}[int(numbers[tryboot])]


def test_an_image_is_tried_once_rolled_back_and_stays_when_it_is_confirmed(yard: Yard) -> None:
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    assert started(yard, tryboot=False) == "a", "whoever restarts it otherwise gets the old one"
    assert yard.slots.environment() == Environment("a", "b", "")
    assert yard.slots.begin_trial() == "0 tryboot"
    assert yard.slots.environment() == Environment("a", "", "b"), "struck out before it is started"
    assert started(yard, tryboot=True) == "b"
    assert started(yard, tryboot=False) == "a", "after any restart, wanted or not"
    with pytest.raises(Refused, match="no image waits for its trial"):
        yard.slots.begin_trial()
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    yard.slots.begin_trial()
    yard.slots.confirm("b")
    assert started(yard, tryboot=False) == "b"
    assert yard.slots.environment() == Environment("b")
    assert (yard.slots.damage("a"), yard.slots.damage("b")) == ("", "")


def test_the_words_are_written_over_themselves(yard: Yard) -> None:
    """No name, no length and no place on the card changes: a power cut leaves the old sector or the new one."""
    file = yard.boot / raspberry.AUTOBOOT
    before = file.stat()
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    after = file.stat()
    assert (before.st_ino, before.st_size) == (after.st_ino, after.st_size)
    assert sorted(path.name for path in yard.boot.iterdir()) == ["a", raspberry.AUTOBOOT, "b"]


def test_the_command_leaves_the_words_and_asks_for_a_restart(
    yard: Yard, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "boat.toml"
    tables = f'[image]\ndirectory = "{yard.boot}"\n[runtime]\nrun_directory = "{tmp_path}"\n'
    file.write_text(f'[boat]\nname = "a"\nid = 1\n{tables}[console]\nsocket = "{tmp_path}/command"\n')
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    assert main(["image", str(file), "try"]) != 0
    assert "nobody would restart the computer" in capsys.readouterr().err
    assert yard.slots.environment() == Environment("a", "b", ""), "the trial waits"
    asked = shutdown.listening(shutdown.socket_path(tmp_path))
    assert asked is not None
    with asked:
        assert main(["image", str(file), "try"]) == 0
        assert asked.recv(200) == b"reboot an image is tried"
    assert shutdown.words_path(tmp_path).read_text() == "0 tryboot"
    assert yard.slots.environment() == Environment("a", "", "b")


# Boards, hats and clocks.


@pytest.mark.parametrize("hat", raspberry.HATS)
@pytest.mark.parametrize("clock", raspberry.CLOCKS)
def test_the_boot_files_are_what_the_boot_loader_reads(hat: str, clock: str) -> None:
    text = raspberry.config_txt(raspberry.HATS[hat], raspberry.CLOCKS[clock])
    for line in text.splitlines():
        assert re.fullmatch(r"\[(all|pi\w+)\]|initramfs initramfs\.gz followkernel|[a-z_0-9]+=[a-z0-9_,.=-]+", line), line
        assert len(line) <= 98, "the boot loader cuts longer lines"
    assert "dtparam=i2c_arm=on" in text.splitlines(), "sensors and PCA9685"
    for board in raspberry.BOARDS.values():
        line = raspberry.cmdline_txt("b", board, raspberry.HATS[hat], raspberry.CLOCKS[clock], "NET=eth0")
        assert line.count("\n") == 1
        assert " delfim.slot=b " in line
        modules = re.findall(r"MODULES=(\S+)", line)[0].split(",")
        assert len(set(modules)) == len(modules)
        assert {"can-raw", "i2c-dev"} < set(modules)


def test_the_document_has_the_table() -> None:
    document = (Path(__file__).parents[2] / "docs/raspberry.md").read_text()
    for name, each in [*raspberry.HATS.items(), *raspberry.CLOCKS.items(), *raspberry.BOARDS.items()]:
        assert not name or (f"`{name}`" in document and each.title in document), name


def boot_files(folder: Path, *without: str) -> Path:
    """As the first partition of Raspberry Pi OS has them, without what is in them."""
    names = {name for board in raspberry.BOARDS.values() for name in board.files}
    lines = [line for hat in (*raspberry.HATS.values(), *raspberry.CLOCKS.values()) for line in hat.config]
    names |= {f"overlays/{line[10:].split(',')[0]}.dtbo" for line in [*lines, "dtoverlay=dwc2"] if line.startswith("dtoverlay")}
    (folder / "overlays").mkdir(parents=True)
    for name in names - set(without):
        (folder / name).write_text(f"{name} of the maker")
    (folder / "kernel8.img").write_text("not ours")
    return folder


@pytest.mark.parametrize(
    ("board", "hat", "clock", "gone"),
    [
        ("pi4", "", "", "start4.elf"),
        ("pi5", "", "", "bcm2712-rpi-5-b.dtb"),
        ("pi3", "", "", "bootcode.bin"),
        ("zero2", "", "", "overlays/dwc2.dtbo"),
        ("pi4", "waveshare-2ch-can-fd", "", "overlays/spi1-3cs.dtbo"),
        ("pi4", "", "ds3231", "overlays/i2c-rtc.dtbo"),
    ],
)
def test_what_a_folder_of_boot_files_lacks_is_named(tmp_path: Path, board: str, hat: str, clock: str, gone: str) -> None:
    folder = boot_files(tmp_path / "boot", gone)
    names = {str(path.relative_to(folder)) for path in folder.rglob("*")}
    asked = raspberry.BOARDS[board], raspberry.HATS[hat], raspberry.CLOCKS[clock]
    assert raspberry.lacking(names, *asked) == [gone]
    assert raspberry.lacking(names | {gone}, *asked) == []


# The card.


def test_a_card_that_is_too_small_or_in_use_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="the card has 800 MiB, and 833 are needed"):
        card.extents(800 << 20)
    parts = card.extents(64 << 30)
    assert [each.first_mib for each in parts] == [1, 65, 321, 577]
    assert parts[-1].first_mib + parts[-1].size_mib == 64 << 10
    with pytest.raises(Refused, match="neither a card nor a file"):
        card.size_of(Path("/dev/null"))
    proc, block = tmp_path / "proc", tmp_path / "block"
    (proc / "self").mkdir(parents=True)
    (proc / "self/mountinfo").write_text(
        "22 1 179:2 / / rw - ext4 /dev/root rw\n25 22 8:17 / /media/x rw - vfat /dev/sdb1 rw\n"
    )
    (proc / "swaps").write_text("Filename Type\n/dev/sda2 partition 1 0 -2\n")
    for name, number in (("mmcblk0", "179:0"), ("mmcblk0/mmcblk0p2", "179:2"), ("sda", "8:0"), ("sda/sda2", "8:2")):
        (block / name / "holders").mkdir(parents=True)
        (block / name / "dev").write_text(number + "\n")
    (block / "sda/sda2/holders/dm-0").mkdir()
    assert list(card.users("mmcblk0", os.makedev(179, 0), proc, block)) == ["mmcblk0p2 is mounted at /"]
    assert list(card.users("sda", os.makedev(8, 0), proc, block)) == ["/dev/sda2 is swap", "dm-0 stands on sda2"]
    assert list(card.users("sdc", os.makedev(8, 32), proc, block)) == []


def words_for(yard: Yard, folder: Path, boot: Path, *more: str) -> list[str]:
    """The command, for a boat with its files in a folder."""
    boat = folder / "boat"
    boat.mkdir()
    (boat / "mavlink.key").write_text("secret")
    (boat / "boat.toml").write_text(
        f'[boat]\nname = "a"\nid = 1\n[image]\nsigners = ["{yard.signers[0].strip()}"]\n'
        'partition = "/dev/mmcblk0p1"\nslots = ["/dev/mmcblk0p2", "/dev/mmcblk0p3"]\n'
    )
    file = folder / "card.img"
    with file.open("wb") as made:
        made.truncate(CARD_MIB << 20)
    image = str(yard.bundle("3.0"))
    where = ["--card", str(file), "--boot", str(boot), *more]
    return ["image", str(boat / "boat.toml"), "write", image, *where]


@needs_programs
def test_a_card_is_written_and_read_back(yard: Yard, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = words_for(yard, tmp_path, boot_files(tmp_path / "maker"), "--board", "pi4", "--hat", "pican2", "--clock", "ds3231")
    assert main(asked) == 0, capsys.readouterr().err
    assert "Raspberry Pi 4B, 400, PiCAN2" in capsys.readouterr().out
    file = tmp_path / "card.img"
    with file.open("rb") as written:
        sector = written.read(512)
    assert sector[510:] == b"\x55\xaa"
    assert [sector[446 + 16 * row + 4] for row in range(4)] == [0x0C, 0x0C, 0x0C, 0x83]
    told = tmp_path / "told"
    for number, first in ((1, 1), (2, 65), (3, 321)):
        (told / str(number)).mkdir(parents=True)
        subprocess.run(["mcopy", "-s", "-i", f"{file}@@{first}M", "::/", told / str(number)], check=True)
    (told / "1/a").rmdir()
    (told / "1/b").rmdir()
    assert (told / "1" / raspberry.AUTOBOOT).read_bytes() == raspberry.autoboot_txt("a", "", "")
    (told / "2").rename(told / "1/a")
    (told / "3").rename(told / "1/b")
    both = Slots(told / "1")
    assert both.environment() == Environment("a")
    assert (both.damage("a"), both.damage("b")) == ("", "")
    for slot in "ab":
        text = (told / "1" / slot / "cmdline.txt").read_text()
        assert f"delfim.slot={slot} VEHICLE=/log/.boat/boat.toml NET=eth0 ADDRESS=192.168.2.10/24\n" in text
        assert (told / "1" / slot / "start4.elf").read_text() == "start4.elf of the maker"
        assert not (told / "1" / slot / "kernel8.img").exists()
    log = tmp_path / "log.img"
    with file.open("rb") as card_file, log.open("wb") as out:
        card_file.seek(577 << 20)
        shutil.copyfileobj(card_file, out)
    subprocess.run(["e2fsck", "-f", "-n", log], check=True, env={"PATH": card.PATH}, capture_output=True)
    listing = subprocess.run(
        ["debugfs", "-R", "ls -p /.boat", log], check=True, env={"PATH": card.PATH}, capture_output=True
    ).stdout
    assert b"/100600/0/0/mavlink.key/6/" in listing


@needs_programs
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("boot", "lacks start4.elf: name the first partition of Raspberry Pi OS"),
        ("signer", "it is signed by a key that the vehicle's file does not name"),
        ("slots", "it could not be updated later: [image] must say"),
    ],
)
def test_nothing_is_written_where_something_is_wrong(
    yard: Yard, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, reason: str
) -> None:
    boot = boot_files(tmp_path / "maker", *(["start4.elf"] if change == "boot" else []))
    asked = words_for(yard, tmp_path, boot, "--board", "pi4")
    file = tmp_path / "boat" / "boat.toml"
    if change == "signer":
        file.write_text(re.sub(r"signers = .*", "signers = []", file.read_text()))
    if change == "slots":
        file.write_text(re.sub(r"slots = .*", "", file.read_text()))
    assert main(asked) != 0
    assert reason in capsys.readouterr().err
    assert (tmp_path / "card.img").stat().st_size == CARD_MIB << 20
    with (tmp_path / "card.img").open("rb") as untouched, pytest.raises(OSError, match="No such device or address"):
        os.lseek(untouched.fileno(), 0, os.SEEK_DATA)  # it is one hole: nothing was written, not even zeros
