"""The guest itself: what a test may rely on when it uses tests/guest/harness.py."""

import sys
from pathlib import Path

import pytest

from tests.guest.harness import ROOT, Guest, GuestError, Result, guest, missing


def test_exit_code_and_both_streams_come_back(can_guest: Guest) -> None:
    assert can_guest.run("echo out; echo err >&2; exit 3") == Result(3, "out\nerr\n")


def test_commands_start_in_the_project_with_this_python(can_guest: Guest) -> None:
    result = can_guest.run("pwd; python -c 'import delfim, sys; print(delfim.__file__, sys.prefix)'")
    assert result == Result(0, f"{ROOT}\n{ROOT}/delfim/__init__.py {sys.prefix}\n")


def test_can_frames_pass_through_a_real_kernel(can_guest: Guest) -> None:
    heard = "candump -n 1 vcan0 & while kill -0 $! 2>/dev/null; do cansend vcan0 123#DEADBEEF; sleep 0.1; done; wait"
    result = can_guest.run(heard, timeout_s=200.0)
    assert result.output.split() == ["vcan0", "123", "[4]", "DE", "AD", "BE", "EF"]


def test_the_host_is_not_changed_but_for_the_shared_folder(can_guest: Guest, tmp_path: Path) -> None:
    stray = ROOT / "written-by-a-guest"
    result = can_guest.run(f'echo x >{stray} && echo x >{tmp_path}/stray && cat {stray} && echo kept >"$FOLDER/kept"')
    assert result == Result(0, "x\n")
    assert not stray.exists()
    assert not (tmp_path / "stray").exists()
    assert (can_guest.folder / "kept").read_text() == "kept\n"


def test_a_command_that_hangs_is_ended_and_the_guest_goes_on(can_guest: Guest) -> None:
    assert can_guest.run("echo before; sleep 60", timeout_s=3.0) == Result(124, "before\n")
    assert can_guest.run("echo after") == Result(0, "after\n")


HUNGRY = """
import subprocess, sys

def count(file, word):
    return next(int(line.split()[1]) for line in open(file) if line.startswith(word))

taken = []
while count("/proc/vmstat", "workingset_refault_file") < 12_000:
    subprocess.run([sys.executable, "-c", "import json"])
    while count("/proc/meminfo", "MemAvailable") > 8 << 10:
        taken.append(b"\\1" * (1 << 20))
"""


@pytest.mark.skipif(missing() is not None, reason=str(missing()))
@pytest.mark.long
def test_a_guest_whose_programs_are_read_again_and_again_has_too_little_memory(tmp_path: Path) -> None:
    with guest(tmp_path, modules=(), memory_mib=96) as small:
        (small.folder / "hungry.py").write_text(HUNGRY)
        with pytest.raises(GuestError, match=r"too little memory: \d+ pages"):
            small.run('echo hungry; python "$FOLDER/hungry.py"', timeout_s=250.0)  # a busy machine reads slowly
        assert small.run("echo enough") == Result(0, "enough\n")


@pytest.mark.skipif(missing() is not None, reason=str(missing()))
def test_a_guest_that_dies_is_told_with_its_last_words(tmp_path: Path) -> None:
    with guest(tmp_path, modules=()) as doomed:
        doomed.run("echo fine")
        with pytest.raises(GuestError, match=r"(?s)ended.*last words.*Kernel panic"):
            doomed.run("echo last words; sync; echo 1 >/proc/sys/kernel/sysrq; echo c >/proc/sysrq-trigger")
        with pytest.raises(GuestError, match="the guest"):
            doomed.run("true")
