"""The depths that boats have told, kept in files: what is left of a survey is known after the console was started again, too.

Each boat has a file of its own, by its number, with the columns that `delfim log export soundings` writes: `delfim survey rest`
and `delfim survey chart` read it.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from delfim.base.clock import Clock

HEAD: Final = "utc,latitude [deg],longitude [deg],depth_m [m]\n"
FOLDER: Final = "soundings"
FLUSH_S: Final = 1.0
PENDING_MAX: Final = 10_000  # rows beyond that, as when the disk is full, are not kept
KEPT_S: Final = 7 * 86400.0  # files that nothing was added to for so long are put aside at the start ...
READ_BYTES: Final = 1 << 24  # ... and so many bytes of the others are read, the newest


class HeardSounding(NamedTuple):
    at_s: float  # since 1970
    latitude_deg: float
    longitude_deg: float
    depth_m: float


class SoundingFiles:
    """The files in a folder beside the sessions. `reason` says why nothing is written, or is empty."""

    def __init__(self, sessions: Path, clock: Clock) -> None:
        self._folder, self._clock = sessions / FOLDER, clock
        self._pending = dict[int, list[str]]()
        self._due_s, self.reason = 0.0, ""

    def put(self, boat: int, latitude_deg: float, longitude_deg: float, depth_m: float) -> None:
        """Takes a depth of a boat."""
        rows = self._pending.setdefault(boat, [])
        if len(rows) < PENDING_MAX:
            rows.append(f"{self._clock.time_ns() / 1e9:.3f},{latitude_deg:.7f},{longitude_deg:.7f},{depth_m:.3f}\n")

    def tick(self) -> None:
        """Called often: writes to the disk once a second."""
        now_s = self._clock.monotonic_s()
        if now_s >= self._due_s:
            self._due_s = now_s + FLUSH_S
            self.flush()

    def flush(self) -> None:
        try:
            for boat, rows in self._pending.items():
                if rows:
                    self._folder.mkdir(parents=True, exist_ok=True)
                    with (self._folder / f"{boat}.csv").open("a", encoding="utf-8") as out:
                        out.write("".join(rows if out.tell() else [HEAD, *rows]))
                    rows.clear()
            self.reason = ""
        except OSError as error:
            self.reason = str(error)

    def files(self) -> list[Path]:
        """What was heard so far, one file of each boat."""
        self.flush()
        return sorted(self._folder.glob("*.csv"))

    def read(self) -> Iterator[HeardSounding]:
        """What was kept of the days before, each boat's in the order of time. A file is cut off where it is not whole, as
        after a power cut. Called once, at the start."""
        try:
            files, left = sorted(self._folder.glob("*.csv"), key=lambda file: -file.stat().st_mtime), READ_BYTES
            if files and self._clock.time_ns() / 1e9 - files[0].stat().st_mtime > KEPT_S:
                self.put_aside()
                return
            for file in files:
                yield from _last(file, left)
                left = max(left - file.stat().st_size, 0)
        except OSError as error:
            self.reason = str(error)

    def put_aside(self) -> None:
        """Another survey of the same water begins: what was heard until now stays in a folder named by the time, and counts no
        longer. Raises OSError."""
        self.flush()
        if self._folder.exists():
            now = time.strftime("%Y%m%d-%H%M%S", time.gmtime(self._clock.time_ns() // 1_000_000_000))
            self._folder.rename(self._folder.with_name(f"{FOLDER}-{now}"))


def _last(file: Path, most_bytes: int) -> Iterator[HeardSounding]:
    """The rows at the end of a file. Raises OSError."""
    with file.open("rb") as its:
        at = its.seek(max(file.stat().st_size - most_bytes, 0))
        at += len(its.readline())  # the head, or what is left of a row
        for line in its:
            try:
                row = HeardSounding(*map(float, line.split(b",")))
            except (TypeError, ValueError):
                break
            if not line.endswith(b"\n"):
                break
            at += len(line)
            yield row
    os.truncate(file, at)
