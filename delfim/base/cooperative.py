"""Cooperative work: what would hold the loop for longer than a callback may is a generator that runs one slice at a time.

The generator yields how much it has done since it last yielded, in comparisons (about a microsecond each), and returns what
it found. Work is counted and no clock is read, so that a run in lock step comes out the same each time.
"""

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from itertools import islice
from typing import Final, Generic, TypeVar

from delfim.base.errors import Refused

SLICE: Final = 100  # comparisons of one callback: a part of its budget, for slower computers
MOST: Final = 5_000_000  # comparisons of one piece of work, after which it is given up

LET_GO: Final = 400  # objects of a few numbers that are freed at a time

T = TypeVar("T")
Work = Generator[int, None, T]


class Sliced(Generic[T]):
    """A piece of work under way, with what it has cost so far, and its result once it is done."""

    result: T

    def __init__(self, work: Work[T]) -> None:
        self._work, self.spent = work, 0

    def step(self, most: int = SLICE) -> bool:
        """Run one slice, and return whether the work is done. Exceptions of the work pass; endless work gets Refused."""
        until = self.spent + most
        try:
            while self.spent < until:
                self.spent += next(self._work)
            if self.spent > MOST:
                self._work.throw(Refused(f"more than {MOST:,} comparisons: use fewer zones, corners, waypoints or pieces"))
        except StopIteration as end:
            self.result = end.value
            return True
        return False

    def finish(self) -> T:
        """Do all that is left at once, for a caller that may take the time."""
        while not self.step():
            pass
        return self.result


class Remains:
    """Garbage that is freed a little at a time: to free all that a large plan is made of, or only to list it, takes longer
    than a callback may."""

    def __init__(self) -> None:
        self._walks = deque[Iterator[object]]()  # through what was dropped, which lives until its walk is over
        self._things: list[object] = []  # met on these walks

    def add(self, *things: Iterable[object]) -> None:
        """Take over the parts of something large, just before it is dropped."""
        self._walks.extend(map(iter, things))

    def let_go(self) -> None:
        """Free some of the garbage; more if there is much, so that nobody can make it grow for ever. Call it now and then."""
        many = max(LET_GO, (len(self._things) + len(self._walks)) // 20)
        del self._things[-many:]
        left = many
        while self._walks and left > 0:
            met = list(islice(self._walks[0], left))
            self._things += met
            if len(met) < left:
                self._walks.popleft()
            left -= len(met) + 1
