"""Queries of the results: SQL over the table `runs`, and answers that everybody wants."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple

import duckdb
import numpy as np

from delfim.base.errors import DelfimError
from delfim.campaign.adopted.columns import COLUMNS
from delfim.campaign.measures import MEASURES
from delfim.campaign.runplan import Answer, CampaignFile, Pass, Plan
from delfim.campaign.store import parts, schema

_KINDS: Final = {each.name: each.kind for each in MEASURES} | {each.name: each.kind for each in COLUMNS}
NUMBERS: Final = tuple(name for name, kind in _KINDS.items() if kind != "VARCHAR")
JUDGED: Final = ("cross_rms_m", "cross_max_m", "noticed_s", "energy_j", "sailed_s")  # the greatest are the worst, in this order
QUANTILES: Final = (0.05, 0.5, 0.95)
WILSON: Final = 1.959964  # of the normal distribution: 95 %


class Holding(NamedTuple):
    """The verdict of one [[pass]]; `where` are the points at which it does not hold."""

    name: str
    holds: bool
    where: tuple[int, ...] = ()


class Printed(NamedTuple):
    """A [[table]] of the file with its results."""

    name: str
    columns: list[str]
    rows: list[tuple[Any, ...]]


class Quantity(NamedTuple):
    """A measure over all runs that have it."""

    name: str
    runs: int
    low: float
    middle: float
    high: float


def connect(folder: Path) -> duckdb.DuckDBPyConnection:
    """Open the results of a campaign as the table `runs`. Raises DelfimError where there are none, or damaged ones."""
    if not any(folder.glob("part-*.parquet")):
        raise DelfimError(f"no results in {folder}")
    database = duckdb.connect()
    try:
        database.execute(f"create view runs as select * from {parts(folder)}")
        database.execute("set allowed_directories = [?]", [f"{folder}/"])
    except (duckdb.Error, UnicodeDecodeError) as error:
        raise DelfimError(str(error).partition("\n")[0]) from None
    return _locked(database)


def _locked(database: duckdb.DuckDBPyConnection) -> duckdb.DuckDBPyConnection:
    """Lock the database: a campaign's file may come from anybody, and its SQL reaches no other file, no network, no extension
    and no variable here."""
    database.execute("set enable_external_access = false; set python_enable_replacements = false")
    database.execute("set lock_configuration = true")
    return database


def selected(database: duckdb.DuckDBPyConnection, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Run a SELECT; returns its columns and rows. Raises DelfimError with DuckDB's words, and for anything but one SELECT."""
    try:
        if [each.type for each in database.extract_statements(sql)] != [duckdb.StatementType.SELECT]:
            raise DelfimError("not one SELECT: nothing else is done")
        answer = database.execute(sql)
        return [each[0] for each in answer.description or ()], answer.fetchall()
    except (duckdb.Error, UnicodeDecodeError) as error:
        raise DelfimError(str(error).partition("\n")[0]) from None


def rehearse(file: CampaignFile, plan: Plan) -> list[Printed]:
    """Run all queries over results without a run, before the first one is sailed; returns the tables, which have columns alone.
    Raises DelfimError for what is no SQL."""
    with duckdb.connect() as database:
        _locked(database).register("runs", schema(plan).empty_table())
        verdicts(database, file.must)
        return answered(database, file.answers)


def verdicts(database: duckdb.DuckDBPyConnection, passes: Iterable[Pass]) -> list[Holding]:
    """The verdict of each [[pass]] of the file; one that gives no truth does not hold. Raises DelfimError for one that is no
    SQL."""
    told = list[Holding]()
    for each in passes:
        if each.each == "point":
            rows = _named(each.name, database, f"select point, ({each.sql}) from runs group by point order by point")[1]
            where = tuple(point for point, holds in rows if holds is not True)
            told.append(Holding(each.name, not where, where))
        else:
            rows = _named(each.name, database, f"select ({each.sql}) from runs")[1]
            told.append(Holding(each.name, bool(rows) and rows[0][0] is True))
    return told


def answered(database: duckdb.DuckDBPyConnection, asked_for: Iterable[Answer]) -> list[Printed]:
    """The results of each [[table]] of the file. Raises DelfimError for one that is no SQL."""
    return [Printed(each.name, *_named(each.name, database, each.sql)) for each in asked_for]


def _named(name: str, database: duckdb.DuckDBPyConnection, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    try:
        return selected(database, sql)
    except DelfimError as error:
        raise DelfimError(f"{name}: {error}") from None


def share(part: int, of: int) -> tuple[float, float]:
    """The 95 % confidence interval of a share (Wilson 1927): 0 of 600 is 0 to 0.6 %."""
    if not of:
        return 0.0, 1.0
    z2, p = WILSON**2, part / of
    middle, half = (
        (p + z2 / (2 * of)) / (1 + z2 / of),
        WILSON / (1 + z2 / of) * math.sqrt(p * (1 - p) / of + z2 / (4 * of * of)),
    )
    return max(middle - half, 0.0), min(middle + half, 1.0)


def quantities(database: duckdb.DuckDBPyConnection) -> list[Quantity]:
    """The quantiles of each measure."""
    found = list[Quantity]()
    there = {name for (name,) in selected(database, "select column_name from (describe runs)")[1]}
    for name in (each for each in NUMBERS if each in there):
        sql = f"select count({name}), {', '.join(f'quantile_cont({name}, {part})' for part in QUANTILES)} from runs"
        runs, *values = selected(database, sql)[1][0]
        if runs:
            found.append(Quantity(name, runs, *values))
    return found


def failed(database: duckdb.DuckDBPyConnection) -> list[tuple[str, int, int, int]]:
    """The reasons why runs failed: (words without numbers, how often, point and seed of one), the most frequent first."""
    sql = """select regexp_replace(why, '-?[0-9]+(\\.[0-9]+)?', 'N', 'g') as words, count(*), arg_min(point, seed), min(seed)
             from (select point, seed, unnest(if(error = '', failures, [error])) as why from runs where not ok)
             group by words order by count(*) desc, words"""
    return [(words, many, point, seed) for words, many, point, seed in selected(database, sql)[1]]


def worst(database: duckdb.DuckDBPyConnection, count: int = 10) -> list[tuple[int, int, str]]:
    """The worst runs, (point, seed, why): those that failed, then those with the greatest value of the first of JUDGED that
    there is."""
    words = "case when error <> '' then error else array_to_string(failures, '; ') end"
    rows = selected(database, f"select point, seed, {words} from runs where not ok order by point, seed limit {count}")[1]
    known = {each.name for each in quantities(database)}
    name = next((name for name in JUDGED if name in known), "sailed_s")
    unit = name.rpartition("_")[2]
    sql = f"select point, seed, {name} from runs where ok and {name} is not null order by {name} desc limit {count - len(rows)}"
    return rows + [
        (point, seed, f"{name.rpartition('_')[0]} {value:.4g} {unit}") for point, seed, value in selected(database, sql)[1]
    ]


def numeric(database: duckdb.DuckDBPyConnection, keys: Iterable[str]) -> list[str]:
    """Those of the keys whose values are numbers and not all the same."""
    found = list[str]()
    kinds = dict(selected(database, "select column_name, column_type from (describe runs)")[1])
    for key in keys:
        if kinds.get(key) == "DOUBLE" and selected(database, f'select count(distinct "{key}") from runs')[1][0][0] > 1:
            found.append(key)
    return found


def sensitivity(database: duckdb.DuckDBPyConnection, keys: Iterable[str]) -> list[tuple[str, str, float]]:
    """The effect of keys on measures: (key, measure, rank correlation -1..1), the strongest first. Without a varied or drawn
    key there is none."""
    found = list[tuple[str, str, float]]()
    known = [each.name for each in quantities(database)]
    for key in numeric(database, keys):
        for name in known:
            rows = np.array(selected(database, f'select "{key}", {name} from runs where {name} is not null')[1], dtype=float)
            ranks = [np.unique(column, return_inverse=True) for column in rows.T]
            if len(rows) < 3 or any(len(values) < 2 for values, _ in ranks):
                continue
            found.append((key, name, float(np.corrcoef(*[_middle(order) for _, order in ranks])[0, 1])))
    return sorted(found, key=lambda each: -abs(each[2]))


def _middle(order: Any) -> Any:
    """The ranks of an order; equal values share the middle of theirs."""
    counts = np.bincount(order)
    return (np.cumsum(counts) - (counts - 1) / 2)[order]


def shown(columns: list[str], rows: list[tuple[Any, ...]]) -> str:
    """Format an answer as a table of text."""
    table = [columns, *([_word(value) for value in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ("  ".join(f"{word:{width}}" for word, width in zip(row, widths, strict=True)) for row in table)
    return "\n".join(line.rstrip() for line in lines)


def _word(value: object) -> str:
    if isinstance(value, list):
        return "; ".join(map(_word, value))
    return f"{value:.6g}" if isinstance(value, float) else "" if value is None else str(value)
