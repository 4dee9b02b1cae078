"""The file of a chart's field of clearances: made ashore by `delfim charts`, read aboard at the start. It is taken whole, by
its digest, or not at all.
"""

import hashlib
import lzma
from collections.abc import Sequence
from typing import Final

import msgspec

from delfim import config
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.untrusted import read_file
from delfim.vehicle.plans.basins import basins_of
from delfim.vehicle.plans.clearance import BYTES, Chart, ClearanceHead, Grid, GridHead
from delfim.vehicle.plans.fence import stopping_m

MAGIC: Final = b"delfim clearance 1\n"
UNWATCHED: Final = "no sounder watches it: sensors.required needs depth_m, and failsafe.shallow its min_depth_m"
HEAD_BYTES: Final = 4096
DIGEST: Final = hashlib.sha256().digest_size
STRIPE: Final = 256  # columns that are packed side by side: the filters below look so far back
KNOTS: Final = 1 << 21  # of one grid
FILTERS: Final = [  # what a knot differs from those beside and below it
    {"id": lzma.FILTER_DELTA, "dist": 1},
    {"id": lzma.FILTER_DELTA, "dist": STRIPE},
    {"id": lzma.FILTER_LZMA2, "dict_size": 1 << 20, "preset": 9 | lzma.PRESET_EXTREME},
]


def packed(head: ClearanceHead, fields: Sequence[Sequence[bytes]]) -> bytes:
    """The file: of each band, the codes of its grids. The sizes in `head` are filled in."""
    parts = [
        lzma.compress(_striped(codes, grid), lzma.FORMAT_XZ, filters=FILTERS)
        for field in fields
        for grid, codes in zip(head.grids, field, strict=True)
    ]
    told = msgspec.json.encode(msgspec.structs.replace(head, sizes=tuple(map(len, parts))))
    data = b"".join((MAGIC, told, b"\n", *parts))
    return data + hashlib.sha256(data).digest()


def read(data: bytes) -> Chart:
    """A file of clearances. Raises FormatError where it is not whole."""
    if not data.startswith(MAGIC):
        raise FormatError("not a file of clearances: delfim charts makes one")
    content, digest = data[:-DIGEST], data[-DIGEST:]
    if hashlib.sha256(content).digest() != digest:
        raise FormatError("it is not whole: its digest is another one; bring it aboard again")
    end = content.find(b"\n", len(MAGIC), len(MAGIC) + HEAD_BYTES)
    try:
        head = msgspec.json.decode(content[len(MAGIC) : end], type=ClearanceHead)
    except (msgspec.DecodeError, ValueError) as error:
        raise FormatError(f"its head is not one of clearances: {error}") from None
    at, fields, sizes = end + 1, dict[str, tuple[Grid, ...]](), iter(head.sizes)
    if head.bands[0] or len(head.sizes) != len(head.bands) * len(head.grids) or at + sum(head.sizes) != len(content):
        raise FormatError("its parts are not those that its head tells of")
    for band in head.bands:
        grids = list[Grid]()
        for grid in head.grids:
            size = next(sizes)
            grids.append(Grid(grid, _unpacked(content[at : at + size], grid)))
            at += size
        fields[band] = tuple(grids)
    return Chart(head, fields, digest.hex()[:16])


def load(settings: config.Vehicle) -> Chart | None:
    """The chart of a vehicle's file; None: it has none. Raises ConfigError where it is not whole, or for a smaller boat."""
    if not (file := settings.fence.chart):
        return None
    try:
        chart = read(read_file(file, BYTES))
    except (FormatError, OSError) as error:
        words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        if isinstance(error, FileNotFoundError):
            words = "there is no such file: the boat, its dry runs and replays of its logs read the chart that they sail by"
        raise ConfigError(file, "fence.chart", words) from None
    for name in ("draught_m", "air_draught_m"):
        made_m, needed_m = getattr(chart.head, name), getattr(settings.boat, name)
        if needed_m > made_m:
            raise ConfigError(file, "fence.chart", f"made for {name} {made_m:g}, and boat.{name} is {needed_m:g}: make it anew")
    watched = "depth_m" in settings.sensors.required and settings.failsafe.shallow.min_depth_m > 0.0
    limits, mps = settings.fence, settings.control.speed.cruise_mps
    rooms_m = sorted({limits.margin_m, limits.mission_margin_m, limits.margin_m + stopping_m(limits, mps)})
    basins = {band: tuple(basins_of(grids, room_m) for room_m in rooms_m) for band, grids in chart.fields.items()}
    return chart._replace(basins=basins, closed="" if watched else UNWATCHED)


def _striped(codes: bytes, grid: GridHead) -> bytes:
    width = grid.columns
    return b"".join(
        codes[row * width + first : row * width + min(first + STRIPE, width)].ljust(STRIPE, b"\0")
        for first in range(0, width, STRIPE)
        for row in range(grid.rows)
    )


def _unpacked(part: bytes, grid: GridHead) -> bytes:
    """The codes row by row. Raises FormatError."""
    stripes = -(-grid.columns // STRIPE)
    size = stripes * STRIPE * grid.rows
    if size > KNOTS:
        raise FormatError(f"a grid of {grid.rows} by {grid.columns} knots: up to {KNOTS}")
    try:
        packed = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=1 << 25)
        codes = packed.decompress(part, size)
        if len(codes) != size or not packed.eof:
            codes += packed.decompress(b"", 1)
    except (lzma.LZMAError, EOFError):
        raise FormatError("a part of it cannot be unpacked") from None
    if len(codes) != size or not packed.eof:
        raise FormatError("a part of it has another size than its head says")
    deep = STRIPE * grid.rows
    return b"".join(
        b"".join(codes[stripe * deep + row * STRIPE : stripe * deep + (row + 1) * STRIPE] for stripe in range(stripes))[
            : grid.columns
        ]
        for row in range(grid.rows)
    )
