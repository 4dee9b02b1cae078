"""The niced child that keeps a record whole on disk: `python -m delfim.logging.kept.writer`, pipe on standard input.

The newest record lies in two slots of each directory, written in turn, in place, and synced: whatever instant the power fails
in, one of them is whole. A slot is `delfim kept SEQUENCE LENGTH DIGEST`, a line feed, and the record; the digest is an
HMAC-SHA256 with the boat's key, so who only can write to the disk cannot make one.

In the pipe, byte order of the machine: length u32, then so many bytes. The first message is JSON: directories, name, key, the
sequence to go on from. Each other one is a record; of several that wait only the newest is written. Each directory has a
thread of its own: a disk that hangs does not keep the record from the other one. A line of JSON on standard output tells of
each directory why it is not written, when that changes. It ends when the pipe does.
"""

import contextlib
import hmac
import json
import os
import signal
import struct
import sys
import threading
from typing import Final

from delfim.base.errors import FormatError

LENGTH: Final = struct.Struct("=I")
MAGIC: Final = b"delfim kept"
SLOTS: Final = 2
VOYAGE: Final = "voyage"  # the name of the record of a voyage
RECORD_MAX: Final = 1 << 23
NICE: Final = 5


def slot(directory: str, name: str, sequence: int) -> str:
    """The file that this record of a directory is written to."""
    return os.path.join(directory, f"{name}-{sequence % SLOTS}")


def packed(sequence: int, record: bytes, key: bytes) -> bytes:
    """Pack the content of a slot."""
    head = b"%s %d %d " % (MAGIC, sequence, len(record))
    return head + hmac.digest(key, head + record, "sha256").hex().encode() + b"\n" + record


def unpacked(content: bytes, key: bytes) -> tuple[int, bytes]:
    """Unpack sequence and record. Raises FormatError for a slot that is torn, or that was not written with this key."""
    head, _, rest = content.partition(b"\n")
    words = head.split(b" ")
    if len(words) != 5 or b" ".join(words[:2]) != MAGIC or not (words[2].isdigit() and words[3].isdigit()):
        raise FormatError("no kept record")
    record = rest[: int(words[3])]
    digest = hmac.digest(key, head[: len(head) - len(words[4])] + record, "sha256").hex().encode()
    if len(record) != int(words[3]) or not hmac.compare_digest(digest, words[4]):
        raise FormatError("torn, or not written by this boat")
    return int(words[2]), record


def store(directory: str, name: str, sequence: int, content: bytes) -> None:
    """Write one slot, and wait for the disk. Raises OSError."""
    path = slot(directory, name, sequence)
    is_new = not os.path.exists(path)
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        left = memoryview(content)
        at = 0
        while at < len(content):
            at += os.pwrite(fd, left[at:], at)
        os.ftruncate(fd, len(content))
        os.fsync(fd)
    finally:
        os.close(fd)
    if is_new:
        folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class NewestRecord:
    """The newest record, for the threads that write it."""

    def __init__(self, sequence: int) -> None:
        self.first = self.sequence = sequence
        self.record = b""
        self.ended = False
        self.changed = threading.Condition()

    def put(self, record: bytes) -> None:
        with self.changed:
            self.sequence, self.record = self.sequence + 1, record
            self.changed.notify_all()

    def end(self) -> None:
        with self.changed:
            self.ended = True
            self.changed.notify_all()


def keep(newest: NewestRecord, directory: str, name: str, key: bytes) -> None:
    """Keep the newest record in one directory: the body of its thread."""
    done, told = newest.first, ""
    while True:
        with newest.changed:
            while newest.sequence == done and not newest.ended:
                newest.changed.wait()
            if newest.sequence == done:
                return
            done, record = newest.sequence, newest.record
        try:
            store(directory, name, done, packed(done, record, key))
            why = ""
        except OSError as error:
            why = error.strerror or str(error)
        if why != told:
            told = why
            _say(directory, why)


def _say(directory: str, why: str) -> None:
    with contextlib.suppress(OSError):  # nobody listens any more: the last record is written all the same
        os.write(sys.stdout.fileno(), json.dumps({"directory": directory, "reason": why}).encode() + b"\n")


def _messages(fd: int) -> list[bytes]:
    """The next complete messages; empty at the end of the pipe."""
    found, buffer = list[bytes](), _rest
    while not found:
        data = os.read(fd, 1 << 16)
        if not data:
            return []
        buffer += data
        while len(buffer) >= LENGTH.size and len(buffer) - LENGTH.size >= (size := LENGTH.unpack_from(buffer)[0]):
            found.append(bytes(buffer[LENGTH.size : LENGTH.size + size]))
            del buffer[: LENGTH.size + size]
    return found


_rest = bytearray()


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.nice(NICE)
    pipe = sys.stdin.fileno()
    first, *waiting = _messages(pipe) or [b""]
    if not first:
        return
    told = json.loads(first)
    newest = NewestRecord(told["sequence"])
    words = told["name"], bytes.fromhex(told["key"])
    writers = [threading.Thread(target=keep, args=(newest, each, *words)) for each in told["directories"]]
    for writer in writers:
        writer.start()
    while True:
        if waiting:
            newest.put(waiting[-1])
        if not (waiting := _messages(pipe)):
            break
    newest.end()


if __name__ == "__main__":
    main()
