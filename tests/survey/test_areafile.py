"""Areas from files: every kind, and what is wrong with them, in one line and without much time or memory."""

import json
import math
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import FormatError
from delfim.survey.areafile import BYTES, CORNERS, Shape, read_area

RING = [(38.69, -9.21), (38.69, -9.209), (38.691, -9.209), (38.691, -9.21)]
HOLE = [(38.6904, -9.2096), (38.6904, -9.2094), (38.6906, -9.2095)]
SHAPE = Shape(RING, [HOLE])
EAST_FIRST = [[[east, north] for north, east in [*ring, ring[0]]] for ring in (RING, HOLE)]
POLYGON = {"type": "Polygon", "coordinates": EAST_FIRST}
FEATURE = {"type": "Feature", "properties": None, "geometry": POLYGON}
POINT = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [1.0, 2.0]}}


def text_of(ring: list[tuple[float, float]]) -> str:
    return " ".join(f"{east},{north},0" for north, east in [*ring, ring[0]])


KML = f"""<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>Dock</name>
<LineString><coordinates>1,2 3,4 5,6</coordinates></LineString>
<Polygon><outerBoundaryIs><LinearRing><coordinates>
{text_of(RING)}
</coordinates></LinearRing></outerBoundaryIs>
<innerBoundaryIs><LinearRing><coordinates>{text_of(HOLE)}</coordinates></LinearRing></innerBoundaryIs></Polygon>
</Placemark></Document></kml>"""
POINTS = "".join(f'<rtept lat="{north}" lon="{east}"><name>x</name></rtept>' for north, east in RING)
GPX = f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="1" lon="2"/><rte><name>Dock</name>{POINTS}</rte></gpx>'
TRACK = POINTS.replace("rtept", "trkpt")
SURVEY = {"type": "ComplexItem", "complexItemType": "survey", "polygon": [list(corner) for corner in RING]}
ZONE = {"inclusion": False, "polygon": [list(corner) for corner in HOLE]}
PLAN = {"fileType": "Plan", "mission": {"items": [{"type": "SimpleItem"}, SURVEY]}, "geoFence": {"polygons": [ZONE]}}


@pytest.fixture
def read(tmp_path):
    def reading(name: str, text: object) -> list[Shape]:
        (tmp_path / name).write_text(text if isinstance(text, str) else json.dumps(text))
        return read_area(tmp_path / name)

    return reading


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("dock.geojson", POLYGON),
        ("dock.geojson", f"\ufeff{json.dumps(POLYGON)}"),
        ("dock.json", {"type": "FeatureCollection", "features": [POINT, {**POINT, "geometry": None}, FEATURE]}),
        ("dock.geojson", {"type": "GeometryCollection", "geometries": [{"type": "MultiPolygon", "coordinates": [EAST_FIRST]}]}),
        ("dock.kml", KML),
        ("dock.KML", KML.replace("<kml ", "<k:kml ").replace("</kml>", "</k:kml>").replace("xmlns=", "xmlns:k=")),
    ],
)
def test_a_polygon_with_a_hole_is_read_from_every_kind_that_has_them(read, name, text) -> None:
    assert read(name, text) == [SHAPE]


def test_routes_and_tracks_of_gpx_are_outlines(read) -> None:
    assert read("dock.gpx", GPX) == [Shape(RING, [])]
    both = GPX.replace("</gpx>", f"<trk><trkseg>{TRACK}</trkseg><trkseg>{TRACK}</trkseg></trk></gpx>")
    assert read("dock.gpx", both) == [Shape(RING, [])] * 3


def test_a_plan_gives_its_surveys_or_else_its_fence(read) -> None:
    assert read("dock.plan", PLAN) == [Shape(RING, []), Shape([], [HOLE])]
    fence = {"polygons": [ZONE, {"inclusion": True, "polygon": SURVEY["polygon"]}]}
    fence["circles"] = [{"inclusion": False, "circle": {"center": [38.6905, -9.2095], "radius": 10.0}}]  # type: ignore[list-item,dict-item]
    outline, zones = read("dock.plan", {**PLAN, "mission": {"items": []}, "geoFence": fence})
    assert (outline, zones.outline, zones.holes[0]) == (Shape(RING, []), [], HOLE)
    far_m = [math.hypot((n - 38.6905) * 111_000.0, (e + 9.2095) * 86_900.0) for n, e in zones.holes[1]]
    assert 10.0 <= min(far_m) <= max(far_m) < 10.5


def shapefile(*rings: list[tuple[float, float]], kind: int = 5) -> bytes:
    """One record, after a point's: as the format's white paper has it."""
    closed = [[*ring, ring[0]] for ring in rings]
    counts = [len(ring) for ring in closed]
    firsts = [sum(counts[:number]) for number in range(len(counts))]
    corners = [number for ring in closed for north, east in ring for number in (east, north)]
    body = struct.pack("<i4dii", kind, *(0.0,) * 4, len(rings), sum(counts)) + struct.pack(f"<{len(rings)}i", *firsts)
    body += struct.pack(f"<{len(corners)}d", *corners)
    point = struct.pack(">ii", 1, 10) + struct.pack("<idd", 1, 2.0, 3.0)
    return struct.pack(">i", 9994) + bytes(96) + point + struct.pack(">ii", 2, len(body) // 2) + body


def test_shapefiles_have_outlines_clockwise_and_holes_the_other_way(tmp_path) -> None:
    file, clockwise, hole = tmp_path / "dock.shp", RING[::-1], HOLE
    file.write_bytes(shapefile(clockwise, hole))
    assert read_area(file) == [Shape(clockwise, []), Shape([], [hole])]
    file.write_bytes(shapefile(RING))
    assert read_area(file) == [Shape(RING, [])], "one ring is an outline, whichever way it goes"
    whole = shapefile(clockwise, hole, kind=15)
    for end in range(0, len(whole), 7):
        file.write_bytes(whole[:end])
        with pytest.raises(FormatError):
            read_area(file)
    file.write_bytes(shapefile([(4_283_000.0, 491_000.0), (4_283_100.0, 491_000.0), (4_283_100.0, 491_100.0)]))
    with pytest.raises(FormatError, match="in degrees of WGS 84"):
        read_area(file)


MANY = json.dumps([[0.001 * n, math.sin(n)] for n in range(CORNERS + 1)])
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><kml>&b;</kml>'


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.geojson", "", "not JSON"),
        ("a.geojson", json.dumps(FEATURE)[:-40], "not JSON"),
        ("a.geojson", "[" * 100_000, "nested too deep"),
        ("a.geojson", "[1, 2]", "not written as .geojson has it"),
        ("a.geojson", '{"type": "Feature"}', "not written as .geojson has it"),
        ("a.geojson", {"type": "FeatureCollection", "features": []}, "there is no area in it"),
        ("a.geojson", POINT, "there is no area in it"),
        ("a.geojson", {"type": "Polygon", "coordinates": [[[1, 2], [3, 4]]]}, "2 corners: it needs three"),
        ("a.geojson", {"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [5, "x"]]]}, "not written"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [NaN, 4]]]}', "no place of the Earth"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [1e400, 4]]]}', "no place of the Earth"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [1, 91]]]}', "no place of the Earth"),
        ("a.geojson", f'{{"type": "Polygon", "coordinates": [{MANY}]}}', "10001 corners: simplify it to 10000"),
        ("a.kml", KML[:-60], "not XML"),
        ("a.kml", "<kml/>", "there is no area in it"),
        ("a.kml", BOMB, "it declares entities"),
        ("a.kml", "<a>" * 1000, "nested too deep"),
        ("a.kml", KML.replace("-9.21,38.69,0", "-9.21"), "not written as .kml has it"),
        ("a.gpx", GPX.replace('lat="38.69"', ""), "not written as .gpx has it"),
        ("a.gpx", GPX.replace("<rte>", "<x>").replace("</rte>", "</x>"), "not written as .gpx has it"),
        ("a.plan", {"mission": {}}, "not written as .plan has it"),
        ("a.plan", {**PLAN, "mission": {"items": []}}, "there is no area in it"),
        ("a.shp", "", "not written as .shp has it"),
        ("a.dxf", "", "not a file of areas: .geojson, .json, .kml, .gpx, .plan, .shp"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(read, name, text, words) -> None:
    with pytest.raises(FormatError) as refused:
        read(name, text)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


CROSSED = [[38.69, -9.21], [38.691, -9.209], [38.69, -9.209], [38.691, -9.21]]


def lines(here: Path, *words: str) -> int:
    return main(["survey", "lines", str(here), "--spacing", "10", "--output", str(here.parent / "out.toml"), *words])


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error, and nothing else."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("delfim: ")
    assert err.count("\n") == 1
    return err


def test_the_command_refuses_in_one_line_and_writes_nothing(tmp_path, capsys) -> None:
    def refused(name: str, text: str, *words: str) -> str:
        (tmp_path / name).write_text(text)
        assert lines(tmp_path / name, *words) == 2
        assert not (tmp_path / "out.toml").exists()
        return told(capsys)

    plan = {**PLAN, "mission": {"items": [{**SURVEY, "polygon": CROSSED}]}}
    assert "area 1 crosses or touches itself at 38.6905" in refused("a.plan", json.dumps(plan))
    flat = {"type": "Polygon", "coordinates": [[[0, 0], [0, 0.001], [0, 0.002]]]}
    assert "crosses or touches itself" in refused("a.geojson", json.dumps(flat))
    filled = {"type": "Polygon", "coordinates": [EAST_FIRST[0], EAST_FIRST[0]]}
    assert "nothing is left to survey" in refused("a.geojson", json.dumps(filled))
    ocean = {"type": "Polygon", "coordinates": [[[0, 0], [0, 10], [10, 10]]]}
    assert "more than 20 km" in refused("a.geojson", json.dumps(ocean))
    good = json.dumps(POLYGON)
    assert "more than 500 are no survey" in refused("a.geojson", good, "--spacing", "0.05")
    assert "a run-in is 10 m or more" in refused("a.geojson", good, "--run-in", "4")
    assert "faster than this boat goes" in refused("a.geojson", good, "--speed", "9")
    assert "narrower than the spacing" in refused("a.geojson", good, "--swath", "5")
    assert "No such file" in (lines(tmp_path / "none.kml") and told(capsys))


@pytest.mark.parametrize("corners", [40_000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_a_file_of_a_hundred_megabytes_and_one_of_many_corners_are_not_read(tmp_path, capsys, corners) -> None:
    large = tmp_path / "a.geojson"
    with large.open("wb") as file:
        file.truncate(100_000_000)
    assert lines(large) == 2
    assert f"files of more than {BYTES} are not read" in told(capsys)
    many = tmp_path / "b.geojson"
    many.write_text(f'{{"type": "Polygon", "coordinates": [[{",".join(["[1,2]", "[3,4]"] * (corners // 2))}]]}}')
    assert lines(many) == 2
    assert "corners: simplify it to 10000" in told(capsys)


def test_the_command_tells_what_it_made(tmp_path, capsys) -> None:
    (tmp_path / "a.geojson").write_text(json.dumps(FEATURE))
    assert lines(tmp_path / "a.geojson", "--cross", "40", "--start", "ne", "--picture", str(tmp_path / "a.svg")) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"{tmp_path}/out.toml: " in out
    assert "lines 10 m apart at " in out
    assert "of them across" in out
    assert "m about holes and fences are left" in out
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")
    assert lines(tmp_path / "a.geojson", "--swath", "20", "--inside", "--heading", "45") == 0
    assert main(["survey", "lines", str(tmp_path / "a.geojson")]) == 2
    assert "say --spacing, or --swath" in capsys.readouterr().err


def test_a_process_of_its_own_reads_a_file_and_says_what_is_wrong_with_it(tmp_path) -> None:
    told = []
    for name, text in (("dock.geojson", json.dumps(FEATURE)), ("cut.geojson", json.dumps(FEATURE)[:-20])):
        (tmp_path / name).write_text(text)
        command = [sys.executable, "-m", "delfim.survey.areafile", str(tmp_path / name)]
        told.append(json.loads(subprocess.run(command, capture_output=True, timeout=60, check=True).stdout))
    assert told[0] == {"areas": json.loads(json.dumps([SHAPE]))}
    assert list(told[1]) == ["refused"]
    assert told[1]["refused"].startswith(f"{tmp_path / 'cut.geojson'}: not JSON")
