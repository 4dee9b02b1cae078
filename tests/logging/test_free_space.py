"""The free-space guard: which days go, which stay, and what a log says when none may go."""

import fcntl
import os
from pathlib import Path

import pytest

from delfim.logging import free_space
from tests.logging.conftest import files

DAYS = ("20100101", "20100102", "20100103", "20100104")
DISK_BYTES = 5000


@pytest.fixture
def disk(tmp_path, monkeypatch) -> Path:
    """A disk of 5000 bytes with four days of 1000 bytes each, and what is no day."""
    directory = tmp_path / "log"
    for day in DAYS:
        (directory / day / "gps").mkdir(parents=True)
        (directory / day / "gps" / "120000.log").write_bytes(bytes(1000))
    (directory / "20091231").write_bytes(b"")
    (directory / "lost+found").mkdir()

    def free_bytes(place: str) -> int:
        assert place == str(directory)
        return DISK_BYTES - sum(path.stat().st_size for path in directory.rglob("*") if path.is_file())

    monkeypatch.setattr(free_space, "free_bytes", free_bytes)
    return directory


def days(directory: Path) -> tuple[str, ...]:
    return tuple(sorted(path.name for path in directory.iterdir() if path.name.isdecimal() and path.is_dir()))


def test_free_bytes_are_those_of_the_disk(tmp_path):
    disk = os.statvfs(tmp_path)
    assert free_space.free_bytes(str(tmp_path)) == pytest.approx(disk.f_bavail * disk.f_bsize, rel=0.05)


@pytest.mark.parametrize(("free_bytes_min", "gone"), [(1000, 0), (1001, 1), (2000, 1), (2001, 2), (5000, 4), (9000, 4)])
def test_as_many_of_the_oldest_days_go_as_must(disk, free_bytes_min, gone):
    free_space.make_room(str(disk), free_bytes_min, ())
    assert days(disk) == DAYS[gone:]
    assert (disk / "lost+found").exists()
    assert (disk / "20091231").exists()


def test_spared_days_stay(disk):
    free_space.make_room(str(disk), 9000, {"20100101", "20100104"})
    assert days(disk) == ("20100101", "20100104")


@pytest.mark.parametrize("where", ["KEEP", "gps/KEEP"])
def test_a_day_to_keep_stays(disk, where):
    (disk / "20100101" / where).write_bytes(b"")
    free_space.make_room(str(disk), 2000, ())
    assert days(disk) == ("20100101", "20100103", "20100104")


def test_a_day_in_which_a_log_is_written_stays(disk):
    writer = os.open(disk / "20100102", os.O_RDONLY)
    fcntl.flock(writer, fcntl.LOCK_SH)
    free_space.make_room(str(disk), 9000, ())
    assert days(disk) == ("20100102",)
    os.close(writer)
    free_space.make_room(str(disk), 9000, ())
    assert days(disk) == ()


def test_a_log_holds_its_day_while_it_writes(disk, file_log, clock):
    clock.step(86_400.0)
    log = file_log()
    free_space.make_room(str(disk), 9000, ())
    assert days(disk) == ("20100102",)
    log.close()
    free_space.make_room(str(disk), 9000, ())
    assert days(disk) == ()


def test_a_log_makes_room_before_it_starts_and_while_it_writes(disk, file_log, clock):
    clock.step(3 * 86_400.0)
    log = file_log(free_bytes_min=1500)
    assert days(disk) == DAYS[1:]
    log.put(bytes(600))
    clock.advance(1.0)
    log.poll()
    assert days(disk) == DAYS[2:]
    assert log.status().writable


def test_a_log_stops_when_no_day_may_go_and_goes_on_when_there_is_room(disk, file_log, clock):
    clock.step(3 * 86_400.0)
    log = file_log(free_bytes_min=3500, deflate=True)
    log.put(os.urandom(600))
    clock.advance(1.0)
    log.poll()
    assert days(disk) == ("20100104",)
    assert log.status().reason == f"{disk}: less than 3500 bytes are free, and no day of logs may be deleted"
    assert log.status().records == 1
    assert not log.put(b"lost")
    (disk / "20100104/gps/120000.log").unlink()
    clock.advance(1.0)
    assert log.put(b"kept")
    log.close()
    assert [path.name for path in files(disk)] == ["000000.log.gz", "000002.log.gz"]


def test_the_running_day_stays_even_when_its_log_had_to_stop(disk, file_log, clock):
    clock.step(3 * 86_400.0)
    log = file_log(free_bytes_min=DISK_BYTES)
    for _ in range(3):
        clock.advance(1.0)
        log.poll()
    assert days(disk) == ("20100104",)


def test_stop_deletes_nothing_and_says_so(disk, file_log, clock):
    log = file_log(free_bytes_min=1500, when_full="stop")
    assert not log.put(b"lost")
    assert log.status().reason == f"{disk}: less than 1500 bytes are free"
    assert days(disk) == DAYS


@pytest.mark.parametrize("free_bytes_min", [1000, 2000, 3000])
@pytest.mark.parametrize("uploaded", [0, 100, 400])
def test_uploads_cost_no_day(disk, file_log, clock, monkeypatch, free_bytes_min, uploaded):
    """Which days go depends on the logs alone: what uploads have taken, and what they may still take, is one sum."""
    clock.step(3 * 86_400.0)
    monkeypatch.setattr(free_space, "upload_room", lambda folder, bytes_max: bytes_max - uploaded)
    (disk / "upload").mkdir()
    (disk / "upload/image").write_bytes(bytes(uploaded))
    log = file_log(free_bytes_min=free_bytes_min, upload_folder="upload", upload_bytes_max=400)
    assert days(disk) == DAYS[-(-(free_bytes_min + 400 - 1000) // 1000) :]
    assert log.status().writable
    log.close()


def test_a_log_goes_on_in_the_room_of_uploads_rather_than_stop(disk, file_log, clock, monkeypatch):
    clock.step(3 * 86_400.0)
    monkeypatch.setattr(free_space, "upload_room", lambda folder, bytes_max: bytes_max)
    log = file_log(free_bytes_min=3000, upload_folder="upload", upload_bytes_max=9000)
    assert days(disk) == DAYS[3:]
    assert log.status().writable
    log = file_log(free_bytes_min=3000, upload_folder="upload", upload_bytes_max=9000, when_full="stop")
    assert log.status().writable


def test_what_uploads_may_still_take(tmp_path):
    folder = tmp_path / "upload"
    assert free_space.upload_room(str(folder), 1 << 20) == 0
    folder.mkdir()
    assert free_space.upload_room(str(folder), 1 << 20) == 1 << 20
    (folder / "sub").mkdir()
    (folder / "sub/x").write_bytes(bytes(100_000))
    (folder / "link").symlink_to("/")
    taken, names = free_space.used(str(folder))
    assert names == 3
    assert 100_000 <= taken < 120_000
    assert free_space.upload_room(str(folder), 1 << 20) == (1 << 20) - taken
    disk = os.statvfs(folder)
    assert free_space.upload_room(str(folder), 1 << 60) <= disk.f_blocks * disk.f_frsize / 4
