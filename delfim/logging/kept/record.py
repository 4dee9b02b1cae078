"""A record that survives crashes, a full disk and power cuts: the newest one, kept whole by a child (`writer.py`). Its
writer never waits: what the pipe has no room for is written with the next record."""

import asyncio
import contextlib
import json
import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

with contextlib.suppress(ImportError):  # Windows has none, and no boat
    import fcntl

from delfim.base.errors import FormatError
from delfim.logging.kept.writer import LENGTH, RECORD_MAX, SLOTS, slot, unpacked

PROGRAM: Final = (sys.executable, "-m", "delfim.logging.kept.writer")
PIPE_BYTES: Final = 1 << 20
CLOSE_S: Final = 0.3  # the logs need the rest of the time that a program has for its end
LOOK_S: Final = 0.01

log = logging.getLogger(__name__)


def newest(directories: Sequence[str], name: str, key: bytes) -> tuple[int, bytes | None]:
    """The newest whole record of these directories, with its sequence number; (0, None) where none was kept. Raises FormatError
    where there are slots and none is whole."""
    found, wrong = list[tuple[int, bytes]](), ""
    for path in (Path(slot(directory, name, number)) for directory in dict.fromkeys(directories) for number in range(SLOTS)):
        try:
            with path.open("rb") as file:
                found.append(unpacked(file.read(RECORD_MAX), key))
        except FileNotFoundError:
            continue
        except (OSError, FormatError) as error:
            wrong = f"{path}: {error}"
    if not found and wrong:
        raise FormatError(wrong)
    return max(found, default=(0, None))


class Keeper:
    """Keeps the newest record in slots of each directory."""

    def __init__(self, directories: Sequence[str], name: str, key: bytes, sequence: int) -> None:
        self._told = {"directories": list(dict.fromkeys(directories)), "name": name, "key": key.hex()}
        self._sequence, self._rest, self._heard = sequence, b"", b""
        self._child: subprocess.Popen[bytes] | None = None
        self.troubles = dict[str, str]()  # by directory: why it is not written, in words

    def put(self, record: bytes) -> bool:
        """Keep this record; False: it is not kept, call again with the next one."""
        if self._child is None:
            self._start()
        if self._child is None or not self._send_rest():
            return False
        self._sequence += 1
        self._rest = LENGTH.pack(len(record)) + record
        self._send_rest()
        return True

    def poll(self) -> None:
        """Read the child's reports, and start it again after it died; call it about once a second."""
        child = self._child
        if child is None:
            return
        self._send_rest()
        self._listen(child)
        if child.poll() is not None:
            log.error("voyage: its writer ended (%s) and is started again", child.returncode)
            self._bury(child)

    async def close(self, timeout_s: float = CLOSE_S) -> None:
        """Give the child the rest, which it writes before it ends; wait for that at most so long, while the loop turns."""
        child = self._child
        if child is None or child.stdin is None:
            return
        for _ in range(round(timeout_s / LOOK_S) + 1):
            if not child.stdin.closed and self._send_rest():
                child.stdin.close()
            if child.poll() is not None:
                break
            await asyncio.sleep(LOOK_S)
        self._bury(child)  # one that still writes goes on, in a session of its own

    def _start(self) -> None:
        try:  # in a session of its own: a signal to the parent's group leaves it alone, and it finishes the pipe
            child = subprocess.Popen(PROGRAM, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True)
        except OSError as error:
            self.troubles = {"": f"its writer cannot be started: {error.strerror}"}
            return
        assert child.stdin is not None
        assert child.stdout is not None
        for pipe in (child.stdin, child.stdout):
            os.set_blocking(pipe.fileno(), False)
        with contextlib.suppress(OSError):
            fcntl.fcntl(child.stdin.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        told = json.dumps(self._told | {"sequence": self._sequence}).encode()
        self._child, self._rest, self.troubles = child, LENGTH.pack(len(told)) + told, {}

    def _send_rest(self) -> bool:
        """Send the rest; return whether all of it is in the pipe."""
        child = self._child
        if child is None or child.stdin is None:
            return False
        try:
            while self._rest:
                self._rest = self._rest[os.write(child.stdin.fileno(), self._rest) :]
        except OSError:  # full, or the child is dead
            return False
        return True

    def _listen(self, child: "subprocess.Popen[bytes]") -> None:
        assert child.stdout is not None
        with contextlib.suppress(OSError):
            self._heard += os.read(child.stdout.fileno(), 1 << 12)
        *lines, self._heard = self._heard.split(b"\n")
        for line in lines:
            told = json.loads(line)
            self.troubles[told["directory"]] = told["reason"]
            if told["reason"]:
                log.error("voyage: not kept in %s: %s", told["directory"], told["reason"])

    def _bury(self, child: "subprocess.Popen[bytes]") -> None:
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()
        self._child, self._rest = None, b""
