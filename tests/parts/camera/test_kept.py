"""Pictures that are kept, after power cuts, beyond their room, and by their times."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.parts.camera import kept
from delfim.parts.camera.jpegblocks import jpeg_of
from delfim.parts.camera.kept import PictureKeeper, PicturesByTime, cameras_under

DAY_MS = 1_790_000_000_000


def picture(number: int) -> bytes:
    return jpeg_of(16, 16, [number % 256, 0, 0, 0])


def keep(folder: Path, count: int, limit: int = 1 << 30) -> list[Path]:
    keeper = PictureKeeper(folder, "bow", limit)
    for number in range(count):
        keeper.put(DAY_MS + 1000 * number, picture(number))
    keeper.close()
    return cameras_under(folder).get("bow", [])


def test_the_picture_of_a_time_is_found(tmp_path: Path) -> None:
    by_time = PicturesByTime(keep(tmp_path, 50))
    assert len(by_time) == 50
    assert by_time.at(DAY_MS - 1) is None
    assert by_time.at(DAY_MS + 7999) == (DAY_MS + 7000, picture(7))
    assert by_time.at(DAY_MS + 99_000) == (DAY_MS + 49_000, picture(49))


def test_pictures_are_found_beside_a_state_log(tmp_path: Path) -> None:
    (file,) = keep(tmp_path, 3)
    assert len(kept.recorded([file.parent.parent])["bow"]) == 3
    assert kept.recorded([]) == {}


def test_one_a_second_is_kept(tmp_path: Path) -> None:
    keeper = PictureKeeper(tmp_path, "bow", 1 << 30)
    for number in range(100):
        keeper.put(DAY_MS + 100 * number, picture(number))
    keeper.close()
    assert len(PicturesByTime(cameras_under(tmp_path)["bow"])) == 10


@given(st.integers(0, 2500), st.sampled_from([b"", b"\0" * 500]))
def test_a_power_cut_takes_what_was_torn_and_nothing_before(cut: int, tail: bytes) -> None:
    with TemporaryDirectory() as folder:
        _torn(keep(Path(folder), 6)[0], cut, tail)


def _torn(file: Path, cut: int, tail: bytes) -> None:
    whole = file.read_bytes()
    places = [at for _, at, _ in kept._records(file)] + [len(whole)]
    file.write_bytes(whole[:cut] + tail)
    left = PicturesByTime([file])
    for number, end in enumerate(places[1:]):
        found = left.at(DAY_MS + 1000 * number)
        assert end > cut or found == (DAY_MS + 1000 * number, picture(number))


def test_after_a_power_cut_a_new_file_is_begun(tmp_path: Path) -> None:
    (file,) = keep(tmp_path, 3)
    file.write_bytes(file.read_bytes()[:-5])
    files = keep(tmp_path, 3)
    assert len(files) == 2
    assert len(PicturesByTime(files)) == 5


def test_the_oldest_give_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "SEGMENT_BYTES", 2000)
    files = keep(tmp_path, 200, limit=10_000)
    assert sum(file.stat().st_size for file in files) <= 10_000
    by_time = PicturesByTime(files)
    assert by_time.at(DAY_MS + 199_000) == (DAY_MS + 199_000, picture(199))
    assert by_time.at(DAY_MS) is None


def test_a_disk_that_takes_no_more_is_told(tmp_path: Path) -> None:
    place = tmp_path / "log"
    place.write_text("a file, where a folder should be")
    keeper = PictureKeeper(place, "bow", 1 << 20)
    with pytest.raises(OSError, match="Not a directory"):
        keeper.put(DAY_MS, picture(1))
