"""The state log of each boat: its header, the first record, and one under way."""

import hashlib
import struct
import tempfile
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

from delfim import config
from delfim.logging.statelog import MAGIC, Schema
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.log.logbook import Logbook
from tests.oracles.keeping import Lines
from tests.oracles.voyages import DELFIMX, ROOT

SAILED_S: Final = 15.0
ALL: Final = "fields of all boats"


def state_logs() -> Lines:
    """By boat. Fields that all have are written once."""
    found: Lines = {}
    for file in (*sorted((ROOT / "etc/boats").glob("*.toml")), DELFIMX):
        found[str(file.relative_to(ROOT))] = list(_log(file))
    common = [lines[0] for lines in takewhile(lambda lines: len(set(lines)) == 1, zip(*found.values(), strict=False))]
    return {ALL: common} | {name: lines[len(common) :] for name, lines in found.items()}


def _log(file: Path) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as place:
        settings = config.load(file, (f'log.directory="{place}"', 'log.state_method="write"', "log.free_bytes_min=0"))
        run = Lockstep(settings, 1, lambda clock: Logbook(settings, clock))
        run.sail(config.mission_place(str(file), settings).read_text(), SAILED_S)
        run.close()
        (log,) = Path(place).glob("*/state/*.state")
        content = log.read_bytes()
    schema, start = Schema.parse(content)
    for name, code, unit, words in schema.rows:
        yield f"field {name} {code} {unit or '-'}: {words}"
    records = [content[at : at + schema.struct.size] for at in range(start, len(content), schema.struct.size)]
    for number in (0, len(records) - 2):
        yield f"record {number + 1}: {' '.join(_cut(records[number], schema))}"
    yield f"boat {schema.boat}; started_ns {schema.started_ns}; {schema.struct.size} bytes in a record"
    yield f"begins with {MAGIC.decode().strip()}; {start} bytes of header, digest {_digest(content[:start])}"


def _cut(record: bytes, schema: Schema) -> Iterator[str]:
    """The bytes of each field."""
    at = 0
    for _, code, _, _ in schema.rows:
        size = struct.calcsize(f"<{code}")
        yield record[at : at + size].hex()
        at += size


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def explained(then: str, now: str, kept: Lines, here: Lines, name: str) -> str:
    """The first field of a record that differs, with both values; empty where these are no records."""
    if not (then.startswith("record ") and now.startswith("record ")):
        return ""
    was, values = (_values(line, [*of[ALL], *of[name]]) for line, of in ((then, kept), (now, here)))
    for field, value in was.items():
        if repr(value) != repr(values.get(field)):
            return f"{then.partition(':')[0]}, field {field}: kept {value!r}, now {values.get(field, 'not there')!r}"
    return f"{then.partition(':')[0]}: what was kept is the same, and there is more"


def _values(record: str, lines: list[str]) -> dict[str, Any]:
    """By field, of which there is a line each."""
    fields = (line.split()[1:3] for line in lines if line.startswith("field "))
    return {
        name: struct.unpack(f"<{code}", bytes.fromhex(data))[0]
        for (name, code), data in zip(fields, record.split()[2:], strict=True)
    }
