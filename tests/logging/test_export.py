"""Logs in the formats of others, read back by the readers of others."""

import csv
import json
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import can
import mcap.reader
import numpy as np
import pytest

from delfim.base.errors import DelfimError
from delfim.base.frames import CAN_ERR, CAN_IDE, Frame, extended, standard
from delfim.logging.ashore import canexport, export, tree
from delfim.logging.ashore.table import table
from delfim.logging.candump import format_line
from delfim.logging.reading import read_events
from delfim.vehicle import console
from tests.logging.sailing import Day, logged, sailed

FORMATS_MISSING = "needs the packages of `make formats`"


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    """(columns, schema, events) of a sailed minute."""
    place = tmp_path_factory.mktemp("day")
    sailed(place).end()
    state = [file for file in logged(place) if file.id == "state"]
    return *table(state), list(tree.events(state))


def written(day, tmp_path: Path, form: str) -> Path:
    file = tmp_path / f"out.{form}"
    export.FORMATS[form](*day, file)
    return file


SHIPS = (
    'simulation.traffic.vessel=[{name="MARIA", transponder="A", north_m=900.0, course_deg=180.0, speed_mps=4.0},'
    '{name="<TEJO>", transponder="B", east_m=-900.0, course_deg=90.0, speed_mps=2.0}]'
)


@pytest.fixture(scope="module")
def met(tmp_path_factory):
    """The same of a minute and a half among ships that are heard by AIS."""
    place = tmp_path_factory.mktemp("met")
    sailing = Day(place, SHIPS, 'simulation.traffic.heard="perfect"', 'sensors.names=["sysstat", "nmea2000"]')
    sailing.sail(90.0)
    sailing.end()
    state = [file for file in logged(place) if file.id == "state"]
    return *table(state), list(tree.events(state))


def test_other_vessels_are_in_the_log_and_in_what_maps_read(met, tmp_path):
    told = [event for event in met[2] if event["event"] == "vessels"]
    assert 6 <= len(told) <= 9, "each ten seconds"
    assert {each["name"] for each in told[-1]["value"]} == {"MARIA", "<TEJO>"}
    with written(met, tmp_path, "mcap").open("rb") as stream:
        messages = [
            (channel.topic, known.name, json.loads(message.data))
            for known, channel, message in mcap.reader.make_reader(stream).iter_messages()
        ]
    seen = [json.loads(message["geojson"]) for topic, name, message in messages if topic == "/delfimx/targets"]
    assert {name for topic, name, _ in messages if topic == "/delfimx/targets"} == {"foxglove.GeoJSON"}
    assert len(seen) == len(told)
    point = next(each for each in seen[-1]["features"] if each["properties"]["name"] == "MARIA")
    maria = next(each for each in told[-1]["value"] if each["name"] == "MARIA")
    assert point["geometry"] == {"type": "Point", "coordinates": [maria["longitude_deg"], maria["latitude_deg"]]}
    assert not any("vessels" in message["message"] for topic, _, message in messages if topic == "/delfimx/log")
    root = ElementTree.fromstring(written(met, tmp_path, "kml").read_text())
    marks = {mark.findtext("{*}name"): mark for mark in root.iter("{http://www.opengis.net/kml/2.2}Placemark")}
    assert {"track", "MARIA", "<TEJO>"} <= marks.keys()
    assert len(marks["MARIA"].findall(".//{*}when")) == len(marks["MARIA"].findall(".//{*}coord")) >= 5


def test_each_sounding_stands_once_at_its_own_time_and_place(tmp_path):
    """The records repeat the last one, cycle after cycle; a chart of that would have depths where none was measured."""
    sailing = Day(tmp_path, 'sensors.names=["sysstat", "nmea2000"]')
    sailing.sail(5.0)
    assert sailing.command(console.Course(90.0, 1.5)) is None
    sailing.sail(40.0)
    sailing.end()
    state = [file for file in logged(tmp_path) if file.id == "state"]
    columns, schema, events = *table(state), list(tree.events(state))
    assert np.count_nonzero(~np.isnan(columns["depth_m"])) > 150
    with written((columns, schema, events), tmp_path, "soundings").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert 40 <= len(rows) <= 46, "one a second"
    assert len({row["utc"] for row in rows}) == len(rows)
    assert {(row["depth_m [m]"], row["depth_offset_m [m]"]) for row in rows} == {("12.0", "0.0")}
    moments = columns["monotonic_s"]
    for event, row in zip((each for each in events if each["event"] == "sounding"), rows, strict=True):
        east_deg = np.interp(event["measured_s"], moments, np.degrees(columns["longitude"]))
        assert row["longitude [deg]"] == "" or float(row["longitude [deg]"]) == pytest.approx(east_deg, abs=1e-7)
    assert sum(bool(row["longitude [deg]"]) for row in rows) >= len(rows) - 2, "but at both ends"


def test_a_sounding_between_two_records_lies_between_their_places_and_in_a_gap_nowhere(day, tmp_path):
    columns, schema, _ = day
    t_ns = int(columns["t1"][50] + columns["t1"][51]) // 2
    told = {"event": "sounding", "t_ns": t_ns + 70_000_000, "monotonic_s": 9.07, "measured_s": 9.0, "depth_m": 4.2}
    with written((columns, schema, [told]), tmp_path, "soundings").open(newline="") as text:
        (row,) = csv.DictReader(text)
    middle = np.degrees(columns["latitude"][50:52]).mean()
    assert float(row["latitude [deg]"]) == pytest.approx(middle, abs=1e-8)
    assert (row["depth_m [m]"], row["depth_offset_m [m]"]) == ("4.2", "")
    far = type(columns)({name: column[[0, -1]] for name, column in columns.items()})
    with written((far, schema, [told]), tmp_path, "soundings").open(newline="") as text:
        assert next(csv.DictReader(text))["latitude [deg]"] == ""


@pytest.mark.parametrize("wrong", [{"depth_m": "deep"}, {"measured_s": None}, {"monotonic_s": 1e300}, {"offset_m": []}])
def test_soundings_of_a_damaged_sidecar_are_left_out(tmp_path, wrong):
    told = {"event": "sounding", "t_ns": 1, "monotonic_s": 2.0, "measured_s": 1.0, "depth_m": 3.0, "offset_m": 0.5}
    (tmp_path / "a.meta.jsonl").write_text(f"{json.dumps(told)}\n{json.dumps(told | wrong)}\n")
    assert list(read_events(tmp_path / "a.meta.jsonl")) == [told]


@pytest.mark.parametrize(
    "value",
    [None, "MARIA", [3], [{"name": 3}], [{"name": "M"}], [{"name": "M", "latitude_deg": "1", "longitude_deg": 1}],
     [{"name": "M", "latitude_deg": 99.0, "longitude_deg": 1.0}],
     [{"name": "M", "latitude_deg": 9.0, "longitude_deg": 1.0, "course_deg": [1]}]],
)  # fmt: skip
def test_vessels_of_a_damaged_sidecar_are_left_out(tmp_path, value):
    sidecar = tmp_path / "000000.meta.jsonl"
    sidecar.write_text(json.dumps({"t_ns": 1, "monotonic_s": 1.0, "event": "vessels", "value": value}) + "\n")
    assert list(read_events(sidecar)) == []


def test_csv_has_every_field_of_every_record_in_degrees_with_units(day, tmp_path):
    columns, schema, _ = day
    columns["cross_track"][0] = np.nan
    with written(day, tmp_path, "csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(columns["t1"])
    heads = [head.partition(" ")[0] for head in rows[0]]
    assert sorted(heads) == sorted(["utc", *schema.names])
    assert heads[-3:] == ["console_s", "guest_s", "watchdog_s"], "stamps of inputs stand apart"
    assert {row["guest_s [s]"] for row in rows} == {""}, "never heard"
    assert max(len(value.partition(".")[2]) for row in rows for head, value in row.items() if head != "utc") <= 9
    assert {"latitude [deg]", "yaw_rate [deg/s]", "cross_track [m]", "starboard_rpm [1/min]", "t1 [ns]", "mode", "run"} <= {
        *rows[0]
    }
    assert rows[0]["utc"].startswith("2010-01-01T00:00:00")
    latitudes_deg = [float(row["latitude [deg]"]) for row in rows]
    assert latitudes_deg == pytest.approx(np.degrees(columns["latitude"]).tolist(), abs=1e-9)
    assert list(dict.fromkeys(row["mode"] for row in rows)) == ["idle", "play", "heading", "manual"]
    assert rows[0]["cross_track [m]"] == "", "not known"


def test_parquet_has_types_units_and_time(day, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason=FORMATS_MISSING)
    columns, schema, _ = day
    read = parquet.read_table(written(day, tmp_path, "parquet"))
    assert read.column_names == ["utc", *schema.names]
    assert str(read.schema.field("utc").type) == "timestamp[ns, tz=UTC]"
    assert read.schema.field("heading").metadata[b"unit"] == b"rad"
    np.testing.assert_array_equal(read.column("starboard_rpm").to_numpy(), columns["starboard_rpm"])
    known = np.isfinite(columns["cross_track"])
    assert 0 < known.sum() < len(known)
    assert read.column("cross_track").null_count == len(known) - known.sum(), "a query's max() is a number"


def test_gpx_has_the_track_and_the_changes_of_mode(day, tmp_path):
    columns, _, _ = day
    root = ElementTree.parse(written(day, tmp_path, "gpx")).getroot()
    names = {"g": "http://www.topografix.com/GPX/1/1"}
    points = root.findall("g:trk/g:trkseg/g:trkpt", names)
    assert len(points) == np.isfinite(columns["latitude"]).sum()
    assert float(points[0].get("lat")) == pytest.approx(np.degrees(columns["latitude"][0]), abs=1e-7)
    assert points[0].find("g:time", names).text.endswith("Z")
    told = [each.find("g:name", names).text for each in root.findall("g:wpt", names)]
    assert "play: operator" in told
    assert "idle: no manual command for 5.0 s" in told


def test_a_gap_without_positions_breaks_the_track(day, tmp_path):
    columns, schema, _ = day
    part = {name: column.copy() for name, column in columns.items()}
    part["latitude"][100:200] = np.nan
    export.to_gpx(part, schema, [], tmp_path / "gap.gpx")
    assert (tmp_path / "gap.gpx").read_text().count("<trkseg>") == 2


def test_kml_has_as_many_times_as_places(day, tmp_path):
    text = written(day, tmp_path, "kml").read_text()
    ElementTree.fromstring(text)
    track = text[text.index("<gx:Track>") :]
    assert track.count("<when>") == track.count("<gx:coord>") == len(day[0]["t1"])


def test_mcap_opens_with_its_own_reader(day, tmp_path):
    columns, _, events = day
    with written(day, tmp_path, "mcap").open("rb") as stream:
        messages = [
            (channel.topic, message.log_time, json.loads(message.data), known.name)
            for known, channel, message in mcap.reader.make_reader(stream).iter_messages()
        ]
    states = [(t_ns, message) for topic, t_ns, message, _ in messages if topic == "/delfimx/state"]
    assert [t_ns for t_ns, _ in states] == columns["t1"].tolist()
    assert states[5][1]["heading"] == pytest.approx(float(columns["heading"][5]))
    assert {name for topic, _, _, name in messages if topic == "/delfimx/location"} == {"foxglove.LocationFix"}
    assert sum(topic == "/delfimx/log" for topic, *_ in messages) == len(events)
    assert "settings" not in json.dumps([message for topic, _, message, _ in messages if topic == "/delfimx/log"])


def test_mat_holds_every_column_as_doubles(day, tmp_path):
    scipy = pytest.importorskip("scipy.io", reason=FORMATS_MISSING)
    columns, schema, _ = day
    read = scipy.loadmat(str(written(day, tmp_path, "mat")))
    assert read["start"][0].startswith("2010-01-01T00:00:00")
    assert set(read) == {"boat", "start", "start_ns", *schema.names}
    np.testing.assert_array_equal(read["heading"][:, 0], columns["heading"].astype(float))
    assert read["t1"][-1, 0] == pytest.approx((columns["t1"][-1] - columns["t1"][0]) / 1e9, abs=1e-9)


FRAMES = [
    ("can0", Frame(standard(0x123), b"\x11\x22", 1_262_304_000_000_123_000)),
    ("can1", Frame(extended(0x18EF2A10), bytes(8), 1_262_304_000_100_000_000, sent_here=True)),
    ("can0", Frame(standard(0x7FF, remote=True), bytes(3), 1_262_304_000_200_000_000)),
    ("can0", Frame(standard(0x001), b"", 1_262_304_001_000_000_000)),
]


@pytest.mark.parametrize("form", canexport.FORMATS)
def test_the_black_box_in_formats_of_others(tmp_path, form):
    if form == "mf4":
        pytest.importorskip("asammdf", reason=FORMATS_MISSING)
    file = tmp_path / f"out.{form}"
    assert canexport.write(iter(FRAMES), file, form) == len(FRAMES)
    with can.LogReader(file) as reader:
        read = sorted(reader, key=lambda message: message.timestamp)
    assert [message.arbitration_id for message in read] == [frame.identifier for _, frame in FRAMES]
    assert [message.is_extended_id for message in read] == [frame.extended for _, frame in FRAMES]
    assert [message.is_remote_frame for message in read] == [frame.remote for _, frame in FRAMES]
    assert [bytes(message.data) for message in read if not message.is_remote_frame] == [
        f.data for _, f in FRAMES if not f.remote
    ]
    since = [message.timestamp - read[0].timestamp for message in read]
    assert since == pytest.approx([(frame.t_ns - FRAMES[0][1].t_ns) / 1e9 for _, frame in FRAMES], abs=2e-4)
    if form != "log":
        assert len({message.channel for message in read}) == 2


@pytest.mark.parametrize("form", ["asc", "blf", "mf4"])
def test_error_frames_are_error_frames_in_the_formats_of_others(tmp_path, form):
    if form == "mf4":
        pytest.importorskip("asammdf", reason=FORMATS_MISSING)
    told = bytes((0, 4, 0, 0, 0, 0, 0, 0))
    error = Frame(4 << 3 | CAN_IDE | CAN_ERR, told, 1_262_304_000_050_000_000)
    file = tmp_path / f"out.{form}"
    assert canexport.write([FRAMES[0], ("can0", error), FRAMES[1]], file, form) == 3
    with can.LogReader(file) as reader:
        read = sorted(reader, key=lambda message: message.timestamp)
    assert [message.is_error_frame for message in read] == [False, True, False]
    if form != "asc":  # which says when there was one, and no more
        assert (read[1].arbitration_id, bytes(read[1].data)) == (4, told)


def test_the_head_of_asc_has_the_time_of_the_first_frame(tmp_path):
    canexport.write(iter(FRAMES), tmp_path / "out.asc", "asc")
    lines = (tmp_path / "out.asc").read_text().splitlines()
    assert lines[0].endswith("2010")
    assert lines[0].removeprefix("date ")[:19] == lines[3].removeprefix("Begin Triggerblock ")[:19]


def test_the_head_of_mf4_has_the_time_of_the_first_frame_and_samples_count_from_there(tmp_path):
    asammdf = pytest.importorskip("asammdf", reason=FORMATS_MISSING)
    canexport.write(iter(FRAMES), tmp_path / "out.mf4", "mf4")
    with asammdf.MDF(tmp_path / "out.mf4") as read:
        assert read.header.start_time.timestamp() == pytest.approx(FRAMES[0][1].t_ns / 1e9, abs=1e-3)
        assert read.get("CAN_DataFrame.ID").timestamps.tolist() == pytest.approx([0.0, 0.099877, 0.999877], abs=1e-5)


@pytest.mark.parametrize("form", ["asc", "blf", "mf4"])
def test_a_time_without_frames_makes_no_file(tmp_path, form):
    with pytest.raises(DelfimError, match="no frame in this time"):
        canexport.write(iter(()), tmp_path / f"out.{form}", form)
    assert not list(tmp_path.iterdir())


def test_asc_is_read_by_can_utils(tmp_path):
    if not shutil.which("asc2log"):
        pytest.skip("asc2log of can-utils is missing (make system installs it on Debian)")
    file = tmp_path / "out.asc"
    canexport.write(iter(FRAMES), file, "asc")
    told = subprocess.run(
        ["asc2log", "-I", str(file)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True
    )
    words = [line.split()[2].removesuffix("#R3").removesuffix("#R") for line in told.stdout.splitlines()]
    assert words == ["123#1122", "18EF2A10#0000000000000000", "7FF", "001#"]


def test_plain_candump_is_what_was_logged_error_frames_included(tmp_path):
    error = Frame(4 << 3 | CAN_IDE | CAN_ERR, bytes(8), 1_262_304_002_000_000_000)
    canexport.write([*FRAMES, ("can0", error)], tmp_path / "out.log", "log")
    lines = (tmp_path / "out.log").read_text().splitlines(keepends=True)
    assert lines == [format_line(frame, name) for name, frame in [*FRAMES, ("can0", error)]]


def test_nothing_logged_is_told(tmp_path):
    with pytest.raises(DelfimError, match="no state was logged"):
        table([])
