"""From cells to the files that leave `delfim charts`, in a process with bounds, for a cell may have any number of corners.

`python -m delfim.survey.enc.making` takes a `ChartJob` as JSON from its standard input, and writes the files, and lines for
people to its standard output; or the reason why not, and ends with WRONG.
"""

import math
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec
from shapely.geometry import box

from delfim.base.errors import DelfimError, in_words
from delfim.base.geodesy import Origin, origin
from delfim.base.input.bounded import bounded
from delfim.base.wholefile import replace_file
from delfim.survey.enc import clearing, nogo
from delfim.survey.enc.dangers import LAYERS, Charted, Need, charted
from delfim.survey.enc.plane import flat
from delfim.survey.enc.reading import WRONG, read_cell
from delfim.vehicle.plans import clearancefile

PROGRAM: Final = (sys.executable, "-m", "delfim.survey.enc.making")
LIMIT_S: Final = 900.0  # the largest cell that is read took 331 s on a busy machine
MEMORY_BYTES: Final = 1 << 31


class ChartJob(msgspec.Struct):
    """What is asked of the process: cells, the middle of the water (degrees), bands to open, and the files to write."""

    cells: list[str]
    at: tuple[float, float]
    need: Need
    opened: list[str]
    output: str
    picture: str  # empty: none


def make(job: ChartJob) -> str:
    """Write the files; lines for people. Raises DelfimError with one line: no file is written then."""
    try:
        made = subprocess.run(PROGRAM, input=msgspec.json.encode(job), capture_output=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        words = f"{', '.join(job.cells)}: not made within {LIMIT_S:g} s: give fewer cells, or those of a smaller scale"
        raise DelfimError(words) from None
    told = made.stdout.decode(errors="replace")
    if made.returncode == WRONG:
        raise DelfimError(told.strip())
    if made.returncode:
        last = made.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise DelfimError(f"{', '.join(job.cells)}: the process that makes the files ended with {made.returncode}: {last}")
    return told


def _made(job: ChartJob) -> Iterator[str]:
    """In the process. Raises DelfimError, OSError."""
    at, output = job.at, Path(job.output)
    chart = charted([read_cell(Path(cell), LAYERS) for cell in job.cells], job.need)
    middle = origin(math.radians(at[0]), math.radians(at[1]))
    bands = [_band(chart, name) for name in job.opened]
    dangers = clearing.growing(chart, middle)
    forbidden = nogo.no_go(dangers, clearing.half_m())
    data = clearing.made(chart, middle, bands)
    text = nogo.geojson(chart, middle, forbidden)
    share = forbidden.area / (2.0 * clearing.half_m()) ** 2
    if share > 0.999:
        raise DelfimError(f"{', '.join(chart.names)}: no water is free about {at[0]:g}, {at[1]:g}: say another place by --at")
    if job.picture:
        from delfim.survey.enc.drawing import draw  # it loads Matplotlib, for half a second

        draw(chart, middle, forbidden, Path(job.picture))
    replace_file(output.with_name(f"{output.name}.geojson"), text.encode())
    replace_file(output.with_name(f"{output.name}.clearance"), data)
    yield f"{', '.join(chart.names)}: {nogo.NOT_FOR}"
    yield f"  no-go: {100.0 * share:.1f} % of {2.0 * clearing.half_m() / 1000.0:.1f} km about {at[0]:g}, {at[1]:g}"
    yield from _reasons(chart, middle)
    yield f"  {output.name}.geojson: {len(text)} bytes, for the page"
    digest = clearancefile.read(data).digest
    yield f"  {output.name}.clearance: {len(data)} bytes, digest {digest}, for fence.chart of the boat's file"


def _band(chart: Charted, name: str) -> str:
    """The whole name of a band, which may come without its unit. Raises DelfimError."""
    there = sorted({each.band for each in chart.dangers if each.band})
    full = name if name.endswith(" m") else f"{name} m"
    if full not in there:
        raise DelfimError(f"there is no band {full} to open: {', '.join(there) or 'none at all'}")
    return full


def _reasons(chart: Charted, middle: Origin) -> Iterator[str]:
    """How many dangers of which kind there are, and the bands."""
    reach_m = clearing.half_m()
    window = box(-reach_m, -reach_m, reach_m, reach_m)
    near = [each for each in chart.dangers if flat(each.shape, middle).intersects(window)]
    kinds = Counter(each.kind for each in near)
    yield "  dangers: " + (", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "none")
    margins = Counter(each.margin_m for each in near)
    yield "  margins: " + ", ".join(f"{margin_m:g} m about {count}" for margin_m, count in sorted(margins.items()))
    if cut := Counter(each.asked_m for each in near if each.asked_m > each.margin_m):
        told = (f"{asked_m:g} m" if asked_m < math.inf else "nobody knows how much" for asked_m in sorted(cut))
        words = f"about {sum(cut.values())} the chart's zone of confidence asks for more: {', '.join(told)}"
        yield f"  margins cut to --margin: {words}. Go near those by sight and sounder alone"
    if bands := sorted({each.band for each in near if each.band}):
        yield f"  bands that a mission may open, if --open has made them: {', '.join(bands)}"


def main() -> int:
    """The process."""
    bounded(MEMORY_BYTES)
    try:
        print(*_made(msgspec.json.decode(sys.stdin.buffer.read(), type=ChartJob)), sep="\n")
    except (DelfimError, OSError) as error:
        print(in_words(error))
    except MemoryError:
        print("the charts take too much memory")
    else:
        return 0
    return WRONG


if __name__ == "__main__":
    sys.exit(main())
