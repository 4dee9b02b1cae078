"""The last lines of the system log, as a visitor selects them."""

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import msgspec

from delfim.base.errors import one_line
from delfim.base.input.unreadable import UNREADABLE
from delfim.logging.ashore.systemlines import LEVELS
from delfim.logging.systemlog import recent
from delfim.services.page.api import LogLine

LINES_MAX: Final = 500  # of an answer
TEXT_MAX: Final = 100  # characters of a text to look for
_LINE: Final = msgspec.json.Decoder(LogLine)


class WantedLines(NamedTuple):
    """Lines of this level or worse, with this text in them or in the name of their service, whatever its case."""

    level: str = "info"
    text: str = ""

    def has(self, line: LogLine) -> bool:
        if LEVELS.get(line.level, 0) < LEVELS[self.level]:
            return False
        return not self.text or self.text.lower() in f"{line.service}: {line.text}".lower()


def wanted(level: str, text: str) -> WantedLines:
    """Parse a visitor's selection: words that mean nothing have their default."""
    return WantedLines(level if level in LEVELS else WantedLines().level, text[:TEXT_MAX])


def parsed(lines: Iterable[bytes]) -> Iterator[LogLine | None]:
    """Parse lines; None for one that is no line of the log. Text that steers a terminal is made readable."""
    for line in lines:
        try:
            told = _LINE.decode(line)
        except UNREADABLE:
            yield None
        else:
            yield msgspec.structs.replace(told, service=one_line(told.service), text=one_line(told.text))


def last_lines(directory: str, count: int) -> tuple[LogLine, ...]:
    """Read the last lines from the level info on, newest first."""
    found = []
    for line in parsed(recent(directory)):
        if line is not None and WantedLines().has(line):
            found.append(line)
            if len(found) == count:
                break
    return tuple(found)
