"""Repeats one run of a campaign, with its log and a picture of its track; it must be the same to the last byte."""

from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.campaign import queries
from delfim.campaign.runplan import Plan
from delfim.campaign.sailing import VERSION, sailed_run
from delfim.logging.ashore import plot
from delfim.logging.statelog import columns


def sail(plan: Plan, folder: Path, point: int, seed: int) -> int:
    """Sail the run here and print what happened. Returns 1 where it differs from the results. Raises DelfimError."""
    place = folder / f"again-{point}-{seed}"
    if place.exists():
        raise DelfimError(f"{place} is there already")
    sailed, failures = sailed_run(plan, point, seed, log=str(place.resolve()))
    for key, value in plan.values(point, seed).items():
        print(f"  {key} = {value}")
    for event in sailed.events:
        print(f"  {event.t_s:7.1f} s  {event.kind:10} {event.name}  {event.text}".rstrip())
    print(f"  end: {sailed.end}", *(f"  failed: {words}" for words in failures), sep="\n")
    data = columns(place.glob("*/state/*.state*"))
    plot.track(data, [], f"{plan.name}: point {point}, seed {seed}", place / "track.png")
    print(f"  log {place}, picture {place / 'track.png'}")
    return _compare(folder, point, seed, sailed.tape.hash.hexdigest())


def _compare(folder: Path, point: int, seed: int, digest: str) -> int:
    sql = f"select digest, version from runs where point = {point} and seed = {seed}"
    rows = queries.selected(queries.connect(folder), sql)[1] if any(folder.glob("part-*.parquet")) else []
    if not rows:
        print(f"  digest {digest}; this run is not among the results")
        return 0
    if rows[0][0] == digest:
        print(f"  digest {digest}: the same run to the last byte")
        return 0
    print(f"  digest {digest}: NOT the run of the results, {rows[0][0]}; that was sailed by {rows[0][1]}, this by {VERSION}")
    return 1
