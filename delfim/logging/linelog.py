"""The black box of a serial line: a line of JSON for each read, with its data and time, as in delfim.logging.nodelog.

Nobody can read a serial line beside the program that uses it, so that program hands over the data it reads.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from delfim.base.clock import Clock
from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json
from delfim.config import LogTable as Limits
from delfim.logging.ashore.tree import LogFile
from delfim.logging.blackbox import device
from delfim.logging.liblog import event_line
from delfim.logging.nodelog import line
from delfim.logging.openlog import open_log
from delfim.logging.reading import read_lines

SUFFIX: Final = ".jsonl"
WAITING: Final = 1024  # pieces between two calls of `write`


class Piece(NamedTuple):
    """The data of one read."""

    name: str  # of the line, as its log is called
    t_ns: int
    data: bytes


def line_id(name: str) -> str:
    """The id of a line's log. Ports by path and lines over the network have colons in their names."""
    return device(name.replace(":", "-"))


class LineLog:
    """The log of one line. It takes pieces at once, and makes them lines of the log when there is time: hundreds of a broken
    line would take longer than a callback may, if they became lines together."""

    def __init__(self, name: str, limits: Limits, clock: Clock) -> None:
        self.id, self.lost = line_id(name), 0
        self._clock, self._log = clock, open_log(limits, self.id, SUFFIX, "zpipe", clock)
        self._waiting = deque[bytes](maxlen=WAITING)
        self._log.note(event_line(clock, "start"))
        self.poll = self._log.poll

    def heard(self, t_ns: int, data: bytes) -> None:
        self.lost += len(self._waiting) == WAITING
        self._waiting.append(line(t_ns, data))

    def write(self) -> None:
        """Hand over the waiting pieces to the disk."""
        if self._waiting:
            count = len(self._waiting)
            self.lost += 0 if self._log.put(b"".join(self._waiting)) else count
            self._waiting.clear()

    def report(self) -> dict[str, object]:
        """The report, JSON-ready: bytes on disk, pieces lost, why it is not written."""
        status = self._log.status()
        return {f"{self.id}_bytes": status.bytes, f"{self.id}_lost": self.lost, f"{self.id}_log": status.reason}

    def close(self) -> None:
        self.write()
        self._log.note(event_line(self._clock, "end"))
        self._log.close()


def pieces(files: Iterable[LogFile]) -> Iterator[Piece]:
    """The pieces in these logs. Unreadable lines are left out."""
    for file in files:
        for told in read_lines(file.path):
            try:
                what = parse_json(told)
                data = what["text"].encode() if "text" in what else bytes.fromhex(what["hex"])
                t_ns = what["t_ns"]
            except (FormatError, KeyError, TypeError, ValueError, AttributeError):
                continue
            if type(t_ns) is int and 0 <= t_ns < 1 << 63:
                yield Piece(file.id, t_ns, data)
