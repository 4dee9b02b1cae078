"""The state log: records of fixed size behind a header that explains them, so that reading needs no code of ours.

    DELFIM STATE 1
    {"record_bytes": 17, "byte_order": "little", "fields": [{"name": "heading", "code": "f", "unit": "rad", ...}, ...], ...}
    record record record ...

Codes are those of Python's struct and numpy's dtype; records are packed without gaps. docs/log-format.md has readers.
"""

import json
import logging
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json
from delfim.logging.liblog import in_order
from delfim.logging.reading import read_log

MAGIC: Final = b"DELFIM STATE 1\n"
CODES: Final = "?bBhHiIqQfd"
ALIGNMENT: Final = 64  # bytes; of the first record, for those who map the file

Row = tuple[str, str, str, str]  # name, struct code, unit, description

logger = logging.getLogger(__name__)


class Schema:
    """The fields of a record.

    `rows` are (name, code, unit, description), codes out of CODES. Raises FormatError for other codes and a name used twice.
    `started_ns`, since 1970, is when the program started; 0 where unknown.
    """

    def __init__(self, rows: Sequence[Row], *, boat: str = "", started_ns: int = 0) -> None:
        self.rows, self.boat, self.started_ns = tuple(rows), boat, started_ns
        self.names = tuple(row[0] for row in self.rows)
        codes = [row[1] for row in self.rows]
        if not codes or any(len(code) != 1 or code not in CODES for code in codes):
            raise FormatError(f"a state record has fields of one code each, out of {CODES}: {codes}")
        if len(set(self.names)) < len(self.names):
            raise FormatError("two fields of a state record have the same name")
        self.struct = struct.Struct("<" + "".join(codes))

    @property
    def header(self) -> bytes:
        """The header of every file. Its second line is padded with blanks, so that records start at a multiple of 64."""
        told = {
            "record_bytes": self.struct.size,
            "byte_order": "little",
            "boat": self.boat,
            "started_ns": self.started_ns,
            "fields": [dict(zip(("name", "code", "unit", "description"), row, strict=True)) for row in self.rows],
        }
        text = MAGIC + json.dumps(told).encode()
        return text + b" " * (-(len(text) + 1) % ALIGNMENT) + b"\n"

    @classmethod
    def parse(cls, content: bytes) -> tuple["Schema", int]:
        """Parse the schema at the head of a file, and where its records start. Raises FormatError."""
        end = content.find(b"\n", len(MAGIC)) + 1
        if not content.startswith(MAGIC) or not end:
            raise FormatError("not a state log: it starts with another header, or with an incomplete one")
        try:
            told = parse_json(content[len(MAGIC) : end])
            rows = [(str(f["name"]), str(f["code"]), str(f["unit"]), str(f["description"])) for f in told["fields"]]
            schema = cls(rows, boat=str(told["boat"]), started_ns=int(told["started_ns"]))
            fits = told["record_bytes"] == schema.struct.size and told["byte_order"] == "little"
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise FormatError(f"the header of this state log is unreadable: {type(error).__name__}") from None
        if not fits:
            raise FormatError("the header of this state log contradicts itself")
        return schema, end


class StateWriter:
    """Packs records and puts them. `rejected` counts those that do not fit the schema, `reason` is that of the last."""

    def __init__(self, put: Callable[[bytes], bool], schema: Schema) -> None:
        self.rejected, self.reason = 0, ""
        self._pack, self._put = schema.struct.pack, put

    def put(self, values: Sequence[object]) -> bool:
        """Log one record, its values in the order of the schema. False: it was not logged. It never raises: the caller
        steers."""
        try:
            record = self._pack(*values)
        except (struct.error, OverflowError) as error:
            self.rejected += 1
            self.reason = f"a record does not fit the schema: {error}"
            return False
        return self._put(record)


class StateFile(NamedTuple):
    schema: Schema
    records: Iterator[tuple[Any, ...]]  # values in the order of the schema
    complaint: str  # the file's damage in words: cut, damaged, its last record incomplete; empty if there is none


def read_state(path: str | Path) -> StateFile:
    """Read a state log, deflated or not, as far as it can be read. Raises OSError, and FormatError for its header."""
    content, complaint = read_log(path)
    try:
        schema, start = Schema.parse(content)
    except FormatError as error:
        raise FormatError(f"{path}: {error}" + (f" ({complaint})" if complaint else "")) from None
    rest = (len(content) - start) % schema.struct.size
    if rest and not complaint:
        complaint = f"{path}: the last record is incomplete"
    return StateFile(schema, schema.struct.iter_unpack(memoryview(content)[start : len(content) - rest]), complaint)


def columns(paths: Iterable[str | Path]) -> dict[str, list[Any]]:
    """Read the records of several files, oldest first, as one list for each field. NaN where a file does not have a field.

    Damage to a file is logged as a warning; a file without a readable header is left out. Raises OSError.
    """
    result: dict[str, list[Any]] = {}
    count = 0
    for path in in_order(map(Path, paths)):
        try:
            schema, records, complaint = read_state(path)
        except FormatError as error:
            logger.warning("left out: %s", error)
            continue
        if complaint:
            logger.warning("%s", complaint)
        new = dict(zip(schema.names, zip(*records, strict=True), strict=False))
        more = max(map(len, new.values()), default=0)
        for name in schema.names:
            result.setdefault(name, [math.nan] * count)
        for name, column in result.items():
            column.extend(new.get(name, [math.nan] * more))
        count += more
    return result
