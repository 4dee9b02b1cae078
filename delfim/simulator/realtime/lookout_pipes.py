"""What simulated look-outs tell, in real time: a named pipe for each program, which copies to the boat what it brings.

Nothing here waits: what nobody reads is lost, and so is what does not fit into the pipe.
"""

import contextlib
import errno
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Self

import msgspec

from delfim import config
from delfim.simulator.nodes.lookouts import Surroundings
from delfim.simulator.tables import Simulation
from delfim.vehicle import console


def pipe_of(settings: config.Vehicle, payload: str) -> Path:
    """Where the program of this name reads what its look-outs see."""
    return Path(settings.runtime.run_directory) / f"lookout-{payload}"


class LookoutPipes:
    """The pipes of all look-outs. Raises OSError where one cannot be made."""

    def __init__(self, settings: config.Vehicle, surroundings: Surroundings | None) -> None:
        rows = settings.of(Simulation).things.lookout if surroundings is not None else ()
        self._paths = {each: pipe_of(settings, each) for row in rows if (each := row.payload) is not None}
        self._ends = dict[str, int]()
        for path in self._paths.values():
            path.unlink(missing_ok=True)
            os.mkfifo(path)
            path.chmod(0o644)  # the program runs as a user of its own

    def say(self, told: Iterable[tuple[str, console.Sight]]) -> None:
        """Write what is told to the programs that listen."""
        for payload, sight in told:
            if (end := self._end(payload)) < 0:
                continue
            try:
                os.write(end, msgspec.json.encode(sight) + b"\n")  # whole or not at all: it is shorter than PIPE_BUF
            except BlockingIOError:
                pass
            except BrokenPipeError:
                os.close(self._ends.pop(payload))

    def _end(self, payload: str) -> int:
        """The end of a pipe; -1: nobody listens at the other. Raises OSError."""
        if payload not in self._ends:
            try:
                self._ends[payload] = os.open(self._paths[payload], os.O_WRONLY | os.O_NONBLOCK)
            except OSError as error:
                if error.errno != errno.ENXIO:
                    raise
                return -1
        return self._ends[payload]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for end in self._ends.values():
            os.close(end)
        for path in self._paths.values():
            with contextlib.suppress(OSError):
                path.unlink()
