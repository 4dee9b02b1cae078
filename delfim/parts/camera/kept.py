"""Pictures that are kept: files of a day's folder as other logs, DAY/camera-NAME/hhmmss.pictures, read by their times.

Each picture is a record with its time and a check sum, and is on the disk soon after: a power cut takes the last seconds and
nothing before. What was torn is left out. The index by time is made from the records' heads, so that it is never at odds with
them.
"""

import os
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from delfim.base.errors import FormatError
from delfim.logging.free_space import hold
from delfim.parts.camera import jpegblocks
from delfim.parts.camera.wire import PICTURE_MAX

SUFFIX: Final = ".pictures"
SEGMENT_BYTES: Final = 16 << 20
EVERY_MS: Final = 1000  # a picture is kept
SYNC_MS: Final = 5000  # and at the latest after so long on the disk
_HEAD: Final = struct.Struct(">4sQII")
_MARK: Final = b"DPic"


def record_of(taken_ms: int, jpeg: bytes) -> bytes:
    return _HEAD.pack(_MARK, taken_ms, len(jpeg), zlib.crc32(jpeg)) + jpeg


class PictureKeeper:
    """Writes pictures of one camera, and deletes its oldest files beyond `limit_bytes`. Blocks on the disk. Raises OSError."""

    def __init__(self, directory: Path, name: str, limit_bytes: int) -> None:
        self._directory, self._id, self._limit = directory, f"camera-{name}", limit_bytes
        self._fd = self._day = -1
        self._size = 0
        self._kept_ms = self._synced_ms = -SYNC_MS

    def put(self, taken_ms: int, jpeg: bytes) -> None:
        """Keeps it, if it is time for another one."""
        if 0 <= taken_ms - self._kept_ms < EVERY_MS:
            return
        record = record_of(taken_ms, jpeg)
        if self._fd < 0 or self._size + len(record) > SEGMENT_BYTES:
            self.close()
            self._open(taken_ms, len(record))
        os.write(self._fd, record)
        self._size += len(record)
        self._kept_ms = taken_ms
        if abs(taken_ms - self._synced_ms) >= SYNC_MS:
            os.fdatasync(self._fd)
            self._synced_ms = taken_ms

    def close(self) -> None:
        """Ends the file."""
        for fd in (self._fd, self._day):
            if fd >= 0:
                os.close(fd)
        self._fd = self._day = -1

    def _open(self, taken_ms: int, size: int) -> None:
        self._make_room(SEGMENT_BYTES)
        moment = datetime.fromtimestamp(taken_ms // 1000, UTC)
        folder = self._directory / f"{moment:%Y%m%d}" / self._id
        folder.mkdir(parents=True, exist_ok=True)
        self._day = hold(str(folder.parent))
        for number in range(1000):
            try:
                path = folder / (f"{moment:%H%M%S}" + (f"-{number}" if number else "") + SUFFIX)
                self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
                break
            except FileExistsError:
                continue
        self._size = 0

    def _make_room(self, size: int) -> None:
        files = sorted(self._directory.glob(f"*/{self._id}/*{SUFFIX}"))
        used = sum(file.stat().st_size for file in files)
        for file in files:
            if used + size <= self._limit:
                return
            used -= file.stat().st_size
            file.unlink()


def _records(path: Path) -> Iterator[tuple[int, int, int]]:
    """Time, place and size of each picture in a file, up to the first that is torn. Raises OSError."""
    with path.open("rb") as file:
        at, end = 0, os.fstat(file.fileno()).st_size
        while at + _HEAD.size <= end:
            file.seek(at)
            mark, taken_ms, size, _ = _HEAD.unpack(file.read(_HEAD.size))
            if mark != _MARK or not 0 < size <= PICTURE_MAX or at + _HEAD.size + size > end:
                return
            yield taken_ms, at, size
            at += _HEAD.size + size


class PicturesByTime:
    """The pictures of some files of one camera, found by time. Raises OSError."""

    def __init__(self, files: Sequence[Path]) -> None:
        self._found = sorted((taken_ms, file, at) for file in files for taken_ms, at, _ in _records(file))

    def __len__(self) -> int:
        return len(self._found)

    def at(self, time_ms: int) -> tuple[int, bytes] | None:
        """The last picture until this time, and when it was taken; None where there is none, or it is torn. Raises OSError."""
        place = bisect_right(self._found, time_ms, key=lambda each: each[0])
        if not place:
            return None
        taken_ms, file, at = self._found[place - 1]
        with file.open("rb") as opened:
            opened.seek(at)
            _, _, size, check = _HEAD.unpack(opened.read(_HEAD.size))
            jpeg = opened.read(size)
        try:
            jpegblocks.size_of(jpeg)
        except FormatError:
            return None
        return (taken_ms, jpeg) if zlib.crc32(jpeg) == check else None


def recorded(days: Iterable[Path]) -> dict[str, PicturesByTime]:
    """The pictures in folders of days, by camera. Raises OSError."""
    files = dict[str, list[Path]]()
    for day in days:
        for name, found in cameras_under(day).items():
            files.setdefault(name, []).extend(found)
    return {name: PicturesByTime(found) for name, found in files.items()}


def cameras_under(folder: Path) -> dict[str, list[Path]]:
    """The files of each camera in a tree of logs, by its name. Raises OSError."""
    found = dict[str, list[Path]]()
    for file in sorted(folder.rglob(f"camera-*/*{SUFFIX}")):
        found.setdefault(file.parent.name.removeprefix("camera-"), []).append(file)
    return found
