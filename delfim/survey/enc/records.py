"""The records of a file of ISO 8211, as far as they tell whether a chart is whole: cells, updates and catalogues of S-57.

Shapes and attributes are read by GDAL; it says nothing where a file ends early, or an update is missing.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

LEADER: Final = 24
UNIT: Final = b"\x1f"  # ends a value in a field
FEATURE: Final = 100  # the name of all records of objects; those of shapes are 110 to 130
COUNTED: Final = {
    ("NOMR", "NOCR", "NOGR", "NOLR"): FEATURE,
    ("NOIN",): 110,
    ("NOCN",): 120,
    ("NOED",): 130,
}  # by the counts in DSSI
COUNTS: Final = "NOMR", "NOCR", "NOGR", "NOLR", "NOIN", "NOCN", "NOED", "NOFA"
CATD_HEAD: Final = 12  # characters before the name of a file in a catalogue
CRCS: Final = 7  # which value of its entry is the checksum

Record = dict[str, bytes]
"""The fields of a record by their tags."""


class DataSet(NamedTuple):
    """What the head of a cell or an update says of itself."""

    name: str
    edition: int
    update: int


def records(data: bytes) -> Iterator[Record]:
    """The records of a file behind the first, which describes them. Raises FormatError where they do not fill it exactly."""
    at = 0
    while at < len(data):
        try:
            length, base = int(data[at : at + 5]), int(data[at + 12 : at + 17])
            wide, far, tag = (int(data[at + n : at + n + 1]) for n in (20, 21, 23))
        except ValueError:
            raise FormatError(f"not a file of S-57: no record begins at byte {at}") from None
        if at + length > len(data):
            raise FormatError(f"cut short: it ends within a record, {at + length - len(data)} bytes early")
        entry = tag + wide + far
        if not (wide and far and tag) or length <= base or base <= LEADER or (base - LEADER - 1) % entry:
            raise FormatError(f"not a file of S-57: the record at byte {at} contradicts itself")
        found = Record()
        for place in range(at + LEADER, at + base - 1, entry):
            row = data[place : place + entry]
            try:
                size, begin = int(row[tag : tag + wide]), int(row[tag + wide :])
            except ValueError:
                raise FormatError(f"not a file of S-57: the record at byte {at} has no directory") from None
            found[row[:tag].decode("latin-1")] = data[at + base + begin : at + min(base + begin + size, length)]
        if data[at + 6 : at + 7] != b"L":
            yield found
        at += length


def checked(data: bytes) -> DataSet:
    """The head of a cell or an update whose records are all there. Raises FormatError."""
    head, told, seen = None, dict[str, int](), Counter[int]()
    for record in records(data):
        if "DSID" in record:
            head = _head(record["DSID"])
        if "DSSI" in record and len(record["DSSI"]) >= 35:
            told = dict(zip(COUNTS, struct.unpack_from("<8I", record["DSSI"], 3), strict=True))
        for name in ("FRID", "VRID"):
            if record.get(name):
                seen[record[name][0]] += 1
    if head is None or not told:
        raise FormatError("not a cell of S-57: it has no head")
    for names, kind in COUNTED.items() if head.update == 0 else ():
        if seen[kind] != (count := sum(told[name] for name in names)):
            raise FormatError(f"it has {seen[kind]} records of {count} ({' + '.join(names)}): cut short, or changed")
    return head


def _head(field: bytes) -> DataSet:
    texts = field[7:].split(UNIT)
    try:
        return DataSet(texts[0].decode("ascii"), int(texts[1]), int(texts[2]))
    except (IndexError, ValueError):
        raise FormatError("not a cell of S-57: its head does not tell its edition") from None


def checksums(data: bytes) -> dict[str, int]:
    """CRC-32 of each file by its name without folders, from the catalogue of an exchange set. Raises FormatError."""
    found = dict[str, int]()
    for record in records(data):
        texts = record.get("CATD", b"").split(UNIT)
        name = texts[0][CATD_HEAD:].decode("latin-1").replace("\\", "/").rpartition("/")[2]
        with suppress(IndexError, ValueError):  # files without one have none
            found[name.upper()] = int(texts[CRCS], 16)
    return found
