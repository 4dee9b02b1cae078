"""Shrinks a run that failed to the least faults, orders and tables with which it still fails in the same words, and writes that
as a scenario: delta debugging (Zeller and Hildebrandt, 2002)."""

import re
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from delfim.base import tables
from delfim.base.errors import DelfimError
from delfim.campaign.runplan import Plan, laid
from delfim.campaign.sailing import Drawn, drawn_run, judged
from delfim.simulator.scenarios.scenario import Scenario

RUNS_MAX: Final = 200
TELL_S: Final = 2.0  # between two lines of progress
CLOSE_S: Final = 1.0  # the end of the run is found to this
LISTS: Final = ("command", "fault", "vessel", "handset")
_NUMBER: Final = re.compile(r"-?[0-9]+(\.[0-9]+)?")


class LeftOver(NamedTuple):
    """A piece that can be left out: a row of one of LISTS, or a table that lies over the vehicle's file."""

    field: str
    keys: tuple[str, ...]
    value: Any


class Shrunk(NamedTuple):
    drawn: Drawn
    words: str  # in which it fails
    runs: int


def alike(words: str) -> str:
    """The words of a failure without their numbers: two with the same are the same failure."""
    return _NUMBER.sub("N", words)


def shrink(drawn: Drawn, failures: Callable[[Drawn], list[str]], tell: Callable[[str], None], most: int = RUNS_MAX) -> Shrunk:
    """Shrink a run. `failures` sails a run and returns what failed, in words. Raises DelfimError where nothing does, or where
    there is nothing to leave out."""
    if drawn.scenario is None:
        raise DelfimError("a mission has no faults and no orders to leave out")
    if not (found := failures(drawn)):
        raise DelfimError("this run does not fail")
    search = _Shrinking(drawn, drawn.scenario, alike(found[0]), failures, tell, most)
    search.shorten()
    search.leave_out()
    search.shorten()
    return Shrunk(drawn._replace(scenario=search.best), found[0], search.runs)


class _Shrinking:
    def __init__(
        self,
        drawn: Drawn,
        scenario: Scenario,
        words: str,
        failures: Callable[[Drawn], list[str]],
        tell: Callable[[str], None],
        most: int,
    ) -> None:
        self.best, self.runs = scenario, 1
        self._drawn, self._words, self._failures, self._tell, self._most = drawn, words, failures, tell, most
        self._told_s = time.monotonic()

    def fails(self, scenario: Scenario) -> bool:
        """Whether this run fails in the same words; it is the best so far then. False when there were too many runs."""
        if self.runs >= self._most:
            return False
        self.runs += 1
        if (now_s := time.monotonic()) - self._told_s >= TELL_S:
            self._told_s, left = now_s, len(_pieces(self.best))
            self._tell(f"shrinking: {self.runs} of at most {self._most} runs, {left} things left, {self.best.seconds:.0f} s")
        if all(alike(words) != self._words for words in self._failures(self._drawn._replace(scenario=scenario))):
            return False
        self.best = scenario
        return True

    def shorten(self) -> None:
        """Let the run end soon after it has failed."""
        low_s, high_s = 0.0, self.best.seconds
        while high_s - low_s > CLOSE_S and self.runs < self._most:
            middle_s = (low_s + high_s) / 2.0
            if self.fails(msgspec.structs.replace(self.best, seconds=middle_s)):
                high_s = middle_s
            else:
                low_s = middle_s

    def leave_out(self) -> None:
        """Leave out parts of the pieces, ever smaller ones, down to one by one."""
        pieces, parts = _pieces(self.best), 2
        while pieces and self.runs < self._most:
            size = -(-len(pieces) // parts)
            for at in range(0, len(pieces), size):
                fewer = pieces[:at] + pieces[at + size :]
                if self.fails(_built(self.best, fewer)):
                    pieces, parts = fewer, max(parts - 1, 2)
                    break
            else:
                if size == 1:
                    return
                parts = min(2 * parts, len(pieces))


def _pieces(scenario: Scenario) -> list[LeftOver]:
    rows = [LeftOver(name, (), row) for name in LISTS for row in getattr(scenario, name)]
    if scenario.guest is not None:
        rows.append(LeftOver("guest", (), scenario.guest))
    for key, value in scenario.vehicle.items():
        if isinstance(value, dict):
            rows += [LeftOver("vehicle", (key, inner), each) for inner, each in value.items()]
        else:
            rows.append(LeftOver("vehicle", (key,), value))
    return rows


def _built(scenario: Scenario, pieces: Sequence[LeftOver]) -> Scenario:
    vehicle = dict[str, Any]()
    for each in pieces:
        if each.field == "vehicle":
            *outer, last = each.keys
            (vehicle.setdefault(outer[0], {}) if outer else vehicle)[last] = each.value
    rows = {name: tuple(each.value for each in pieces if each.field == name) for name in LISTS}
    guest = next((each.value for each in pieces if each.field == "guest"), None)
    return msgspec.structs.replace(scenario, vehicle=vehicle, guest=guest, **rows)


def written(shrunk: Shrunk, folder: Path) -> list[Path]:
    """Write the vehicle's file and the scenario, with its mission beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn, scenario = shrunk.drawn, shrunk.drawn.scenario
    assert scenario is not None
    tree = msgspec.to_builtins(scenario)
    tree["vehicle"] = laid(tree["vehicle"], {key: value for key, value in drawn.values.items() if not re.search(r"\.\d", key)})
    if drawn.mission:
        (folder / "mission.toml").write_text(drawn.mission, encoding="utf-8")
        tree["mission"] = "mission.toml"
    kept = {key: value for key, value in tree.items() if value or value is False}
    texts = {"boat.toml": tables.text_of(drawn.boat), "scenario.toml": f"# {shrunk.words}\n{tables.text_of(kept)}"}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def run(plan: Plan, folder: Path, point: int, seed: int) -> int:
    """Shrink a run of a campaign, and print the command that repeats what is left; returns 0. Raises DelfimError."""

    def failures(drawn: Drawn) -> list[str]:
        try:
            return judged(plan, drawn, seed)[1]
        except Exception as error:  # a defect is what is looked for
            return [f"{type(error).__name__}: {error}"]

    drawn = drawn_run(plan, point, seed)
    shrunk = shrink(drawn, failures, lambda words: print(f"  {words}", flush=True))
    was, now = drawn.scenario, shrunk.drawn.scenario
    assert was is not None
    assert now is not None
    boat, file = written(shrunk, folder / f"shrunken-{point}-{seed}")
    left = [f"{len(getattr(now, name))} of {len(getattr(was, name))} {name}s" for name in ("fault", "command")]
    print(f"  {shrunk.words}: shrunken to {', '.join(left)}, {now.seconds:.0f} of {was.seconds:.0f} s in {shrunk.runs} runs")
    words = ["delfim", "sim", str(boat), "--scenario", str(file), "--seed", str(seed)]
    if shrunk.words.startswith("audit: "):
        log = str(file.parent / "log")
        print(f"  again: {shlex.join([*words, '--output', log])} && delfim log audit {shlex.quote(log)}")
    else:
        print(f"  again: {shlex.join(words)}")
    return 0
