"""The table of pairs that a campaign has met (`delfim.simulator.scenarios.pairs`), for people."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import duckdb

from delfim.base.errors import DelfimError
from delfim.campaign import queries
from delfim.simulator.scenarios.pairs import ALL, PAIRS, THINGS, kind_of

LEAST: Final = 10  # pairs that are named one by one
NEVER: Final = 40
SQL: Final = """select place::integer, count(*) from (select unnest(string_split(pairs, ' ')) as place from runs
  where pairs is not null) where place <> '' group by place"""
_COUNTED: Final = frozenset(ALL)
_POSSIBLE: Final = frozenset(PAIRS)
Counts = Mapping[tuple[str, str], int]


def counted(database: duckdb.DuckDBPyConnection) -> dict[tuple[str, str], int]:
    """The number of runs in which each pair was met, of those that were."""
    return {ALL[int(place)]: int(runs) for place, runs in queries.selected(database, SQL)[1]}


def part(counts: Counts) -> float:
    """The fraction of the possible pairs that were met."""
    return sum(pair in counts for pair in PAIRS) / len(PAIRS)


def lines(counts: Counts) -> list[str]:
    """Lines about the pairs by kind, and the rarest by name."""
    met = sorted((pair for pair in PAIRS if pair in counts), key=lambda pair: (counts[pair], pair))
    never = [pair for pair in PAIRS if pair not in counts]
    told = [f"pairs met: {len(met)} of {len(PAIRS)} that are possible, {part(counts):.2%}"]
    for kinds in dict.fromkeys(tuple(map(kind_of, pair)) for pair in PAIRS):
        those = [pair for pair in PAIRS if tuple(map(kind_of, pair)) == kinds]
        told.append(f"  {' and '.join(kinds):20} {sum(pair in counts for pair in those):5} of {len(those)}")
    told += [f"  least met: {' with '.join(pair)}, {counts[pair]} runs" for pair in met[:LEAST]]
    told += [f"  never met: {' with '.join(pair)}" for pair in never[:NEVER]]
    told += [f"  never met: {len(never) - NEVER} more"] if len(never) > NEVER else []
    return told + [f"  MET, and held to be impossible: {' with '.join(pair)}, {counts[pair]} runs" for pair in wrong(counts)]


def wrong(counts: Counts) -> list[tuple[str, str]]:
    """Pairs that were met although they are held to be impossible."""
    return sorted(pair for pair in counts if pair not in _POSSIBLE)


def picture(counts: Counts) -> str:
    """A character for each pair: how many digits the number of runs has that met it."""
    across = [thing for thing in THINGS if kind_of(thing) != "order"]
    names = [thing.partition(" ")[2] for thing in across]
    high = max(map(len, names))
    rows = ["".join(name.rjust(high)[i] + " " for name in names) for i in range(high)]
    down = [thing for thing in THINGS if kind_of(thing) != "mode"]
    wide = max(map(len, down))
    told = [f"{'':{wide}}  {row}".rstrip() for row in rows]
    told += [f"{thing:{wide}}  {''.join(_square(counts, other, thing) + ' ' for other in across)}".rstrip() for thing in down]
    key = "a digit: how many digits has the number of runs that met the pair; . never met; - impossible"
    return "\n".join([*told, key])


def _square(counts: Counts, one: str, other: str) -> str:
    pair = (one, other)
    if pair not in _COUNTED:
        return " "
    if pair in counts:
        return str(len(str(counts[pair])))
    return "." if pair in _POSSIBLE else "-"


def tell(database: duckdb.DuckDBPyConnection, least: float, folder: Path) -> bool:
    """Print the table, and keep the picture as pairs.txt. Returns whether so many are met, and none that cannot be."""
    counts = counted(database)
    if not counts:
        raise DelfimError("no run met any pair")
    told = picture(counts)
    (folder / "pairs.txt").write_text(told + "\n", encoding="utf-8")
    print(f"\n{told}\n", *lines(counts), sep="\n")
    return part(counts) >= least and not wrong(counts)
