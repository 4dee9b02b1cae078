"""The boat's image for another processor, built here and booted on an emulated board until a propeller turns."""

import lzma
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.guest import boat_image
from tests.guest.harness import PATH, ROOT
from tests.guest.pc import board
from tests.guest.recording import record

pytestmark = [pytest.mark.long, pytest.mark.timeout(1500)]  # the image is built; a busy machine emulates slowly
PATIENCE_S = 600.0
OPTIONS = "console=ttyAMA0 quiet panic=10 LOG=/dev/vda MODULES=virtio_pci,virtio_blk,kvaser_pci,can-raw rdinit=/bin/sh"
SET_UP = "until ip link set can1 type can bitrate 500000 && ip link set can1 up; do sleep 0.2; done 2>/dev/null"
BESIDE = (
    f"(until [ -e /log/frames ]; do sleep 0.2; done; {SET_UP}; exec python3 /log/guest_actuation.py /log/frames) & exec /init"
)


@pytest.fixture(scope="module")
def image() -> Path:
    if reason := boat_image.missing("qemu-system-aarch64", "qemu-aarch64"):
        pytest.skip(reason)
    return boat_image.build_arm64()


def test_an_arm64_board_boots_the_image_and_turns_its_propellers(image: Path, tmp_path: Path) -> None:
    """Over the emulated CAN controllers, by the vehicle's file as shipped. The figures are printed (pytest -rP)."""
    disk, content = tmp_path / "log.img", tmp_path / "log"
    content.mkdir()
    (content / "guest_actuation.py").write_text((ROOT / "tests/guest/guest_actuation.py").read_text())
    record(ROOT / "etc/delfimx.toml", content / "frames", 60.0)
    subprocess.run(["mke2fs", "-q", "-t", "ext2", "-d", content, disk, "96M"], check=True, env={"PATH": PATH})
    with board(image, disk, OPTIONS) as computer:
        computer.wait_for("# ", PATIENCE_S)
        computer.type(f"mount -t devtmpfs dev /dev; {BESIDE}")
        said = computer.wait_for(" END", PATIENCE_S)
    first, turns = (float(found[1]) for found in re.finditer(r"(?:FIRST|TURNS) ([\d.]+)", said))
    print(f"kernel starts /init to the first frame to a propeller: {first:.1f} s; one that lets it run: {turns:.1f} s")
    assert 0.0 < first <= turns


def test_what_the_kernel_lacks_is_named(image: Path) -> None:
    """By the program that builds, and by the document; and only that: the drivers of a Raspberry Pi's hat are there."""
    lacking = re.search(r"the kernel \S+ lacks (.*): a boat", (image / "said").read_text())
    assert lacking
    assert lacking[1].split(", ") == ["tscan1", "cc770", "cc770_isa"]
    document = (ROOT / "docs/image.md").read_text()
    assert all(f"`{name}`" in document for name in lacking[1].split(", "))
    modules = {path.stem for path in (image / "modules").rglob("*.ko")}
    assert {"mcp251x", "mcp251xfd", "spi-bcm2835", "sdhci-iproc", "genet"} <= modules


def test_the_kernel_is_configured_as_the_document_says(image: Path) -> None:
    """Its preemption is chosen when it is compiled, not by the boot parameter."""
    options = {"CONFIG_PREEMPT_VOLUNTARY=y", "# CONFIG_PREEMPT_DYNAMIC is not set", "CONFIG_HZ=250", "CONFIG_HIGH_RES_TIMERS=y"}
    assert options - boat_image.kernel_options(image) == set()


def test_a_kernel_whose_modules_are_compressed_will_do(image: Path, tmp_path: Path) -> None:
    """As those of Raspberry Pi OS are: with what they need, and as the boat's modprobe reads them."""
    copy_modules = runpy.run_path(str(ROOT / "docker/image.py"), run_name="image")["copy_modules"]
    source, target = next((image / "kernel/lib/modules").iterdir()), tmp_path / "modules" / "6.12-rpi"
    for name in ("mcp251x", "can-dev"):
        path = next(source.rglob(f"{name}.ko"))
        place = target / path.relative_to(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.with_suffix(".ko.xz").write_bytes(lzma.compress(path.read_bytes()))
    shutil.copy(source / "modules.builtin", target)
    assert "sdhci-iproc" in copy_modules(target, tmp_path / "copied", "arm64")
    copied = [path for path in (tmp_path / "copied").rglob("*") if path.suffix in (".ko", ".dep")]
    assert sorted(path.name for path in copied) == ["can-dev.ko", "mcp251x.ko", "modules.dep"]
    assert "mcp251x.ko: " in next(path for path in copied if path.suffix == ".dep").read_text()
