"""What goes home of a chart, as files of others: GeoTIFF, GeoPackage, XYZ, CSV, crowd-sourced bathymetry. No GDAL writes them.

GeoTIFF by OGC 19-008, GeoPackage by OGC 12-128r19, crowd-sourced bathymetry by IHO B-12, GeoJSON CSB 3.1.
"""

import json
import re
import sqlite3
import struct
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from PIL import Image, TiffImagePlugin

from delfim.base.errors import FormatError
from delfim.survey.chart.reduction import REASONS, Reduced
from delfim.survey.chart.soundings import Array, Soundings
from delfim.survey.chart.surface import Surface

NOTHING: Final = -9999.0  # a cell of a GeoTIFF that is not known
WGS: Final = 4326
CHUNK: Final = 1 << 16  # rows in memory as text
DOUBLES, SHORTS, ASCII = 12, 3, 2  # kinds of TIFF's tags
SCALE, TIE, KEYS, NODATA, WORDS = 33550, 33922, 34735, 42113, 270  # TIFF's tags
WKT: Final = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'AUTHORITY["EPSG","6326"]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)
SCHEMA: Final = """
PRAGMA application_id = 1196444487;
PRAGMA user_version = 10300;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name));
"""


def geotiff(path: Path, values: Array, its: Surface, epsg: int, words: str) -> None:
    """Write the cells of a surface, 32 bits, north up."""
    image = Image.fromarray(np.where(np.isfinite(values), values, NOTHING).astype("<f4")[::-1])
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    north_m = its.south_m + its.cell_m * values.shape[0]
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, epsg)  # projected; a value is of its cell; which plane
    for tag, kind, value in (
        (SCALE, DOUBLES, (its.cell_m, its.cell_m, 0.0)),
        (TIE, DOUBLES, (0.0, 0.0, 0.0, its.west_m, north_m, 0.0)),
        (KEYS, SHORTS, keys),
        (NODATA, ASCII, f"{NOTHING:g}"),
        (WORDS, ASCII, words),
    ):
        tags[tag], tags.tagtype[tag] = value, kind
    image.save(path, "TIFF", compression="tiff_adobe_deflate", tiffinfo=tags)


class Layer(NamedTuple):
    """Features of a GeoPackage, degrees of WGS 84."""

    name: str
    kind: str  # POINT or LINESTRING
    columns: dict[str, str]  # name: REAL, INTEGER or TEXT
    rows: Iterable[tuple[Any, ...]]  # well-known binary, then the columns
    bounds: tuple[float, float, float, float]  # west, south, east, north


def geopackage(path: Path, layers: Sequence[Layer]) -> None:
    """Write the layers, each a table. What was there before is lost."""
    path.unlink(missing_ok=True)
    head = b"GP\x00\x01" + struct.pack("<i", WGS)
    with closing(sqlite3.connect(path)) as db:
        db.executescript(SCHEMA)
        undefined = [
            (f"Undefined {kind}", number, "NONE", number, "undefined", "")
            for kind, number in (("cartesian", -1), ("geographic", 0))
        ]
        db.executemany(
            "INSERT INTO gpkg_spatial_ref_sys VALUES (?,?,?,?,?,?)", [*undefined, ("WGS 84", WGS, "EPSG", WGS, WKT, "")]
        )
        for layer in layers:
            typed = ", ".join(f"{name} {kind}" for name, kind in layer.columns.items())
            db.execute(f"CREATE TABLE {layer.name} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom BLOB, {typed})")
            listed = "table_name, data_type, identifier, srs_id, min_x, min_y, max_x, max_y"
            row = layer.name, "features", layer.name, WGS, *layer.bounds
            db.execute(f"INSERT INTO gpkg_contents ({listed}) VALUES (?,?,?,?,?,?,?,?)", row)
            db.execute("INSERT INTO gpkg_geometry_columns VALUES (?,?,?,?,0,0)", (layer.name, "geom", layer.kind, WGS))
            places = ",".join("?" * (1 + len(layer.columns)))
            filled = f"INSERT INTO {layer.name} (geom, {', '.join(layer.columns)}) VALUES ({places})"
            db.executemany(filled, ((head + row[0], *row[1:]) for row in layer.rows))
        db.commit()


def points(longitude_deg: Array, latitude_deg: Array) -> Iterator[bytes]:
    """Each place as well-known binary."""
    kind = np.dtype([("order", "u1"), ("type", "<u4"), ("x", "<f8"), ("y", "<f8")])
    its = np.zeros(len(longitude_deg), kind)
    its["order"], its["type"], its["x"], its["y"] = 1, 1, longitude_deg, latitude_deg
    data = its.tobytes()
    return (data[at : at + kind.itemsize] for at in range(0, len(data), kind.itemsize))


def line(longitude_deg: Array, latitude_deg: Array) -> bytes:
    """A line as well-known binary."""
    its = np.stack([longitude_deg, latitude_deg], 1).astype("<f8")
    return struct.pack("<BII", 1, 2, len(its)) + its.tobytes()


def xyz(path: Path, its: Reduced) -> None:
    """Write the soundings that are believed: east, north, depth, in metres of UTM, with blanks between."""
    good = np.flatnonzero(its.good)
    with path.open("w") as file:
        for chunk in _chunks(good):
            rows = zip(*(each[chunk].tolist() for each in (its.east_m, its.north_m, its.depth_m)), strict=True)
            file.writelines(f"{east:.3f} {north:.3f} {depth:.3f}\n" for east, north, depth in rows)


def csv(path: Path, soundings: Soundings, its: Reduced) -> None:
    """Write all soundings, those that are not believed, too, with the reason."""
    latitude, longitude = its.degrees()
    with path.open("w") as file:
        file.write("utc,latitude_deg,longitude_deg,east_m,north_m,depth_m,tide_m,range_m,line,refused\n")
        for chunk in _chunks(np.arange(len(its.at_s))):
            columns = (latitude, longitude, its.east_m, its.north_m, its.depth_m, its.tide_m, soundings.range_m, soundings.line)
            rows = zip(utc(its.at_s[chunk]), *(each[chunk].tolist() for each in columns), its.why[chunk].tolist(), strict=True)
            for at, n, e, x, y, depth, tide, told, number, why in rows:
                place = f"{n:.9f},{e:.9f},{x:.3f},{y:.3f},{depth:.3f}" if x == x else ",,,,"
                file.write(f"{at},{place},{tide:.3f},{told:.3f},{number:.0f},{REASONS[why]}\n")


def utc(at_s: Array) -> list[str]:
    """Times by ISO 8601, to the millisecond."""
    stamps = np.round(at_s * 1000.0).astype("datetime64[ms]")
    return [f"{each}Z" for each in np.datetime_as_string(stamps).tolist()]


class CsbProvider(NamedTuple):
    """Who gives crowd-sourced bathymetry away, as B-12 wants to know it."""

    name: str
    email: str


def provider_of(text: str) -> CsbProvider:
    """Parse "NAME <a@b.pt>". Raises FormatError."""
    match = re.fullmatch(r"\s*([^<>]{1,100}?)\s*<([A-Za-z0-9._%+-]+@[A-Za-z0-9.-]+\.[A-Za-z]{2,6})>\s*", text)
    if match is None:
        raise FormatError(f"{text}: who provides it, as NAME <name@place.pt>")
    return CsbProvider(match[1], match[2])


def crowd_sourced(path: Path, its: Reduced, provider: CsbProvider, boat: str, version: str) -> None:
    """Write the soundings that are believed as crowd-sourced bathymetry: depths below the water line, without the
    tide, for those who collect them reduce them alike."""
    node = {
        "providerOrganizationName": provider.name,
        "providerEmail": provider.email,
        "uniqueVesselID": f"DELFIM-{uuid.uuid5(uuid.NAMESPACE_DNS, f'{boat}.{provider.email}')}",
        "convention": "GeoJSON CSB 3.1",
        "dataLicense": "CC0 1.0",
        "providerLogger": "Delfim",
        "providerLoggerVersion": version,
        "navigationCRS": f"EPSG:{WGS}",
        "verticalReferenceOfDepth": "Waterline",
        "vesselPositionReferencePoint": "Transducer",
    }
    platform = {"name": boat, "type": "Uncrewed surface vehicle"}
    crs = {"type": "name", "properties": {"name": f"EPSG:{WGS}"}}
    head = {"type": "FeatureCollection", "crs": crs, "properties": {"trustedNode": node, "platform": platform}}
    good = np.flatnonzero(its.good)
    latitude, longitude = its.degrees()
    with path.open("w") as file:
        file.write(json.dumps(head)[:-1] + ', "features": [')
        between = "\n"
        for chunk in _chunks(good):
            water = its.depth_m[chunk] + its.tide_m[chunk]
            rows = zip(
                utc(its.at_s[chunk]), *(each.tolist() for each in (longitude[chunk], latitude[chunk], water)), strict=True
            )
            for at, x, y, depth in rows:
                place = f'"geometry":{{"type":"Point","coordinates":[{x:.8f},{y:.8f}]}}'
                file.write(f'{between}{{"type":"Feature",{place},"properties":{{"depth":{depth:.3f},"time":"{at}"}}}}')
                between = ",\n"
        file.write("]}\n")


def _chunks(numbers: "np.ndarray[Any, Any]") -> Iterator["np.ndarray[Any, Any]"]:
    return (numbers[at : at + CHUNK] for at in range(0, len(numbers), CHUNK))
