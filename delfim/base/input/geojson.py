"""GeoJSON (RFC 7946) from anybody: its geometries one by one, however they are collected."""

from codecs import BOM_UTF8
from collections.abc import Iterator
from typing import Any, NamedTuple

from delfim.base.input.untrusted import parse_json


class Geometry(NamedTuple):
    """A Point, a LineString or a Polygon: of several in one, each."""

    kind: str
    coordinates: Any  # as the file has them: longitude comes first
    says: dict[str, Any]  # the properties of its feature


def geometries(data: bytes) -> Iterator[Geometry]:
    """What is in a file, in its order. Raises FormatError where it is no JSON, and KeyError, TypeError and the like where it is
    no GeoJSON."""
    without_mark = data.removeprefix(BOM_UTF8)  # some editors of Windows write one
    ahead: list[tuple[Any, dict[str, Any]]] = [(parse_json(without_mark), {})]
    while ahead:
        it, says = ahead.pop()
        match it["type"]:
            case "FeatureCollection":
                ahead += [(each, {}) for each in reversed(it["features"])]
            case "Feature":
                if it["geometry"] is not None:
                    ahead.append((it["geometry"], it.get("properties") or {}))
            case "GeometryCollection":
                ahead += [(each, says) for each in reversed(it["geometries"])]
            case "Point" | "LineString" | "Polygon" as kind:
                yield Geometry(kind, it["coordinates"], says)
            case "MultiPoint" | "MultiLineString" | "MultiPolygon" as kind:
                yield from (Geometry(kind.removeprefix("Multi"), each, says) for each in it["coordinates"])
