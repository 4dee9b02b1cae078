"""Limits as files of a control group; that the kernel keeps them is tried in tests/guest/test_guest_boot.py."""

import logging
from pathlib import Path

import pytest

from delfim.services.supervision import cgroup
from delfim.services.supervision.cgroup import Limits


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The kernel's folder."""
    cgroup._warn_once.cache_clear()
    (tmp_path / "cgroup.controllers").write_text("cpu memory\n")
    return tmp_path


def test_limits_are_written_and_the_process_with_them(root: Path) -> None:
    assert Limits(64 << 20, 0.5).hold("sshd", 123, root)
    group = root / "delfim/sshd"
    found = {path.name: path.read_text() for path in group.iterdir()}
    assert found == {
        "memory.max": "67108864",
        "memory.oom.group": "1",
        "cpu.max": "50000 100000",
        "cgroup.procs": "123",
    }
    assert (root / "cgroup.subtree_control").read_text() == "+memory +cpu"
    assert (root / "delfim/cgroup.subtree_control").read_text() == "+memory +cpu"


@pytest.mark.parametrize(
    ("limits", "controller", "files"),
    [
        (Limits(1 << 20), "+memory", {"memory.max", "memory.oom.group", "cgroup.procs"}),
        (Limits(0, 2), "+cpu", {"cpu.max", "cgroup.procs"}),
    ],
)
def test_only_the_controller_that_is_needed_is_asked_for(root: Path, limits: Limits, controller: str, files: set[str]) -> None:
    """A kernel with groups of real time refuses the processor's while one of these runs below systemd."""
    assert limits.hold("sshd", 1, root)
    assert {path.name for path in (root / "delfim/sshd").iterdir()} == files
    assert (root / "cgroup.subtree_control").read_text() == controller
    assert (root / "delfim/cgroup.subtree_control").read_text() == controller


def test_a_limit_that_the_kernel_refuses_is_named(root, caplog, monkeypatch):
    def refused(*_: object) -> None:
        raise OSError(22, "Invalid argument")  # of a write: without the file's name

    monkeypatch.setattr(Path, "write_text", refused)
    assert not Limits(1 << 20).hold("sshd", 1, root)
    assert f"{root}/delfim/sshd: Invalid argument" in caplog.text


def test_no_limits_no_group(root: Path) -> None:
    Limits().hold("sshd", 1, root)
    assert not (root / "delfim").exists()


def test_where_there_are_no_control_groups_one_line_says_so(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    (root / "cgroup.controllers").unlink()
    with caplog.at_level(logging.WARNING):
        assert not Limits(1 << 20).hold("sshd", 1, root)
        Limits(1 << 20).hold("ftpd", 2, root)
    assert [record.message for record in caplog.records] == [
        f"memory and processor limits: {root}: no control groups here; going on without them"
    ]


@pytest.mark.parametrize(
    ("events", "reason"),
    [
        ("low 0\noom 1\noom_kill 1\n", "killed by the kernel: it needed more than its 64 MB"),
        ("low 0\noom 0\noom_kill 0\n", ""),
        ("nonsense\n", ""),
    ],
)
def test_why_it_was_killed(root: Path, events: str, reason: str) -> None:
    limits = Limits(64 << 20)
    limits.hold("sshd", 1, root)
    (root / "delfim/sshd/memory.events").write_text(events)
    assert limits.exceeded("sshd", root) == reason


def test_all_that_live_under_limits_end_together(root: Path) -> None:
    limits = Limits(1 << 20)
    limits.end("sshd", root)
    assert not (root / "delfim/sshd").exists()
    limits.hold("sshd", 1, root)
    limits.end("sshd", root)
    assert (root / "delfim/sshd/cgroup.kill").read_text() == "1"


def test_without_a_group_nothing_is_known(root: Path) -> None:
    assert Limits(64 << 20).exceeded("sshd", root) == ""
    assert Limits().exceeded("sshd", root) == ""
