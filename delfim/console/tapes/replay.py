"""A recorded run in place of boats: it takes the place of `Fleet`, shows the state known at each time, and commands nothing."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any, Final, NoReturn

from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, FormatError, Refused, in_words
from delfim.console.boats.boat import Boat
from delfim.console.boats.plan_transfer import planned
from delfim.console.plans.plan import mission_of
from delfim.console.tapes.statetape import States, number_of
from delfim.console.tapes.tape import Graphs, Tape, TlogTape, Track
from delfim.logging.statelog import read_state

RATE_MAX: Final = 60.0
EVENTS_MAX: Final = 300  # marks on the time line
TRACK_MAX: Final = 4000  # points of a whole track
GRAPH_MAX: Final = 600  # points of a graph


class TapePlayer:
    """Plays from the beginning in real time. `moved` is called when time has jumped, because the tracks change then."""

    def __init__(self, tapes: Sequence[Tape], clock: Clock, tell: Callable[[dict[str, Any]], None]) -> None:
        self.from_s, self.to_s = min(tape.from_s for tape in tapes), max(tape.to_s for tape in tapes)
        self.boats: dict[int, Boat] = {}
        self.missions: dict[int, dict[str, dict[str, Any]]] = {}
        self.at_s, self.rate = self.from_s, 1.0
        self.moved: Callable[[], None] = lambda: None
        self._tapes, self._clock, self._tell = tapes, clock, tell
        self._played_s = clock.monotonic_s()
        self.seek(self.from_s)

    def seek(self, at_s: float) -> None:
        """Jumps to the state known at this time."""
        self.at_s = min(max(at_s, self.from_s), self.to_s)
        self.boats.clear()
        for tape in self._tapes:
            tape.seek(self.boats, self.at_s)
        self._show_missions()
        self.moved()

    def steer(self, at_s: float | None, rate: float | None) -> None:
        """Sets time and rate as the page asks; a rate of 0 pauses. Raises FormatError."""
        rate = self.rate if rate is None else rate
        if not 0.0 <= rate <= RATE_MAX or (at_s is not None and not math.isfinite(at_s)):
            raise FormatError(f"replay: a rate is 0 to {RATE_MAX:.0f} and a time is a number")
        self.rate = rate
        if at_s is not None:
            self.seek(at_s)

    def tick(self) -> None:
        """Called often: plays up to the present."""
        now_s = self._clock.monotonic_s()
        from_s, self.at_s = self.at_s, min(self.at_s + (now_s - self._played_s) * self.rate, self.to_s)
        self._played_s = now_s
        if self.at_s > from_s:
            self._show_missions()
            for text in [text for tape in self._tapes for text in tape.play(self.boats, from_s, self.at_s)]:
                said = {"boat": text.boat, "severity": text.severity, "text": text.text}
                self._tell({"t": "text", **said, "at_s": text.at_s})

    def snapshot(self) -> list[dict[str, Any]]:
        return [
            boat.snapshot(self.at_s) | planned(boat, self.missions.get(number, {}))
            for number, boat in sorted(self.boats.items())
        ]

    def _show_missions(self) -> None:
        """Sends the pages the mission aboard at this time, if it has changed; they draw it as the plan."""
        for number, missions in [each for tape in self._tapes for each in tape.missions.items()]:
            known = bisect_right(missions, self.at_s, key=lambda each: each[0])
            before = self.missions.pop(number, {}).get("aboard")
            aboard = missions[known - 1][1] if known else None
            if aboard is not None:
                self.missions[number] = {"here": aboard, "aboard": aboard}
            if aboard is not before:
                shown = aboard or mission_of("", [[], [], []])
                self._tell({"t": "mission", "boat": number, "where": "here", "mission": shown})

    def events(self) -> list[dict[str, Any]]:
        """Messages for the marks on the time line, in order of time; of too many, the gravest ones."""
        texts = sorted((text for tape in self._tapes for text in tape.texts), key=lambda text: text.severity)
        return [text._asdict() for text in sorted(texts[:EVENTS_MAX])]

    def tracks(self) -> dict[int, Track]:
        """The track of each boat, from the first recording to the last, at most TRACK_MAX points each."""
        whole: dict[int, Track] = {}
        for tape in self._tapes:
            for number, track in tape.tracks.items():
                whole[number] = sorted([*whole.get(number, ()), *track])
        return {number: track[:: len(track) // TRACK_MAX + 1] for number, track in whole.items()}

    def graphs(self) -> dict[int, Graphs]:
        """Speed, charge and the values of sensors of each boat over the time line, at most GRAPH_MAX points each."""
        whole: dict[int, Graphs] = {}
        for tape in self._tapes:
            for number, graphs in tape.graphs.items():
                for name, points in graphs.items():
                    its = whole.setdefault(number, {})
                    its[name] = sorted([*its.get(name, ()), *points])
        return {number: {n: each[:: len(each) // GRAPH_MAX + 1] for n, each in its.items()} for number, its in whole.items()}

    # These need real boats.

    def progress(self) -> list[dict[str, Any]]:
        return []

    def receive(self, address: Any, data: bytes) -> None:
        """Real boats are not part of a replay."""

    def release(self, number: int, why: str, page: int | None = None) -> None:
        """Nothing is steered."""

    def release_all(self, why: str, page: int | None = None) -> None:
        """Nothing is steered."""

    def input(self, number: int, count: int, port_pct: float, starboard_pct: float, page: int = 0) -> None:
        """Nothing is steered."""

    def command(self, number: int, word: str, words: dict[str, Any], answer: Any, page: int = 0) -> NoReturn:
        raise Refused("this is a replay: there is no boat to command")

    def put(self, number: int, mission: dict[str, Any]) -> NoReturn:
        raise Refused("this is a replay: there is no boat to plan for")

    def forget(self, number: int) -> NoReturn:
        raise Refused("this is a replay: its boats are those of the recording")

    def ask_home(self, number: int) -> NoReturn:
        raise Refused("this is a replay: there is no boat to ask")

    def afford(self, number: int, answer: Any) -> NoReturn:
        raise Refused("this is a replay: there is no boat to ask")

    def upload(self, number: int, answer: Any) -> NoReturn:
        raise Refused("this is a replay: there is no boat to send to")

    def download(self, number: int, answer: Any) -> NoReturn:
        raise Refused("this is a replay: there is no boat to ask")


def open_tapes(paths: Sequence[Path]) -> list[Tape]:
    """The recordings in files and folders: every .tlog, and the state logs, those of one boat together. A state log that had
    just begun when the power was cut has no header, and is left out. Raises DelfimError if there is nothing to replay, or a
    session cannot be read."""
    reason = "nothing to replay: no .tlog, .state or .state.gz"
    files = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    tapes: list[Tape] = []
    by_boat: dict[str, list[Path]] = {}
    try:
        for file in files:
            if file.suffix == ".tlog":
                tapes.append(TlogTape(file))
            elif file.name.endswith((".state", ".state.gz")):
                try:
                    by_boat.setdefault(read_state(file).schema.boat, []).append(file)
                except FormatError as error:
                    reason = str(error)
        tapes += _states(by_boat, {number for tape in tapes for number in tape.tracks})
    except OSError as error:
        raise DelfimError(in_words(error)) from None
    if not tapes:
        raise DelfimError(f"{', '.join(map(str, paths))}: {reason}")
    return tapes


def _states(by_boat: dict[str, list[Path]], known: set[int]) -> list[Tape]:
    """The state logs of each boat under its own number where no boat before has it, or else under one that nobody has.
    `known` are the numbers in the sessions."""
    own = {name: number_of(files) for name, files in by_boat.items()}
    whose: dict[int, str] = {}
    tapes: list[Tape] = []

    def free(but: set[int]) -> int:
        return next(number for number in count(1) if number not in but | whose.keys() | set(own.values()))

    for name, files in by_boat.items():
        told = own[name]
        number = free(set()) if told is None else told if told not in whose else free(known)
        tape = States(files, number)
        if told is not None and told != number:
            words = f"{name}: its number {told} is {whose[told]}’s, too; here it has {number}"
            tape.complaint = "; ".join(filter(None, [words, tape.complaint]))
        whose[number] = name
        tapes.append(tape)
    return tapes
