"""Makes the oracles anew: `make oracles`, or some with ARGS="boats telemetry". Days at sea only by name: ARGS=days."""

import sys
import time
from concurrent.futures import ProcessPoolExecutor

from tests.oracles import keeping, replays
from tests.oracles.kinds import LINES
from tests.oracles.traces import Trace
from tests.oracles.voyages import VOYAGES, Voyage


def _sailed(voyage: Voyage) -> Trace:
    """Without the values of its cycles, which are many."""
    return voyage.sail({})._replace(columns={}, at_s=())


def _sail(kind: str, workers: ProcessPoolExecutor) -> None:
    voyages, found = list(VOYAGES[kind]()), dict[str, Trace]()
    for voyage, trace in zip(voyages, workers.map(_sailed, voyages), strict=True):
        found[voyage.name] = trace
        print(f"oracles: {kind}, {len(found)} of {len(voyages)}: {voyage.name}", file=sys.stderr, flush=True)
    keeping.keep_traces(kind, found)


def main(asked: list[str]) -> int:
    known = [*LINES, *VOYAGES]
    if unknown := set(asked).difference(known, ["days"]):
        print(f"oracles: nothing is named {', '.join(sorted(unknown))}; known: {', '.join(known)}, days", file=sys.stderr)
        return 2
    began_s = time.monotonic()
    with ProcessPoolExecutor() as workers:
        for kind in asked or known:
            if kind in LINES:
                keeping.keep_lines(kind, LINES[kind].make())
            elif kind in VOYAGES:
                _sail(kind, workers)
            else:
                replays.record()
            print(f"oracles: {kind} is kept", file=sys.stderr, flush=True)
    size = sum(file.stat().st_size for file in keeping.KEPT.rglob("*") if file.is_file())
    print(f"oracles: {size / 1000:.0f} kB, {time.monotonic() - began_s:.0f} s; see what changed: git diff --stat tests/oracles")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
