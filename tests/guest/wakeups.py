"""What the kernel's preemption is worth (docs/image.md): python -m tests.guest.wakeups prints the table, in about ten minutes.

The PC is emulated, and its clock counts its instructions, 2 ns each: the host matters little; memory, disk and wires do not.
"""

import subprocess
import tempfile
from pathlib import Path

from tests.guest import boat_image
from tests.guest.harness import PATH, ROOT
from tests.guest.pc import emulated

MACHINE = "qemu-system-x86_64 -accel tcg -cpu max -icount shift=1,sleep=off -rtc clock=vm -m 768"
PATIENCE_S = 3600.0
SETUP = (
    "mount -t proc proc /proc; mount -t devtmpfs dev /dev; for m in virtio_pci virtio_blk ext4; do modprobe $m; done;"
    " mount -t ext2 /dev/vda /log; python3 /log/guest_wakeups.py"
)


def measured(image: Path, preempt: str, folder: Path) -> list[str]:
    """Per kind of load a row: median, 99 %, 99.9 %, worst in us, interrupts of the timer a second."""
    disk, content = folder / f"{preempt}.img", folder / preempt
    content.mkdir()
    (content / "guest_wakeups.py").write_text((ROOT / "tests/guest/guest_wakeups.py").read_text())
    subprocess.run(["mke2fs", "-q", "-t", "ext2", "-d", content, disk, "256M"], check=True, env={"PATH": PATH})
    options = f"console=ttyS0 quiet rdinit=/bin/sh preempt={preempt}"
    parts = ("-kernel", str(image / "vmlinuz"), "-initrd", str(image / "initramfs.gz"), "-append", options)
    with emulated(MACHINE, (disk,), parts) as computer:
        computer.wait_for("# ", PATIENCE_S)
        computer.type(SETUP)
        said = [computer.wait_for(" END", PATIENCE_S).splitlines()[-1] for _ in range(2)]
    return [f"| `{preempt}`, {' | '.join(row.split())} |" for row in said]


def main() -> None:
    print("| `preempt=`, load | median | 99 % | 99.9 % | worst, us | ticks/s |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for preempt in ("none", "voluntary", "full"):
            print(*measured(boat_image.build(), preempt, Path(folder)), sep="\n", flush=True)


if __name__ == "__main__":
    main()
