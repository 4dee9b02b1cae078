"""Whatever a file holds, its reader answers with a line of words, in bounded memory and time."""

import ast
import gzip
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import asyncssh
import msgspec
import pytest

from delfim import config
from delfim.adoption.trial.manoeuvres import MotionSeen
from delfim.adoption.trial.motors import MotorsFound
from delfim.adoption.trial.session import TrialProgress, keep
from delfim.base.clock import ManualClock
from delfim.base.geodesy import origin
from delfim.base.input.keys import new_key, read_key
from delfim.campaign.runplan import read
from delfim.campaign.store import Store
from delfim.console.boats.fleet import Fleet
from delfim.console.boats.soundings import HEAD
from delfim.console.gateway.watchlog import WatchLine, table
from delfim.console.link.session import Session
from delfim.console.tapes.replay import open_tapes
from delfim.console.watch.alerts import AlertList
from delfim.logging import nodelog
from delfim.logging.chain import Chain
from delfim.logging.kept.writer import packed
from delfim.logging.reading import read_log
from delfim.parts.camera.jpegblocks import jpeg_of
from delfim.parts.camera.kept import record_of
from delfim.parts.iridium import orders
from delfim.parts.mavlink.codec.signing import Kept, Signing, write_stamps
from delfim.services.image.raspberry import AUTOBOOT, autoboot_txt
from delfim.simulator.scenarios.scenario import load_scenario
from delfim.vehicle import console
from delfim.vehicle.orders.voyage import KeptHead
from delfim.vehicle.plans.mission import load_mission
from delfim.vehicle.voyagestate import VoyageState
from tests.console.fakeboat import FakeBoat
from tests.console.test_charts import _points, chart, geotiff, mbtiles, png, world
from tests.console.test_planfile import PLAN as WAY_PLAN
from tests.console.test_planfile import file_of
from tests.logging.sailing import MISSION, Day
from tests.mutated_files import READERS, ROOT, command, refused
from tests.services.test_slots import Yard
from tests.survey.cells import MadeCell, catalogue, harbour
from tests.survey.test_areafile import FEATURE, GPX, HOLE, KML, PLAN, RING, shapefile
from tests.vehicle.charted import chart as chart_of

CAMPAIGN = """version = 1
name = "Storms"
vehicle = "boat.toml"
scenario = "storm.toml"
seeds = { first = 2, count = 9 }
[vary]
"simulation.sea.wind_mps" = { from = 1.0, to = 8.0, steps = 4 }
"log.required" = [true, false]
[draw]
"simulation.sea.gusts" = { uniform = [0.1, 0.4] }
[[pass]]
name = "all"
sql = "bool_and(ok)"
"""
STORM = """version = 1
name = "storm"
seconds = 60
mission = "lake.toml"
guest = {heading_deg = 10.0, speed_mps = 1.0}
vehicle = {failsafe = {pause_s = 5.0}}
[[command]]
at_s = 5
command = "heading"
heading_deg = 90
speed_mps = 1.5
[[fault]]
at_s = 30
kind = "frames_late"
value = 0.2
for_s = 30
[[expect]]
mode = "play"
after = 5.0
within_s = 30.0
"""


def trial(file: Path) -> TrialProgress:
    """Twenty seconds of a trial whose motors were found."""
    motors = MotorsFound((1, -1), (1, 1), (0.2, 0.2))
    sensors = [{"velocity": (0.1 * i, 1.0, 0.0), "heading": (0.1 * i, 0.0), "rate": (0.1 * i, 0.01)} for i in range(200)]
    moves = 0.0, 0.0, 0.01, 1.0, 0.0, (0.3, 0.2), True, ""
    seen = [MotionSeen(0.1 * i, 0.1 * i, *moves, measured) for i, measured in enumerate(sensors)]
    return TrialProgress(config.load(file).thrusters, (38.69, -9.21), motors=motors, is_proven=True, tape=seen)


def settings(folder: Path) -> None:
    shutil.copy(ROOT / "etc/delfimx.toml", folder / "boat.toml")
    keep(folder / "trial.json", trial(folder / "boat.toml"))
    shutil.copy(ROOT / "etc/missions/doca.toml", folder / "lake.toml")
    (folder / "storm.toml").write_text(STORM)
    (folder / "campaign.toml").write_text(CAMPAIGN)
    for end in ("toml", "json"):
        shutil.copy(ROOT / f"etc/encounters/imazu22-real.{end}", folder)
    (folder / "cruise.toml").write_text(CAMPAIGN.replace('scenario = "storm.toml"', 'mission = "lake.toml"'))
    plan = read(folder / "campaign.toml")[1]
    results = Store(folder / "results", plan, 2, "of the sample")
    results.add(0, [{"batch": 0, "point": 0, "seed": seed, "ok": True, "way_m": 3.0 * seed} for seed in (2, 3)])
    results.flush()
    shutil.copy(ROOT / "etc/delfimx.dbc", folder / "boat.dbc")


def sailed(place: Path, *overrides: str) -> None:
    """A few seconds of a mission."""
    day = Day(place, *overrides)
    day.sail(3.0)
    for word in (console.LoadMission(MISSION), console.Play()):
        assert day.command(word) is None
    day.sail(6.0)
    day.end()


def chained(file: Path) -> None:
    """The chain of a log in lock step, which has none by itself: a link for each twentieth of it."""
    stem, data = file.with_name(file.name.partition(".")[0]), file.read_bytes()
    made = Chain(str(file.parents[2]), file.parent.name)
    made.begin(str(stem))
    for at in range(0, len(data), len(data) // 20):
        made.wrote(data[at : at + len(data) // 20])
        made.link(10**18 + at, kept=True)
    made.link(2 * 10**18, kept=True, end=True)


def logs(folder: Path) -> None:
    sailed(folder / "log")
    (box,) = (folder / "log").rglob("*.log.gz")
    chained(next((folder / "log").rglob("*.state.gz")))
    shutil.copy(box, folder / "box.log.gz")
    (folder / "box.log").write_bytes(gzip.decompress(box.read_bytes())[:60_000])
    said = b"".join(
        json.dumps(
            {"t_ns": t, "monotonic_s": t / 1e9, "level": "info", "pid": 7, "service": "sshd", "text": "ana logged in"}
        ).encode()
        + b"\n"
        for t in range(10**18, 10**18 + 10**11, 10**9)
    )
    (folder / "system.jsonl").write_bytes(said)
    (system := next((folder / "log").iterdir()) / "system/000000.jsonl").parent.mkdir()
    system.write_bytes(said)
    (line := next((folder / "log").iterdir()) / "-dev-gnss/000000.jsonl").parent.mkdir()
    line.write_bytes(b"".join(nodelog.line(each, b"$GPGGA,%d\r\n" % each + bytes([each])) for each in range(256)))


def plain_logs(folder: Path) -> None:
    """As other programs keep them."""
    sailed(folder / "log", 'log.state_method="write"')
    (box,) = (folder / "log").rglob("*.log.gz")
    box.with_suffix("").write_bytes(gzip.decompress(box.read_bytes()))
    box.unlink()


def session(folder: Path) -> None:
    """A minute with two boats, the mission of one of them read."""
    clock = ManualClock(100.0)
    tape = Session(folder, clock)
    boats = list[FakeBoat]()
    fleet = Fleet(clock, lambda address, data: boats[address - 1].hear(data), lambda message: None)
    fleet.record = tape.put
    boats += [FakeBoat(number, clock, lambda data, number=number: fleet.receive(number, data)) for number in (1, 2)]  # type: ignore[misc]
    place = {"latitude_deg": 38.69, "longitude_deg": -9.21, "speed_mps": 1.0, "acceptance_m": 3.0, "hold_s": 0.0}
    for step in range(300):
        clock.advance(0.1)
        for boat in boats:
            boat.tick()
        if step == 100:
            fleet.put(1, {"name": "line", "waypoints": [place, place | {"latitude_deg": 38.7}]})
            fleet.upload(1, lambda well, why: None)
        fleet.tick()
        tape.tick()
    tape.flush()
    assert tape.file is not None
    tape.file.rename(folder / "day.tlog")


def charts(folder: Path) -> None:
    chart(folder / "chart.png")
    (folder / "chart.toml").write_text(_points((0, 0, 38.70, -9.22), (200, 0, 38.70, -9.20), (200, 100, 38.69, -9.20)))


def worlds(folder: Path) -> None:
    for name in ("chart.png", "chart.jpg"):
        chart(folder / name)
    for name in ("chart.pgw", "chart.jgw"):
        world(folder / name, 0.0, -0.0001, -0.0001, 0.0, -9.20005, 38.69995)


def geotiffs(folder: Path) -> None:
    geotiff(folder / "chart.tif")


def tiles(folder: Path) -> None:
    told = {"bounds": "-9.3,38.6,-9.1,38.8", "format": "png", "name": "harbour"}
    mbtiles(folder / "harbour.mbtiles", told, [(12, 1943, 2513, png()), (13, 0, 8191, png())])


def areas(folder: Path) -> None:
    (folder / "dock.geojson").write_text(json.dumps(FEATURE))
    (folder / "dock.kml").write_text(KML)
    (folder / "dock.gpx").write_text(GPX)
    (folder / "dock.plan").write_text(json.dumps(PLAN))
    (folder / "dock.shp").write_bytes(shapefile(RING[::-1], HOLE))
    begun = command("survey", "lines", str(folder / "dock.geojson"), "--spacing", "20", "--output", str(folder / "dock.toml"))
    assert begun == []


WAYS = "geojson", "kml", "gpx", "plan", "waypoints", "shp"


def ways(folder: Path) -> None:
    for kind in WAYS:
        file_of(folder, f".{kind}", WAY_PLAN).rename(folder / f"way.{kind}")


def answers(folder: Path) -> None:
    (folder / "answers.json").write_text('{"boat": "otter", "name": "Ana", "id": "7", "where": "38.69 -9.21"}')


def keys(folder: Path) -> None:
    new_key(folder / "key")
    (folder / "ntrip").write_text("ana:secret\n")
    (folder / "address").write_text("35\n")
    signing = Signing(bytes(32), ManualClock(time_ns=1_800_000_000_000_000_000))
    (folder / "bow.pictures").write_bytes(b"".join(record_of(1000 * at, jpeg_of(16, 16, [at] * 4)) for at in range(3)))
    (folder / "message.sbd").write_bytes(orders.sealed(orders.WORDS["home"], 3, 7, signing))
    write_stamps(folder / "stamps", Kept(7, 5, [((255, 190, 1), 123_456_789), ((250, 190, 2), 99)]))
    (folder / "host_key").write_bytes(asyncssh.generate_private_key("ssh-ed25519").export_private_key("openssh"))
    words = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-subj",
        "/CN=boat",
    ]
    subprocess.run([*words, "-keyout", folder / "key.pem", "-out", folder / "cert.pem"], check=True, capture_output=True)
    (folder / "boat.pem").write_bytes(b"".join((folder / name).read_bytes() for name in ("key.pem", "cert.pem")))
    (folder / "user.pub").write_bytes(asyncssh.generate_private_key("ssh-ed25519").export_public_key("openssh"))
    (folder / "numbers").write_text(json.dumps({"00" * 15 + "07": 125, "ff" * 16: 20}))
    voyage = KeptHead("test", "", "", 0, 0.0), VoyageState(), console.Rally(((38.69, -9.21),))
    (folder / "voyage-1").write_bytes(packed(1, b"\n".join(map(msgspec.json.encode, voyage)), b""))
    operator = {"name": "Ana", "role": "command", "key_sha256": 32 * "7f"}
    point = "BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4"  # of RFC 8291
    wakes = {"endpoint": "https://a.example/b", "keys": {"p256dh": point, "auth": "BTBZMqHH6r4Tts7J_aSIgg"}}
    pushed = {"key": "yfWPiYE-n46HLnH0KqZOF1fJJU3MYrct3AELtAQ-oRw", "browsers": [wakes]}
    (folder / "push.json").write_text(json.dumps(pushed))
    (folder / "operators.json").write_text(json.dumps([operator, operator | {"name": "Rui"}]))
    alerts = AlertList(lambda: 1_790_000_000.5)
    for boat, text in ((1, "port propeller: no report for 1.0 s: stop"), (2, "fence left: stop"), (None, "the disk is full")):
        alerts.hear(boat, 2, text, is_boats=boat == 1)
    alerts.troubles(1, 64)
    alerts.acknowledge("Ana", [1, 3])
    (folder / "alerts.json").write_bytes(msgspec.json.encode(alerts.kept()))
    lines = (WatchLine(1_790_000_000.0 + n, n % 3 or None, "boat", "Ana, too", "order", f'=play "{n}"') for n in range(20))
    (folder / "20260921-100000.csv").write_text(table(lines))
    (folder / "token").write_text("Zm9vYmFyYmF6cXV4cXV1eA\n")
    record = {"stage": "safe", "at_s": 12.5, "holders": ["state", "can0"], "deadman": {"at_s": 1.5, "reason": "silent"}}
    (folder / "record").write_text(json.dumps(record))


def images(folder: Path) -> None:
    yard = Yard(folder)
    shutil.copy(yard.bundle("2.0"), folder / "new.image")
    for name in ("grub", "a", "b"):
        if (yard.boot / name).exists():
            shutil.copytree(yard.boot / name, folder / name)
    (folder / "pi").mkdir()
    (folder / "pi" / AUTOBOOT).write_bytes(autoboot_txt("a", "", "b"))


def sounded(folder: Path) -> None:
    """Two lines beside each other and one across, of a depth each second."""
    head = "utc,latitude [deg],longitude [deg],depth_m [m],confidence,line\n"
    places = [(38.69 + 1e-5 * i, -9.21 + 1e-4 * line, line) for line in (1, 2) for i in range(0, 60, 2 - line % 2)]
    places += [(38.6903, -9.2102 + 1e-5 * i, 3) for i in range(40)]
    rows = (
        f"2026-09-21T12:{i // 60:02}:{i % 60:02}Z,{n:.6f},{e:.6f},{5 + 0.01 * i:.2f},0.9,{k}\n"
        for i, (n, e, k) in enumerate(places)
    )
    (folder / "soundings.csv").write_text(head + "".join(rows))
    (folder / "soundings").mkdir()
    (folder / "soundings/1.csv").write_text(
        HEAD + "".join(f"179{i:07}.0,{n:.6f},{e:.6f},5.2\n" for i, (n, e, _) in enumerate(places))
    )
    (folder / "tide.csv").write_text(
        "time,metres\n" + "".join(f"2026-09-21T12:{minute:02},1.{minute}\n" for minute in range(0, 60, 10))
    )


def exchanged(folder: Path) -> None:
    with zipfile.ZipFile(folder / "set.zip", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("ENC_ROOT/XX5TEST1.000", harbour().data())


def official(folder: Path) -> None:
    """A cell with an update, and the boat's file of it; the catalogue tells of another cell, so that damage of this one is seen
    by itself."""
    harbour().write(folder)
    MadeCell(update=1, first=500).point("UWTROC", (38.692, -9.2), WATLEV=3).write(folder)
    other = MadeCell("XX5TEST2").point("UWTROC", (38.692, -9.2), WATLEV=3).write(folder)
    (folder / "CATALOG.031").write_bytes(catalogue(other))
    (folder / "harbour.clearance").write_bytes(chart_of(origin(0.67, -0.16), [(0.0, 0.0, 50.0)]))


def shown(folder: Path) -> None:
    """What delfim charts makes for the page."""
    rock = {"type": "Point", "coordinates": [-9.2, 38.69]}
    land = {"type": "MultiPolygon", "coordinates": [[[[-9.2, 38.69], [-9.1, 38.69], [-9.1, 38.7], [-9.2, 38.69]]]]}
    rows = [{"type": "Feature", "properties": {"kind": "danger", "why": "rock"}, "geometry": each} for each in (rock, land)]
    (folder / "pelee.geojson").write_text(json.dumps({"type": "FeatureCollection", "delfim": {}, "features": rows}))


FEW = 10  # mutations that are tried each time
SAMPLES = {
    shown: ("dangers for the page",),
    settings: (
        "vehicle",
        "vehicle to commission",
        "vehicle to be adopted",
        "vehicle of a simulation",
        "trial to go on",
        "mission",
        "library",
        "scenario",
        "campaign",
        "mission of a campaign",
        "head of a campaign's results",
        "a campaign's results",
        "scenario's mission",
        "encounters",
        "mission to send",
        "CAN database",
    ),
    logs: (
        *("chain of a log", "log with a chain"),
        *("serial line", "system log", "last lines of the system log"),
        *("state log, deflated", "black box", "sidecar", "run to repeat", "run to repeat, state", "run to repeat, sidecar"),
        *("state log as a tape", "sidecar of a tape", "serial line", "candump", "candump, deflated"),
    ),
    plain_logs: ("state log", "state log to identify", "black box, plain"),
    session: ("session",),
    charts: ("control points",),
    worlds: ("PNG", "JPEG", "world file"),
    geotiffs: ("GeoTIFF",),
    tiles: ("MBTiles",),
    exchanged: ("exchange set of charts",),
    official: ("official chart", "update of an official chart", "catalogue of official charts", "field of clearances"),
    sounded: ("soundings as CSV", "depths that the console heard", "tide"),
    ways: tuple(f"way, {kind}" for kind in WAYS),
    answers: ("answers of a form",),
    areas: ("survey that goes on", "area", "area, KML", "area, GPX", "area of a plan", "area, shapefile"),
    keys: (
        *("key in an inventory", "host key in an inventory", "certificate in an inventory"),
        "user's ssh key",
        "numbers of DroneCAN devices",
        "address on NMEA 2000",
        "signing key",
        "password at a caster",
        "stamps",
        "message by satellite",
        "kept pictures",
        "host key",
        "certificate",
        "browsers to wake",
        "supervisor's record",
        "page's token",
        "operators of a console",
        "alerts of a console",
        "log of the watch",
        "kept voyage",
    ),
    images: ("image", "boot environment", "words of a Raspberry Pi", "manifest of a slot"),
}


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folder of each reader's sample."""
    folders = dict[str, Path]()
    for make, names in SAMPLES.items():
        folder = tmp_path_factory.mktemp(make.__name__)
        make(folder)
        folders |= dict.fromkeys(names, folder)
    return folders


@pytest.fixture(scope="module")
def trying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """The program that tries the readers, and the file of what it complains of."""
    errors = tmp_path_factory.mktemp("trying") / "errors"
    here = os.environ | {"PYTHONSAFEPATH": ""}  # make sets it: then a module of the working directory is not found
    words, pipe = [sys.executable, "-m", "tests.mutated_files"], subprocess.PIPE
    with (
        errors.open("w") as file,
        subprocess.Popen(words, cwd=ROOT, env=here, stdin=pipe, stdout=pipe, stderr=file, text=True) as it,
    ):
        yield it, errors
        it.communicate()


@pytest.mark.parametrize("few", [True, pytest.param(False, marks=pytest.mark.long)], ids=["few", "all"])
@pytest.mark.parametrize("name", READERS)
def test_a_mutated_file_is_read_or_refused_in_words(
    name: str, samples: dict[str, Path], trying: tuple[subprocess.Popen[str], Path], mutations: int, few: bool
) -> None:
    """The few are the first ones of all."""
    program, errors = trying
    assert program.stdin
    assert program.stdout
    before = len(errors.read_text())
    print(json.dumps([name, str(samples[name]), min(mutations, FEW) if few else mutations]), file=program.stdin, flush=True)
    said = program.stdout.readline()
    assert json.loads(said) == {}, errors.read_text()[before:]
    assert (program.stdout.readline(), errors.read_text()[before:]) == ("0\n", "")


OPENERS = {"read_file", "read_text", "read_bytes", "raw", "load_cert_chain", "read_private_key", "load_file"}
MODULES = {"Image", "gzip", "sqlite3", "tarfile"}


def _opens(call: ast.Call) -> bool:
    """Whether a call reads a file, or opens one to be read."""
    words = ast.unparse(call.func).split(".")
    modes = [each.value for each in call.args[1:] if isinstance(each, ast.Constant) and isinstance(each.value, str)]
    if words[-1] in ("open", "connect") and words[0] in MODULES:
        return True
    if words == ["open"] or (
        words[-1] == "open" and "rb" in [each.value for each in call.args if isinstance(each, ast.Constant)]
    ):
        return not any(set(mode) & set("wax") for mode in modes)
    return words[-1] in OPENERS


def readers() -> set[str]:
    """The functions of the program that read files: "console/tapes/tape.py: __init__"."""
    found = set[str]()
    for path in (ROOT / "delfim").rglob("*.py"):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if any(_opens(node) for node in ast.walk(function) if isinstance(node, ast.Call)):
                found.add(f"{path.relative_to(ROOT / 'delfim')}: {function.name}")
    return found


LOGS = {"system log", "state log", "black box", "sidecar", "run to repeat", "state log as a tape", "sidecar of a tape"}
READ_BY = {  # function: the readers above that come by it
    "adoption/trial/session.py: kept": {"trial to go on"},
    "adoption/trial/concluding.py: conclude": {"vehicle to be adopted"},
    "adoption/trial/dialogue.py: copied": {"vehicle to be adopted"},
    "adoption/trial/dialogue.py: proof": {"vehicle to be adopted"},
    "adoption/identify.py: with_twin": {"vehicle to be adopted"},
    "adoption/identify.py: write": {"vehicle to be adopted"},
    "base/tables.py: read_toml": {"vehicle", "mission", "scenario", "control points"},
    "commands/simulation/sim.py: _copied": {"vehicle of a simulation"},
    "console/boats/soundings.py: _last": {"depths that the console heard"},
    "console/plans/library.py: load": {"library"},
    "console/terminal/bus.py: logged": {"candump", "candump, deflated"},
    "console/terminal/framefilter.py: decoder": {"CAN database"},
    "console/charts/charts.py: _add_tiles": {"MBTiles"},
    "console/pages/pushing.py: __init__": {"browsers to wake"},
    "console/pages/admission.py: kept_token": {"page's token"},
    "console/watch/operators.py: read_operators": {"operators of a console"},
    "console/watch/alertsfile.py: read_alerts": {"alerts of a console"},
    "console/gateway/watchlog.py: kept_lines": {"log of the watch"},
    "logging/kept/record.py: newest": {"kept voyage"},
    "console/terminal/drive.py: _file": {"mission to send"},
    "survey/enc/reading.py: _whole": {"official chart", "update of an official chart", "catalogue of official charts"},
    "vehicle/plans/clearancefile.py: load": {"field of clearances"},
    "console/charts/charts.py: _add_dangers": {"dangers for the page"},
    "survey/progress.py: read_survey": {"survey that goes on"},
    "survey/chart/soundings.py: _rows": {"soundings as CSV"},
    "survey/chart/tide.py: read_tide": {"tide"},
    "console/plans/planfile.py: read_plan": {f"way, {kind}" for kind in WAYS},
    "commands/description/newform.py: read_form": {"answers of a form"},
    "survey/areafile.py: read_area": {"area", "area, KML", "area, GPX", "area of a plan", "area, shapefile"},
    "console/charts/georeference.py: _header": {"PNG", "JPEG", "GeoTIFF"},
    "console/charts/georeference.py: _world": {"world file"},
    "console/tapes/tape.py: __init__": {"session"},
    "console/charts/warp.py: warp": {"PNG", "JPEG", "GeoTIFF"},
    "logging/reading.py: raw": LOGS,
    "logging/reading.py: read_events": LOGS,
    "logging/reading.py: _pieces": LOGS,
    "logging/ashore/repair.py: repair": {"state log", "black box", "sidecar"},
    "logging/systemlog/__init__.py: recent": {"last lines of the system log"},
    "logging/ashore/tree.py: _end": {"sidecar"},
    "logging/ashore/tree.py: _starts": {"sidecar"},
    "logging/ashore/chaincheck.py: _checked": {"log with a chain"},
    "logging/ashore/chaincheck.py: _read": {"chain of a log"},
    "services/access/inventory.py: _of_file": {
        "key in an inventory",
        "host key in an inventory",
        "certificate in an inventory",
    },
    "services/access/certificates.py: server_tls": {"certificate"},
    "commands/description/commission.py: _users": {"user's ssh key"},
    "campaign/runplan.py: _mission": {"mission of a campaign"},
    "campaign/store.py: head_of": {"head of a campaign's results", "a campaign's results"},
    "parts/nmea2000/nmea2000d.py: __init__": {"address on NMEA 2000"},
    "parts/dronecan/numbering.py: known_numbers": {"numbers of DroneCAN devices"},
    "base/input/untrusted.py: read_private": {"password at a caster", "signing key"},
    "services/supervision/supervisorfile.py: last_deadman": {"supervisor's record"},
    "services/image/slots.py: environment": {"boot environment", "words of a Raspberry Pi"},
    "services/image/slots.py: manifest": {"manifest of a slot"},
    "services/image/imagefile.py: verify": {"image"},
    "services/files/sshd.py: _host_key": {"host key"},
    "services/vehiclefile.py: changed": {"vehicle to commission"},
    "simulator/scenarios/encounters.py: read_encounters": {"encounters"},
    "simulator/scenarios/scenario.py: mission_of": {"scenario's mission"},
    "services/suite.py: _outcome": {"supervisor's record"},
    "parts/mavlink/codec/signing.py: read_stamps": {"stamps"},
    "commands/operation/iridium.py: _read": {"message by satellite"},
    "parts/camera/kept.py: _records": {"kept pictures"},
    "parts/camera/kept.py: at": {"kept pictures"},
}
OTHERS = {  # what the kernel tells, and what is only copied or digested
    "adoption/record.py: digest_of",
    "survey/chart/takehome.py: geopackage",  # it writes one
    *(
        "commands/description/commission.py: _mission",
        "commands/description/new.py: _about",
        "commands/description/parts.py: _new",
        "commands/aboard/image.py: confirm",
        "commands/aboard/image.py: status",
    ),
    *("console/charts/dropping.py: _keep", "console/gateway/plan_tools.py: renew", "console/gateway/plan_tools.py: work"),
    *("console/pages/installable.py: built", "services/page/document.py: _read"),  # of the page that came with the program
    "console/logs/fetcher.py: main",  # it sends a file as it is
    *("base/input/untrusted.py: read_file", "base/input/untrusted.py: read_text"),
    *("logging/ashore/fetch.py: _condition", "logging/ashore/fetch.py: _digest", "logging/ashore/fetch.py: _read"),
    *("campaign/store.py: flush", "desk/firstcontact.py: user_of", "parts/dronecan/numbering.py: identity"),
    *("services/supervision/cgroup.py: exceeded", "services/computer.py: _read", "services/supervision/shutdown.py: _read"),
    *("services/radio/slipd.py: _counters", "services/radio/slipd.py: carrier_source"),
    *("services/image/imagefile.py: _digest", "services/image/slots.py: _digest_of_disk", "services/image/imagefile.py: pack"),
    *("services/image/card.py: _digest", "services/image/card.py: users", "services/image/card.py: size_of"),
    "console/terminal/nodes.py: firmware",  # handed to a motor controller as it is
    *(
        "services/image/slots.py: present_notice",
        "services/supervision/children.py: process_state",
        "services/supervision/processes.py: _all",
    ),
    "services/voyage_on_disk.py: _boot",
    *("logging/chain.py: newest", "logging/chain.py: noted"),  # of what this boat wrote itself, its last lines
    *("services/access/inventory.py: _digest", "desk/evidence.py: _digest", "commands/description/inventory.py: run"),
    *("services/clock/kernel.py: _read", "services/suite.py: _started", "parts/pwm/sim.py: _part"),
}


def test_no_reader_of_files_is_forgotten() -> None:
    assert readers() == READ_BY.keys() | OTHERS, "a new reader needs a sample, a row above, and a row here"
    assert set().union(*READ_BY.values()) <= READERS.keys()


@pytest.mark.parametrize(("kind", "words"), [("pipe", "a pipe, not a file"), ("device", "a device"), ("large", "are not read")])
def test_what_never_ends_or_never_begins_is_refused_in_words(kind: str, words: str, tmp_path: Path) -> None:
    """Given instead of a vehicle's file, a mission, a session, a log, a key."""
    place = tmp_path / "log/20260101/state"
    place.mkdir(parents=True)
    odd = place / "000000.state"
    if kind == "pipe":
        os.mkfifo(odd)
    elif kind == "device":
        odd.symlink_to("/dev/zero")
    else:
        with odd.open("wb") as file:
            file.truncate(2 << 30)
    (place / "day.tlog").symlink_to(odd)
    if kind != "device":
        odd.chmod(0o600)
    said = [
        command("check", str(odd)),
        refused(lambda: load_mission(odd)),
        refused(lambda: load_scenario(odd)),
        refused(lambda: open_tapes([place / "day.tlog"])),
        refused(lambda: read_log(odd)),
        refused(lambda: read_key(odd)) if kind != "device" else [words],
    ]
    assert [lines for lines in said if len(lines) != 1 or words not in lines[0]] == []
