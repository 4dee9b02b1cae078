"""Shapefiles from anybody: the records of points, lines and polygons, each with its length before it."""

import struct
from collections.abc import Container, Iterator
from itertools import pairwise
from typing import Final

MAGIC: Final = 9994  # what a shapefile begins with
RECORDS_AT: Final = 100  # bytes before its first record
POINTS, LINES, POLYGONS = (1, 11, 21), (3, 13, 23), (5, 15, 25)  # kinds of record; some have heights or measures behind

Place = tuple[float, float]
"""Latitude and longitude, degrees."""


def records(data: bytes, kinds: Container[int]) -> Iterator[tuple[int, list[list[Place]]]]:
    """The kind and the parts of each record of these kinds; others are passed over. Raises ValueError, struct.error for what is
    no shapefile."""
    if struct.unpack_from(">i", data) != (MAGIC,):
        raise ValueError
    at = RECORDS_AT
    while at < len(data):
        _, words = struct.unpack_from(">ii", data, at)
        (kind,) = struct.unpack_from("<i", data, at + 8)
        if kind in kinds and kind in POINTS:
            east, north = struct.unpack_from("<2d", data, at + 12)
            yield kind, [[(north, east)]]
        elif kind in kinds:
            parts, count = struct.unpack_from("<ii", data, at + 44)
            if 44 + 4 * parts + 16 * count > 2 * words:  # records that overlap would be read for ever
                raise ValueError
            firsts = [*struct.unpack_from(f"<{parts}i", data, at + 52), count]
            numbers = struct.unpack_from(f"<{2 * count}d", data, at + 52 + 4 * parts)
            places = list(zip(numbers[1::2], numbers[::2], strict=True))
            yield kind, [places[first:end] for first, end in pairwise(firsts)]
        at += 8 + 2 * max(words, 2)
