"""The last act, on this machine: who uses a file system is found and named; what holds it up is bounded."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from delfim.services.supervision import shutdown
from delfim.services.supervision.shutdown import User, devices, last_act, mounts, request, users

HOLD = """
import mmap, os, signal, sys
how, path = sys.argv[1:]
if how == "open": keep = open(path)
if how == "deleted": keep = open(path); os.unlink(path)
if how == "directory": os.chdir(os.path.dirname(path))
if how == "mapped":
    with open(path, "r+b") as file: keep = mmap.mmap(file.fileno(), 0)
print("holding", flush=True)
signal.pause()
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[object]:
    """A process that uses a file of ours."""
    children: list[subprocess.Popen[str]] = []

    def hold(how: str, path: Path) -> int:
        command = [sys.executable, "-c", HOLD, how, str(path)]
        children.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd="/"))
        assert children[-1].stdout is not None
        assert children[-1].stdout.readline() == "holding\n"
        return children[-1].pid

    yield hold
    for child in children:
        child.kill()
        child.communicate()


@pytest.mark.parametrize("how", ["open", "deleted", "directory", "mapped"])
def test_whoever_uses_the_file_system_is_named(tmp_path: Path, holder, how: str) -> None:
    file = tmp_path / "log file"
    file.write_text("x" * 100)
    pid = holder(how, file)
    found = {user.pid: user for user in users(str(tmp_path))}
    assert found[pid].name.startswith("python")
    assert os.getpid() not in found


def test_a_user_in_words() -> None:
    assert str(User(7, "tar", "/log/a")) == "tar (process 7) uses /log/a"


def test_a_place_that_is_not_there_has_no_users() -> None:
    assert users("/does/not/exist") == []


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["8:2 / /log", "8:3 / /logs", "7:0 / /log/a\\040b"], ["/log/a b", "/log"]),
        (["8:2 / /log", "8:2 / /srv/log"], ["/srv/log", "/log"]),
        (["8:3 / /logs"], []),
        (["8:1 /data /log"], []),
    ],
    ids=["below", "a second time", "nothing", "a part of the root"],
)
def test_what_is_unmounted(tmp_path: Path, rows: list[str], expected: list[str]) -> None:
    (tmp_path / "self").mkdir()
    lines = (f"1 0 {row} rw - ext2 x rw\n" for row in ["8:1 / /", *rows])
    (tmp_path / "self/mountinfo").write_text("".join(lines))
    assert mounts("/log", tmp_path) == expected


def test_what_the_kernel_itself_uses_is_named(tmp_path: Path) -> None:
    for name, file in (("loop0", "/log/image\n"), ("loop1", "/boot/image\n")):
        (tmp_path / f"sys/block/{name}/loop").mkdir(parents=True)
        (tmp_path / f"sys/block/{name}/loop/backing_file").write_text(file)
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/swaps").write_text("Filename Type Size Used Priority\n/log/swap file 1 0 -2\n")
    assert sorted(devices("/log", tmp_path)) == ["loop0 uses /log/image", "swap uses /log/swap"]


class Told:
    """What the bus was told."""

    def __init__(self, tmp_path: Path) -> None:
        self.said: list[tuple[bool, list[str]]] = []
        self.record = tmp_path / "shutdown.json"

    def __call__(self, is_safe: bool, holders: Sequence[str]) -> None:
        self.said.append((is_safe, list(holders)))

    def last_act(self, mount: str, **limits: float) -> bool:
        spans = {"end_s": 0.1, "held_s": 0.0, "told_s": 0.0} | limits
        return last_act("button", mount, tell=self, record=self.record, **spans)


@pytest.mark.parametrize("mount", ["", "/does/not/exist"])
def test_where_nothing_is_mounted_it_is_safe_at_once(tmp_path: Path, mount: str) -> None:
    told = Told(tmp_path)
    assert told.last_act(mount)
    assert told.said == [(True, [])]
    record = json.loads(told.record.read_text())
    assert (record["reason"], record["stage"], record["holders"]) == ("button", "safe", [])


def test_what_is_in_the_way_is_told_until_it_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(tmp_path)
    monkeypatch.setattr(shutdown, "release", lambda mount, end_s: ["tar (process 7) uses /log/a"])
    monkeypatch.setattr(shutdown, "AGAIN_S", 0.01)
    assert not told.last_act("/log", held_s=0.1)
    assert len(told.said) > 1
    assert set(map(str, told.said)) == {str((False, ["tar (process 7) uses /log/a"]))}
    assert json.loads(told.record.read_text())["stage"] == "held"


def test_what_goes_away_at_last_makes_it_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told, left = Told(tmp_path), [["tar (process 7) uses /log/a"], []]
    monkeypatch.setattr(shutdown, "release", lambda mount, end_s: left.pop(0))
    monkeypatch.setattr(shutdown, "AGAIN_S", 0.01)
    assert told.last_act("/log", held_s=10.0)
    assert [is_safe for is_safe, _ in told.said] == [False, True]


def test_a_disk_that_does_not_answer_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(tmp_path)
    monkeypatch.setattr(shutdown, "release", lambda mount, end_s: signal.sigtimedwait([signal.SIGPWR], 30.0))
    monkeypatch.setattr(shutdown, "ATTEMPT_S", 0.05)
    monkeypatch.setattr(shutdown, "KILL_S", 0.0)
    assert not told.last_act("/log")
    assert told.said == [(False, ["/log does not answer"])]


def test_a_defect_is_not_taken_for_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(tmp_path)
    monkeypatch.setattr(shutdown, "release", lambda mount, end_s: 1 / 0)
    assert not told.last_act("/log")
    assert told.said == [(False, ["/log: division by zero"])]


def test_a_record_that_cannot_be_written_is_no_reason_to_stop(tmp_path: Path) -> None:
    told = Told(tmp_path)
    told.record.mkdir()
    assert told.last_act("")


def test_the_outcome_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(tmp_path)
    monkeypatch.setattr(shutdown, "TELL_S", 0.01)
    told.last_act("", told_s=0.1)
    assert len(told.said) > 2


def test_a_request_goes_to_who_listens_and_nowhere_else(tmp_path: Path) -> None:
    place = shutdown.socket_path(tmp_path)
    assert not shutdown.is_listening(place)
    with pytest.raises(FileNotFoundError):
        request(place, "off", "test")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(place))
        assert shutdown.is_listening(place)
        request(place, "reboot", "test of words")
        assert supervisor.recv(100) == b"reboot test of words"
    with pytest.raises(ConnectionRefusedError):
        request(place, "off", "test")


def test_a_restart_has_the_words_that_were_left_for_the_boot_loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As reboot(2) of a Raspberry Pi takes them; where the kernel does not know it, the ordinary restart follows."""
    called: list[tuple[object, ...]] = []
    monkeypatch.setattr(shutdown, "_libc", lambda name, *words: called.append((name, *words)))
    words = shutdown.words_path(tmp_path)
    shutdown.leave("reboot", words)
    assert [each[0] for each in called] == ["reboot"], "no words, no file"
    words.write_text("0 tryboot")
    shutdown.leave("off", words)
    assert [each[0] for each in called] == ["reboot", "reboot"]
    shutdown.leave("reboot", words)
    assert [each[0] for each in called[2:]] == ["syscall", "reboot"]
    assert called[2][-1] == b"0 tryboot"
