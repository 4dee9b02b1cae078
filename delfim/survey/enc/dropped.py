"""`python -m delfim.survey.enc.dropped`: makes the files of charts that were dropped on the console's page, in a process with
bounds.

One line of JSON comes in: the `folder` of the files, what the boat needs of the water (`need`), the `places` where the field
may have its middle, the best first, and `output`. OUTPUT.geojson is written, and OUTPUT.clearance where there is a field. One
line goes out: the `chart` in words, the share of no-go water (`no_go`) and why there is no field (`unfit`), or why the chart is
`refused`; nothing is written then.
"""

import json
import math
import re
import sys
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
from shapely.geometry import Point

from delfim.base.errors import DelfimError, FormatError, in_words
from delfim.base.geodesy import origin
from delfim.base.input.bounded import bounded
from delfim.base.wholefile import replace_file
from delfim.survey.enc.dangers import LAYERS, Charted, Need, charted
from delfim.survey.enc.reading import BYTES, read_cell

NAMED: Final = re.compile(r"[A-Z0-9_]{1,40}\.(000|\d{3}|031)")
CELLS: Final = 12  # each takes seconds
FILES: Final = 2000  # of an archive
MEMORY_BYTES: Final = 1 << 31
CPU_S: Final = 240
FULL: Final = 0.999  # of the water is forbidden: there is nothing to sail


class DropJob(msgspec.Struct):
    """What is asked of the process."""

    folder: str
    need: Need
    places: list[tuple[float, float]]
    output: str


def unpacked(archive: Path) -> None:
    """Lay the cells, updates and the catalogue of an exchange set beside the archive; what else is in it is left out. Raises
    FormatError."""
    left = BYTES
    try:
        with zipfile.ZipFile(archive) as packed:
            if len(packed.infolist()) > FILES:
                raise FormatError(f"more than {FILES} files in it")
            for each in packed.infolist():
                name = each.filename.rpartition("/")[2].upper()
                if each.is_dir() or not NAMED.fullmatch(name):
                    continue
                with packed.open(each) as source:
                    data = source.read(left + 1)
                if (left := left - len(data)) < 0:
                    raise FormatError(f"more than {BYTES / 1e6:.0f} MB of charts in it")
                if (file := archive.with_name(name)).exists():
                    raise FormatError(f"{name} is in it twice")
                file.write_bytes(data)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise FormatError(f"no archive that can be read: {error}") from None


def made(job: DropJob) -> dict[str, Any]:
    """Write the files. Raises DelfimError, OSError."""
    from delfim.survey.enc import clearing, nogo

    folder = Path(job.folder)
    for archive in sorted(folder.glob("*.zip")):
        unpacked(archive)
    cells = sorted(folder.glob("*.000"))
    if not cells:
        raise FormatError("there is no cell (.000) in it")
    if len(cells) > CELLS:
        raise FormatError(f"{len(cells)} cells: up to {CELLS}; drop those of your water")
    chart = charted([read_cell(cell, LAYERS) for cell in cells], job.need)
    at = middle(chart, job.places)
    here = origin(math.radians(at[0]), math.radians(at[1]))
    forbidden = nogo.no_go(clearing.growing(chart, here), clearing.half_m())
    share = forbidden.area / (2.0 * clearing.half_m()) ** 2
    unfit = f"no water is free about {at[0]:.4f}, {at[1]:.4f}" if share > FULL else ""
    replace_file(Path(f"{job.output}.geojson"), nogo.geojson(chart, here, forbidden).encode())
    try:
        if not unfit:
            replace_file(Path(f"{job.output}.clearance"), clearing.made(chart, here))
    except FormatError as error:  # too large
        unfit = str(error)
    return {"chart": ", ".join(chart.names), "name": cells[0].stem, "no_go": round(share, 4), "unfit": unfit}


def middle(chart: Charted, places: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The first of the places that a cell covers, degrees; none of them: a place within the cells."""
    covered = (at for at in places if chart.covered.contains(Point(at[1], at[0])))
    centre = chart.covered.centroid
    within = centre if chart.covered.contains(centre) else chart.covered.representative_point()
    return next(covered, (within.y, within.x))


def main() -> None:
    bounded(MEMORY_BYTES, CPU_S)
    job = msgspec.json.decode(sys.stdin.readline(), type=DropJob)
    try:
        told = made(job)
    except (DelfimError, OSError) as error:
        told = {"refused": in_words(error).replace(f"{job.folder}/", "")}
    except MemoryError:
        told = {"refused": "it takes too much memory to read"}
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
