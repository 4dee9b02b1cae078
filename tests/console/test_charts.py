"""Charts: where their pixels lie, and what pages get of them."""

import contextlib
import sqlite3
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, TiffImagePlugin

from delfim.base.errors import ConfigError, FormatError
from delfim.base.projection import plane
from delfim.console.charts.charts import Charts
from delfim.console.charts.georeference import placed
from delfim.console.charts.warp import warp

RED, BLUE = (255, 0, 0), (0, 0, 255)
HARBOUR = (38.69, -9.21)


def chart(file: Path, size: tuple[int, int] = (200, 100), **more: Any) -> Path:
    """Red; its upper right quarter is blue."""
    image = Image.new("RGB", size, RED)
    image.paste(BLUE, (size[0] // 2, 0, size[0], size[1] // 2))
    image.save(file, **more)
    return file


def world(file: Path, *numbers: float) -> None:
    file.write_text("\n".join(map(repr, numbers)))


@given(st.integers(1, 60), st.floats(-3.0, 3.0), st.floats(-79.0, 83.0))
def test_utm_and_back_is_where_it_was(zone: int, off_deg: float, latitude_deg: float) -> None:
    forward, back = plane(32600 + zone)
    longitude_deg = zone * 6.0 - 183.0 + off_deg
    assert back(*forward(longitude_deg, latitude_deg)) == pytest.approx((longitude_deg, latitude_deg), abs=1e-9)


def test_planes_agree_with_known_places() -> None:
    # The meridian quadrant to 45 degrees of WGS 84 is 4 984 944.378 m; the scale on the middle meridian is 0.9996.
    assert plane(32631)[0](3.0, 45.0) == pytest.approx((500_000.0, 4_984_944.378 * 0.9996), abs=0.001)
    # Published example: the CN tower, 43 38 33.24 N, 79 23 13.70 W, is 17N 630084 E, 4833438 N.
    assert plane(32617)[0](-79.0 - 23.0 / 60.0 - 13.70 / 3600.0, 43.0 + 38.0 / 60.0 + 33.24 / 3600.0) == pytest.approx(
        (630_084.0, 4_833_438.0), abs=1.0
    )
    assert plane(3857)[0](180.0, 0.0) == pytest.approx((20_037_508.342789, 0.0), abs=1e-6)
    with pytest.raises(FormatError, match="EPSG:27700"):
        plane(27700)


def test_a_world_file_places_the_centre_of_the_first_pixel(tmp_path: Path) -> None:
    image = chart(tmp_path / "a.png")
    world(tmp_path / "a.pgw", 0.0001, 0.0, 0.0, -0.0001, -9.21995, 38.69995)
    here = placed(image)
    assert here.extent() == pytest.approx((-9.22, 38.69, -9.20, 38.70))
    assert here.upright
    assert here.pixel(*here.degrees(12.5, 34.5)) == pytest.approx((12.5, 34.5))


def test_two_control_points_turn_and_scale_without_shear(tmp_path: Path) -> None:
    image = chart(tmp_path / "a.png")
    east = "latitude_deg = 38.69\nlongitude_deg = -9.20"
    text = "[[point]]\ncolumn = 0\nrow = 0\nlatitude_deg = 38.69\nlongitude_deg = -9.21\n"
    (tmp_path / "a.toml").write_text(f"{text}[[point]]\ncolumn = 0\nrow = 100\n{east}\n")
    here = placed(image)  # down the image is east, so to the right is north
    longitude_deg, latitude_deg = here.degrees(100.0, 0.0)
    assert longitude_deg == pytest.approx(-9.21)
    assert latitude_deg - 38.69 == pytest.approx(0.01 * 0.78055 * 1.0041, rel=1e-3)  # cosine, and the flattening
    assert not here.upright


def _points(*rows: tuple[float, float, float, float]) -> str:
    keys = ("column", "row", "latitude_deg", "longitude_deg")
    return "".join("[[point]]\n" + "".join(f"{key} = {value}\n" for key, value in zip(keys, row, strict=True)) for row in rows)


CORNERS = ((0, 0, 38.70, -9.22), (200, 0, 38.70, -9.20), (200, 100, 38.69, -9.20), (0, 100, 38.69, -9.22))


def test_four_control_points_are_balanced(tmp_path: Path) -> None:
    image = chart(tmp_path / "a.png")
    (tmp_path / "a.toml").write_text(_points(*CORNERS))
    assert placed(image).extent() == pytest.approx((-9.22, 38.69, -9.20, 38.70))


@pytest.mark.parametrize(
    ("beside", "reason"),
    [
        (_points(CORNERS[0]), "a single control point"),
        (_points((0, 0, 38.7, -9.2), (1, 1, 38.6, -9.1), (2, 2, 38.5, -9.0)), "on one line"),
        (_points(*CORNERS[:3], (0, 100, 38.69, -9.32)), r"point\[\d\]: lies elsewhere"),
        ("epsg = 27700\n", "EPSG:27700"),
        ("dance = 1\n", "unknown key"),
        ("[[point", "not TOML"),
    ],
)
def test_what_is_wrong_with_a_chart_is_said(tmp_path: Path, beside: str, reason: str) -> None:
    image = chart(tmp_path / "a.png")
    world(tmp_path / "a.pgw", 1.0, 0.0, 0.0, -1.0, 487_000.0, 4_283_000.0)
    (tmp_path / "a.toml").write_text(beside)
    with pytest.raises(ConfigError, match=reason):
        placed(image)


@pytest.mark.parametrize("text", ["", "1 2 3", "a b c d e f", "nan 0 0 nan 0 0", "0 0 0 0 1 1", "1 0 0 -1 487000 4283000"])
def test_a_world_file_that_means_nothing_is_refused(tmp_path: Path, text: str) -> None:
    image = chart(tmp_path / "a.png")
    (tmp_path / "a.pgw").write_text(text)
    with pytest.raises(ConfigError):
        placed(image)


@given(st.binary(max_size=300))
def test_a_file_that_is_no_image_is_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    file = tmp_path_factory.getbasetemp() / "noise.png"
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    with pytest.raises(ConfigError):
        placed(file)


def geotiff(file: Path, *, by_matrix: bool = False, centres: bool = False) -> Path:
    """A chart in UTM 29N, 10 m a pixel, north up."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags.tagtype.update({33550: 12, 33922: 12, 34264: 12, 34735: 3})
    x, y = (487_005.0, 4_282_995.0) if centres else (487_000.0, 4_283_000.0)
    if by_matrix:
        tags[34264] = (10.0, 0.0, 0.0, x, 0.0, -10.0, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    else:
        tags[33550], tags[33922] = (10.0, 10.0, 0.0), (0.0, 0.0, 0.0, x, y, 0.0)
    tags[34735] = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 2 if centres else 1, 3072, 0, 1, 32629)
    return chart(file, tiffinfo=tags)


@pytest.mark.parametrize("by_matrix", [False, True])
@pytest.mark.parametrize("centres", [False, True])
def test_a_geotiff_says_itself_where_it_lies(tmp_path: Path, by_matrix: bool, centres: bool) -> None:
    here = placed(geotiff(tmp_path / "a.tif", by_matrix=by_matrix, centres=centres))
    assert here.epsg == 32629
    assert here.degrees(0, 0) == pytest.approx(plane(32629)[1](487_000.0, 4_283_000.0), abs=1e-9)


def test_a_turned_chart_is_drawn_with_north_up(tmp_path: Path) -> None:
    image = chart(tmp_path / "a.png")
    world(tmp_path / "a.pgw", 0.0, -0.0001, -0.0001, 0.0, -9.20005, 38.69995)  # right is south, down is west
    warp(image, tmp_path / "out.png")
    with Image.open(tmp_path / "out.png") as drawn:
        width, height = drawn.size
        assert height > width
        corners = [drawn.getpixel((c, r)) for c, r in ((5, 5), (width - 5, 5), (5, height - 5), (width - 5, height - 5))]
    # The blue quarter, upper right of the image, is now lower right.
    assert corners == [(*RED, 255), (*RED, 255), (*RED, 255), (*BLUE, 255)]


def test_a_chart_in_utm_lands_where_its_pixels_are(tmp_path: Path) -> None:
    file = geotiff(tmp_path / "a.tif")
    here = placed(file)
    warp(file, tmp_path / "out.png")
    west, south, east, north = here.extent()
    with Image.open(tmp_path / "out.png") as drawn:
        for column, row in ((20, 80), (150, 20), (98, 52), (103, 47)):
            longitude_deg, latitude_deg = here.degrees(column, row)
            at = (longitude_deg - west) / (east - west) * drawn.width, (north - latitude_deg) / (north - south) * drawn.height
            assert drawn.getpixel((int(at[0]), int(at[1]))) == (*(BLUE if column > 100 and row < 50 else RED), 255)


def mbtiles(file: Path, told: dict[str, str], tiles: list[tuple[int, int, int, bytes]]) -> Path:
    base = sqlite3.connect(file)
    base.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
    base.execute("CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)")
    base.executemany("INSERT INTO metadata VALUES (?, ?)", told.items())
    base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", tiles)
    base.commit()
    base.close()
    return file


def png() -> bytes:
    out = BytesIO()
    Image.new("RGB", (8, 8), BLUE).save(out, "PNG")
    return out.getvalue()


@contextlib.asynccontextmanager
async def served(charts: Charts) -> AsyncIterator[Callable[[str], Any]]:
    """Real HTTP."""
    app = web.Application()
    charts.routes(app)
    runner = web.AppRunner(app)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    url = f"http://127.0.0.1:{runner.addresses[0][1]}"

    async def get(path: str) -> tuple[int, str, bytes]:
        async with session.get(url + path) as answer:
            return answer.status, answer.content_type, await answer.read()

    try:
        async with aiohttp.ClientSession() as session:
            yield get
    finally:
        await runner.cleanup()
        charts.close()


async def test_a_folder_of_charts_is_told_and_served(tmp_path: Path) -> None:
    chart(tmp_path / "plain.png")
    world(tmp_path / "plain.pgw", 0.0001, 0.0, 0.0, -0.0001, -9.21995, 38.69995)
    geotiff(tmp_path / "utm.tif")
    chart(tmp_path / "lost.jpg")
    mbtiles(tmp_path / "sea.mbtiles", {"bounds": "-9.3,38.6,-9.1,38.8", "format": "png"}, [(3, 1, 2, png())])
    mbtiles(tmp_path / "vector.mbtiles", {"format": "pbf"}, [(0, 0, 0, b"x")])
    (tmp_path / "broken.mbtiles").write_bytes(b"no data base" * 100)
    (tmp_path / "notes.txt").write_text("not a chart")
    charts = Charts(tmp_path)
    told = {each["name"]: each for each in charts.backgrounds}
    assert sorted(told) == ["plain", "sea", "utm"]
    assert (told["sea"]["extent"], told["sea"]["minzoom"], told["sea"]["maxzoom"]) == ((-9.3, 38.6, -9.1, 38.8), 3, 3)
    assert len(charts.faults) == 3
    assert any("nothing says where it lies" in fault for fault in charts.faults)
    async with served(charts) as get:
        assert await get("/background/plain") == (200, "image/png", (tmp_path / "plain.png").read_bytes())
        status, kind, data = await get("/background/utm")
        assert (status, kind, data[:4]) == (200, "image/png", b"\x89PNG")
        assert (await get("/background/utm"))[2] == data
        assert (await get("/background/lost"))[0] == 404
        for name in ("..%2Fplain.png", "..", "%00", "a" * 300, "%FF", "%2Fetc%2Fpasswd", "<b>", "CON"):
            assert (await get(f"/background/{name}"))[0] == 404, name
            assert (await get(f"/tiles/{name}/3/1/5"))[0] == 404, name
        assert await get("/tiles/sea/3/1/5") == (200, "image/png", png()), "rows count from the north"
        assert (await get("/tiles/sea/3/1/2"))[0] == 204
        assert (await get("/tiles/sea/99/1/2"))[0] == 404
        assert (await get("/tiles/river/3/1/5"))[0] == 404


def test_no_folder_is_no_charts(tmp_path: Path) -> None:
    for folder in (None, tmp_path / "none"):
        charts = Charts(folder)
        assert (charts.backgrounds, charts.faults) == ([], [])
        charts.close()


def test_a_console_without_images_needs_no_pillow(tmp_path: Path) -> None:
    """An image says in words what it lacks."""
    (tmp_path / "chart.png").write_bytes(b"")
    program = f"""
import sys
sys.modules["PIL"] = None
from pathlib import Path
from delfim.console.gateway.gateway import Charts
print(Charts(None).faults, Charts(Path({str(tmp_path)!r})).faults)"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert told == f"[] [\"{tmp_path}/chart.png: image: it needs PIL: pip install 'delfim[ground]'\"]\n"
