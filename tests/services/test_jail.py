"""No path leads out: named, linked, or put there while one looks."""

import ctypes
import mmap
import os
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import DelfimError
from delfim.services.files.jail import Jail


@pytest.fixture
def jail(tmp_path):
    (tmp_path / "root/folder").mkdir(parents=True)
    (tmp_path / "root/folder/file").write_text("inside")
    (tmp_path / "root/.keys").mkdir()
    (tmp_path / "root/.keys/key").write_text("private")
    (tmp_path / "rooted").write_text("a sibling whose name begins alike")
    (tmp_path / "secret").write_text("outside")
    (tmp_path / "root/inward").symlink_to(tmp_path / "root/folder")
    (tmp_path / "root/outward").symlink_to(tmp_path)
    (tmp_path / "root/sibling").symlink_to(tmp_path / "rooted")
    return Jail(tmp_path / "root")


@pytest.mark.parametrize("path", ["folder/file", "/folder/file", "//folder//file", "folder/../folder/./file", "inward/file"])
def test_what_is_inside_is_found(jail, path):
    fd = jail.open(path)
    assert os.read(fd, 100) == b"inside"
    os.close(fd)
    assert jail.shown(jail.real(path)) == "/folder/file"


@pytest.mark.parametrize(
    "path",
    [
        "../secret",
        "/../secret",
        "folder/../../secret",
        "outward/secret",
        "sibling",
        "../rooted",
        "outward",
        "x\0y",
        ".keys/key",
        "folder/../.keys/key",
    ],
)
def test_what_is_outside_is_not(jail, path):
    with pytest.raises(DelfimError):
        jail.open(path)


@given(st.text(alphabet="./ab\0", max_size=30))
def test_whatever_the_path_the_real_one_is_inside(path):
    jail = Jail("/usr/lib")
    try:
        real = jail.real(path)
    except DelfimError:
        return
    assert real == "/usr/lib" or real.startswith("/usr/lib/")


@pytest.mark.parametrize("path", ["folder", "pipe"])
def test_only_plain_files_are_opened(jail, tmp_path, path):
    os.mkfifo(tmp_path / "root/pipe")
    with pytest.raises(DelfimError, match="not a plain file"):
        jail.open(path)


def listed(jail):
    with jail.folder("folder") as folder:
        return os.listdir(folder)


@pytest.mark.parametrize(
    "look",
    [lambda jail: jail.open("folder/file"), lambda jail: jail.status("folder/file"), listed],
    ids=["file", "status", "list"],
)
def test_a_link_put_there_after_the_look_is_noticed(jail, tmp_path, monkeypatch, look):
    """The folder becomes a link to the outside between the look and the opening."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/file").write_text("outside")
    real = jail.real

    def slow(path):
        found = real(path)
        (tmp_path / "root/folder").rename(tmp_path / "root/away")
        (tmp_path / "root/folder").symlink_to(tmp_path / "elsewhere")
        return found

    monkeypatch.setattr(jail, "real", slow)
    with pytest.raises(DelfimError, match="outside"):
        look(jail)


def test_a_link_in_the_place_of_a_file_is_not_followed(jail, tmp_path, monkeypatch):
    real = jail.real

    def slow(path):
        found = real(path)
        (tmp_path / "root/folder/file").unlink()
        (tmp_path / "root/folder/file").symlink_to(tmp_path / "secret")
        return found

    monkeypatch.setattr(jail, "real", slow)
    assert jail.status("folder/file").st_size != (tmp_path / "secret").stat().st_size


def test_a_chain_of_links_is_refused_in_words_or_walked_to_its_end(jail, tmp_path):
    """Python before 3.13 follows links by recursion and gives up; later ones do not mind how many there are."""
    for number in range(1500):
        (tmp_path / f"root/{number}").symlink_to(str(number + 1))
    try:
        end = jail.real("0")
    except DelfimError as error:
        end = str(error)
    assert end == ("a chain of links" if sys.version_info < (3, 13) else str(tmp_path / "root/1500"))


def test_a_file_is_not_read_ahead(jail, tmp_path):
    """A kernel that reads megabytes ahead within one call may give the processor to nobody meanwhile."""
    (tmp_path / "root/large").write_bytes(bytes(4 << 20))
    fd = jail.open("large", os.O_RDWR)
    os.fsync(fd)  # only what is on the disk can be forgotten
    os.posix_fadvise(fd, 0, 0, os.POSIX_FADV_DONTNEED)
    before = resident_pages(fd, 4 << 20)
    os.pread(fd, mmap.PAGESIZE, 1 << 20)
    after = resident_pages(fd, 4 << 20)
    os.close(fd)
    assert after - before <= 1


def resident_pages(fd, size):
    """How much of a file is in memory (mincore(2))."""
    with mmap.mmap(fd, size) as place:
        pages = (ctypes.c_ubyte * (size // mmap.PAGESIZE))()
        at = ctypes.c_ubyte.from_buffer(place)
        assert ctypes.CDLL(None).mincore(ctypes.byref(at), ctypes.c_size_t(size), pages) == 0
        del at
    return sum(page & 1 for page in pages)


def test_the_root_is_shown_as_such(jail):
    assert jail.shown(jail.root) == "/"
    assert jail.real("/") == jail.root
