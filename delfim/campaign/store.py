"""The folder of a campaign: rows in Parquet parts, written by one process, each batch once.

A part gets its name when it is complete and on the disk; a batch counts when its number stands in a named part. So nothing is
lost and nothing is there twice, whatever the workers do, and a campaign that was interrupted goes on with what is missing.
"""

import json
import os
import platform
import time
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from delfim.base.errors import DelfimError, in_words
from delfim.base.input.untrusted import parse_json, read_text
from delfim.campaign.adopted.columns import COLUMNS
from delfim.campaign.measures import MEASURES
from delfim.campaign.runplan import Plan

PART_ROWS: Final = 5000
PART_S: Final = 10.0  # a part is written when it has so many rows, or after this time
HEAD: Final = "campaign.json"
PACKAGES: Final = ("msgspec", "python-can", "pymavlink", "numpy", "pyarrow", "duckdb", "matplotlib", "distributed")
_KINDS: Final = {"DOUBLE": pa.float64(), "INTEGER": pa.int64(), "VARCHAR": pa.string()}
_VALUES: Final = {bool: pa.bool_(), int: pa.float64(), float: pa.float64(), str: pa.string()}


def packages() -> dict[str, str]:
    """The versions of those of PACKAGES that are installed, by name."""
    found = dict[str, str]()
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def schema(plan: Plan) -> pa.Schema:
    """The columns of the results. Raises DelfimError where the values of a key are of several kinds."""
    keys = dict[str, set[Any]]()
    for _, values in plan.points:
        for key, value in values.items():
            keys.setdefault(key, set()).add(_VALUES[type(value)])
    for key, how in plan.draw.items():
        keys[key] = {_VALUES[type(each)] for each in how.choice} or {pa.float64()}
    if mixed := [key for key, kinds in keys.items() if len(kinds) > 1]:
        raise DelfimError(f"{mixed[0]}: its values are of several kinds")
    fields = [("batch", pa.int64()), ("point", pa.int32()), ("seed", pa.int64())]
    fields += [("vehicle", pa.string()), ("story", pa.string())]
    fields += [(key, *kinds) for key, kinds in keys.items()]
    fields += [("ok", pa.bool_()), ("failures", pa.list_(pa.string())), ("error", pa.string())]
    fields += [(each.name, _KINDS[each.kind]) for each in (COLUMNS if plan.is_adoption else MEASURES)]
    fields += [
        ("wall_s", pa.float64()),
        ("cpu_s", pa.float64()),
        ("host", pa.string()),
        ("pid", pa.int64()),
        ("version", pa.string()),
    ]
    return pa.schema(fields)


class Store:
    """The folder, opened by the only process that writes there. Its memory does not grow with the runs: of batches that are
    there, the first that is missing, and those beyond it."""

    def __init__(self, folder: Path, plan: Plan, size: int, version: str) -> None:
        """Open the folder. `size`: runs of a batch. Raises DelfimError where the folder holds another campaign or results of
        other code."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._schema = folder, schema(plan)
        head = {"name": plan.name, "digest": plan.digest, "runs": plan.runs, "batch": size, "version": version}
        head |= {"platform": platform.platform(), "packages": packages()}
        head |= {"vehicles": {story.boat: story.vehicle for story in plan.stories}}
        place = folder / HEAD
        if place.exists():
            _same(folder, head_of(folder), head)
        place.write_text(json.dumps(head, indent=1, default=str) + "\n", encoding="utf-8")
        for left in folder.glob("*.tmp"):
            left.unlink()
        self._rows, self._since_s = list[dict[str, Any]](), time.monotonic()
        self._parts = sorted(folder.glob("part-*.parquet"))
        self._next = int(self._parts[-1].stem.removeprefix("part-")) + 1 if self._parts else 0
        self._missing, self._beyond, self.runs, self.failed = 0, set[int](), 0, 0
        if self._parts:
            sql = f"select batch, count(*), count_if(not ok) from {parts(folder)} group by batch order by batch"
            try:
                with duckdb.connect() as database:
                    answer = database.execute(sql)
                    while row := answer.fetchone():
                        self._count(*row)
            except duckdb.Error as error:
                raise DelfimError(f"{folder}: {str(error).partition(chr(10))[0]}") from None

    def has(self, batch: int) -> bool:
        """Whether a batch need not be sailed again."""
        return batch < self._missing or batch in self._beyond

    def _count(self, batch: int, runs: int, failed: int) -> None:
        self._beyond.add(batch)
        while self._missing in self._beyond:
            self._beyond.remove(self._missing)
            self._missing += 1
        self.runs, self.failed = self.runs + runs, self.failed + failed

    def add(self, batch: int, rows: list[dict[str, Any]]) -> None:
        """Take the rows of a batch, unless they are there."""
        if self.has(batch):
            return
        self._count(batch, len(rows), sum(not row["ok"] for row in rows))
        self._rows += rows
        if len(self._rows) >= PART_ROWS or time.monotonic() - self._since_s > PART_S:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting as a part."""
        self._since_s = time.monotonic()
        if not self._rows:
            return
        place = self.folder / f"part-{self._next:06}.parquet"
        new = place.with_suffix(".tmp")
        pq.write_table(pa.Table.from_pylist(self._rows, self._schema), new, compression="zstd")
        with open(new, "rb") as file:
            os.fsync(file.fileno())
        os.replace(new, place)
        self._next, self._rows = self._next + 1, []


def head_of(folder: Path) -> dict[str, Any]:
    """Read the head that a campaign wrote. Raises DelfimError."""
    try:
        head = parse_json(read_text(folder / HEAD))
    except OSError as error:
        raise DelfimError(f"{folder / HEAD}: {in_words(error)}") from None
    if not isinstance(head, dict):
        raise DelfimError(f"{folder / HEAD} is damaged")
    return head


def _same(folder: Path, was: dict[str, Any], head: dict[str, Any]) -> None:
    for key, words in (
        ("digest", "another campaign"),
        ("batch", "batches of another size"),
        ("version", "results of other code"),
    ):
        if was.get(key) != head[key]:
            raise DelfimError(f"{folder} holds {words} ({was.get(key)}, here {head[key]}): take another folder with --output")


def parts(folder: Path) -> str:
    """The results as a table of DuckDB's SQL."""
    return "read_parquet('{}')".format(str(folder / "part-*.parquet").replace("'", "''"))
