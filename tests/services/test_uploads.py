"""The folder of uploads: its share of the disk, its names, and the logs beside it."""

import contextlib
import os
import threading
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.logging import free_space
from delfim.services.files.uploads import NoRoom, Uploads

BLOCK = 4096
DISK_BYTES, DISK_INODES = 6_000_000, 100
FREE_MIN = 1_000_000


class Status(NamedTuple):
    f_frsize: int
    f_blocks: int
    f_bfree: int
    f_bavail: int
    f_files: int
    f_favail: int


@pytest.fixture
def disk(tmp_path, monkeypatch) -> Path:
    """A disk of 6 MB and 100 inodes."""

    def statvfs(place: str) -> Status:
        os.stat(place)
        found = list((tmp_path / "log").rglob("*"))
        taken = sum(path.lstat().st_blocks * 512 for path in found) // BLOCK
        blocks = DISK_BYTES // BLOCK
        return Status(BLOCK, blocks, blocks - taken, blocks - taken, DISK_INODES, DISK_INODES - len(found))

    (tmp_path / "log").mkdir()
    monkeypatch.setattr(os, "statvfs", statvfs)
    return tmp_path / "log"


def opened(disk: Path, **limits: int) -> Uploads:
    """Its folder is there."""
    settings = {"free_bytes_min": FREE_MIN, "upload_bytes_max": 1 << 30} | limits
    folder = Uploads(str(disk), config.LogTable(directory=str(disk), **settings))
    folder.prepare()
    return folder


def put(uploads: Uploads, path: str, size: int) -> None:
    fd = uploads.open(path, os.O_RDWR | os.O_CREAT)
    try:
        for at in range(0, size, 60_000):
            uploads.write(fd, bytes(min(60_000, size - at)), at)
    finally:
        os.close(fd)


def filled(uploads: Uploads, size: int) -> int:
    """Put files of a size until there is no room. Returns how many there was room for."""
    for number in range(10_000):
        try:
            put(uploads, f"/upload/{number}", size)
        except NoRoom:
            return number
    raise AssertionError("there is no end")


def folders(uploads: Uploads, count: int) -> None:
    for number in range(count):
        uploads.make_folder(f"/upload/{number}")


def written(uploads: Uploads, files: list[int], size: int) -> None:
    """All files grow side by side."""
    for at in range(0, size, 1 << 16):
        for fd in files:
            uploads.write(fd, bytes(1 << 16), at)


@pytest.mark.parametrize("size", [1, 60_000, 1_000_000, 5_000_000])
def test_uploads_of_any_size_end_at_their_share_of_the_disk(disk, size):
    filled(opened(disk, upload_names_max=10_000), size)
    taken, _ = free_space.used(str(disk / "upload"))
    assert taken <= DISK_BYTES * free_space.UPLOAD_SHARE
    assert free_space.free_bytes(str(disk)) >= FREE_MIN


def test_uploads_end_at_the_quota_of_the_file_and_at_the_reserve_of_the_logs(disk):
    uploads = opened(disk, upload_bytes_max=300_000)
    assert filled(uploads, 60_000) == 4
    (disk / "20260101").mkdir()
    (disk / "20260101/x.log").write_bytes(bytes(4_800_000))
    (disk / "upload/0").unlink()
    with pytest.raises(NoRoom, match="disk is full"):
        put(uploads, "/upload/0", 60_000)


def test_names_are_counted(disk):
    uploads = opened(disk, upload_names_max=20)
    folders(uploads, 19)
    put(uploads, "/upload/0/last", 1)
    for do in (lambda: uploads.make_folder("/upload/1/2"), lambda: put(uploads, "/upload/x", 1)):
        with pytest.raises(NoRoom, match="there are 20 uploads"):
            do()
    put(uploads, "/upload/0/last", 1000)
    uploads.remove_folder("/upload/3")
    uploads.make_folder("/upload/3")


def test_a_quarter_of_the_inodes_stays_with_the_logs(disk):
    uploads = opened(disk)
    with pytest.raises(NoRoom, match="no room for more files"):
        folders(uploads, DISK_INODES)
    assert DISK_INODES / 4 - 2 <= os.statvfs(disk).f_favail <= DISK_INODES / 4


def test_many_files_that_are_written_at_once_have_one_room(disk):
    uploads = opened(disk)
    files = [uploads.open(f"/upload/{number}", os.O_RDWR | os.O_CREAT) for number in range(20)]
    with pytest.raises(NoRoom):
        written(uploads, files, 1 << 20)
    for fd in files:
        os.close(fd)
    assert free_space.used(str(disk / "upload"))[0] <= DISK_BYTES * free_space.UPLOAD_SHARE


def test_a_copy_needs_room_too(disk):
    uploads = opened(disk)
    put(uploads, "/upload/x", 1_000_000)
    fd = uploads.open("/upload/copy", os.O_RDWR | os.O_CREAT)
    with pytest.raises(NoRoom):
        uploads.copy("/upload/x", fd)
    os.close(fd)


@pytest.mark.parametrize(
    "path", ["/20260101/x.log", "/upload", "/", "/upload/../x", "/uploads/x", "/upload/../../x", "upload/x"]
)
def test_nothing_is_changed_elsewhere(disk, path):
    uploads = opened(disk)
    (disk / "20260101").mkdir()
    (disk / "20260101/x.log").write_text("x")
    put(uploads, "/upload/mine", 1)
    for do in (
        lambda: uploads.open(path, os.O_RDWR | os.O_CREAT),
        lambda: uploads.make_folder(path),
        lambda: uploads.remove(path),
        lambda: uploads.remove_folder(path),
        lambda: uploads.rename(path, "/upload/x"),
        lambda: uploads.rename("/upload/mine", path),
        lambda: uploads.apply(path, os.close),
    ):
        with pytest.raises(DelfimError, match="you can only write in /upload"):
            do()
    assert sorted(str(found.relative_to(disk)) for found in disk.rglob("*")) == [
        "20260101", "20260101/x.log", "upload", "upload/mine",
    ]  # fmt: skip


def test_a_link_put_there_between_look_and_deed_leads_nowhere(disk, tmp_path, monkeypatch):
    """Whoever has a shell can put links into the folder, and the daemon may have more rights."""
    uploads = opened(disk)
    outside = tmp_path / "etc"
    outside.mkdir()
    (outside / "passwd").write_text("x")
    (outside / "empty").mkdir()
    real = uploads._jail.real

    def slow(path):
        (disk / "upload/folder").mkdir()
        found = real(path)
        (disk / "upload/folder").rmdir()
        (disk / "upload/folder").symlink_to(outside)
        return found

    for do in (
        lambda: uploads.open("/upload/folder/new", os.O_RDWR | os.O_CREAT),
        lambda: uploads.open("/upload/folder/passwd", os.O_RDWR),
        lambda: uploads.make_folder("/upload/folder/new"),
        lambda: uploads.remove("/upload/folder/passwd"),
        lambda: uploads.remove_folder("/upload/folder/empty"),
        lambda: uploads.rename("/upload/folder/passwd", "/upload/mine"),
        lambda: uploads.apply("/upload/folder/passwd", os.close),
    ):
        monkeypatch.setattr(uploads._jail, "real", slow)
        with pytest.raises((DelfimError, FileExistsError)):
            do()
        (disk / "upload/folder").unlink()
        monkeypatch.setattr(uploads._jail, "real", real)
    assert (outside / "passwd").read_text() == "x"
    assert sorted(path.name for path in outside.iterdir()) == ["empty", "passwd"]


def test_a_folder_that_cannot_be_made_is_said_and_costs_nothing_else(tmp_path, caplog):
    (tmp_path / "upload").write_text("a file")
    Uploads(str(tmp_path), config.LogTable()).prepare()
    assert f"no uploads: {tmp_path}/upload: File exists" in caplog.text


def test_folders_that_become_links_meanwhile_lead_nowhere(disk, tmp_path):
    """A folder and a link to the outside change places all the time while everything is tried that makes, reads or removes."""
    uploads = opened(disk, upload_names_max=10_000)
    outside, folder, spare = tmp_path / "outside", disk / "upload/folder", disk / "upload/spare"
    outside.mkdir()
    (outside / "secret").write_text("secret")
    (outside / "empty").mkdir()
    spare.mkdir()
    folder.symlink_to(outside)
    over, inside = threading.Event(), 0

    def flip() -> None:
        away = disk / "upload/away"
        while not over.is_set():
            for source, target in ((folder, away), (spare, folder), (away, spare)):
                source.rename(target)

    def read(name: str) -> None:
        fd = uploads.open(f"/upload/folder/{name}", os.O_RDWR)
        try:
            assert os.read(fd, 10) != b"secret"
        finally:
            os.close(fd)

    tries = (
        lambda: os.close(uploads.open("/upload/folder/new", os.O_RDWR | os.O_CREAT)),
        lambda: read("new"),
        lambda: read("secret"),
        lambda: uploads.remove("/upload/folder/new"),
        lambda: uploads.remove("/upload/folder/secret"),
        lambda: uploads.make_folder("/upload/folder/sub"),
        lambda: uploads.remove_folder("/upload/folder/sub"),
        lambda: uploads.remove_folder("/upload/folder/empty"),
        lambda: uploads.rename("/upload/folder/secret", "/upload/stolen"),
        lambda: uploads.apply("/upload/folder/secret", lambda fd: os.fchmod(fd, 0o777)),
    )
    thread = threading.Thread(target=flip)
    thread.start()
    try:
        for number in range(200_000):
            if number >= 2000 and inside >= 20:
                break
            with contextlib.suppress(DelfimError, OSError):
                tries[number % len(tries)]()
                inside += 1
    finally:
        over.set()
        thread.join()
    assert inside >= 20, "some met the folder"
    assert (outside / "secret").read_text() == "secret"
    assert (outside / "secret").stat().st_mode & 0o777 != 0o777
    assert sorted(path.name for path in outside.iterdir()) == ["empty", "secret"]
    assert not (disk / "upload/stolen").exists()
