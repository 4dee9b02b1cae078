"""Official charts dropped on the page: through a real browser, the gateway and its process with bounds, to the boat's own file
server. With a folder on its command line it keeps the picture of docs/charts.md (`make pictures`).
"""

import asyncio
import base64
import io
import json
import signal
import socket
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import aiohttp
import msgspec
import pytest
from aiohttp import web

from delfim import config
from delfim.__main__ import main as delfim
from delfim.base.errors import FormatError, Refused
from delfim.console.boats.boat import Boat as ConsoleBoat
from delfim.console.charts.charts import Charts
from delfim.console.charts.dropping import ChartDrop
from delfim.console.logs.fetching import LogFetching
from delfim.services.access.connection_limits import hashed
from delfim.survey.enc.dangers import Need
from delfim.survey.enc.dropped import DropJob, made, unpacked
from delfim.vehicle.plans import clearancefile
from tests.console.chain import PATIENCE_S, VEHICLE, Sea, operating, select
from tests.console.test_first_voyage import Visit
from tests.console.test_survey_page import Picture, nothing
from tests.kit.pictures import keeper
from tests.services.browser import Page, shrink
from tests.survey.cells import MadeCell, catalogue, harbour

BERTH = "38.6907,-9.2153"
BESIDE = 38.6920, -9.2160  # the rock of the update lies there
DROP = """(() => {
  const data = new DataTransfer();
  for (const [name, text] of %s) data.items.add(new File([Uint8Array.from(atob(text), (each) => each.charCodeAt(0))], name));
  window.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
})()"""
SAID = "document.getElementById('said').innerText"
SEND = "[...document.querySelectorAll('.item')].find((each) => each.textContent.includes('Send it to'))"


def cell(folder: Path) -> list[Path]:
    """A harbour, and an update of it."""
    folder.mkdir(exist_ok=True)
    update = MadeCell(update=1, first=500).point("UWTROC", BESIDE, WATLEV=3)
    return [harbour().write(folder), update.write(folder)]


def exchange_set(files: Sequence[Path]) -> bytes:
    """As offices send it."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("ENC_ROOT/README.TXT", "hello")
        packed.writestr("ENC_ROOT/CATALOG.031", catalogue(*files))
        for each in files:
            packed.writestr(f"ENC_ROOT/XX5TEST1/{each.name}", each.read_bytes())
    return out.getvalue()


async def dropped(page: Page, *files: tuple[str, bytes]) -> None:
    await page.value(DROP % json.dumps([(name, base64.b64encode(data).decode()) for name, data in files]))


async def said(page: Page, words: str) -> None:
    await page.until(f"{SAID}.includes({words!r})", PATIENCE_S)


def aboard(folder: Path, chart: Path, port: int) -> tuple[str, ...]:
    """Settings of a boat that sails by a chart, and takes files."""
    user = f"{{password={json.dumps(hashed('sesame'))},upload=true}}"
    return (
        f'fence.chart="{chart}"',
        "boat.draught_m=0.5",
        f'ftpd.listen="127.0.0.1:{port}"',
        f'ftpd.root="{folder}/1/log"',
        f"ftpd.users={{ana={user}}}",
    )


def before(folder: Path) -> Path:
    """The chart that the boat has: of the cell without its update, where the file of the boat says. Uploads make that folder
    theirs."""
    [first, _] = cell(folder / "cells")
    alone = folder / "alone"
    alone.mkdir()
    (alone / first.name).write_bytes(first.read_bytes())
    chart = folder / "1/log/upload/harbour.clearance"
    words = ["charts", str(alone / first.name), "--at", BERTH, "--draught", "0.5", "-o", str(folder / "harbour")]
    assert delfim(words) == 0
    return chart


async def sailed_by(folder: Path, picture: Picture) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    chart = before(folder)
    console_file = folder / "boat1.toml"
    text = VEHICLE.read_text().replace('name = "DelfimX"', 'name = "boat1"\ndraught_m = 0.5', 1)
    console_file.write_text(f'{text}\n[fence]\nchart = "{chart}"\n')
    console = f"--vehicle={console_file}", f"--logs=boat1=ftp://ana:sesame@127.0.0.1:{port}/"
    async with operating(folder, *aboard(folder, folder / "harbour.clearance", port), count=1, console=console) as sea:
        await walked(folder, sea, chart, picture)


async def walked(folder: Path, sea: Sea, chart: Path, picture: Picture) -> None:
    page, you = sea.page, Visit(sea.page, lambda name: picture(sea.page, name), False)
    files = [(each.name, each.read_bytes()) for each in cell(folder / "cells")]
    await select(page, 1)
    await page.value("delfim.fit(38.684, -9.226, 38.698, -9.200)")
    await dropped(page, (files[0][0], files[0][1][:-1000]))
    await said(page, "chart refused: XX5TEST1.000")
    await dropped(page, files[1])
    await said(page, "there is no cell (.000) in it")
    await dropped(page, *files)
    await you.sees("Send it to boat1")
    await page.until(f"delfim.why({BESIDE[0]}, {BESIDE[1]})?.includes('edition 2, update 1') ?? false", PATIENCE_S)
    await picture(page, "chart-dropped")
    await you.chooses("Send it to boat1")
    await said(page, "boat1 keeps to XX5TEST1 from its next start on")
    kept = folder / "charts/XX5TEST1.clearance"
    assert chart.read_bytes() == kept.read_bytes() != (folder / "harbour.clearance").read_bytes()
    settings = msgspec.convert(config.load(VEHICLE), config.Vehicle)
    fence = msgspec.structs.replace(settings.fence, chart=str(chart))
    loaded = clearancefile.load(msgspec.structs.replace(settings, fence=fence))
    assert loaded is not None
    assert loaded.head.chart == "XX5TEST1 edition 2.1"
    sea.gateway.end(signal.SIGTERM)
    await asyncio.to_thread(sea.gateway.start)
    await sea.load()
    await page.until(f"delfim.why({BESIDE[0]}, {BESIDE[1]})?.includes('update 1') ?? false", PATIENCE_S)
    page.calls_in_vain = True
    sea.radios[0].cut()
    await page.until("document.getElementById('bar').textContent.includes('link lost')", PATIENCE_S)
    await dropped(page, ("set.zip", exchange_set(cell(folder / "cells"))))
    await page.until(f"{SEND}?.textContent.includes('boat1 is not heard') ?? false", PATIENCE_S)
    await sea.nothing_amiss()


@pytest.mark.long
def test_a_cell_with_its_update_is_shown_sent_to_the_boat_and_there_after_a_restart(tmp_path: Path) -> None:
    asyncio.run(sailed_by(tmp_path, nothing))


def job(folder: Path) -> DropJob:
    return DropJob(str(folder), Need(0.5), [(0.0, 0.0), (38.6907, -9.2153)], str(folder / "made"))


def test_the_checksums_of_an_exchange_set_count_and_its_field_is_about_the_first_place_that_it_covers(
    tmp_path: Path,
) -> None:
    files = cell(tmp_path / "cells")
    (tmp_path / "set.zip").write_bytes(exchange_set(files))
    told = made(job(tmp_path))
    assert (told["chart"], told["name"], told["unfit"]) == ("XX5TEST1 edition 2.1", "XX5TEST1", "")
    head = clearancefile.read((tmp_path / "made.clearance").read_bytes()).head
    assert (round(head.latitude_deg, 4), round(head.longitude_deg, 4)) == (38.6907, -9.2153)
    other = tmp_path / "other"
    other.mkdir()
    data = bytearray(files[0].read_bytes())
    whole = exchange_set(files)
    files[0].write_bytes(bytes(data[:-1]) + b"!")
    with zipfile.ZipFile(io.BytesIO(whole)) as packed:
        (other / "CATALOG.031").write_bytes(packed.read("ENC_ROOT/CATALOG.031"))
    for each in files:
        (other / each.name).write_bytes(each.read_bytes())
    with pytest.raises(FormatError, match="its checksum is"):
        made(job(other))


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"PK\x03\x04 no archive", "no archive that can be read"),
        (b"", "no archive that can be read"),
    ],
)
def test_an_archive_that_is_none_is_refused(tmp_path: Path, data: bytes, why: str) -> None:
    (tmp_path / "set.zip").write_bytes(data)
    with pytest.raises(FormatError, match=why):
        unpacked(tmp_path / "set.zip")


def test_what_an_archive_inflates_to_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("delfim.survey.enc.dropped.BYTES", 1000)
    with zipfile.ZipFile(tmp_path / "set.zip", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("A.000", bytes(1_000_000))
    with pytest.raises(FormatError, match="MB of charts in it"):
        unpacked(tmp_path / "set.zip")
    with zipfile.ZipFile(tmp_path / "set.zip", "w") as packed:
        packed.writestr("../../A.000", b"a")
        packed.writestr("b/A.000", b"b")
    with pytest.raises(FormatError, match=r"A\.000 is in it twice"):
        unpacked(tmp_path / "set.zip")


def boats_file(folder: Path, boat: str, more: str) -> Path:
    file = folder / "boat.toml"
    text = VEHICLE.read_text().replace('name = "DelfimX"', f'name = "Alfa"\n{boat}', 1)
    file.write_text(f"{text}\n{more}\n")
    return file


CHART = '[fence]\nchart = "/log/upload/pelee.clearance"'


@pytest.mark.parametrize(
    ("boat", "more", "bytes_", "age_s", "why"),
    [
        ("draught_m = 0.5", CHART, 1000, 0.0, ""),
        ("draught_m = 0.5", CHART, 1000, 60.0, "Alfa is not heard"),
        ("", CHART, 1000, 0.0, "nobody knows the boat's draught"),
        ("draught_m = 0.5", "", 1000, 0.0, "its file names no chart"),
        ("draught_m = 0.5", '[fence]\nchart = "/etc/a.clearance"', 1000, 0.0, "which is not in its folder upload"),
        ("draught_m = 0.5", CHART, 300_000, 0.0, "its field is 300 kB: the boat takes 250 kB"),
        ("draught_m = 0.5", CHART, 0, 0.0, "there is no pelee.clearance"),
    ],
)
def test_why_a_chart_cannot_be_sent_is_said(tmp_path: Path, boat: str, more: str, bytes_: int, age_s: float, why: str) -> None:
    if bytes_:
        (tmp_path / "pelee.clearance").write_bytes(bytes(bytes_))
    logs = LogFetching({"Alfa": "ftp://boat/"}, tmp_path, lambda told: None, lambda number: False)
    its = ConsoleBoat(1, 0.0)
    its.rename("Alfa")
    charts = Charts(tmp_path)
    drop = ChartDrop(charts, boats_file(tmp_path, boat, more), lambda: logs, lambda file, answer: None, lambda told: None)
    said = drop.unsent(its, "pelee", age_s)
    assert why in said if why else said == ""
    its.rename("Bravo")
    assert drop.unsent(its, "pelee", 0.0) != ""
    with pytest.raises(Refused, match="no chart has such a name"):
        drop.ask(its, "chart", "../pelee", 0.0, lambda well, reason: None)
    charts.close()


async def test_files_that_are_no_charts_and_too_many_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("delfim.console.charts.dropping.BYTES", 1_000_000)
    charts = Charts(tmp_path)
    drop = ChartDrop(charts, None, lambda: LogFetching({}, tmp_path, print, bool), lambda file, answer: None, lambda told: None)
    app = web.Application()
    drop.routes(app)
    runner = web.AppRunner(app)
    await runner.setup()
    try:
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        url = f"http://127.0.0.1:{runner.addresses[0][1]}/chart?at=nan,1;x"
        async with aiohttp.ClientSession() as page:

            async def told(body: Any) -> str:
                async with page.post(url, data=body) as answer:
                    assert answer.status == 200
                    return str((await answer.json())["refused"])

            assert await told(b"hello") == "no files came"
            assert await told({"file": io.BytesIO(b"a")}) == "no cell (.000), update or exchange set (.zip) is among the files"
            form = aiohttp.FormData()
            form.add_field("file", io.BytesIO(bytes(2_000_000)), filename="A.000")
            assert await told(form) == "up to 100 files, and 1 MB of them"
            form = aiohttp.FormData()
            form.add_field("file", io.BytesIO(b"no cell"), filename="A.000")
            assert (await told(form)).startswith("A.000: ")
    finally:
        await runner.cleanup()
        drop.close()
        charts.close()
    assert list(tmp_path.iterdir()) == []


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="dropped-") as place:
        asyncio.run(sailed_by(Path(place), keeper(folder, "console")))
    shrink(folder.glob("console-chart-dropped.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
