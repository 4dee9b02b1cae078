"""The record of a session, all frames of all links, as ground stations keep it (.tlog): time in us since 1970, 8 bytes,
big-endian, then the MAVLink frame. MAVExplorer, Mission Planner, QGroundControl and `delfim console --replay` read it.
"""

import struct
import time
from pathlib import Path
from typing import Final

from delfim.base.clock import Clock

STAMP: Final = struct.Struct(">Q")
FLUSH_S: Final = 1.0
PENDING_BYTES: Final = 1 << 20  # frames beyond that, as when the disk is full, are dropped and counted


class Session:
    """The file of this session, begun with the first frame. `reason` says why nothing is written, or is empty. Without
    `frames` none is kept: the boat's own log has them, and the file's name is that of the watch's log alone."""

    def __init__(self, folder: Path, clock: Clock, frames: bool = True) -> None:
        self.dropped, self.reason = 0, ""
        utc = time.gmtime(clock.time_ns() // 1_000_000_000)
        self._stem, self._clock = folder / time.strftime("%Y%m%d-%H%M%S", utc), clock
        self.file: Path | None = None if frames else self._stem
        self._frames = frames
        self._pending = bytearray()
        self._due_s = 0.0

    def put(self, frame: bytes) -> None:
        """Takes a frame that was received or sent."""
        if not self._frames:
            return
        if len(self._pending) + len(frame) > PENDING_BYTES:
            self.dropped += 1
            return
        self._pending += STAMP.pack(self._clock.time_ns() // 1000)
        self._pending += frame

    def tick(self) -> bool:
        """Called often: writes the frames to the disk once a second. Whether it did now."""
        now_s = self._clock.monotonic_s()
        if now_s < self._due_s:
            return False
        self._due_s = now_s + FLUSH_S
        self.flush()
        return True

    def flush(self) -> None:
        if not self._pending:
            return
        try:
            file = self.file or self._create()
            with file.open("ab", buffering=0) as out:
                whole = out.tell()
                if out.write(self._pending) != len(self._pending):
                    out.truncate(whole)
                    raise OSError(f"{file}: the disk is full")
        except OSError as error:
            self.reason = str(error)
            return
        self._pending.clear()
        self.reason = ""

    def _create(self) -> Path:
        """Creates a file with a new name. Raises OSError."""
        self._stem.parent.mkdir(parents=True, exist_ok=True)
        number = 0
        while True:
            file = self._stem.with_name(f"{self._stem.name}{f'-{number}' if number else ''}.tlog")
            try:
                file.open("xb").close()
            except FileExistsError:
                number += 1
                continue
            self.file = file
            return file
