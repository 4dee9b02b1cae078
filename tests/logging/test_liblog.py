"""Logs that the caller writes: names, ends of files, and every failure that a disk can have."""

import errno
import os
import shutil
import zlib
from typing import Any

import pytest

from delfim import config
from delfim.base import wholefile
from delfim.base.clock import ManualClock
from delfim.logging import chain, filelog, free_space, liblog
from delfim.logging.ashore import chaincheck
from delfim.logging.liblog import LogStatus, in_order
from delfim.logging.openlog import open_log
from delfim.logging.reading import read_log
from tests.logging.conftest import content, files, numbers, remount

NEW_YEAR_2010 = 1_262_304_000_000_000_000


def names(directory):
    return [str(path.relative_to(directory)) for path in files(directory)]


def record(number: int, size: int = 0) -> bytes:
    """A numbered line; its tail does not compress."""
    return b"%06d" % number + (b" " + os.urandom(size).hex().encode() if size else b"") + b"\n"


def test_names_follow_the_thesis(tmp_path, file_log):
    log = file_log()
    assert log.put(b"one\n")
    assert names(tmp_path / "log") == ["20100101/gps/000000.log"]
    assert log.status() == LogStatus(True, "", str(tmp_path / "log/20100101/gps/000000.log"), 4, 1, 0)


def test_a_plain_record_is_in_the_file_at_once(tmp_path, file_log):
    file_log().put(b"one\n")
    assert content(tmp_path / "log") == b"one\n"


def test_a_plain_record_costs_one_system_call_where_somebody_polls(tmp_path, file_log, clock, monkeypatch):
    log, calls = file_log(), []

    class Counting:
        def __getattr__(self, name: str) -> Any:
            calls.append(name)
            return getattr(os, name)

    monkeypatch.setattr(filelog, "os", Counting())
    for number in range(500):
        calls.clear()
        assert log.put(record(number))
        assert calls == ["write"]
        clock.advance(0.01)
        if number % 100 == 99:
            log.poll()
    assert "fstat" in calls, "whether the file is still there, and the disk's room"


def test_deflated_records_are_in_the_file_within_a_second(tmp_path, file_log, clock):
    log = file_log(deflate=True)
    for number in range(3):
        log.put(record(number))
    assert numbers(tmp_path / "log") == []
    clock.advance(0.9)
    log.poll()
    assert names(tmp_path / "log") == ["20100101/gps/000000.log.gz"]
    assert numbers(tmp_path / "log") == [0, 1, 2]


def test_a_closed_deflated_file_is_complete(tmp_path, file_log):
    log = file_log(deflate=True, header=b"head\n")
    log.put(b"one\n")
    log.close()
    assert read_log(files(tmp_path / "log")[0]) == (b"head\none\n", "")


@pytest.mark.parametrize("deflate", [False, True])
def test_a_file_ends_past_its_size(tmp_path, file_log, clock, deflate):
    log = file_log(file_bytes=500, deflate=deflate, header=b"head\n")
    for number in range(40):
        log.put(record(number, size=50))
        clock.advance(1.0)
        log.poll()
    log.close()
    sizes = [path.stat().st_size for path in files(tmp_path / "log")]
    assert len(sizes) > 5
    assert all(500 <= size < 800 for size in sizes[:-1])
    assert all(read_log(path)[0].startswith(b"head\n0") for path in files(tmp_path / "log"))
    assert all(read_log(path)[1] == "" for path in files(tmp_path / "log"))
    assert [int(line[:6]) for line in content(tmp_path / "log").splitlines() if line != b"head"] == list(range(40))


def test_a_file_ends_past_its_age(tmp_path, file_log, clock):
    log = file_log(file_s=600.0)
    for number in range(4):
        log.put(record(number))
        clock.advance(400.0)
    assert names(tmp_path / "log") == ["20100101/gps/000000.log", "20100101/gps/001320.log"]
    assert [read_log(path)[0] for path in files(tmp_path / "log")] == [b"000000\n000001\n", b"000002\n000003\n"]


def test_a_file_without_records_to_come_is_not_followed_by_another(tmp_path, file_log, clock):
    log = file_log(file_s=600.0)
    log.put(b"one\n")
    for _ in range(5):
        clock.advance(700.0)
        log.poll()
    assert len(files(tmp_path / "log")) == 1
    assert log.status().writable


def test_a_new_day_is_a_new_folder(tmp_path, file_log, clock):
    clock.step(86_399.0)
    log = file_log(file_s=2.0)
    for number in range(2):
        log.put(record(number))
        clock.advance(3.0)
    assert names(tmp_path / "log") == ["20100101/gps/235959.log", "20100102/gps/000002.log"]


def test_a_taken_name_is_never_taken_again(tmp_path, file_log):
    for text in (b"first", b"second", b"third"):
        log = file_log()
        log.put(text)
        log.close()
    assert names(tmp_path / "log") == [f"20100101/gps/000000{tail}.log" for tail in ("", "-1", "-2")]
    assert [read_log(path)[0] for path in files(tmp_path / "log")] == [b"first", b"second", b"third"]


def test_files_of_one_second_keep_their_order(tmp_path):
    made = [tmp_path / "20100101" / "gps" / f"000000{tail}.log.gz" for tail in ("", "-1", "-2", "-10")]
    made += [tmp_path / "20100102" / "gps" / "000000.log.gz"]
    assert in_order(sorted(made)) == made


@pytest.mark.parametrize("step_s", [4e8, -4e8, 0.7, -0.7])
def test_a_stepping_wall_clock_loses_nothing(tmp_path, file_log, clock, step_s):
    log = file_log(file_s=2.0, deflate=True)
    for number in range(20):
        if number in (5, 12):
            clock.step(step_s if number == 5 else -step_s)
        assert log.put(record(number))
        clock.advance(0.5)
    log.close()
    assert sorted(numbers(tmp_path / "log")) == list(range(20))
    assert log.status().records == 20
    assert all(read_log(path)[1] == "" for path in files(tmp_path / "log"))


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_from_before_the_clock_was_set_gets_its_right_name(tmp_path, file_log, clock, durable):
    """A run stays one run, wherever it began, and its step is noted beside it."""
    clock.step(-40 * 365.25 * 86_400.0)
    log = file_log(deflate=True, durable=durable)
    other = file_log(id="can0")
    log.note(b"start\n")
    for number in range(20):
        if number == 3:
            clock.step(56 * 365.25 * 86_400.0)
        log.put(record(number))
        log.poll()
        clock.advance(0.5)
        if number == 5:
            log.note(b"stepped\n")
    assert log.status().file == str(tmp_path / "log/20260101/gps/000000.log.gz")
    log.close()
    assert names(tmp_path / "log") == ["19700101/can0/000000.log", "20260101/gps/000000.log.gz"]
    assert numbers(tmp_path / "log/20260101/..") == list(range(20))
    assert (tmp_path / "log/20260101/gps/000000.meta.jsonl").read_text() == "start\nstepped\n"
    assert not (tmp_path / "log/19700101/gps").exists()
    other.poll()
    assert not (tmp_path / "log/19700101").exists(), "nothing is left of it"


def test_a_small_step_renames_nothing(tmp_path, file_log, clock):
    log = file_log()
    for step_s in (3000.0, -3000.0, 600.0):
        clock.step(step_s)
        clock.advance(1.0)
        log.poll()
    assert names(tmp_path / "log") == ["20100101/gps/000000.log"]


def test_notes_go_to_the_sidecar_of_the_file(tmp_path, file_log, clock):
    log = file_log(file_s=10.0, durable=True)
    log.put(b"one\n")
    assert log.note(b"{1}\n")
    assert log.note(b"{2}\n")
    clock.advance(11.0)
    log.put(b"two\n")
    log.note(b"{3}\n")
    folder = tmp_path / "log/20100101/gps"
    assert (folder / "000000.meta.jsonl").read_bytes() == b"{1}\n{2}\n"
    assert (folder / "000011.meta.jsonl").read_bytes() == b"{3}\n"


def test_after_close_everything_is_dropped(file_log):
    log = file_log()
    log.put(b"one\n")
    log.close()
    assert not log.put(b"two\n")
    assert not log.note(b"{}\n")
    log.poll()
    assert log.status()[:2] == (False, "closed")
    assert log.status()[4:] == (1, 1)


def test_members_of_ten_seconds(tmp_path, file_log, clock):
    log = file_log(deflate=True)
    for number in range(35):
        log.put(record(number))
        clock.advance(1.0)
    log.close()
    data, members = files(tmp_path / "log")[0].read_bytes(), 0
    while data:
        member = zlib.decompressobj(wbits=31)
        member.decompress(data)
        data, members = member.unused_data, members + 1
    assert members == 4


def test_a_file_cut_anywhere_gives_what_was_flushed(tmp_path, file_log, clock):
    log, whole, flushed = file_log(deflate=True), b"", []
    for number in range(30):
        whole += record(number)
        log.put(record(number))
        clock.advance(0.9)
        log.poll()
        flushed.append((log.status().bytes, len(whole)))
    log.close()
    data = files(tmp_path / "log")[0].read_bytes()
    cut = tmp_path / "cut.log.gz"
    for size in range(2, len(data)):
        cut.write_bytes(data[:size])
        text, complaint = read_log(cut)
        assert whole.startswith(text)
        assert len(text) >= max((length for on_disk, length in flushed if on_disk <= size), default=0)
        at_member_end = any(on_disk == size for on_disk, _ in flushed)
        assert complaint or at_member_end


def test_damage_is_told(tmp_path, file_log):
    log = file_log(deflate=True)
    log.put(os.urandom(3000))
    log.close()
    path = files(tmp_path / "log")[0]
    data = bytearray(path.read_bytes())
    path.write_bytes(bytes(data[:-8]) + b"\0" * 8)
    assert "damaged" in read_log(path)[1]
    path.write_bytes(bytes(data) + b"\0" * 100)
    assert "damaged after 3000 bytes" in read_log(path)[1]


def test_a_full_disk_is_told_and_survived(small_disk, file_log, clock):
    log = file_log(directory=str(small_disk))
    puts = 0
    while log.put(record(puts, size=500)):
        puts += 1
    assert "No space left on device" in log.status().reason
    assert not log.put(b"lost\n")
    assert numbers(small_disk) == list(range(puts))
    for path in files(small_disk):
        path.rename(path.with_suffix(".moved"))
    for path in small_disk.rglob("*.moved"):
        path.unlink()
    clock.advance(1.0)
    assert log.put(b"000999\n")
    assert log.status()[:2] == (True, "")
    assert log.status()[4:] == (puts + 1, 2)
    assert numbers(small_disk) == [999]


def test_a_full_disk_does_not_collect_empty_files(small_disk, file_log, clock):
    (small_disk / "filler").write_bytes(bytes(48 << 10))
    log = file_log(directory=str(small_disk), deflate=True, durable=True)
    for number in range(100):
        log.put(record(number, size=500))
        clock.advance(1.0)
    assert not log.status().writable
    assert len(files(small_disk)) == 1
    log.close()
    assert numbers(small_disk) == list(range(log.status().records))
    assert log.status().records + log.status().dropped == 100


def test_a_read_only_disk_is_told_and_survived(small_disk, file_log, clock):
    remount(small_disk, "ro")
    log = file_log(directory=str(small_disk))
    assert not log.put(b"lost\n")
    assert "Read-only file system" in log.status().reason
    remount(small_disk, "rw")
    clock.advance(1.0)
    log.poll()
    assert log.status().writable
    assert log.put(b"kept\n")


def test_a_directory_that_is_no_directory(tmp_path, file_log, clock):
    (tmp_path / "log").write_text("in the way")
    log = file_log()
    assert not log.put(b"lost\n")
    assert log.status().reason == f"{tmp_path}/log: File exists"
    (tmp_path / "log").unlink()
    clock.advance(1.0)
    assert log.put(b"kept\n")


def test_a_directory_that_goes_and_comes_back(tmp_path, file_log, clock):
    log = file_log()
    log.put(b"gone\n")
    (tmp_path / "log").rename(tmp_path / "away")
    files(tmp_path / "away")[0].unlink()
    (tmp_path / "log").write_text("in the way")
    for _ in range(2):
        clock.advance(1.0)
        log.poll()
    assert not log.status().writable
    (tmp_path / "log").unlink()
    clock.advance(1.0)
    assert log.put(b"kept\n")
    assert content(tmp_path / "log") == b"kept\n"


def test_nobody_writes_into_a_deleted_file(tmp_path, file_log, clock):
    log = file_log()
    log.put(b"gone\n")
    files(tmp_path / "log")[0].unlink()
    clock.advance(1.0)
    log.poll()
    assert log.status().reason.endswith("the file was deleted")
    clock.advance(1.0)
    assert log.put(b"kept\n")
    assert content(tmp_path / "log") == b"kept\n"


class Faulty:
    """The modules os and shutil, some of whose calls fail: number `first` to `first + count - 1` of those that a
    disk can let fail."""

    CALLS = (
        "close",
        "disk_usage",
        "fstat",
        "fsync",
        "ftruncate",
        "link",
        "makedirs",
        "open",
        "replace",
        "rmdir",
        "unlink",
        "write",
    )

    def __init__(self, first: int, count: int) -> None:
        self.first, self.last, self.calls = first, first + count - 1, 0

    def __getattr__(self, name: str) -> Any:
        real = getattr(os if hasattr(os, name) else shutil, name)
        if name not in self.CALLS:
            return real

        def call(*arguments: Any, **named: Any) -> Any:
            self.calls += 1
            if not self.first <= self.calls <= self.last:
                return None if name == "fsync" else real(*arguments, **named)  # hundreds of them take seconds
            if name == "close":
                real(*arguments)
            if name == "write" and len(arguments[1]) > 1:
                real(arguments[0], arguments[1][: len(arguments[1]) // 2])
            raise OSError((errno.EIO, errno.ENOSPC, errno.EROFS)[self.calls % 3], "fault", None)

        return call


def run_with_faults(directory, monkeypatch, first: int, count: int, **how: bool) -> tuple[Faulty, LogStatus]:
    """Sixty records over 30 s, and a clock that is set. The log must be itself again at the end."""
    clock, faulty = ManualClock(), Faulty(first, count)
    settings = liblog.LogSettings(str(directory), "gps", ".log", b"", 600, 12.0, 1, "delete-oldest")
    with monkeypatch.context() as patch:
        patch.setattr(filelog, "os", faulty)
        patch.setattr(wholefile, "os", faulty)
        patch.setattr(chain, "os", faulty)
        patch.setattr(free_space, "os", faulty)
        patch.setattr(free_space, "shutil", faulty)
        log = filelog.FileLog(settings, clock, **how)
        for number in range(60):
            log.put(record(number, size=10))
            clock.advance(0.5)
            if number == 20:
                clock.step(16 * 365 * 86_400.0)
        after = log.status()
        log.close()
    if faulty.calls >= faulty.last + 30:
        assert after.writable, after
    return faulty, log.status()


@pytest.mark.parametrize("how", [{"deflate": False}, {"deflate": True}, {"deflate": True, "durable": True}], ids=str)
@pytest.mark.parametrize("count", [1, 4])
def test_every_call_may_fail(tmp_path, monkeypatch, count, how):
    first, faulty = 1, None
    while faulty is None or faulty.calls >= faulty.first:
        directory = tmp_path / str(first)
        faulty, status = run_with_faults(directory, monkeypatch, first, count, **how)
        assert status.records + status.dropped == 60
        if how.get("durable"):
            told = chaincheck.check([str(directory)], 0)
            assert not [each for each in told if each.found == "changed"], "a failing disk is no forger"
        read = numbers(directory)
        assert read == sorted(set(read))
        if count == 1:
            assert len(read) == status.records
            assert all(read_log(path)[0][-1:] in (b"\n", b"") for path in files(directory))
        else:  # what is done about the failure may fail as well, and then more is on the disk than is known to be
            assert len(read) >= status.records
        first += 1
    assert first > 30


def test_a_write_that_is_cut_short_leaves_whole_records(tmp_path, file_log, monkeypatch, clock):
    log = file_log()
    log.put(b"000001\n")
    real, left = os.write, [3]

    def short(fd: int, data: bytes) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = real(fd, bytes(data)[: left[0]])
        left[0] -= written
        return written

    with monkeypatch.context() as patch:
        patch.setattr(filelog.os, "write", short)
        assert not log.put(b"000002\n")
    assert numbers(tmp_path / "log") == [1]
    clock.advance(1.0)
    assert log.put(b"000003\n")
    assert numbers(tmp_path / "log") == [1, 3]


def test_what_is_flushed_is_synced_and_so_is_its_name(tmp_path, file_log, clock, monkeypatch):
    synced, real = [], os.fsync

    def fsync(fd: int) -> None:
        synced.append((os.readlink(f"/proc/self/fd/{fd}"), os.fstat(fd).st_size))
        real(fd)

    monkeypatch.setattr(filelog.os, "fsync", fsync)
    log = file_log(deflate=True, durable=True)
    folder = tmp_path / "log/20100101/gps"
    assert {path for path, _ in synced} == {str(path) for path in (folder, *folder.parents[:2], folder / "000000.log.gz")}
    synced.clear()
    log.put(b"one\n")
    assert synced == []
    clock.advance(1.0)
    log.poll()
    assert synced == [(str(folder / "000000.log.gz"), log.status().bytes)]


def test_open_log_chooses_the_way(tmp_path, clock):
    limits = config.LogTable(directory=str(tmp_path), free_bytes_min=0)
    plain = open_log(limits, "a", ".log", "write", clock)
    deflated = open_log(limits, "b", ".log", "zwrite", clock)
    assert plain.status().file.endswith("/a/000000.log")
    assert deflated.status().file.endswith("/b/000000.log.gz")
    assert plain.status_fileno() == -1
    plain.close()
    deflated.close()
