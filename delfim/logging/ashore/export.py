"""State logs in formats of other programs: CSV, Parquet, GPX, KML, MCAP (Foxglove, Lichtblick) and MAT (Octave, MATLAB, scipy);
and the soundings alone.

Numbers stay in SI units and radians, as they were logged, except in CSV and where the format itself has degrees.
"""

import csv
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.sax.saxutils import escape

from delfim.base.modes import Mode
from delfim.logging.ashore import topics
from delfim.logging.ashore.table import TIME, Columns, units
from delfim.logging.statelog import Schema

if TYPE_CHECKING:
    from numpy.typing import NDArray


SOUNDED_NS: Final = 2_000_000_000  # between positions further apart nobody knows where a sounding was taken
GAP_NS: Final = 10_000_000_000  # without positions: the track is broken here

Events = Iterable[Mapping[str, Any]]  # of the sidecars


def to_csv(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """CSV for people and spreadsheets: a line for each record, names with units in the first, degrees, modes by name; unknown
    values are empty. The first column is the time in UTC; the stamps of the loop and of its inputs come last."""
    its = units(schema)
    names = sorted(columns, key=lambda name: name in _STAMPS)
    heads = [f"{name} [{_DEGREES.get(its.get(name, ''), its[name])}]" if its.get(name) else name for name in names]
    lists = [_readable(name, its.get(name, ""), columns[name]) for name in names]
    with file.open("w", newline="", encoding="utf-8") as text:
        writer = csv.writer(text)
        writer.writerow(["utc", *heads])
        for t_ns, *values in zip(columns[TIME].tolist(), *lists, strict=True):
            writer.writerow([_iso(t_ns), *values])


_DEGREES: Final = {"rad": "deg", "rad/s": "deg/s"}
_STAMPS: Final = ("utc_ns", "t0", "t1", "t2", "t3", "t4", "previous_t5", "console_s", "guest_s", "watchdog_s")
_NEVER_S: Final = -1e8  # a stamp before that: not heard yet


def _readable(name: str, unit: str, column: "NDArray[Any]") -> list[Any]:
    import numpy as np

    if column.dtype.kind == "f":
        single, column = (
            column.dtype.itemsize == 4,
            np.degrees(column.astype(float)) if unit in _DEGREES else column.astype(float),
        )
        column = column.round(6) if single else column.round(9)
    values = column.tolist()
    if name in _STAMPS:
        return ["" if value < _NEVER_S else value for value in values]
    if name == "mode":
        names = {int(mode): mode.name.lower() for mode in Mode}
        return [names.get(value, value) for value in values]
    return ["" if isinstance(value, float) and math.isnan(value) else value for value in values]


SOUNDED: Final = (  # what stands beside a sounding: head, name of the field, in degrees, between two records or as before it
    ("latitude [deg]", "latitude", True, True),
    ("longitude [deg]", "longitude", True, True),
    ("line", "line", False, False),
    ("heading [deg]", "heading", True, True),
    ("roll [deg]", "roll", True, True),
    ("pitch [deg]", "pitch", True, True),
    ("fix", "fix", False, False),
    ("accuracy [m]", "accuracy", False, True),
    ("height_m [m]", "height_m", False, True),
)
TOLD: Final = {"depth_m [m]": "depth_m", "depth_offset_m [m]": "offset_m", "confidence": "confidence"}
TOLD_MORE: Final = {"source": "source", "number": "number"}


def to_soundings(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """CSV for charts: each ping once, raw, at its own time, and where the boat was and how it lay then, between the positions
    before and after. What is not known is empty."""
    pings = [event for event in events if event["event"] == "sounding"]
    stamps = [told["t_ns"] - round((told["monotonic_s"] - told["measured_s"]) * 1e9) for told in pings]
    beside = {head: _beside(columns, stamps, name, is_angle, between) for head, name, is_angle, between in SOUNDED}
    place = dict(list(beside.items())[:2])
    heads = ["utc", *place, *TOLD, *TOLD_MORE, *list(beside)[2:]]
    with file.open("w", newline="", encoding="utf-8") as text:
        writer = csv.DictWriter(text, heads)
        writer.writeheader()
        for number, (t_ns, told) in enumerate(zip(stamps, pings, strict=True)):
            row = {head: told.get(key, "") for head, key in (TOLD | TOLD_MORE).items()}
            writer.writerow({"utc": _iso(t_ns)} | row | {head: values[number] for head, values in beside.items()})


def _beside(columns: Columns, stamps: list[int], name: str, is_angle: bool, is_between: bool) -> list[object]:
    """The values of a field at these times; empty where no position is known shortly before and after."""
    import numpy as np

    known = np.isfinite(columns["latitude"]) & np.isfinite(columns["longitude"])
    times, at = columns[TIME][known], np.array(stamps, dtype=np.int64)
    if name not in columns or len(times) < 2:
        return [""] * len(stamps)
    values = columns[name][known].astype(float)
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    apart = times[after] - times[after - 1]
    is_near = (at > times[after - 1]) & (at <= times[after]) & (apart <= SOUNDED_NS)
    step = values[after] - values[after - 1]
    step = np.remainder(step + math.pi, math.tau) - math.pi if is_angle else step
    found = values[after - 1] + (step * (at - times[after - 1]) / np.maximum(apart, 1) if is_between else 0.0)
    if is_angle:
        found = np.degrees(found)
        found = np.remainder(found, 360.0) if name == "heading" else np.remainder(found + 180.0, 360.0) - 180.0
    digits = 9 if name in ("latitude", "longitude") else 3
    told = zip(found.tolist(), (is_near & np.isfinite(found)).tolist(), strict=True)
    return [round(value, digits) if is_known else "" for value, is_known in told]


def to_parquet(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """Parquet: a column for each field, its unit and description in the field's metadata. Needs pyarrow."""
    import pyarrow as arrow
    from pyarrow import parquet

    told = {name: {"unit": unit, "description": words} for name, _, unit, words in schema.rows}
    arrays = [arrow.array(column, from_pandas=True) for column in columns.values()]  # unknown values are null, not NaN
    fields = [arrow.field(name, array.type, metadata=told.get(name)) for name, array in zip(columns, arrays, strict=True)]
    stamps = arrow.array(columns[TIME]).cast(arrow.timestamp("ns", tz="UTC"))
    table = arrow.Table.from_arrays([stamps, *arrays], schema=arrow.schema([arrow.field("utc", stamps.type), *fields]))
    parquet.write_table(table.replace_schema_metadata({"boat": schema.boat}), file, compression="zstd")


def to_gpx(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """GPX 1.1: the track, broken where positions are missing, and a waypoint where the mode changed."""
    with file.open("w", encoding="utf-8") as text:
        text.write('<?xml version="1.0" encoding="UTF-8"?>\n')
        text.write('<gpx version="1.1" creator="Delfim" xmlns="http://www.topografix.com/GPX/1/1">\n')
        for t_ns, latitude, longitude, name in _mode_changes(columns, events):
            place = f'lat="{latitude:.8f}" lon="{longitude:.8f}"'
            text.write(f"<wpt {place}><time>{_iso(t_ns)}</time><name>{escape(name)}</name></wpt>\n")
        text.write(f"<trk><name>{escape(schema.boat)}</name><trkseg>\n")
        before_ns = 0
        for t_ns, latitude, longitude in _positions(columns):
            if before_ns and t_ns - before_ns > GAP_NS:
                text.write("</trkseg><trkseg>\n")
            before_ns = t_ns
            text.write(f'<trkpt lat="{latitude:.8f}" lon="{longitude:.8f}"><time>{_iso(t_ns)}</time></trkpt>\n')
        text.write("</trkseg></trk>\n</gpx>\n")


def to_kml(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """KML 2.2 with a gx:Track, which Google Earth plays, one of each other vessel, and a place mark where the mode changed."""
    with file.open("w", encoding="utf-8") as text:
        text.write('<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"')
        text.write(f' xmlns:gx="http://www.google.com/kml/ext/2.2"><Document><name>{escape(schema.boat)}</name>\n')
        for t_ns, latitude, longitude, name in _mode_changes(columns, events):
            text.write(f"<Placemark><name>{escape(name)}</name><TimeStamp><when>{_iso(t_ns)}</when></TimeStamp>")
            text.write(f"<Point><coordinates>{longitude:.8f},{latitude:.8f},0</coordinates></Point></Placemark>\n")
        text.write("<Placemark><name>track</name><Style><LineStyle><color>ff5b49d1</color><width>2</width></LineStyle></Style>")
        text.write("<gx:Track><altitudeMode>clampToGround</altitudeMode>\n")
        points = list(_positions(columns))
        for t_ns, _, _ in points:
            text.write(f"<when>{_iso(t_ns)}</when>\n")
        for _, latitude, longitude in points:
            text.write(f"<gx:coord>{longitude:.8f} {latitude:.8f} 0</gx:coord>\n")
        text.write("</gx:Track></Placemark>\n")
        for name, places in _vessel_ways(events).items():
            whens = "".join(f"<when>{_iso(t_ns)}</when>" for t_ns, _, _ in places)
            coords = "".join(f"<gx:coord>{longitude:.7f} {latitude:.7f} 0</gx:coord>" for _, latitude, longitude in places)
            text.write(f"<Placemark><name>{escape(name)}</name><gx:Track>{whens}{coords}</gx:Track></Placemark>\n")
        text.write("</Document></kml>\n")


def to_mcap(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """MCAP with JSON messages, by the topics of `topics.py`: state with every field, location and other vessels for maps,
    log."""
    from mcap.writer import Writer

    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="delfim")
        state = {name: {"type": _JSON[code], "description": f"{words} [{unit}]"} for name, code, unit, words in schema.rows}
        channels = {}
        for of in (topics.STATE, topics.LOCATION, topics.TARGETS, topics.LOG):
            name, told = topics.schema(of, state)
            number = writer.register_schema(name, "jsonschema", told)
            channels[of] = writer.register_channel(topics.topic(schema.boat, of), "json", number)

        def add(of: str, t_ns: int, message: object) -> None:
            writer.add_message(channels[of], t_ns, json.dumps(message).encode(), t_ns)

        for event in sorted(events, key=lambda each: each["t_ns"]):
            if event["event"] == "sounding":
                continue
            if event["event"] == "vessels":
                add(topics.TARGETS, event["t_ns"], topics.targets(event["value"]))
            else:
                add(topics.LOG, event["t_ns"], _line(event))
        for t_ns, latitude, longitude in _positions(columns):
            add(topics.LOCATION, t_ns, topics.location(t_ns, schema.boat, latitude, longitude))
        names, lists = tuple(columns), [column.tolist() for column in columns.values()]
        for t_ns, *values in zip(columns[TIME].tolist(), *lists, strict=True):
            known = {n: v for n, v in zip(names, values, strict=True) if not isinstance(v, float) or math.isfinite(v)}
            add(topics.STATE, t_ns, known)  # JSON has no NaN
        writer.finish()  # type: ignore[no-untyped-call]


def to_mat(columns: Columns, schema: Schema, events: Events, file: Path) -> None:
    """MAT version 4: a column vector of doubles for each field. Wall clock stamps become seconds since the text `start`: a
    double does not hold nanoseconds since 1970."""
    import struct

    zero_ns, its = int(columns[TIME][0]), units(schema)

    def matrix(name: str, kind: int, rows: int, columns: int, data: bytes) -> bytes:
        return struct.pack("<5i", kind, rows, columns, 0, len(name) + 1) + name.encode() + b"\0" + data

    with file.open("wb") as stream:
        for name, text in (("boat", schema.boat), ("start", _iso(zero_ns)), ("start_ns", str(zero_ns))):
            letters = text.encode("latin-1", "replace")
            stream.write(matrix(name, 51, 1, len(letters), letters))  # 51: text of one byte a letter
        for name, column in columns.items():
            seconds = (column - zero_ns) / 1e9 if its.get(name) == "ns" else column
            stream.write(matrix(name, 0, len(seconds), 1, seconds.astype("<f8").tobytes()))


FORMATS: Final[dict[str, Callable[[Columns, Schema, Events, Path], None]]] = {
    "csv": to_csv,
    "parquet": to_parquet,
    "gpx": to_gpx,
    "kml": to_kml,
    "mcap": to_mcap,
    "mat": to_mat,
    "soundings": to_soundings,
}


def _vessel_ways(events: Events) -> dict[str, list[tuple[int, float, float]]]:
    """The track of each other vessel while it was heard: (time, latitude, longitude), ns and degrees."""
    ways: dict[str, list[tuple[int, float, float]]] = {}
    for event in events:
        for each in event["value"] if event["event"] == "vessels" else ():
            if not each.get("lost"):
                ways.setdefault(each["name"], []).append((event["t_ns"], each["latitude_deg"], each["longitude_deg"]))
    return ways


def _positions(columns: Columns) -> Iterator[tuple[int, float, float]]:
    """The known positions: (time, latitude, longitude) in ns and degrees."""
    its = (columns[name].tolist() for name in (TIME, "latitude", "longitude"))
    for t_ns, latitude, longitude in zip(*its, strict=True):
        if math.isfinite(latitude + longitude):
            yield t_ns, math.degrees(latitude), math.degrees(longitude)


def _mode_changes(columns: Columns, events: Events) -> Iterator[tuple[int, float, float, str]]:
    """The changes of mode in the sidecar, (time, latitude, longitude, mode and reason), at the position known then."""
    import numpy as np

    points = list(_positions(columns))
    stamps = np.array([point[0] for point in points])
    for event in events:
        if event["event"] == "mode" and points:
            at = max(int(np.searchsorted(stamps, event["t_ns"], "right")) - 1, 0)
            yield event["t_ns"], points[at][1], points[at][2], f"{event['value']}: {event['reason']}"


_JSON: Final = {"?": "boolean", "f": "number", "d": "number"} | dict.fromkeys("bBhHiIqQ", "integer")


def _line(event: Mapping[str, Any]) -> dict[str, object]:
    words = {key: value for key, value in event.items() if key not in ("t_ns", "monotonic_s", "event", "id", "settings")}
    level = topics.INFORMATION if event["event"] in ("start", "end", "command", "mode") else topics.WARNING
    text = f"{event['event']} {json.dumps(words) if words else ''}".strip()
    return topics.line(event["t_ns"], event["id"], level, text)


def _iso(t_ns: int) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=t_ns // 1000)).isoformat().replace("+00:00", "Z")
