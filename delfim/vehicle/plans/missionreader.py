"""Reads a mission's text in a process of its own: parsing TOML keeps the interpreter busy for many milliseconds, and for hours
with a text made for that purpose. The process has bounds, and ends when the mission is no longer wanted.

`python -m delfim.vehicle.plans.missionreader CPU_S` reads the text from its standard input. It writes the tables, one JSON
object a line behind the name of its table, and the boat puts them together in slices; or it writes the reason and ends with
WRONG.
"""

import subprocess
import sys
from collections.abc import Iterator
from typing import Any, Final, Literal

import msgspec

from delfim import config
from delfim.base.cooperative import Work
from delfim.base.errors import ConfigError, DelfimError, FormatError
from delfim.base.input.bounded import bounded
from delfim.vehicle.plans.mission import Mission, PathPoint, PayloadItem, Waypoint, read_mission

PROGRAM: Final = (sys.executable, "-m", "delfim.vehicle.plans.missionreader")
CPU_S: Final = 10  # the largest mission takes half a second, and on a slow board ten times that
MEMORY_BYTES: Final = 1 << 28
ROW, ZONE = 4, 20  # time for a line with a row or with a zone, counted in comparisons
WRONG: Final = 3  # exit code for a text that is not a mission
_rows = {  # by the tables' names
    name: msgspec.json.Decoder(kind)
    for name, kind in (
        (b"mission", tuple[str, Literal["hold", "home"], str]),
        (b"waypoint", Waypoint),
        (b"path", PathPoint),
        (b"action", PayloadItem),
        (b"in", config.Area),
        (b"out", config.Area),
    )
}


class Reading:
    """One text under way."""

    def __init__(self, text: str, cpu_s: int = CPU_S) -> None:
        self._text, self._program = text, (*PROGRAM, str(cpu_s))
        self._child: subprocess.Popen[bytes] | None = None
        self._is_wanted = True

    def lines(self) -> list[bytes] | DelfimError:
        """The output of the process, or why there is no mission. It waits: call it in a worker."""
        pipe = subprocess.PIPE
        with subprocess.Popen(self._program, stdin=pipe, stdout=pipe, start_new_session=True) as self._child:  # no Ctrl-C
            if not self._is_wanted:
                self._child.kill()
            told, _ = self._child.communicate(self._text.encode())
        if self._child.returncode == WRONG:
            return FormatError(told.decode().rstrip())
        if self._child.returncode:
            return FormatError("mission: its text takes too much time or memory to read; make it shorter")
        return told.splitlines()

    def cancel(self) -> None:
        """End the process: the mission is no longer wanted."""
        self._is_wanted = False
        if self._child is not None:
            self._child.kill()


def written(mission: Mission) -> Iterator[bytes]:
    """The output lines of a mission."""
    yield _line("mission", (mission.name, mission.then, mission.opens))
    zones = ("in", mission.fence.keep_in), ("out", mission.fence.keep_out)
    for name, rows in (("waypoint", mission.waypoint), ("path", mission.path), ("action", mission.action), *zones):
        for row in rows:
            yield _line(name, row)


def gathered(lines: list[bytes]) -> Work[Mission]:
    """The mission put together from its lines."""
    found: dict[bytes, list[Any]] = {name: [] for name in _rows}
    for line in lines:
        kind, _, row = line.partition(b" ")
        yield ZONE if kind in (b"in", b"out") else ROW
        found[kind].append(_rows[kind].decode(row))
    ((name, then, opens),), waypoint, path, action, keep_in, keep_out = (tuple(each) for each in found.values())
    fence = config.Zones(keep_in=keep_in, keep_out=keep_out)
    return Mission(version=1, name=name, waypoint=waypoint, path=path, action=action, then=then, opens=opens, fence=fence)


def _line(name: str, told: object) -> bytes:
    return name.encode() + b" " + msgspec.json.encode(told) + b"\n"


def main(cpu_s: str) -> int:
    """The process."""
    bounded(MEMORY_BYTES, int(cpu_s))
    try:
        sys.stdout.buffer.writelines(written(read_mission(sys.stdin.buffer.read().decode())))
    except ConfigError as error:
        print(error)
        return WRONG
    except MemoryError:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
