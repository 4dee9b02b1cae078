"""Official charts: what is dangerous in them and why, cells that are not whole, and the field of clearances against truth."""

import json
import lzma
import math
from collections.abc import Callable
from pathlib import Path

import numpy
import pytest
import shapely

from delfim.__main__ import main
from delfim.base.errors import FormatError
from delfim.base.geodesy import Origin, origin
from delfim.vehicle.plans.clearance import laid
from delfim.vehicle.plans.clearancefile import read
from tests.survey.cells import MadeCell, catalogue, harbour, square

pytest.importorskip("pyogrio", reason="it comes with make formats")

from delfim.survey.enc import making
from delfim.survey.enc.clearing import coded, made, overstated_m
from delfim.survey.enc.dangers import LAYERS, ChartDanger, Need, charted
from delfim.survey.enc.plane import degrees, flat
from delfim.survey.enc.reading import BYTES, EncCell, read_cell
from delfim.vehicle.plans.clearance import METRES

LAKE = Path(__file__).parents[1] / "data/charts/US5OH10M.000.xz"
PELEE, BAY = (41.76, -82.68), (41.48, -82.76)
SOURCE = "XX5TEST1, edition 2, 1:10,000, zone of confidence A2"
AT = "--at=38.69,-9.21"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> EncCell:
    file = tmp_path_factory.mktemp("lake") / "US5OH10M.000"
    file.write_bytes(lzma.decompress(LAKE.read_bytes()))
    return read_cell(file, LAYERS)


def dangers(cell: Path | EncCell, **need: float) -> dict[str, ChartDanger]:
    cell = read_cell(cell, LAYERS) if isinstance(cell, Path) else cell
    return {each.what: each for each in charted([cell], Need(0.5, **need)).dangers}


def test_dangers_come_with_their_reason_and_the_margin_of_their_chart(tmp_path: Path) -> None:
    found = dangers(harbour().write(tmp_path))
    assert {what: (each.margin_m, each.band) for what, each in found.items()} == {
        "shallow water of 0-2 m, 1 m needed": (20.0, "0-2 m"),
        "sounding of 0.6 m": (20.0, "0-2 m"),
        "land Ilha": (5.0, ""),
        "rock awash": (20.0, ""),
        "wreck of unknown depth": (20.0, ""),
        "bridge 2.5 m above the water": (5.0, ""),
        "restricted area Cais: entry prohibited": (5.0, ""),
    }
    assert found["rock awash"].why == f"rock awash, {SOURCE}"


def test_the_boat_the_tide_and_the_zone_of_confidence_count(tmp_path: Path) -> None:
    cell = read_cell(harbour(zone=6).write(tmp_path), LAYERS)
    found = dangers(cell, tide_m=-3.0, air_draught_m=2.4)
    assert "obstruction 4.2 m deep" not in found, "1.2 m of water are left"
    assert "obstruction 4.2 m deep" in dangers(cell, tide_m=-3.0, under_keel_m=0.8)
    assert "bridge 2.5 m above the water" not in found
    assert "bridge 2.5 m above the water" in dangers(cell, tide_m=0.2, air_draught_m=2.4), "the water is higher"
    assert found["rock awash"].margin_m == 50.0
    assert found["rock awash"].why.endswith("zone of confidence not assessed")
    assert dangers(cell, margin_m=12.0)["rock awash"].margin_m == 12.0
    assert dangers(cell, under_keel_m=9.0)["shallow water of 5-10 m, 9.5 m needed"].band == "5-10 m"


def test_what_is_not_known_is_dangerous(tmp_path: Path) -> None:
    cell, sea = MadeCell(), square(38.69, -9.21, 0.01)
    cell.area("DEPARE", sea).area("M_COVR", sea, CATCOV=1)
    cell.area("DEPARE", square(38.69, -9.2, 0.001), DRVAL1=-1.5, DRVAL2=0)
    cell.point("OBSTRN", (38.69, -9.211), VALSOU=9, QUASOU=8).point("BRIDGE", (38.69, -9.212))
    assert set(dangers(cell.write(tmp_path))) == {
        "shallow water of unknown depth",
        "shallow water that dries 1.5 m",
        "obstruction of unknown depth",
        "bridge of unknown clearance",
    }


def test_updates_beside_a_cell_are_applied(tmp_path: Path) -> None:
    file = harbour().write(tmp_path)
    for number in (1, 2):
        MadeCell(update=number, first=500 * number).point("UWTROC", (38.692, -9.2), WATLEV=3).write(tmp_path)
    cell = read_cell(file, LAYERS)
    assert (cell.update, sum(each.layer == "UWTROC" for each in cell.objects)) == (2, 3)
    assert charted([cell], Need(0.5)).names == ("XX5TEST1 edition 2.2",)


def _missing(folder: Path) -> None:
    MadeCell(update=2, first=500).point("UWTROC", (38.692, -9.2)).write(folder)


def _mixed(folder: Path) -> None:
    MadeCell(update=2, first=500).point("UWTROC", (38.692, -9.2)).write(folder).rename(folder / "XX5TEST1.001")


def _of_another_edition(folder: Path) -> None:
    MadeCell(update=1, edition=1, first=500).point("UWTROC", (38.692, -9.2)).write(folder)


def _without_a_record(folder: Path) -> None:
    data = (folder / "XX5TEST1.000").read_bytes()
    at = len(data)
    starts = []
    place = 0
    while place < at:
        starts.append(place)
        place += int(data[place : place + 5])
    (folder / "XX5TEST1.000").write_bytes(data[: starts[-1]])


def _changed(folder: Path) -> None:
    file = folder / "XX5TEST1.000"
    (folder / "CATALOG.031").write_bytes(catalogue(file))
    file.write_bytes(file.read_bytes().replace(b"Ilha", b"Agua"))


def _written(data: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / "XX5TEST1.000").write_bytes(data) and None


def _large(folder: Path) -> None:
    with (folder / "XX5TEST1.000").open("wb") as file:
        file.truncate(100_000_000)


def _shapeless(folder: Path) -> None:
    """A line whose end is nowhere: GDAL warns, and goes on."""
    file = folder / "XX5TEST1.000"
    data = file.read_bytes()
    file.write_bytes(data.replace(b"\x82\x01\x00\x00\x00\x01\x01\xff", b"\x82\xff\x7f\x00\x00\x01\x01\xff"))


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (_missing, "XX5TEST1.002: update 1 before it is missing"),
        (_mixed, "XX5TEST1.001: it is update 2 of edition 2, not 1 of edition 2"),
        (_of_another_edition, "XX5TEST1.001: it is update 1 of edition 1, not 1 of edition 2"),
        (_without_a_record, "XX5TEST1.000: it has 10 records of 11 (NOMR"),
        (_changed, "XX5TEST1.000: its checksum is "),
        (_written(b""), "XX5TEST1.000: not a cell of S-57: it has no head"),
        (_written(b"PK\3\4" * 100), "XX5TEST1.000: not a file of S-57: no record begins at byte 0"),
        (_written(harbour().data()[:-1]), "XX5TEST1.000: cut short: it ends within a record, 1 bytes early"),
        (_large, f"XX5TEST1.000: 100000000 bytes: files of more than {BYTES} are not read"),
        (_shapeless, "XX5TEST1.000: GDAL does not read it whole: Couldn't find spatial record 32767"),
    ],
)
def test_a_cell_that_is_not_whole_is_one_line_and_no_file(
    harm: Callable[[Path], None], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = harbour().write(tmp_path)
    harm(tmp_path)
    code = main(["charts", str(file), AT, "--draught=0.5", "--output", str(tmp_path / "made")])
    said = capsys.readouterr().err.splitlines()
    assert (code, len(said)) == (2, 1), said
    assert words in said[0]
    assert not list(tmp_path.glob("made*"))


def test_files_that_are_not_made_in_time_are_one_line_and_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(making, "LIMIT_S", 0.01)  # no process begins in less
    file = harbour().write(tmp_path)
    code = main(["charts", str(file), AT, "--draught=0.5", "--output", str(tmp_path / "made")])
    said = capsys.readouterr().err.splitlines()
    assert (code, len(said)) == (2, 1), said
    assert f"{file}: not made within 0.01 s: give fewer cells" in said[0]
    assert not list(tmp_path.glob("made*"))


def test_a_checksum_of_the_catalogue_is_looked_at(tmp_path: Path) -> None:
    file = harbour().write(tmp_path)
    (tmp_path / "CATALOG.031").write_bytes(catalogue(file))
    assert read_cell(file, LAYERS).edition == 2


@pytest.mark.parametrize(("zone", "asked"), [(4, "500 m"), pytest.param(6, "nobody knows how much", marks=pytest.mark.long)])
def test_a_margin_that_is_less_than_the_chart_asks_for_is_told(zone: int, asked: str, tmp_path: Path, capsys) -> None:
    assert main(["charts", str(harbour(zone=zone).write(tmp_path)), AT, "--draught=0.5", f"--output={tmp_path / 'made'}"]) == 0
    words = f"margins cut to --margin: about 4 the chart's zone of confidence asks for more: {asked}."
    assert words in capsys.readouterr().out


@pytest.mark.long
def test_a_cell_becomes_files_for_the_page_and_for_the_boat(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = harbour().write(tmp_path), tmp_path / "out"
    words = ["charts", str(file), AT, "--draught=0.5", "--air-draught=3", "--open=0-2", "--output", str(out)]
    assert main([*words, "--picture", str(tmp_path / "out.png")]) == 0
    said = capsys.readouterr().out
    assert said.startswith("XX5TEST1 edition 2: not for navigation\n")
    assert "bands that a mission may open, if --open has made them: 0-2 m" in said
    tree = json.loads(out.with_suffix(".geojson").read_text())
    kinds = [row["properties"]["kind"] for row in tree["features"]]
    assert (kinds.count("no-go"), kinds.count("depth"), kinds.count("danger")) == (1, 2, 7)
    assert tree["delfim"]["note"] == "not for navigation"
    forbidden = shapely.geometry.shape(tree["features"][0]["geometry"])
    assert forbidden.contains(shapely.Point(-9.216, 38.691))
    assert not forbidden.contains(shapely.Point(-9.2105, 38.6905))
    chart = read(out.with_suffix(".clearance").read_bytes())
    assert (chart.head.chart, chart.head.bands, chart.head.draught_m) == ("XX5TEST1 edition 2", ("", "0-2 m"), 0.5)
    assert out.with_suffix(".clearance").stat().st_size < 100_000
    place = shapely.get_coordinates(flat(shapely.Point(-9.205, 38.695), _middle(38.69, -9.21)))[0]
    for band, is_free in (("", False), ("0-2 m", True)):
        assert bool(laid(chart.water(band), _middle(38.69, -9.21)).clear_m(place[1], place[0]) > 0.0) is is_free
    assert main([*words[:-3], "--open=0-9", "--output", str(out)]) == 2
    assert "there is no band 0-9 m to open: 0-2 m" in capsys.readouterr().err
    assert main(["charts", str(file), AT]) == 2
    assert "say the boat's --draught" in capsys.readouterr().err
    assert main(["charts", str(file), "--at=0,0", "--draught=0.5"]) == 2
    assert "no water is free about 0, 0" in capsys.readouterr().err


def _middle(latitude_deg: float, longitude_deg: float) -> Origin:
    return origin(math.radians(latitude_deg), math.radians(longitude_deg))


@pytest.mark.parametrize(("place", "count"), [(PELEE, 100_000), (BAY, 20_000)])
@pytest.mark.long
def test_no_dangerous_place_is_said_to_be_free(place: tuple[float, float], count: int, lake: EncCell) -> None:
    """The judge measures from the shapes themselves, without sides, knots or codes."""
    chart, boats = charted([lake], Need(0.5)), _middle(place[0] + 0.01, place[1] - 0.01)
    asked = laid(read(made(chart, _middle(*place))).water(""), boats)
    drawn = numpy.random.default_rng(1)
    middle = shapely.get_coordinates(flat(shapely.Point(place[1], place[0]), boats))[0]
    half_m = numpy.where(numpy.arange(count) % 2, 2_000.0, 5_000.0)[:, None]  # in the fine grid, and in both
    places = middle + drawn.uniform(-1.0, 1.0, (count, 2)) * half_m
    points = shapely.points(places)
    forbidden = ~shapely.contains(_prepared(flat(chart.covered, boats)), points)
    for margin_m in {each.margin_m for each in chart.dangers}:
        tree = shapely.STRtree([flat(each.shape, boats) for each in chart.dangers if each.margin_m == margin_m])
        forbidden[tree.query(points, predicate="dwithin", distance=margin_m)[0]] = True
    free = numpy.array([asked.clear_m(y, x) >= 0.0 for x, y in places.tolist()])
    assert not (free & forbidden).any()
    assert (~free & ~forbidden).sum() < 0.05 * (~forbidden).sum()
    assert 0.2 < forbidden.mean() < 0.95


def _prepared(shape: shapely.Geometry) -> shapely.Geometry:
    shapely.prepare(shape)
    return shape


def test_interpolation_says_no_more_too_much_than_it_may() -> None:
    """The worst that can be: points at any place between four knots."""
    drawn = numpy.random.default_rng(3)
    for cell_m, margin_m in ((4.0, 5.0), (4.0, 10.0), (10.0, 10.0), (10.0, 50.0)):
        over_m = overstated_m(cell_m, margin_m)
        corners = cell_m * numpy.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        for _ in range(300):
            rocks = drawn.uniform(-1.0, 2.0, (drawn.integers(1, 5), 2)) * cell_m + drawn.normal(0.0, margin_m, 2)
            knots = numpy.hypot(*(corners[:, None] - rocks).transpose(2, 0, 1)).min(axis=1) - margin_m
            at = drawn.uniform(0.0, 1.0, (200, 2))
            said = sum(
                knot * (at[:, 0] if east else 1.0 - at[:, 0]) * (at[:, 1] if north else 1.0 - at[:, 1])
                for knot, (east, north) in zip(knots, [(0, 0), (1, 0), (0, 1), (1, 1)], strict=True)
            )
            true = numpy.hypot(*(cell_m * at[:, None] - rocks).transpose(2, 0, 1)).min(axis=1) - margin_m
            wrong = numpy.where(true >= 0.0, said - over_m - true, said - over_m)
            assert wrong.max() <= 1e-9
    assert overstated_m(4.0, 10.0) < 1.0 < overstated_m(4.0, 5.0) < 4.0 * math.sqrt(0.5) + 0.01


def test_codes_say_no_more_than_true() -> None:
    clear_m = numpy.linspace(-90.0, 300.0, 10_001)
    said = numpy.array([METRES[each] for each in coded(clear_m)])
    assert (said <= clear_m)[clear_m >= METRES[0]].all()
    assert (clear_m - said)[(clear_m > 0.0) & (clear_m < 20.0)].max() < 0.6


def test_degrees_and_metres_of_the_plane_are_inverse_over_the_date_line() -> None:
    place = shapely.Point(-179.99, -17.5)
    there = flat(place, _middle(-17.5, 179.99))
    assert 2000.0 < there.x < 2200.0
    assert degrees(there, _middle(-17.5, 179.99)).x == pytest.approx(180.01)


def test_a_file_must_be_a_cell(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"ends with \.000"):
        read_cell(tmp_path / "chart.kap", LAYERS)
    with pytest.raises(FileNotFoundError):
        read_cell(tmp_path / "XX5TEST1.000", LAYERS)
