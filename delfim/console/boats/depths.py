"""The depths that the boats of a console have told, in cells: what its pages draw while a survey is under way.

Cells lie in tiles of a fixed raster of the Earth, the same for every boat and after each start. A cell has the mean of what was
told in it; what was not told, because a link was lost, is not filled. Bounded: the tile that was sounded longest ago gives way.
"""

import base64
import math
from array import array
from collections.abc import Iterator
from typing import Any, Final

CELL_M: Final = 5.0  # what a boat at 1.5 m/s fills to nine tenths where a depth comes each second
SIDE: Final = 100  # cells of a tile, each way
TILES_MAX: Final = 100  # a million cells, 25 square kilometres: 6 MB
TILE_DEG: Final = SIDE * CELL_M / 111_132.0  # of latitude
LATITUDE_DEG: Final = 85.0
DEPTH_M: Final = 650.0
Place = tuple[int, int]


class DepthTile:
    """A tile: rows from the north, columns from the west."""

    def __init__(self, place: Place) -> None:
        self.place, (row, column) = place, place
        wide = wide_deg(row)
        south, west = row * TILE_DEG, column * wide
        self.extent = (west, south, west + wide, south + TILE_DEG)  # degrees
        self._sums, self._counts = array("f", bytes(4 * SIDE * SIDE)), array("H", bytes(2 * SIDE * SIDE))
        self.changed = set[int]()

    def add(self, latitude_deg: float, longitude_deg: float, depth_m: float) -> None:
        west, _, east, north = self.extent
        right = min(int((longitude_deg - west) / (east - west) * SIDE), SIDE - 1)
        down = min(max(int((north - latitude_deg) / TILE_DEG * SIDE), 0), SIDE - 1)
        cell = down * SIDE + right
        if self._counts[cell] < 0xFFFF:
            self._sums[cell] += depth_m
            self._counts[cell] += 1
            self.changed.add(cell)

    def depth_cm(self, cell: int) -> int:
        """The mean, cm; 0: nothing was told there."""
        count = self._counts[cell]
        return max(round(100.0 * self._sums[cell] / count), 1) if count else 0

    def told(self, **cells: Any) -> dict[str, Any]:
        return {"t": "depths", "tile": list(self.place), "extent": [round(each, 8) for each in self.extent], **cells}

    def whole(self) -> dict[str, Any]:
        """All cells: base64 of unsigned numbers of two bytes, the low one first."""
        cells = array("H", map(self.depth_cm, range(SIDE * SIDE)))
        return self.told(whole=base64.b64encode(cells.tobytes()).decode())


class DepthGrid:
    """All tiles."""

    def __init__(self) -> None:
        self._tiles: dict[Place, DepthTile] = {}  # the one that was sounded last stands last

    def add(self, latitude_deg: float, longitude_deg: float, depth_m: float) -> bool:
        """Takes a depth; one that is none, or nowhere, is dropped. Whether it was taken."""
        if not (abs(latitude_deg) <= LATITUDE_DEG and abs(longitude_deg) <= 180.0 and 0.0 < depth_m <= DEPTH_M):
            return False
        row = math.floor(latitude_deg / TILE_DEG)
        place = row, math.floor(longitude_deg / wide_deg(row))
        tile = self._tiles.pop(place, None) or DepthTile(place)
        self._tiles[place] = tile
        tile.add(latitude_deg, longitude_deg, depth_m)
        if len(self._tiles) > TILES_MAX:
            del self._tiles[next(iter(self._tiles))]
        return True

    def forget(self) -> None:
        self._tiles.clear()

    def changes(self) -> Iterator[dict[str, Any]]:
        """For the pages: cells that have changed since the last time."""
        for tile in self._tiles.values():
            if tile.changed:
                yield tile.told(cells=[[cell, tile.depth_cm(cell)] for cell in sorted(tile.changed)])
                tile.changed.clear()

    def whole(self) -> Iterator[dict[str, Any]]:
        """For a page that was opened: everything."""
        for tile in self._tiles.values():
            yield tile.whole()


def wide_deg(row: int) -> float:
    """Longitude of the tiles of a row: there a cell is as wide as it is high."""
    return TILE_DEG / math.cos(math.radians(min(abs((row + 0.5) * TILE_DEG), LATITUDE_DEG)))
