"""Keeps the alerts over a restart of the console: one small file beside the sessions, replaced whole.

A thread writes it, so that a slow disk holds nobody; of what comes meanwhile the newest is written next.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from delfim.base.errors import DelfimError, FormatError, in_words
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file
from delfim.console.watch.alerts import AlertList, KeptAlerts

NAME: Final = "alerts.json"
BYTES_MAX: Final = 1 << 23  # some thousand alerts of the greatest fleet


class AlertsFile:
    """`reason` says why nothing is kept, or was not read, or is empty."""

    def __init__(self, sessions: Path) -> None:
        self.reason = ""
        self._file, self._writer = sessions / NAME, ThreadPoolExecutor(1, "alerts")
        self._under_way: Future[None] | None = None
        self._next: AlertList | None = None

    def restore(self, alerts: AlertList) -> None:
        """Called once, at the start. A file that cannot be read is put aside, and `reason` says so."""
        try:
            if self._file.exists():
                alerts.restore(read_alerts(self._file))
        except (DelfimError, OSError) as error:
            self.reason = f"the alerts of the session before are lost: {in_words(error)}"
            with suppress(OSError):
                self._file.replace(self._file.with_suffix(".damaged"))

    def put(self, alerts: AlertList) -> None:
        """They have changed."""
        self._next = alerts

    def tick(self) -> None:
        """Often: the next one is written when the one before is."""
        if self._under_way is not None:
            if not self._under_way.done():
                return
            self.reason = in_words(error) if (error := self._under_way.exception()) is not None else ""
            self._under_way = None
        if self._next is not None:
            self._under_way = self._writer.submit(self._write, msgspec.json.encode(self._next.kept()))
            self._next = None

    def close(self) -> None:
        """Waits for the disk."""
        self._writer.shutdown(wait=True)
        if self._next is not None:
            with suppress(OSError):
                self._write(msgspec.json.encode(self._next.kept()))

    def _write(self, content: bytes) -> None:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self._file, content)


def read_alerts(file: Path) -> KeptAlerts:
    """Raises OSError, FormatError."""
    try:
        return msgspec.json.decode(read_file(file, BYTES_MAX), type=KeptAlerts)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(f"{file}: {error}") from None
