"""A mission's text, read in a process of its own: to read TOML keeps the interpreter busy for many milliseconds, and for hours
with a text that was made for it. The process has bounds, and ends when nobody wants the mission any more.

`python -m delfim.vehicle.missionreader CPU_S` reads the text from its standard input. It writes the tables, one JSON object a
line behind the name of its table, and the boat puts them together in slices; or it writes the reason and ends with WRONG.
"""

import subprocess
import sys
from collections.abc import Iterator
from typing import Any, Final

import msgspec

from delfim import config
from delfim.errors import ConfigError, DelfimError, FormatError
from delfim.slices import Work
from delfim.vehicle.mission import Mission, PathPoint, Waypoint, read_mission

PROGRAM: Final = (sys.executable, "-m", "delfim.vehicle.missionreader")
CPU_S: Final = 10  # the largest mission takes half a second, and on a slow board ten times that
MEMORY_BYTES: Final = 1 << 28
NICE: Final = 10
ROW, ZONE = 4, 20  # comparisons, in time, of a line with a row or with a zone
WRONG: Final = 3  # the exit code of a text that is no mission
_head = msgspec.json.Decoder(tuple[str, config.Ring])  # the mission's name, and the polygon that it does not leave
_waypoint, _path, _zone = (msgspec.json.Decoder(kind) for kind in (Waypoint, PathPoint, config.KeepOut))


class Reading:
    """One text under way."""

    def __init__(self, text: str, cpu_s: int = CPU_S) -> None:
        self._text, self._program = text, (*PROGRAM, str(cpu_s))
        self._child: subprocess.Popen[bytes] | None = None
        self._is_wanted = True

    def lines(self) -> list[bytes] | DelfimError:
        """What the process wrote, or why there is no mission. For a worker: it waits."""
        with subprocess.Popen(self._program, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as self._child:
            if not self._is_wanted:
                self._child.kill()
            told, _ = self._child.communicate(self._text.encode())
        if self._child.returncode == WRONG:
            return FormatError(told.decode().rstrip())
        if self._child.returncode:
            return FormatError("mission: its text takes too much time or memory to read; make it shorter")
        return told.splitlines()

    def cancel(self) -> None:
        """Nobody wants it any more."""
        self._is_wanted = False
        if self._child is not None:
            self._child.kill()


def written(mission: Mission) -> Iterator[bytes]:
    """A mission as its lines."""
    yield _line("mission", (mission.name, mission.fence.keep_in))
    for name, rows in (("waypoint", mission.waypoint), ("path", mission.path), ("zone", mission.fence.keep_out)):
        for row in rows:
            yield _line(name, row)


def gathered(lines: list[bytes]) -> Work[Mission]:
    """The mission of its lines."""
    head, *rows = lines
    name, keep_in = _head.decode(head.partition(b" ")[2])
    found: dict[bytes, list[Any]] = {b"waypoint": [], b"path": [], b"zone": []}
    decoders = {b"waypoint": _waypoint, b"path": _path, b"zone": _zone}
    for line in rows:
        kind, _, row = line.partition(b" ")
        yield ZONE if kind == b"zone" else ROW
        found[kind].append(decoders[kind].decode(row))
    waypoint, path, zones = (tuple(each) for each in found.values())
    return Mission(version=1, name=name, waypoint=waypoint, path=path, fence=config.Zones(keep_in=keep_in, keep_out=zones))


def _line(name: str, told: object) -> bytes:
    return name.encode() + b" " + msgspec.json.encode(told) + b"\n"


def main(cpu_s: str) -> int:
    """The process."""
    import os
    import resource

    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s)))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
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
