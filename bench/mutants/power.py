"""What seeds notice: changes of the safety core, sailed by seeds of mixed faults that the watch judges alone (docs/mutants.md).

    python -m bench.mutants.power [FILE.py ...] [--changes N] [--seeds N] [--draw SEED]

Of each file so many changes are drawn. Each sails the seeds until the watch tells one; those that told most sail first. A
change that altered what the boat did in some run, and that no run told, is listed. What was tried of the same program is not
tried again (run/mutants/power.jsonl), and what was told by a seed of another program sails that seed first.
"""

import argparse
import hashlib
import importlib
import json
import os
import resource
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from random import Random
from types import CodeType, FrameType
from typing import Any, Final, NamedTuple

from bench.mutants.changes import Change, changed, changes

FILES: Final = ("failsafe", "troubles", "plans/fence", "plans/zones", "gate", "propulsion", "kills", "helm", "control/*")
LEDGER: Final = Path("run/mutants/power.jsonl")
VEHICLE: Final = "etc/delfimx.toml"
CHANGES, SEEDS, DRAW = 12, 60, 1
RUN_S: Final = 10.0  # of a processor; a run takes less than a tenth of a second
BYTES_MAX: Final = 2 << 30
ENDS: Final = "the program ends, or never does"  # as a campaign's worker, which calls that a failure, too
COLUMNS: Final = ("tried", "told", "altered, not told", "no run differs", "told of those that alter a run")


class Told(NamedTuple):
    """What came of a change: the seed that told it, or -1, in which words, and the first seed whose run it altered, or -1."""

    seed: int
    words: str
    altered: int


class Changed(SourceFileLoader):
    """Loads a file as it is after one of its changes."""

    def __init__(self, name: str, path: str, number: int) -> None:
        super().__init__(name, path)
        self._number = number

    def get_code(self, fullname: str) -> CodeType:
        return compile(changed(Path(self.path).read_text(), self._number), self.path, "exec")


class Finder:
    """Finds the changed file before others find it as it is."""

    def __init__(self, file: str, number: int) -> None:
        self._name, self._path, self._number = file.removesuffix(".py").replace("/", "."), os.path.abspath(file), number

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        if name != self._name:
            return None
        return spec_from_file_location(name, self._path, loader=Changed(name, self._path, self._number))


def forked(work: Callable[[], object]) -> Any:
    """What a process of its own answers, as JSON; None where it ends without an answer."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        resource.setrlimit(resource.RLIMIT_DATA, (BYTES_MAX, BYTES_MAX))
        with os.fdopen(writing, "w") as file:
            json.dump(work(), file)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as file:
        said = file.read()
    os.waitpid(child, 0)
    return json.loads(said) if said else None


def sailed(seed: int) -> tuple[str, list[str]]:
    """The digest of a run, and what the watch says of it. Whatever the boat's program raises is a failure."""
    from delfim import config
    from delfim.campaign.measures import RunTape
    from delfim.simulator.scenarios.random_faults import mixed, mixed_mission
    from delfim.simulator.scenarios.scenario import settings_of
    from delfim.simulator.scenarios.trial import sail
    from delfim.simulator.tables import Simulation
    from delfim.vehicle.state import NoLog

    here, tapes = config.load(VEHICLE), list[RunTape]()
    scenario = mixed(seed, here)

    def tape(clock: Any) -> RunTape:
        tapes.append(RunTape(clock, NoLog()))
        return tapes[-1]

    signal.setitimer(signal.ITIMER_PROF, RUN_S)  # which ends the process
    result = sail(scenario, settings_of(scenario, VEHICLE), seed, mixed_mission(here.of(Simulation)), tape)
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    return tapes[0].hash.hexdigest(), result.failures


def tell(file: str, number: int, seeds: Sequence[int], right: dict[str, str]) -> Told:
    """Sails the changed program until the watch tells it. `right`: the digests of the runs as they were."""
    sys.meta_path.insert(0, Finder(file, number))
    altered = -1
    for seed in seeds:
        try:
            digest, failures = sailed(seed)
        except Exception as error:
            return Told(seed, f"{type(error).__name__}: {error}", seed)
        altered = seed if altered < 0 and digest != right[str(seed)] else altered
        if failures:
            return Told(seed, failures[0], altered)
    return Told(-1, "", altered)


def looked(files: Sequence[str], seeds: Sequence[int]) -> tuple[dict[str, str], dict[str, list[int]], list[str]]:
    """Of the program as it is: each run's digest, the lines of each file that run, and what is imported from elsewhere."""
    paths, reached = {os.path.abspath(file): file for file in files}, {file: set[int]() for file in files}

    def trace(frame: FrameType, event: str, what: object) -> Any:
        file = paths.get(frame.f_code.co_filename)
        if file is None:
            return None
        lines = reached[file]

        def line(frame: FrameType, event: str, what: object) -> Any:
            lines.add(frame.f_lineno)
            return line

        return line(frame, event, what)

    sys.settrace(trace)
    digests = dict[str, str]()
    for seed in seeds:
        digests[str(seed)], failures = sailed(seed)
        if failures:
            raise RuntimeError(f"seed {seed} fails without any change: {failures}")
    sys.settrace(None)
    here = f"{Path.cwd()}/"
    ours = {name for name, module in sys.modules.items() if (getattr(module, "__file__", None) or "").startswith(here)}
    outside = [name for name in sys.modules if name not in ours or ".venv" in (sys.modules[name].__file__ or "")]
    return digests, {file: sorted(lines) for file, lines in reached.items()}, [name for name in outside if name != "__main__"]


class Ledger:
    """What came of each change, kept between calls. Of another program only which seed told it."""

    def __init__(self, basis: str) -> None:
        self._basis = basis
        rows = [json.loads(line) for line in LEDGER.read_text().splitlines()] if LEDGER.exists() else []
        self._rows = {(row["file"], row["name"]): row for row in rows}
        self._telling = Counter(row["seed"] for row in self._rows.values() if row["seed"] >= 0)

    def known(self, file: str, name: str) -> Told | None:
        row = self._rows.get((file, name))
        return None if row is None or row["basis"] != self._basis else Told(row["seed"], row["words"], row["altered"])

    def order(self, file: str, name: str, seeds: Sequence[int]) -> list[int]:
        """The seeds, those first that are likely to tell this change."""
        last = self._rows.get((file, name), {"seed": -1})["seed"]
        return sorted(seeds, key=lambda seed: (seed != last, -self._telling[seed]))

    def write(self, file: str, name: str, told: Told) -> None:
        row = {"basis": self._basis, "file": file, "name": name, **told._asdict()}
        self._rows[file, name] = row
        self._telling[told.seed] += told.seed >= 0
        LEDGER.parent.mkdir(parents=True, exist_ok=True)
        with LEDGER.open("a") as log:
            log.write(json.dumps(row) + "\n")


def drawn(found: Sequence[Change], count: int, draw: int, file: str) -> list[int]:
    """The numbers of the changes that are tried; of more, these and others."""
    numbers = list(range(len(found)))
    Random(f"{draw} {file}").shuffle(numbers)
    return sorted(numbers[:count])


def basis(words: object) -> str:
    """A digest of the program, and of how it is asked."""
    digest = hashlib.sha256(repr(words).encode())
    for path in sorted((*Path("delfim").rglob("*.py"), Path(VEHICLE), Path(__file__))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def tried(files: Sequence[str], count: int, seeds: Sequence[int], draw: int) -> Iterator[tuple[str, Change, Told]]:
    """What came of each change that is drawn."""
    right, reached, elsewhere = forked(partial(looked, files, seeds))
    for name in elsewhere:  # what is the same after each change is imported once
        importlib.import_module(name)
    ledger = Ledger(basis(list(seeds)))
    for file in files:
        _, found = changes(Path(file).read_text())
        for number in drawn(found, count, draw, file):
            change = found[number]
            told = ledger.known(file, change.name)
            if told is None:
                is_reached = change.function == "<module>" or bool(set(range(change.line, change.end + 1)) & set(reached[file]))
                order = ledger.order(file, change.name, seeds) if is_reached else []
                answer = forked(partial(tell, file, number, order, right))
                told = Told(order[0] if order else -1, ENDS, order[0] if order else -1) if answer is None else Told(*answer)
                ledger.write(file, change.name, told)
                print(f"{file}:{change.line}: {change.name}: {told.words or _untold(told)}", file=sys.stderr, flush=True)
            yield file, change, told


def _untold(told: Told) -> str:
    return f"NOT TOLD, alters seed {told.altered}" if told.altered >= 0 else "no run differs"


def shown(rows: Sequence[tuple[str, Change, Told]]) -> str:
    """The table, and the changes that altered a run and were not told."""
    lines = [f"| file | {' | '.join(COLUMNS)} |", f"|---{'|---' * len(COLUMNS)}|"]
    for name in (*dict.fromkeys(file for file, _, _ in rows), "all"):
        those = [told for file, _, told in rows if name in ("all", file)]
        told, untold = sum(each.seed >= 0 for each in those), sum(each.seed < 0 <= each.altered for each in those)
        part = f"{100.0 * told / (told + untold):.0f} %" if told + untold else "–"
        lines.append(f"| `{name}` | {len(those)} | {told} | {untold} | {len(those) - told - untold} | {part} |")
    left = [f"{file}:{change.line}: {change.name}" for file, change, told in rows if told.seed < 0 <= told.altered]
    return "\n".join([*lines, "", *left])


def core(names: Sequence[str] = FILES) -> list[str]:
    return sorted(
        str(path) for name in names for path in Path("delfim/vehicle").glob(f"{name}.py") if path.stat().st_size > 200
    )


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.mutants.power", description=__doc__.split("\n\n")[0])
    parser.add_argument("files", nargs="*", metavar="FILE.py")
    parser.add_argument("--changes", type=int, default=CHANGES, help="so many of each file (%(default)s)")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="so many runs for each, at most (%(default)s)")
    parser.add_argument("--draw", type=int, default=DRAW, help="the seed of the draw (%(default)s)")
    asked = parser.parse_args(words)
    print(shown(list(tried(asked.files or core(), asked.changes, range(asked.seeds), asked.draw))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
