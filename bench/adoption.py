"""Whole trials of boats that are drawn: what they find, how far it is from the truth, how they end.

    python -m bench.adoption [--hulls 0:44] [--seeds 1:4] [--motors] [--drift] [--rows run/adoption.jsonl]

The hulls below 40 are boats of etc/boats drawn anew (delfim/adoption/trial/hiddenhull.py): inertia from a third to three
times, coefficients up to 40 % off, unequal motors, any wiring, dead bands to 0.15, delays to 0.5 s, wind to 4 m/s, current to
0.3 m/s, a receiver of 1 m and 0.05 m/s that is late and off the middle, a compass of 2 degrees that is off by up to 20 and bent
by up to 10. Those from 40 to 99 are hulls of another hand, programs of their own over UDP in lock step (bench/otherhulls.py),
those from 100 on of boats with one motor that steers, those from 200 on of boats with three or four fixed thrusters
(bench/layouts.py), in any order, unequal by up to 30 %. One hull with 100 seeds takes five
minutes of a core; each trial appends a row to the file, which it is not asked for again, and the table is of all rows.
"""

import argparse
import contextlib
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

import msgspec

from bench import otherhulls
from bench.layouts import LAYOUTS
from delfim import config
from delfim.adoption import identify, magnet
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import Hidden, drawn
from delfim.adoption.trial.manoeuvres import SeaTrial
from delfim.adoption.trial.motors import corrected
from delfim.adoption.trial.session import TrialProgress, TrialSession
from delfim.adoption.trial.taped import record_of
from delfim.base.errors import DelfimError
from delfim.campaign.adopted.truth import BoatTruth, compass_off, figures_off, is_right, truth
from delfim.simulator.model import hull_of
from delfim.simulator.realtime.external_model import SteppedModel
from delfim.simulator.tables import Simulation

BOATS: Final = "heron", "otter", "wam-v", "blueboat"
OTHERS: Final = 40  # the first hull of another hand
STEERED: Final = "skiff", "bait-boat"
STEERED_FROM: Final = 100  # the first hull with one motor that steers
SEVERAL_FROM: Final = 200  # the first hull with three or four thrusters
RADIUS_M: Final = 60.0
CURRENT_MPS, WIND_MPS = 0.3, 4.0  # the strongest


def vehicle(boat: str, *more: str) -> config.Vehicle:
    noise = (f"simulation.{key}={value}" for key, value in NOISE.items())
    return config.load(f"etc/boats/{boat}.toml", ["adopted.proven=false", *noise, *more])


@contextlib.contextmanager
def other_model(settings: config.Vehicle, hull: int, seed: int) -> Iterator[SteppedModel]:
    """A hull of another hand, in a process of its own."""
    here = settings.of(Simulation)
    place = math.radians(here.latitude_deg), math.radians(here.longitude_deg)
    model = SteppedModel(hull_of(settings), "127.0.0.1:0", *place, settings.thrusters)
    port = str(model._socket.getsockname()[1])
    child = subprocess.Popen([sys.executable, otherhulls.__file__, port, str(hull), str(seed)])
    try:
        model.begin()
        yield model
    finally:
        child.kill()
        child.wait()
        model._socket.close()


def other_truth(its: otherhulls.Drawn) -> BoatTruth:
    wiring = its.swapped, tuple(its.reversed), False
    return BoatTruth(wiring, otherhulls.full_mps(its), tuple(its.dead), its.delay_s + its.lag_s)


def drifting(hidden: Hidden) -> Hidden:
    """The same boat in the strongest current and wind that are drawn, both the same way."""
    towards_deg = hidden.sea.current_to_deg
    strong = {"current_mps": CURRENT_MPS, "wind_mps": WIND_MPS, "wind_from_deg": (towards_deg + 180.0) % 360.0}
    return hidden._replace(sea=msgspec.structs.replace(hidden.sea, **strong))


def tried(
    hull: int, seed: int, place: Path, more: Sequence[str] = (), *, motors_alone: bool, drifts: bool = False
) -> dict[str, Any]:
    """One trial: a row of figures."""
    its = otherhulls.drawn(hull - OTHERS, seed) if OTHERS <= hull < STEERED_FROM else None
    boats, layouts = BOATS if hull < OTHERS else STEERED, list(LAYOUTS.items())
    name, layout = layouts[hull % len(layouts)]
    if hull >= SEVERAL_FROM:
        settings = vehicle(layout.boat, *layout.told, *more)
    else:
        name, settings = "", vehicle(boats[hull % len(boats)], *more) if its is None else vehicle(its.hull.boat, *its.hull.told)
    hidden, most_m, began_s = drawn(settings, seed, hull), [0.0], time.process_time()
    hidden = drifting(hidden) if drifts else hidden

    def look(boat: SimulatedTrial) -> None:
        north_m, east_m = boat.model.north_m - boat.middle_m[0], boat.model.east_m - boat.middle_m[1]
        most_m[0] = max(most_m[0], math.hypot(north_m, east_m))

    with contextlib.ExitStack() as held:
        model = held.enter_context(other_model(settings, hull - OTHERS, seed)) if its is not None else None
        boat = SimulatedTrial(settings, hidden, seed, RADIUS_M, look, model)
        progress = TrialProgress(settings.thrusters)
        session = TrialSession(boat, settings, progress, place, RADIUS_M, lambda words: True, lambda words: None)
        ended = session.run() if not motors_alone else _motors(session)
        real = truth(settings, hidden) if its is None else other_truth(its)
        found = progress.wiring
        row = {"hull": hull, "seed": seed, "boat": name or settings.boat.name, "ended": ended, "most_m": most_m[0]}
        row |= {"seconds": session.trial.elapsed_s, "cpu_s": time.process_time() - began_s, "told": hidden.words()}
        if its is None:
            is_so = found is not None and is_right(found, hidden, settings.thrusters)
        else:
            is_so = found is not None and found[:3] == real.wiring
        row["motors"] = "none" if found is None else "right" if is_so else "wrong"
        row["proven"] = progress.is_proven
        row["power"] = max((abs(part) for each in progress.tape for part in each.told), default=0.0)
        if not ended and not motors_alone:
            row |= _figures(settings, hidden, progress, real)
    return row


def _motors(session: TrialSession) -> str:
    """The trial of the motors alone."""
    hull, SeaTrial.hull = SeaTrial.hull, lambda self, *told: None  # type: ignore[method-assign]
    try:
        return session.run()
    finally:
        SeaTrial.hull = hull  # type: ignore[method-assign]


def _figures(settings: config.Vehicle, hidden: Hidden, progress: TrialProgress, real: BoatTruth) -> dict[str, Any]:
    """What the fit and the compass alone say, less the truth."""
    assert progress.motors is not None
    record = record_of(progress, is_estimated=settings.navigation.estimator)
    row = dict[str, Any]()
    try:
        row |= _compass("compass", hidden, magnet.compass_of(record))
    except DelfimError as error:
        row["compass_refused"] = str(error)
    rows = zip(settings.thrusters, corrected(progress.motors, settings.thrusters), strict=True)
    owner = msgspec.structs.replace(settings, thrusters=tuple(msgspec.structs.replace(row, **keys) for row, keys in rows))
    began_s = time.process_time()
    try:
        result = identify.identified(record, owner, "2026-11-27")
    except DelfimError as error:
        return row | {"refused": str(error)}
    row |= {"fit_s": time.process_time() - began_s, "chi2": result.fit.chi2, "refused": result.fit.refusal}
    return row | figures_off(result, settings, hidden, real)


def _compass(name: str, hidden: Hidden, found: magnet.CompassFound) -> dict[str, Any]:
    numbers = {
        "hard_ahead": found.hard[0],
        "hard_aside": found.hard[1],
        "soft_along": found.soft[0],
        "soft_across": found.soft[1],
    }
    row = _bent(name, hidden, numbers | {"compass_offset": found.offset_rad})
    return row | {
        "apart": found.shape.apart,
        "circles_deg": math.degrees(found.shape.residual_rad),
        "place": found.shape.hopeless,
    }


def _bent(name: str, hidden: Hidden, numbers: dict[str, Any]) -> dict[str, float]:
    """Offset and deviation less the truth, degrees: the mean over all headings, and the rest, rms and at most."""
    off = compass_off(hidden, numbers)
    return {f"{name}_offset_deg": off.offset_deg, f"{name}_rms_deg": off.rms_deg, f"{name}_most_deg": off.most_deg}


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """The figures of all rows, by boat."""
    kinds = dict[str, list[dict[str, Any]]]()
    for row in rows:
        kinds.setdefault(row["boat"] + (", another hand" if OTHERS <= row["hull"] < STEERED_FROM else ""), []).append(row)
    yield "| boat | trials | motors right | wrong | no clear answer | whole | way, m, median (most) | s, median (most) |"
    yield "|---|---|---|---|---|---|---|---|"
    for name, its in [*kinds.items(), ("all", rows)]:
        counts = [sum(row["motors"] == how for row in its) for how in ("right", "wrong", "none")]
        whole = sum(not row["ended"] for row in its)
        ways, seconds = ([row[key] for row in its] for key in ("most_m", "seconds"))
        told = f"{median(ways):.0f} ({max(ways):.0f}) | {median(seconds):.0f} ({max(seconds):.0f})"
        yield f"| {name} | {len(its)} | {' | '.join(map(str, [*counts, whole]))} | {told} |"
    yield ""
    taken = [row for row in rows if row.get("refused") == ""]
    yield f"{sum('refused' in row for row in rows)} fits, {len(taken)} taken; of these within:"
    within: list[tuple[str, Callable[[dict[str, Any]], float | None], float]] = [
        ("full speed 5 %, where it was sailed", lambda row: None if row["beyond"] else row["full_off"], 0.05),
        ("full speed 5 %, extrapolated", lambda row: row["full_off"] if row["beyond"] else None, 0.05),
        ("dead band 2 % of command", lambda row: row["dead_off"], 0.02),
        ("angle at which she goes straight 1.5 degrees", lambda row: row.get("straight_off_deg"), 1.5),
        ("delay and lag 0.1 s", lambda row: row["late_off_s"], 0.1),
        ("offset of the compass 1 degree, by the fit", lambda row: row["offset_off_deg"], 1.0),
        ("deviation 1.5 degrees, by the fit", lambda row: row["deviation_off_deg"], 1.5),
        ("offset of the compass 1 degree, alone", lambda row: row.get("compass_offset_deg"), 1.0),
        ("deviation 1.5 degrees, alone", lambda row: row.get("compass_most_deg"), 1.5),
    ]
    for words, of, most in within:
        off = sorted(abs(value) for row in taken if (value := of(row)) is not None)
        if off:
            inside = sum(each <= most for each in off)
            yield f"  {words}: {inside} of {len(off)}; median {median(off):.3g}, 95 % {off[int(0.95 * (len(off) - 1))]:.3g}"
    ends = dict[str, int]()
    for row in rows:
        for why in (row["ended"], row.get("refused") or "", row.get("compass_refused") or "", row.get("place") or ""):
            key = "".join(each for each in why if not each.isdigit())
            ends[key] = ends.get(key, 0) + bool(why)
    yield from (f"  {count} x {why}" for why, count in sorted(ends.items(), key=lambda each: -each[1]) if count)


def span(text: str) -> range:
    first, _, last = text.partition(":")
    return range(int(first), int(last) if last else int(first) + 1)


def _rows(file: Path) -> Iterator[dict[str, Any]]:
    yield from (json.loads(line) for line in (file.read_text() if file.exists() else "").splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.adoption", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hulls", type=span, default=range(44), metavar="FIRST:LAST", help="Without the last.")
    parser.add_argument("--seeds", type=span, default=range(1, 4), metavar="FIRST:LAST", help="Without the last.")
    parser.add_argument("--motors", action="store_true", help="Of each trial the motors alone.")
    parser.add_argument("--drift", action="store_true", help="In a current of 0.3 and a wind of 4 m/s, both the same way.")
    parser.add_argument("--rows", type=Path, default=Path("run/adoption.jsonl"), metavar="FILE")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="Laid over the boats' files.")
    asked = parser.parse_args()
    asked.rows.parent.mkdir(parents=True, exist_ok=True)
    had = {(row["hull"], row["seed"]) for row in _rows(asked.rows)}
    with tempfile.TemporaryDirectory() as folder:
        for hull in asked.hulls:
            for seed in (each for each in asked.seeds if (hull, each) not in had):
                row = tried(
                    hull, seed, Path(folder) / f"{hull}-{seed}.trial", asked.set, motors_alone=asked.motors, drifts=asked.drift
                )
                with asked.rows.open("a") as rows:
                    rows.write(json.dumps(row, default=float) + "\n")
    print("\n".join(table(list(_rows(asked.rows)))))


if __name__ == "__main__":
    main()
