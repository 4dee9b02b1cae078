"""The boat's image in an emulated PC: started by its boot loader from either slot, tried once, rolled back, confirmed."""

import gzip
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.services.image import imagefile, slots
from delfim.services.image.slots import Environment
from tests.guest import boat_image
from tests.guest.pc import PATH, Pc, make_disk, pc

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]  # the first one waits for the image to be built
BOOT_S = 400.0  # a busy machine emulates slowly
OPTIONS = "console=ttyS0 quiet mitigations=off panic=10"
SHELL = "rdinit=/bin/sh"  # a shell on the serial port in place of the first program
PROMPT = "# "
SETUP = (
    "mount -t proc proc /proc; mount -t sysfs sysfs /sys; mount -t devtmpfs dev /dev; mkdir -p /run/delfim;"
    " for m in virtio_pci virtio_blk; do modprobe $m; done; mount -t ext2 /dev/vdb /log; stty -echo; echo set up"
)


@pytest.fixture(scope="module")
def image() -> Path:
    if reason := boat_image.missing():
        pytest.skip(reason)
    return boat_image.build()


def ext2(path: Path, size_mib: int, content: Path | None = None) -> Path:
    with path.open("wb") as file:
        file.truncate(size_mib << 20)
    words = ["mke2fs", "-q", "-t", "ext2", *(["-d", content] if content else []), path]
    subprocess.run(words, check=True, env={"PATH": PATH})
    return path


def test_nothing_is_aboard_that_is_nobody_s_business(image: Path) -> None:
    """No secret, no name of this machine, no address where packages come from."""
    text = gzip.decompress((image / "initramfs.gz").read_bytes())
    assert text.startswith(b"070701")
    secret = re.search(rb"-----BEGIN [A-Z ]*PRIVATE KEY-----\n[A-Za-z0-9+/]{40}|scrypt:[A-Za-z0-9+/=]{8}", text)
    assert secret is None, secret
    asked = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True).stdout
    passwords = [each.encode() for each in re.findall(r"//([^/\s'@]+)@", asked)]
    for word in (str(boat_image.ROOT).encode(), b"/cache/wheel", b"_apt", *passwords):
        assert word not in text, text[text.index(word) - 100 :][:300]
    assert len(text) < 150e6
    assert (image / "initramfs.gz").stat().st_size < 60e6


def test_the_same_sources_give_the_same_bytes(image: Path, tmp_path: Path) -> None:
    """Built again somewhere else, with packages that are at hand already."""
    other = tmp_path / "somewhere" / "else"
    shutil.copytree(image / "cache" / "debian", other / "cache" / "debian")
    boat_image.make(other)
    for name in imagefile.PARTS:
        assert (other / name).read_bytes() == (image / name).read_bytes(), name
    shutil.rmtree(other)


def test_the_kernel_is_configured_as_the_document_says(image: Path) -> None:
    """The reasons and figures of docs/image.md are for this configuration."""
    options = {
        "CONFIG_PREEMPT_DYNAMIC=y",
        "CONFIG_PREEMPT_VOLUNTARY=y",
        "CONFIG_HZ=250",
        "CONFIG_NO_HZ_FULL=y",
        "CONFIG_HIGH_RES_TIMERS=y",
    }
    assert options - boat_image.kernel_options(image) == set()


class Shell:
    """What a person at the serial port does."""

    def __init__(self, computer: Pc, slot: str) -> None:
        self._computer, self._number = computer, 0
        computer.wait_for(f"slot {slot}", BOOT_S)
        computer.wait_for(PROMPT, BOOT_S)
        computer.type(SETUP)
        computer.wait_for("set up\r\n", BOOT_S)

    def run(self, command: str) -> tuple[int, str]:
        """Exit code and output."""
        self._number += 1
        self._computer.type(f'{command}; echo "end of {self._number}: $?."')
        said = self._computer.wait_for(f"end of {self._number}: ", BOOT_S)
        return int(self._computer.wait_for(".\r\n", BOOT_S)), said

    def image(self, words: str) -> tuple[int, str]:
        return self.run(f'delfim image --set \'image.partition="/dev/vda1"\' --set "$SIGNERS" /etc/delfimx.toml {words}')


def test_a_new_image_is_tried_once_rolled_back_and_then_confirmed(image: Path, tmp_path: Path) -> None:
    key = tmp_path / "yard"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "yard", "-f", key], check=True)
    uploads = tmp_path / "log"
    uploads.mkdir()
    parts = {name: image / name for name in imagefile.PARTS}
    imagefile.pack(uploads / "new.image", parts, "2.0", key)
    slot = tmp_path / "boot" / "a"
    slot.mkdir(parents=True)
    for name in imagefile.PARTS:
        shutil.copy(image / name, slot)
    shutil.copy(uploads / imagefile.MANIFEST, slot)
    (slot.parent / "grub").mkdir()
    (slot.parent / "grub" / "grubenv").write_bytes(slots.write_environment(Environment("a")))
    make_disk(tmp_path / "disk.img", slot.parent, f"{OPTIONS} {SHELL}")
    log = ext2(tmp_path / "log.img", 96, uploads)
    signers = (tmp_path / "yard.pub").read_text().strip()
    export = f"export SIGNERS='image.signers=[\"{signers}\"]'"

    def start(slot: str) -> Shell:
        shell = Shell(computer, slot)
        assert shell.run(export)[0] == 0
        return shell

    with pc(tmp_path / "disk.img", log) as computer:
        shell = start("a")
        code, said = shell.image("install /log/new.image")
        assert code == 0, said
        assert "version 2.0, signed by yard, is in slot b and is tried at the next start" in said
        computer.type("reboot -f")
        shell = start("b")
        code, said = shell.image("status")
        assert code == 0, said
        assert "slot a: version 2.0, confirmed\r\n" in said
        assert "slot b: version 2.0, running\r\n" in said
        assert "the image in slot b is on trial" in said
    with pc(tmp_path / "disk.img", log) as computer:  # the power was cut
        shell = start("a")
        code, said = shell.image("status")
        assert code == 1, said
        assert "rolled back: the image in slot b was tried and not confirmed; slot a runs again" in said
        assert shell.image("install /log/new.image")[0] == 0
        computer.type("reboot -f")
        shell = start("b")
        code, said = shell.image("confirm")
        assert "slot b is confirmed" in said
        code, said = shell.image("status")
        assert code == 0, said
        assert "slot b: version 2.0, confirmed, running\r\n" in said
        assert "nothing to confirm" in said
