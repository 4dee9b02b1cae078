"""The operator's own charts: georeferenced images, MBTiles and what `delfim charts` makes from one folder, served to the page.

An image that lies north up in degrees is served as it is; a child process (`delfim.console.charts.warp`)
redraws any other one, once, when a page first asks for it.
"""

import asyncio
import sqlite3
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import msgspec
from aiohttp import web

from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.input.untrusted import read_file

WARP_S: Final = 60.0
ZOOM_MAX: Final = 24
TILE_BYTES: Final = 8 << 20
TAKING_STEPS: Final = 100_000_000  # of SQLite for a look at all tiles: ten million of them without an index
TILE_STEPS: Final = 10_000_000  # of SQLite for one tile; a file's "tiles" may be a view that never ends
IMAGES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
WORLD: Final = (-180.0, -85.05, 180.0, 85.05)
KINDS: Final = ((b"\x89PNG", "image/png"), (b"\xff\xd8", "image/jpeg"), (b"RIFF", "image/webp"))
DANGERS_BYTES: Final = 20 << 20
DEEP: Final = 5  # lists within lists, of a shape
_AGE: Final = {"Cache-Control": "max-age=3600"}


class DangerShape(msgspec.Struct):
    """A shape of GeoJSON."""

    type: str
    coordinates: list[Any] = []


class DangerRow(msgspec.Struct):
    """No-go water, an area of depth or a danger."""

    properties: dict[str, str | float | None]
    geometry: DangerShape


class Dangers(msgspec.Struct):
    """What `delfim charts` makes for the page."""

    delfim: dict[str, Any]
    features: list[DangerRow]


class Charts:
    """The charts in the folder when the console starts. `faults` lists the files left out, and why."""

    def __init__(self, folder: Path | None) -> None:
        self.path = folder
        self.folder = str(folder.resolve()) if folder is not None else "charts"  # for people
        self.backgrounds: list[dict[str, Any]] = []
        self.faults: list[str] = []
        self._images: dict[str, Path] = {}
        self._drawn: dict[str, Path] = {}
        self._tiles: dict[str, sqlite3.Connection] = {}
        self._turn = asyncio.Lock()  # one chart is drawn at a time
        self._made = tempfile.TemporaryDirectory(prefix="delfim-charts-", ignore_cleanup_errors=True)
        for file in sorted(folder.iterdir()) if folder is not None and folder.is_dir() else ():
            self._take(file)

    def close(self) -> None:
        for tiles in self._tiles.values():
            tiles.close()
        self._made.cleanup()

    def routes(self, app: web.Application) -> None:
        app.router.add_get("/background/{name}", self._background)
        app.router.add_get("/tiles/{name}/{z:[0-9]+}/{x:[0-9]+}/{y:[0-9]+}", self._tile)

    def again(self, file: Path) -> None:
        """Takes what `delfim charts` makes, anew where it is known. It may be called in a worker. Raises ConfigError."""
        others = [each for each in self.backgrounds if each["name"] != file.stem]
        if any(each["name"] == file.stem and each["kind"] != "dangers" for each in self.backgrounds):
            raise ConfigError(str(file), "name", "another chart has the same name")
        self.backgrounds = [*others, {"name": file.stem, **self._add_dangers(file)}]

    def _take(self, file: Path) -> None:
        add: Callable[[Path], dict[str, Any]]
        if file.suffix.lower() in IMAGES:
            add = self._add_image
        elif file.suffix.lower() == ".mbtiles":
            add = self._add_tiles
        elif file.suffix.lower() == ".geojson":
            add = self._add_dangers
        else:
            return
        try:
            if any(file.stem == other["name"] for other in self.backgrounds):
                raise ConfigError(str(file), "name", "another chart has the same name")
            self.backgrounds.append({"name": file.stem, **add(file)})
        except ConfigError as error:
            self.faults.append(str(error))

    def _add_image(self, file: Path) -> dict[str, Any]:
        try:  # Pillow is needed by charts alone
            from delfim.console.charts.georeference import placed
            from delfim.console.charts.warp import SIDE_MAX
        except ModuleNotFoundError as error:
            raise ConfigError(str(file), "image", f"it needs {error.name}: pip install 'delfim[ground]'") from None
        image = placed(file)
        shown = image.upright and file.suffix.lower() in (".png", ".jpg", ".jpeg") and max(image.size) <= SIDE_MAX
        self._images[file.stem] = file
        if shown:
            self._drawn[file.stem] = file
        return {"kind": "image", "extent": image.extent(), "minzoom": None, "maxzoom": None}

    def _add_dangers(self, file: Path) -> dict[str, Any]:
        """What `delfim charts` makes. The page gets its text as it is, which is known to be its own."""
        try:
            told = msgspec.json.decode(data := read_file(file, DANGERS_BYTES), type=Dangers)
        except (OSError, FormatError, *UNREADABLE) as error:
            raise ConfigError(str(file), "file", f"not of delfim charts: {error}") from None
        self._drawn[file.stem] = self._images[file.stem] = file
        corners = [corner for each in told.features for corner in _corners(each.geometry.coordinates)]
        if not corners:
            raise ConfigError(str(file), "file", "it has no place")
        longitudes, latitudes = zip(*corners, strict=True)
        extent = min(longitudes), min(latitudes), max(longitudes), max(latitudes)
        return {"kind": "dangers", "extent": extent, "minzoom": None, "maxzoom": None, "made": zlib.crc32(data)}

    def _add_tiles(self, file: Path) -> dict[str, Any]:
        try:
            tiles = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
            try:
                told = _metadata(tiles)
            except BaseException:
                tiles.close()
                raise
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise ConfigError(str(file), "file", f"no MBTiles: {error}") from None
        self._tiles[file.stem] = tiles
        return told

    async def _background(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        if name not in self._images:
            raise web.HTTPNotFound(text="no such chart\n")
        async with self._turn:
            if name not in self._drawn:
                self._drawn[name] = await self._draw(name)
        return web.FileResponse(self._drawn[name], headers=_AGE)

    async def _draw(self, name: str) -> Path:
        target = Path(self._made.name) / f"{len(self._drawn)}.png"
        words = ("-m", "delfim.console.charts.warp", str(self._images[name].resolve()), str(target))
        child = _started(words)
        try:
            said = await asyncio.to_thread(_ended, child)
        except subprocess.TimeoutExpired:
            raise web.HTTPInternalServerError(text=f"not drawn within {WARP_S:.0f} s\n") from None
        finally:
            child.kill()
        if child.returncode:
            raise web.HTTPInternalServerError(text=said.decode(errors="replace")[-500:])
        return target

    async def _tile(self, request: web.Request) -> web.Response:
        tiles = self._tiles.get(request.match_info["name"])
        z, x, y = (int(request.match_info[key][:9]) for key in "zxy")
        if tiles is None or z > ZOOM_MAX:
            raise web.HTTPNotFound(text="no such tiles\n")
        asked = z, x, (1 << z) - 1 - y  # in the file rows count from the south
        sql = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        try:
            with closing(tiles.execute(sql, asked)) as found:
                row = found.fetchone()
        except sqlite3.Error as error:
            raise web.HTTPInternalServerError(text=f"{error}\n") from None
        if row is None or not isinstance(row[0], bytes):
            return web.Response(status=204, headers=_AGE)
        kind = next((words for magic, words in KINDS if row[0].startswith(magic)), "application/octet-stream")
        return web.Response(body=row[0], content_type=kind, headers=_AGE)


def _corners(shape: list[Any], deep: int = DEEP) -> Iterator[tuple[float, float]]:
    """The places of a shape, degrees: longitude, latitude."""
    if len(shape) >= 2 and all(isinstance(each, int | float) for each in shape[:2]):
        yield shape[0], shape[1]
        return
    for each in shape if deep else ():
        if isinstance(each, list):
            yield from _corners(each, deep - 1)


def _started(words: Sequence[str]) -> "subprocess.Popen[bytes]":
    """Not by asyncio, whose loop that selects has no children on Windows."""
    return subprocess.Popen((sys.executable, *words), stderr=subprocess.PIPE)


def _ended(child: "subprocess.Popen[bytes]") -> bytes:
    """Its errors when it has ended. Raises TimeoutExpired after WARP_S, and has ended it."""
    with child:
        try:
            return child.communicate(timeout=WARP_S)[1]
        except subprocess.TimeoutExpired:
            child.kill()
            raise


def _metadata(tiles: sqlite3.Connection) -> dict[str, Any]:
    """For the page; from here on its answers are bounded in size and work. Raises ValueError, OverflowError, sqlite3.Error."""
    tiles.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, TILE_BYTES)
    tiles.set_progress_handler(lambda: 1, TAKING_STEPS)
    rows = tiles.execute("SELECT name, substr(value, 1, 1000) FROM metadata LIMIT 1000")
    told = {str(name): str(value) for name, value in rows}
    if told.get("format", "png") not in ("png", "jpg", "jpeg", "webp"):
        raise ValueError(f"its tiles are {told['format']}, not pictures")
    low, high = tiles.execute("SELECT min(zoom_level), max(zoom_level) FROM tiles").fetchone()
    if low is None:
        raise ValueError("it has no tiles")
    extent = tuple(float(word) for word in told["bounds"].split(",")) if "bounds" in told else WORLD
    if len(extent) != 4 or not (-180.0 <= extent[0] < extent[2] <= 180.0 and -90.0 <= extent[1] < extent[3] <= 90.0):
        raise ValueError(f"its bounds mean nothing: {told['bounds']}")
    tiles.set_progress_handler(lambda: 1, TILE_STEPS)
    return {"kind": "tiles", "extent": extent, "minzoom": int(low), "maxzoom": int(high)}
