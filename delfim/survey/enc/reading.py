"""`python -m delfim.survey.enc.reading CELL`: reads a cell of S-57, its updates applied, in a process with bounds, for GDAL was
not made for files of anybody. It writes what is in it to standard output, or the reason why not, and ends with WRONG.

GDAL reads what is left of a damaged cell, and passes over an update that is missing: here such a cell is refused whole.
"""

import subprocess
import sys
import warnings
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim.base.errors import DelfimError, FormatError
from delfim.base.input.bounded import bounded
from delfim.base.input.untrusted import read_file
from delfim.survey.enc.records import checked, checksums

PROGRAM: Final = (sys.executable, "-m", "delfim.survey.enc.reading")
BYTES: Final = 10_000_000  # of a cell with its updates: offices keep them below 5 MB, and larger ones take minutes
CPU_S: Final = 60
WALL_S: Final = 180.0
MEMORY_BYTES: Final = 1 << 31  # GDAL maps its libraries, too
OBJECTS: Final = 200_000
WRONG: Final = 3
CATALOGUE: Final = "CATALOG.031"
KEYS: Final = frozenset(  # attributes that count
    (
        "CATCOV",
        "CATREA",
        "CATZOC",
        "DRVAL1",
        "DRVAL2",
        "OBJNAM",
        "QUASOU",
        "RESTRN",
        "VALSOU",
        "VERCCL",
        "VERCLR",
        "VERCSA",
        "WATLEV",
    )
)


class ChartObject(msgspec.Struct, array_like=True):
    """An object of a cell: its class, its attributes that are known, and its shape as WKB, degrees."""

    layer: str
    values: dict[str, float | str | list[str]]
    shape: bytes


class EncCell(msgspec.Struct, array_like=True):
    """A cell of an official chart."""

    name: str
    edition: int
    update: int
    issued: str
    scale: int  # of compilation, 1:scale
    objects: list[ChartObject]


def read_cell(file: Path, layers: Sequence[str]) -> EncCell:
    """Read the objects of these classes in a cell. Raises FormatError with one line, OSError; nothing is half read."""
    _whole(file)  # before any process is begun
    if (size := sum(each.stat().st_size for each in (file, *updates(file)))) > BYTES:
        raise FormatError(f"{file}: {size / 1e6:.0f} MB with its updates: up to {BYTES / 1e6:.0f} MB")
    with subprocess.Popen((*PROGRAM, str(file), *layers), stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        try:
            told, said = child.communicate(timeout=WALL_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()
            raise FormatError(f"{file}: not read within {WALL_S:.0f} s") from None
    if child.returncode == WRONG:
        raise FormatError(f"{file}: {told.decode(errors='replace').strip()}")
    if child.returncode:
        if b"No module named 'pyogrio'" in said:
            raise DelfimError("charts need pyogrio: pip install 'delfim[charts]'")
        raise FormatError(f"{file}: it takes too much time or memory to read, or GDAL ended on it ({child.returncode})")
    return msgspec.msgpack.decode(told, type=EncCell)


def updates(file: Path) -> list[Path]:
    """The updates beside a cell, in their order."""
    found = (each for each in file.parent.glob(f"{file.stem}.[0-9][0-9][0-9]") if each.suffix != ".000")
    return sorted(found)


def _whole(file: Path) -> None:
    """Check that cell and updates are complete, belong together, and are what a catalogue beside them says. Raises FormatError,
    OSError."""
    if file.suffix != ".000":
        raise FormatError(f"{file}: a cell of S-57 ends with .000; its updates lie beside it")
    told = dict[str, int]()
    for folder in (file.parent, *list(file.resolve().parents)[1:3]):
        if (catalogue := folder / CATALOGUE).is_file():
            told = checksums(read_file(catalogue, BYTES))
            break
    base = None
    for number, each in enumerate((file, *updates(file))):
        data = read_file(each, BYTES)
        try:
            if (crc := told.get(each.name.upper())) is not None and zlib.crc32(data) != crc:
                raise FormatError(f"its checksum is {zlib.crc32(data):08X}, and {CATALOGUE} says {crc:08X}")
            head = checked(data)
            if each.suffix != f".{number:03}":
                raise FormatError(f"update {number} before it is missing")
            base = base or head
            if number and (head.update != number or head.edition not in (base.edition, 0)):
                raise FormatError(
                    f"it is update {head.update} of edition {head.edition}, not {number} of edition {base.edition}"
                )
        except FormatError as error:
            raise FormatError(f"{each}: {error}") from None


def gathered(file: Path, wanted: Collection[str]) -> EncCell:
    """What GDAL finds of these classes in a cell. Raises FormatError where it has a doubt."""
    from pyogrio import list_layers, raw, set_gdal_config_options

    set_gdal_config_options({"OGR_S57_OPTIONS": "UPDATES=APPLY,SPLIT_MULTIPOINT=OFF,RECODE_BY_DSSI=ON"})
    with warnings.catch_warnings(record=True) as doubts:  # GDAL goes on after them
        warnings.simplefilter("always")
        try:
            there = {str(name) for name in list_layers(file)[:, 0]}
            meta, _, _, rows = raw.read(file, layer="DSID")
            head = {str(name): row[0] for name, row in zip(meta["fields"], rows, strict=True)}
            objects = list[ChartObject]()
            for layer in sorted(there - {"DSID"}):
                if layer in wanted:
                    objects += _layer(layer, *raw.read(file, layer=layer))
                    if len(objects) > OBJECTS:
                        raise FormatError(f"more than {OBJECTS} objects")
            name = str(head["DSID_DSNM"]).partition(".")[0]
            edition, update = int(head["DSID_EDTN"]), int(head["DSID_UPDN"])
            cell = EncCell(name, edition, update, str(head["DSID_ISDT"]), int(head["DSPM_CSCL"]), objects)
        except DelfimError:
            raise
        except Exception as error:  # GDAL's, or of a head without a key
            raise FormatError(f"GDAL cannot read it: {_line(error)}") from None
    if doubts:
        raise FormatError(f"GDAL does not read it whole: {_line(doubts[0].message)}")
    last = len(updates(file))
    if last and cell.update != last:
        raise FormatError(f"update {last} was not applied: it is at {cell.update}")
    if not 0 < cell.scale < 100_000_000:
        raise FormatError(f"its scale is 1:{cell.scale}")
    return cell


def _line(error: Warning | Exception | str) -> str:
    return "".join(each for each in " ".join(str(error).split()) if each.isprintable())[:300]


def _layer(layer: str, meta: Any, _: Any, shapes: Any, columns: Any) -> list[ChartObject]:
    names = [str(name) for name in meta["fields"]]
    wanted = [(name, column) for name, column in zip(names, columns, strict=True) if name in KEYS]
    found = list[ChartObject]()
    for row in range(len(columns[0])):
        values = {name: value for name, column in wanted if (value := _value(column[row])) is not None}
        shape = shapes[row] if shapes is not None else None
        if shape is None:
            raise FormatError(f"an object of {layer} has no shape")
        found.append(ChartObject(layer, values, bytes(shape)))
    return found


def _value(value: Any) -> float | str | list[str] | None:
    if value is None or value != value:  # NaN: not known
        return None
    if isinstance(value, str):
        return value
    return float(value) if not hasattr(value, "__len__") else [str(each) for each in value]


def main(file: str, *layers: str) -> int:
    """The process."""
    bounded(MEMORY_BYTES, CPU_S)
    try:
        sys.stdout.buffer.write(msgspec.msgpack.encode(gathered(Path(file), layers)))
    except DelfimError as error:
        print(error)
        return WRONG
    except MemoryError:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
