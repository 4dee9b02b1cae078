"""A payload program in lock step: the real program, its lines by pipes, and a clock that waits for it.

Each line of navigation is its turn, which it ends with a line of values; orders come before that. So the same program does the
same each time. Here it is not confined; at sea `delfim/parts/payload/payload.py` runs it.
"""

import contextlib
import os
import select
import subprocess
from collections.abc import Callable, Sequence
from typing import Final, Self

from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.orders.entrusting import PAYLOAD, within
from delfim.vehicle.orders.payloadlines import OrderBudget, answered, lines, ordered, word_of
from delfim.vehicle.report import BoatReport
from delfim.vehicle.snapshot import report

PERIOD_S: Final = 0.2  # between two states that it is told, as at sea
HANGS_S: Final = 20.0  # of the wall clock: a program that says nothing for so long has failed
TURN_BYTES: Final = 1 << 16  # said in one turn

Order = Callable[[console.Commands, str], str | None]


class PayloadProgram(contextlib.AbstractContextManager["PayloadProgram"]):
    """One program; call `turn` after each cycle. Raises DelfimError where it cannot be started."""

    def __init__(self, name: str, words: Sequence[str], order: Order) -> None:
        self.name, self._order, self._budget = name, order, OrderBudget()
        self._before: BoatReport | None = None
        self._next_s, self._rest, self._turns = 0.0, b"", 0
        self.is_running = True
        try:
            self._child = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        except OSError as error:
            raise DelfimError(f"payload {name}: {error.strerror}: {words[0]}") from None

    def turn(self, run: Lockstep) -> None:
        """Send it the boat's state, if that is due, and carry out its orders. A program that has ended is silent, and so is one
        whose link is lost, as a guest's."""
        now_s = run.elapsed_s
        if now_s + 1e-9 < self._next_s or not self.is_running or "guest_lost" in run.faults.on:
            return
        self._next_s = now_s + PERIOD_S
        now = report(run.state, now_s)
        told, self._before = list(lines(now, self._before)), now
        self._tell(b"".join(told))
        if told and b'"utc_ns"' in told[-1]:
            self._listen(run)

    def _tell(self, data: bytes) -> None:
        assert self._child.stdin is not None
        try:
            self._child.stdin.write(data)
        except OSError:
            self.is_running = False

    def _listen(self, run: Lockstep) -> None:
        """Read its lines up to the one that ends its turn. Raises DelfimError for a program that ends neither its turn nor
        itself."""
        assert self._child.stdout is not None
        said = 0
        while self.is_running:
            while b"\n" in self._rest:
                line, _, self._rest = self._rest.partition(b"\n")
                if (word := word_of(line)) is None:
                    return
                self._tell(answered(word, self._obeyed(line, run)))
            if said > TURN_BYTES or not select.select([self._child.stdout], [], [], HANGS_S)[0]:
                raise DelfimError(f"payload {self.name} does not end its turn: in lock step a line of values does")
            data = os.read(self._child.stdout.fileno(), 4096)
            said += len(data)
            self.is_running = bool(data)
            self._rest += data

    def _obeyed(self, line: bytes, run: Lockstep) -> str | None:
        """Carry out its order; returns why it was refused, or None."""
        try:
            command = ordered(line)
            if why := self._budget.exceeded(command, run.elapsed_s):
                return f"refused: {why}"
            if isinstance(command, console.Upload):
                command = within(command, run.vehicle.helm.plans.zones)
        except (FormatError, Refused) as error:
            return f"refused: {error}"
        return self._order(command, f"{PAYLOAD}{self.name}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *what: object) -> None:
        self.is_running = False
        self._child.kill()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                pipe.close()
        self._child.wait()
