"""The boat's own PID 1, from the kernel's first process to the dark: booted with etc/init on an ext2 log partition, driven,
started again, and ended by a shutdown frame that somebody else sends."""

import compileall
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from delfim.base.frames import Frame
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import ShutdownStage
from delfim.logging.candump import parse_line
from tests.guest.harness import PATH, ROOT, Guest, GuestError, guest, missing
from tests.guest.recording import record

SETTINGS = {'interface = "can0"': 'interface = "vcan0"', "required = true": "required = true\nfree_bytes_min = 1_000_000"}
FOREVER_S = 120.0
UP = "until [ -e /sys/class/net/vcan0 ] && grep -q . /run/delfim/supervisor.json; do sleep 0.1; done 2>/dev/null\n"
CANDUMP = "candump -L vcan0,040:7FE,0C8:7FE >$FOLDER/dump &\n"
SEEN = "until grep -q ' 040#' $FOLDER/dump; do sleep 0.1; done\n"  # it listens; an idle boat says "motor off"


class Boat:
    """A guest that boots as a boat, and its disk."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.disk, self.file = folder / "log.img", folder / "boat.toml"
        self.disk.touch()
        os.truncate(self.disk, 32 << 20)
        subprocess.run(["mke2fs", "-q", "-t", "ext2", "-F", self.disk], env={"PATH": PATH}, check=True, timeout=60)
        text = (ROOT / "etc/delfimx.toml").read_text()
        for old, new in SETTINGS.items():
            assert old in text
            text = text.replace(old, new)
        self.file.write_text(text)

    def says(self, more: str) -> None:
        """More lines of the vehicle's file."""
        self.file.write_text(self.file.read_text() + more)

    @contextmanager
    def booted(self, log: str = "/dev/ubda") -> Iterator[Guest]:
        words = [f"BOAT={ROOT}/etc/init", f"VEHICLE={self.file}", "MODULES=vcan,can-raw,loop", f"LOG={log}"]
        with guest(self.folder, modules=(), kernel_args=(f"ubd0={self.disk}", *words)) as g:
            yield g

    def check(self) -> str:
        """What e2fsck finds on the disk; empty: nothing."""
        done = subprocess.run(
            ["e2fsck", "-n", "-f", self.disk], env={"PATH": PATH}, capture_output=True, text=True, timeout=60, check=False
        )
        return "" if done.returncode == 0 and "not cleanly" not in done.stdout else done.stdout


@pytest.fixture
def boat(tmp_path: Path) -> Boat:
    if reason := missing():
        pytest.skip(reason)
    return Boat(tmp_path)


def wait(condition: str) -> str:
    """Shell: until this command is well."""
    return f"until {condition}; do sleep 0.1; done\n"


def drive(boat: Boat, words: str) -> str:
    return f"python -m delfim drive {boat.file} {words}"


def sail(boat: Boat) -> str:
    """Shell: the other nodes, and the boat under way."""
    return f"python -m delfim nodes {boat.file} >$FOLDER/nodes 2>&1 &\n" + wait(drive(boat, "heading 150 1.2 2>/dev/null"))


def order(reboot: bool = False) -> str:
    """Shell: the frame of the power board."""
    return f"cansend vcan0 {identifier(messages.SHUTDOWN)}#{messages.pack_shutdown(messages.Shutdown(reboot)).hex()}\n"


def identifier(arb: int) -> str:
    return f"{arb >> 21:03X}"


def dark(g: Guest, command: str) -> str:
    """Run a command that ends the guest; what its console said meanwhile."""
    with pytest.raises(GuestError) as end:
        g.run(command + "sleep 1000", timeout_s=FOREVER_S)
    assert "the guest ended" in str(end.value)
    return str(end.value)


def dumped(g: Guest, *arbs: int) -> list[Frame]:
    """What candump saw of these."""
    lines = (g.folder / "dump").read_text().splitlines()
    frames = [parse_line(line)[1] for line in lines if line.count(" ") == 2]
    return [frame for frame in frames if frame.arb in arbs]


def acknowledges(g: Guest) -> list[messages.ShutdownAcknowledge]:
    return [messages.unpack_shutdown_acknowledge(frame.data) for frame in dumped(g, messages.SHUTDOWN_ACKNOWLEDGE)]


def test_from_init_to_the_first_actuation(boat: Boat) -> None:
    """The contract is 5 s. The figure is printed (pytest -rP)."""
    compileall.compile_dir(ROOT / "delfim", quiet=1)  # as on the image; the guest keeps nothing
    play = record(boat.file, boat.folder / "nodes.log", 60.0)
    began = "import time; up, init = (float(open(f).read().split()[0]) for f in ('/proc/uptime', '/run/init'))"
    with boat.booted() as g:
        result = g.run(
            wait('read -r state 2>/dev/null </sys/class/net/vcan0/operstate && [ "$state" = unknown ]')
            + f"canplayer -I {play} >/dev/null 2>&1 &\n"
            + "candump -L -n 1 vcan0,040:7FE\n"
            + f'python -c "{began}; print(time.time() - up + init)"',
            timeout_s=FOREVER_S,
        )
    first, began_s = result.output.splitlines()[-2:]
    took_s = parse_line(first)[1].t_ns / 1e9 - float(began_s)
    print(f"kernel starts /init to first actuation: {took_s:.2f} s")
    assert took_s > 0.0


@pytest.mark.long
def test_sail_start_again_sail_and_end_by_the_frame(boat: Boat) -> None:
    with boat.booted() as g:
        said = g.run(UP + sail(boat) + "tr '\\0' ' ' </proc/1/cmdline", timeout_s=FOREVER_S).output
        assert "supervise --init" in said
        g.run(drive(boat, "reboot"))
        g.wait_for("GUEST ready", FOREVER_S)  # the kernel started itself again
        checks = g.run(UP + sail(boat) + drive(boat, "checks"), timeout_s=FOREVER_S).output
        assert "ok   last shutdown" in checks, checks
        said = dark(g, CANDUMP + SEEN + "(cd /log; exec sleep 1001) &\n sleep 1\n" + order())
        told = acknowledges(g)
        last = dumped(g, messages.PROPELLER_PORT)[-1]
    assert "uses /log: ended with SIGTERM" in said
    assert told[0].stage == ShutdownStage.BEGUN
    assert set(told[1:]) == {messages.ShutdownAcknowledge(ShutdownStage.SAFE, 0)}
    assert not messages.unpack_propeller_command(last.data).run
    assert boat.check() == ""


@pytest.mark.long
def test_what_cannot_be_ended_is_named_and_the_disk_is_whole(boat: Boat) -> None:
    """A loop device is the kernel's own: no signal ends it."""
    boat.says("\n[powerd]\nheld_s = 2.0\ntold_s = 1.0\n")
    with boat.booted() as g:
        hold = "truncate -s 1M /log/image; losetup /dev/loop0 /log/image\n"
        said = dark(g, UP + wait("[ -S /run/delfim/command ]") + CANDUMP + SEEN + hold + order())
        told = acknowledges(g)
    assert "/log cannot be unmounted: loop0 uses /log/image" in said
    assert "not safe: loop0 uses /log/image" in said
    assert told[0].stage == ShutdownStage.BEGUN
    assert set(told[1:]) == {messages.ShutdownAcknowledge(ShutdownStage.HELD, 1)}
    subprocess.run(["e2fsck", "-f", "-p", boat.disk], env={"PATH": PATH}, timeout=60, check=False)
    assert boat.check() == "", "the next boot mends what was not unmounted"


@pytest.mark.long
def test_a_second_mount_is_unmounted_and_what_only_reads_does_not_matter(boat: Boat) -> None:
    """A loop device that only reads holds the partition, but not against being made read-only."""
    with boat.booted() as g:
        hold = "truncate -s 1M /log/image; losetup -r /dev/loop0 /log/image; mkdir /srv/log; mount --bind /log /srv/log\n"
        said = dark(g, UP + wait("[ -S /run/delfim/command ]") + CANDUMP + SEEN + hold + order())
        told = acknowledges(g)
    assert "/log is in use and was made read-only instead: loop0 uses /log/image" in said
    assert told[-1] == messages.ShutdownAcknowledge(ShutdownStage.SAFE, 0)
    assert boat.check() == ""


LIMITED = """
import subprocess, sys
from delfim.services.supervision.cgroup import Limits
limits = Limits(32 << 20, 0.5)
eats = "import sys; sys.stdin.readline(); x = [bytearray(1 << 20) for _ in range(64)]; print('fits')"
child = subprocess.Popen([sys.executable, "-c", eats], stdin=subprocess.PIPE, text=True)
limits.hold("eater", child.pid)
child.communicate("\\n")
print("REPORT", child.returncode, limits.exceeded("eater"))
"""


def test_the_kernel_keeps_the_limits(can_guest: Guest) -> None:
    (can_guest.folder / "limited.py").write_text(LIMITED)
    result = can_guest.run("mount -t cgroup2 cgroup /sys/fs/cgroup; python $FOLDER/limited.py; umount /sys/fs/cgroup")
    assert "REPORT -9 killed by the kernel: it needed more than its 32 MB" in result.output


CONFINED = """
import os, subprocess, sys
from delfim.services.supervision import processes
from delfim.services.supervision.cgroup import Limits

def carried(name, words):
    limits = ["nobody", "32", "0.5", "8", "alone"]
    command = [sys.executable, "-m", "delfim.services.supervision.confine", name, *limits, "/bin/sh", "-c", words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)

eater = carried("payload-eater", "tail /dev/zero; echo alive")
print("REPORT", eater.communicate()[0], eater.returncode, Limits(32 << 20).exceeded("payload-eater"))
loose = carried("payload-loose", "setsid sleep 1000 & setsid sleep 1000 & cut -d: -f3 /proc/self/cgroup; sleep 1000")
print("REPORT in", loose.stdout.readline())
left = open("/sys/fs/cgroup/delfim/payload-loose/cgroup.procs")

def away(pid):
    try:
        return os.getsid(pid) != loose.pid
    except ProcessLookupError:  # it ended since the list was read
        return False

while sum(away(int(pid)) for pid in left.read().split()) < 2:  # until both have left the session
    left.seek(0)
processes.kill(loose.pid)
loose.wait()
left.seek(0)
print("REPORT left", len(left.read().split()))
Limits(32 << 20).end("payload-loose")
left.seek(0)
while left.read():
    left.seek(0)
print("REPORT none is left")
"""


def test_a_payload_program_has_its_limits_and_none_of_it_stays_behind(can_guest: Guest) -> None:
    (can_guest.folder / "confined.py").write_text(CONFINED)
    run = f"PYTHONPATH={ROOT} python $FOLDER/confined.py"
    result = can_guest.run(f"mount -t cgroup2 cgroup /sys/fs/cgroup; {run}; umount /sys/fs/cgroup")
    assert "killed by the kernel: it needed more than its 32 MB" in result.output
    assert "alive" not in result.output
    assert "REPORT in b'/delfim/payload-loose\\n'" in result.output
    assert "REPORT left 2\n" in result.output, "those that left the session"
    assert "REPORT none is left" in result.output


@pytest.mark.long
def test_a_boat_without_its_disk_boots_and_says_why_it_stays(boat: Boat) -> None:
    os.truncate(boat.disk, 0)
    os.truncate(boat.disk, 32 << 20)
    with boat.booted() as g:
        result = g.run(
            UP
            + wait("[ -S /run/delfim/command ]")
            + f"python -m delfim nodes {boat.file} >$FOLDER/nodes 2>&1 &\n"
            + wait(drive(boat, "checks") + " | grep 'NOT.*log.*Read-only file system'"),
            timeout_s=FOREVER_S,
        )
        assert "no log, no start: " in result.output
        dark(g, order())


@pytest.mark.long
def test_a_disk_that_comes_late_is_waited_for(boat: Boat) -> None:
    """Memory cards and what is on USB are found after their modules are loaded."""
    with boat.booted("/dev/late") as g:
        found = wait("[ -e /run/init ]") + "sleep 1; ln -s ubda /dev/late\n" + UP + "grep ' /log ' /proc/mounts"
        assert "/dev/ubda /log ext2" in g.run(found, timeout_s=FOREVER_S).output.replace("/dev/late", "/dev/ubda")


def test_a_vehicle_file_that_is_wrong_leaves_a_shell_and_no_panic(boat: Boat) -> None:
    boat.says("\n[nonsense]\n")
    with boat.booted() as g:
        g.wait_for("nonsense: unknown key", FOREVER_S)
        g.wait_for("the boat cannot start; this is a shell to repair it", FOREVER_S)
