"""Plans of other programs: what is written comes back, others read it, and what is wrong is one line."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp

from delfim.base.errors import FormatError
from delfim.console.plans.planfile import BYTES, KINDS, POINTS, read_plan
from delfim.console.plans.planwriting import WRITERS, written

READERS = "the readers of others are not installed: make formats"
PLACES = [(38.6907, -9.2153), (38.6912, -9.2153), (38.6912, -9.2146)]
PLAN: dict[str, Any] = {
    "name": "Öre & <sound>",
    "waypoints": [
        {"latitude_deg": north, "longitude_deg": east, "speed_mps": 1.2 * n, "acceptance_m": 3.0, "hold_s": 5.0 * n}
        for n, (north, east) in enumerate(PLACES)
    ],
    "actions": [],
    "then": "home",
    "path": [],
    "path_actions": [],
    "fence": [[38.690, -9.216], [38.692, -9.216], [38.692, -9.214], [38.690, -9.214]],
    "obstacles": [{"latitude_deg": 38.691, "longitude_deg": -9.2149, "radius_m": 12.0}],
    "zones": [],
    "home": {"latitude_deg": 38.6906, "longitude_deg": -9.2152},
}
PICTURE = {"command": 206, "params": [5.0, 0.0, 1.0, 0.0], "x": 0, "y": 0, "z": 0.0, "frame": 2}
PLAN["waypoints"][0]["actions"] = [PICTURE]
ROW = "{}\t0\t3\t16\t0\t0\t0\t0\t{}\t{}\t0\t1\n"
LINE = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": [[e, n] for n, e in PLACES]}}
EAST_FIRST = " ".join(f"{e},{n},0" for n, e in PLACES)
KML = f"""<kml xmlns="http://www.opengis.net/kml/2.2"><Document>
<Placemark><Point><coordinates>1,2,3</coordinates></Point></Placemark>
<Placemark><LineString><coordinates>{EAST_FIRST}</coordinates></LineString></Placemark></Document></kml>"""
LONG = {"type": "LineString", "coordinates": [[0, n / 1e4] for n in range(POINTS + 1)]}
BOMB = '<!DOCTYPE x [<!ENTITY a "b">]><kml>&a;</kml>'


def file_of(folder: Path, kind: str, plan: dict[str, Any]) -> Path:
    ending, data = written(kind, plan)
    file = folder / f"plan{kind}"
    if ending == ".zip":
        data = zipfile.ZipFile(io.BytesIO(data)).read("plan.shp")
    file.write_bytes(data)
    return file


def at(plan: dict[str, Any]) -> list[tuple[float, float]]:
    return [(each["latitude_deg"], each["longitude_deg"]) for each in plan["waypoints"]]


degrees = st.tuples(st.integers(-890_000_000, 890_000_000), st.integers(-1_800_000_000, 1_800_000_000))


@given(kind=st.sampled_from(sorted(WRITERS)), places=st.lists(degrees, min_size=1, max_size=30, unique=True))
def test_the_places_of_each_kind_come_back(
    kind: str, places: list[tuple[int, int]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    stops = [{"latitude_deg": n / 1e7, "longitude_deg": e / 1e7} for n, e in places if (n, e) != (0, 0)]
    if not stops:
        return
    plan = read_plan(file_of(tmp_path_factory.getbasetemp(), kind, {"name": "a", "waypoints": stops}))
    assert at(plan) == [(each["latitude_deg"], each["longitude_deg"]) for each in stops]
    assert plan["left"] == ""


@pytest.mark.parametrize("kind", [".plan", ".waypoints"])
def test_lists_of_items_have_all_that_items_have(kind: str, tmp_path: Path) -> None:
    plan = read_plan(file_of(tmp_path, kind, PLAN))
    assert plan["left"] == ""
    assert [(each["speed_mps"], each["acceptance_m"], each["hold_s"]) for each in plan["waypoints"]] == [
        (0.0, 3.0, 0.0), (1.2, 3.0, 5.0), (2.4, 3.0, 10.0)
    ]  # fmt: skip
    assert plan["then"] == "home"
    assert plan["waypoints"][0]["actions"][0]["command"] == 206
    if kind == ".plan":
        assert (plan["fence"], plan["home"]) == (PLAN["fence"], PLAN["home"])
        assert [(each["latitude_deg"], each["radius_m"]) for each in plan["obstacles"]] == [(38.691, 12.0)]


def test_points_of_our_geojson_say_speed_acceptance_and_stay(tmp_path: Path) -> None:
    plan = read_plan(file_of(tmp_path, ".geojson", PLAN))
    assert [(each["speed_mps"], each["acceptance_m"], each["hold_s"]) for each in plan["waypoints"]] == [
        (0.0, 3.0, 0.0), (1.2, 3.0, 5.0), (2.4, 3.0, 10.0)
    ]  # fmt: skip
    assert plan["fence"] == PLAN["fence"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.geojson", json.dumps(LINE)),
        ("a.json", json.dumps({"type": "FeatureCollection", "features": [LINE]})),
        ("a.kml", KML),
        ("a.gpx", "<gpx><trk><trkseg>" + "".join(f'<trkpt lat="{n}" lon="{e}"/>' for n, e in PLACES) + "</trkseg></trk></gpx>"),
        ("a.gpx", "<gpx>" + "".join(f'<wpt lat="{n}" lon="{e}"><name>x</name></wpt>' for n, e in PLACES) + "</gpx>"),
        ("a.txt", "QGC WPL 110\n" + ROW.format(0, 1.0, 2.0) + "".join(ROW.format(n, *at) for n, at in enumerate(PLACES, 1))),
    ],
)
def test_lines_are_ways_and_points_where_there_is_no_line(name: str, text: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(text)
    assert at(read_plan(file)) == PLACES


def test_what_the_boat_cannot_do_is_left_out_in_words(tmp_path: Path) -> None:
    file = tmp_path / "a.waypoints"
    jump = "2\t0\t3\t177\t1\t3\t0\t0\t0\t0\t0\t1\n"
    file.write_text("QGC WPL 110\n" + ROW.format(0, 1.0, 2.0) + ROW.format(1, *PLACES[0]) + jump + ROW.format(3, *PLACES[1]))
    plan = read_plan(file)
    assert at(plan) == PLACES[:2]
    assert plan["left"] == "item 2: DO_JUMP (177) is not something this boat does"


def test_the_survey_of_qgroundcontrol_is_the_items_that_it_stands_for(tmp_path: Path) -> None:
    simple = [{"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, *place, 0]} for place in PLACES]
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": simple}, "polygon": []}
    file = tmp_path / "a.plan"
    file.write_text(json.dumps({"fileType": "Plan", "mission": {"items": [survey]}}))
    assert at(read_plan(file)) == PLACES


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.csv", "", "not a plan: .geojson"),
        ("a.plan", "{", "not JSON"),
        ("a.plan", "{}", "a plan is not written as .plan has it"),
        ("a.plan", json.dumps({"mission": {"items": [{"type": "SimpleItem", "command": "x"}]}}), "not written as .plan"),
        ("a.plan", json.dumps({"mission": {"items": []}}), "there is no way in it"),
        ("a.waypoints", "hello", "does not begin with 'QGC WPL 110'"),
        ("a.waypoints", "", "not written as .waypoints"),
        ("a.geojson", json.dumps({"type": "Polygon", "coordinates": []}), "there is no way in it"),
        ("a.geojson", '{"type": "LineString", "coordinates": [[1e400, 2]]}', "no place of the Earth"),
        ("a.geojson", "[" * 100_000, "not JSON"),
        ("a.kml", "<kml>", "not XML"),
        ("a.kml", '<?xml version="1.0" encoding="UT9-8"?><kml/>', "not XML: unknown encoding"),
        ("a.kml", BOMB, "it declares entities"),
        ("a.gpx", "<a>" * 100, "nested too deep"),
        ("a.gpx", '<gpx><wpt lat="95" lon="0"/></gpx>', "no place of the Earth"),
        ("a.shp", "no", "not written as .shp"),
        ("a.geojson", json.dumps(LONG), f"simplify it to {POINTS}"),
        ("a.txt", " " * (BYTES + 1), "are not read"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_one_line(name: str, text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises((FormatError, OSError)) as told:
        read_plan(file)
    assert says in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("kind", [".kml", ".gpx", ".geojson", ".shp"])
def test_gdal_reads_the_way(kind: str, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio", reason=READERS)
    ending, data = written(kind, PLAN)
    file = tmp_path / f"plan{ending}"
    file.write_bytes(data)
    layers = [str(layer) for layer, _ in pyogrio.list_layers(file)]
    layer = "routes" if kind == ".gpx" else layers[0]
    meta, _, shapes, fields = pyogrio.raw.read(file, layer=layer)
    assert meta["crs"] == "EPSG:4326"
    wkb = next(shape for shape in shapes if shape[1] in (2, 5))  # a line
    assert int.from_bytes(wkb[5:9], "little") == (len(PLACES) if wkb[1] == 2 else 1)
    names = [str(each) for column in fields for each in column]
    assert PLAN["name"] in names


def test_pymavlink_reads_the_list(tmp_path: Path) -> None:
    loader = mavwp.MAVWPLoader()
    assert (
        loader.load(str(file_of(tmp_path, ".waypoints", PLAN))) == 8
    )  # home, picture, waypoints with two changes of speed, the way home
    rows = [loader.wp(number) for number in range(loader.count())]
    assert [(round(each.x, 7), round(each.y, 7)) for each in rows if each.command == 16][1:] == PLACES


def test_every_kind_that_is_written_is_read() -> None:
    assert set(WRITERS) <= set(KINDS)
    with pytest.raises(FormatError, match="no kind of plan"):
        written(".doc", PLAN)
