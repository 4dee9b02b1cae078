"""`python -m tests.mutated_files` takes lines of JSON, `["READER", "FOLDER", COUNT]`: the reader of files is given its sample,
mutated so many times, in a process with a bound on memory and, for each file, on processor time. What it must not have done
is printed as JSON, and its exit code as a second line.

A reader says yes, or one line of error. `tests/test_mutated_files.py` makes the samples and runs all readers.
"""

import asyncio
import contextlib
import importlib
import io
import json
import logging
import os
import resource
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import FrameType
from typing import NamedTuple

from delfim.logging import reading
from tests.mutations import BINARY, TEXT, Mutation, deflated, large_png, odd_tables

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")
MEMORY_BYTES = 1 << 28  # more than the program has before it reads
LOG_BYTES = 1 << 22  # instead of the limit of a computer that looks at logs
PROCESSOR_S = 20.0  # for one file, of a mebibyte at most: none takes a tenth of it
LINE_MAX = 1000
PRELOADED = "delfim.__main__", "delfim.simulator.lockstep", "delfim.logging.ashore.tree", "delfim.console.boats.fleet"
LINES_MAX = 60  # of a list of mistakes, or warnings of a command that goes on

Said = list[str]


class Reader(NamedTuple):
    """Who reads, how it is called with a folder of which one file is mutated, and how."""

    file: str
    read: Callable[[Path], Said]
    how: tuple[Mutation, ...]


def command(*words: str) -> Said:
    """What the command line says on standard error."""
    from delfim.__main__ import main

    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        code = main(words)
    lines = errors.getvalue().splitlines()
    if code not in (0, 1, 2, 100):
        return [f"\0exit code {code}"]
    if code == 2 and not any(line.startswith("delfim: ") for line in lines):
        return ["\0refused without a word"]
    return lines


def refused(read: Callable[[], object]) -> Said:
    """What a function says that is not a command."""
    from delfim.base.errors import DelfimError, in_words

    try:
        read()
    except (DelfimError, OSError) as error:
        return [in_words(error)]
    return []


def vehicle(here: Path) -> Said:
    return command("check", str(here / "boat.toml"))


def commissioned(here: Path) -> Said:
    shutil.rmtree(here / "out", ignore_errors=True)
    return command("commission", str(here / "boat.toml"), "--yes", "--users", "ana", "--output", str(here / "out"))


def adopted(here: Path) -> Said:
    """The file to which what was found of the boat is written."""
    from delfim import config
    from delfim.adoption.trial.concluding import conclude
    from delfim.adoption.trial.session import TrialProgress
    from delfim.adoption.writing import FoundKey, with_keys
    from delfim.base.input.untrusted import read_text
    from delfim.base.wholefile import replace_file

    file, nothing = here / "boat.toml", TrialProgress(config.load(ROOT / "etc/delfimx.toml").thrusters)
    found = FoundKey(("boat", "inertia_kgm2"), 120.0, 3.0, None), FoundKey(("adopted", "chi2"), 0.4, None, None)
    concluded = refused(lambda: conclude(nothing, file, here / "report", "today", None, str))
    return concluded + refused(lambda: replace_file(file, with_keys(read_text(file), found, "found", "boat.toml")))


def trial_to_go_on(here: Path) -> Said:
    from delfim import config
    from delfim.adoption.trial.session import kept
    from delfim.adoption.trial.taped import record_of
    from delfim.adoption.windows import windows_of

    progress = kept(here / "trial.json", config.load(ROOT / "etc/delfimx.toml"))
    return refused(lambda: windows_of(record_of(progress, is_estimated=True), [(0, 1.0), (1, 1.0)]))


def identified(here: Path) -> Said:
    return command("identify", str(here / "log"), "--vehicle", str(ROOT / "etc/delfimx.toml"), "--output", str(here / "out"))


def users_key(here: Path) -> Said:
    shutil.rmtree(here / "out", ignore_errors=True)
    words = ("commission", str(ROOT / "etc/delfimx-sea.toml"), "--yes", "--users", f"ana={here / 'user.pub'}")
    return command(*words, "--output", str(here / "out"))


def numbers(here: Path) -> Said:
    from delfim.parts.dronecan.numbering import known_numbers, log

    log.propagate, log.handlers = False, [logging.NullHandler()]  # it says what is damaged
    return refused(lambda: known_numbers(here / "numbers"))


def mission(here: Path) -> Said:
    from delfim.vehicle.plans.mission import load_mission

    return refused(lambda: load_mission(here / "lake.toml"))


def library(here: Path) -> Said:
    """The text is read in this process, and not in one of its own for each mutation."""
    from delfim.base.errors import DelfimError
    from delfim.console.plans.library import Library
    from delfim.vehicle.plans.mission import read_mission
    from delfim.vehicle.plans.missionreader import Reading, written

    def lines(self: Reading) -> list[bytes] | DelfimError:
        try:
            return [line.rstrip() for line in written(read_mission(self._text))]
        except DelfimError as error:
            return error

    Reading.lines = lines  # type: ignore[method-assign]
    missions = Library(here)
    return [
        words
        for name in missions.names()
        for words in refused(lambda name=name: json.dumps(missions.load(name), allow_nan=False))
    ]  # type: ignore[misc]


def scenario(here: Path) -> Said:
    from delfim.simulator.scenarios.scenario import load_scenario, settings_of

    return refused(lambda: settings_of(load_scenario(here / "storm.toml"), VEHICLE))


def scenarios_mission(here: Path) -> Said:
    from delfim.simulator.scenarios.scenario import load_scenario, mission_of

    return refused(lambda: mission_of(load_scenario(here / "storm.toml"), here / "storm.toml"))


def encounters(here: Path) -> Said:
    from delfim.simulator.scenarios.encounters import staged_of
    from delfim.simulator.scenarios.scenario import load_scenario

    file = here / "imazu22-real.toml"
    return refused(lambda: staged_of(load_scenario(file), file))


def campaign(here: Path) -> Said:
    from delfim.campaign.runplan import read

    return refused(lambda: read(here / "campaign.toml"))


def missions_campaign(here: Path) -> Said:
    from delfim.campaign.runplan import read

    return refused(lambda: read(here / "cruise.toml"))


def results(here: Path) -> Said:
    """Those of a campaign, as somebody finds them who goes on with it."""
    from delfim.campaign.queries import connect, quantities
    from delfim.campaign.runplan import read
    from delfim.campaign.store import Store

    plan = read(here / "campaign.toml")[1]
    said = refused(lambda: Store(here / "results", plan, 2, "of the sample"))
    return said + refused(lambda: quantities(connect(here / "results")))


def own_address(here: Path) -> Said:
    from delfim.parts.nmea2000.nmea2000d import Memory

    return [] if 0 <= Memory(here / "address").address <= 251 else ["no address"]


def operators_mission(here: Path) -> Said:
    from delfim.console.terminal.drive import command as words_of

    return refused(lambda: words_of(["mission", str(here / "lake.toml")]))


def serial_line(here: Path) -> Said:
    from delfim.logging.ashore.tree import files
    from delfim.logging.linelog import pieces

    return refused(lambda: list(pieces(files([here / "log" / next(os.walk(here / "log"))[1][0] / "-dev-gnss"]))))


def last_lines(here: Path) -> Said:
    """As the boat's page shows them; those that it must not show are told."""
    from delfim.services.page import saidlines

    said = [words for told in saidlines.last_lines(str(here), 100) for words in (told.service, told.text)]
    return [words for words in said if not words.isprintable()]


def replayed(here: Path) -> Said:
    """All of a tape, and every tenth of it jumped to, as a page gets it."""
    from delfim.base.clock import ManualClock
    from delfim.console.tapes.replay import TapePlayer, open_tapes

    def play() -> None:
        clock, told = ManualClock(), list[object]()
        replay = TapePlayer(open_tapes([here]), clock, told.append)
        replay.steer(None, 60.0)
        for tenth in range(4):
            replay.steer(replay.from_s + tenth * (replay.to_s - replay.from_s) / 4.0, None)
            clock.advance(0.5)
            replay.tick()
            json.dumps([replay.snapshot(), told], allow_nan=False)

    return refused(play)


def inventoried(here: Path) -> Said:
    """The keys of a boat whose fingerprints are told."""
    named = {"sshd.host_key": "host_key", "ftpd.certificate": "boat.pem", "mavlink.key": "key"}
    words = [word for key, name in named.items() for word in ("--set", f'{key}="{here / name}"')]
    return command("inventory", VEHICLE, *words)


def log_verb(*words: str) -> Callable[[Path], Said]:
    def read(here: Path) -> Said:
        verb, *more = words
        return command("log", verb, *more, str(here / "log"))

    return read


def logs(*verbs: tuple[str, ...]) -> Callable[[Path], Said]:
    """Several verbs after each other on one tree."""

    def read(here: Path) -> Said:
        os.chdir(here)
        return next((said for verb in verbs if faults(said := log_verb(*verb)(here))), [])

    return read


def can_replay(name: str) -> Callable[[Path], Said]:
    def read(here: Path) -> Said:
        from delfim.console.terminal.bus import logged

        errors = io.StringIO()
        with contextlib.redirect_stderr(errors):
            said = refused(lambda: sum(1 for _ in logged(str(here / name))))
        return said + errors.getvalue().splitlines()

    return read


def surveyed(name: str) -> Callable[[Path], Said]:
    from delfim import config
    from delfim.survey.areafile import read_area
    from delfim.survey.ground import laid
    from delfim.survey.planning import LinesWanted, planned

    return lambda here: refused(lambda: planned(laid(read_area(here / name)), LinesWanted(20.0, 1.5), config.Zones()))


def way_of(name: str) -> Callable[[Path], Said]:
    from delfim.console.plans.planfile import read_plan

    return lambda here: refused(lambda: read_plan(here / name))


def form_of_new(here: Path) -> Said:
    from delfim.commands.description.newform import read_form

    return refused(lambda: read_form(str(here / "answers.json")))


def official_chart(here: Path) -> Said:
    """In this process, and not in one of its own for each mutation."""
    from delfim.survey.enc.dangers import LAYERS, Need, charted
    from delfim.survey.enc.reading import _whole, gathered

    def told() -> None:
        _whole(here / "XX5TEST1.000")
        charted([gathered(here / "XX5TEST1.000", LAYERS)], Need(0.5))

    return refused(told)


def exchange_set(here: Path) -> Said:
    from delfim.survey.enc.dropped import unpacked

    with TemporaryDirectory() as place:  # what is in it is laid beside it
        archive = Path(place) / "set.zip"
        archive.write_bytes((here / "set.zip").read_bytes())
        return refused(lambda: unpacked(archive))


def dangers(here: Path) -> Said:
    from delfim.console.charts.charts import Charts

    return list(Charts(here).faults)


def clearances(here: Path) -> Said:
    from delfim import config
    from delfim.vehicle.plans.clearancefile import load

    fence = config.FenceTable(chart=str(here / "harbour.clearance"))
    return refused(lambda: load(config.Vehicle(boat=config.BoatTable(name="test"), fence=fence)))


def survey_rest(here: Path) -> Said:
    return command("survey", "rest", str(here / "dock.survey.json"), "--output", str(here / "rest.toml"))


def charted(here: Path) -> Said:
    from delfim.survey.chart.making import made
    from delfim.survey.chart.reduction import SoundingCorrections
    from delfim.survey.chart.soundings import read

    return refused(lambda: made("a boat", [(read(here / "soundings.csv"), SoundingCorrections())]))


def heard_depths(here: Path) -> Said:
    from delfim.base.clock import ManualClock
    from delfim.console.boats.soundings import SoundingFiles

    return refused(lambda: list(SoundingFiles(here, ManualClock()).read()))


def copied(here: Path) -> Said:
    from delfim.commands.simulation.sim import _copied

    return refused(lambda: _copied(str(here / "boat.toml"), here / "console", 2))


def tide(here: Path) -> Said:
    from delfim.survey.chart.tide import read_tide

    return refused(lambda: read_tide(here / "tide.csv"))


def database(here: Path) -> Said:
    from delfim.base.frames import Frame, standard
    from delfim.console.terminal.framefilter import decoder

    def read() -> None:
        decoded = decoder(str(here / "boat.dbc"))
        for number in range(0, 2048, 8):
            decoded(Frame(standard(number), bytes(8), 0))

    return refused(read)


def chart(name: str) -> Callable[[Path], Said]:
    """Taken into the console's folder, and drawn anew where it lies askew."""

    def read(here: Path) -> Said:
        from delfim.console.charts.charts import Charts
        from delfim.console.charts.warp import main as warp

        charts = Charts(here)
        charts.close()
        json.dumps(charts.backgrounds, allow_nan=False)
        if charts.faults:
            return charts.faults
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors):
            warp([str(here / name), str(here / "drawn")])
        return errors.getvalue().splitlines()

    return read


def tiles(here: Path) -> Said:
    from aiohttp import web
    from aiohttp.test_utils import make_mocked_request

    from delfim.console.charts.charts import Charts

    charts, said = Charts(here), list[str]()
    json.dumps(charts.backgrounds, allow_nan=False)
    for z, x, y in ((12, 1943, 1582), (13, 0, 0)) if charts.backgrounds else ():
        request = make_mocked_request("GET", "/", match_info={"name": "harbour", "z": str(z), "x": str(x), "y": str(y)})
        try:
            asyncio.run(charts._tile(request))
        except web.HTTPException as error:
            said += (error.text or "").splitlines()
    charts.close()
    return charts.faults + said


def image(here: Path) -> Said:
    return command(
        "image",
        VEHICLE,
        "verify",
        str(here / "new.image"),
        "--set",
        f"image.signers=[{json.dumps((here / 'yard.pub').read_text())}]",
    )


def slot(here: Path) -> Said:
    return command("image", VEHICLE, "status", "--set", f'image.directory="{here}"')


def slot_of_a_pi(here: Path) -> Said:
    return command("image", VEHICLE, "status", "--set", f'image.directory="{here / "pi"}"')


def casters_password(here: Path) -> Said:
    from delfim.base.input.untrusted import read_credentials

    os.chmod(here / "ntrip", 0o600)
    return refused(lambda: read_credentials(str(here / "ntrip")))


def key(here: Path) -> Said:
    from delfim.base.input.keys import read_key

    os.chmod(here / "key", 0o600)
    return refused(lambda: read_key(here / "key"))


def by_satellite(here: Path) -> Said:
    return command("iridium", "read", str(here / "message.sbd"))


def kept_pictures(here: Path) -> Said:
    from delfim.parts.camera.kept import PicturesByTime

    return refused(lambda: PicturesByTime([here / "bow.pictures"]).at(1 << 62))


def stamps(here: Path) -> Said:
    from delfim.parts.mavlink.codec.signing import read_stamps

    return refused(lambda: read_stamps(here / "stamps"))


def host_key(here: Path) -> Said:
    from delfim.services.files.sshd import _host_key

    return refused(lambda: _host_key(str(here / "host_key")))


def certificate(here: Path) -> Said:
    from delfim.services.access.certificates import server_tls

    return refused(lambda: server_tls(str(here / "boat.pem"), "ftpd.certificate"))


def browsers_to_wake(here: Path) -> Said:
    from delfim.base.clock import ManualClock
    from delfim.console.pages.pushing import PushDesk
    from delfim.console.watch.operators import OperatorsFile

    return [PushDesk(here / "push.json", OperatorsFile(None), ManualClock()).reason]


def operators_of_console(here: Path) -> Said:
    from delfim.console.watch.operators import read_operators

    names = list[str]()
    return refused(lambda: names.extend(each.name for each in read_operators(here / "operators.json"))) or names


def alerts_of_console(here: Path) -> Said:
    """As a console takes them, and as its pages get them."""
    from delfim.console.watch.alerts import AlertList
    from delfim.console.watch.alertsfile import read_alerts

    def told() -> None:
        alerts = AlertList(lambda: 0.0)
        alerts.restore(read_alerts(here / "alerts.json"))
        for boat in (1, 2):
            alerts.troubles(boat, 3)
        json.dumps([alerts.shown(), list(alerts.history)], allow_nan=False)

    return refused(told)


def log_of_watch(here: Path) -> Said:
    return command("console", "--sessions", str(here), "--watch-log", "1e9")


def page_token(here: Path) -> Said:
    from delfim.console.pages.admission import kept_token

    return [kept_token(here / "token")]


def kept_voyage(here: Path) -> Said:
    from delfim import config
    from delfim.logging.kept.record import newest
    from delfim.vehicle.orders import voyage

    def told() -> None:
        _, record = newest([str(here)], "voyage", b"")
        assert record is not None
        voyage.read(record, config.Vehicle(boat=config.BoatTable(name="test")), voyage.KeptHead("test", "", "", 0, 0.0))

    return refused(told)


def supervisors_record(here: Path) -> Said:
    from delfim.services.suite import _outcome
    from delfim.services.supervision.supervisorfile import last_deadman

    with contextlib.redirect_stdout(io.StringIO()):
        return refused(lambda: (last_deadman(here / "record"), _outcome(here / "record", 0.0, "")))


LOG_VERBS = (("ls",), ("info",), ("cat",), ("cat", "--events"), ("export", "csv", "--output", "out"), ("repair",))
BOX_VERBS = (("info",), ("cat", "--id", "lockstep"), ("export", "log", "--output", "out"), ("repair",))

READERS = {
    "vehicle": Reader("boat.toml", vehicle, TEXT),
    "vehicle to commission": Reader("boat.toml", commissioned, TEXT),
    "vehicle to be adopted": Reader("boat.toml", adopted, TEXT),
    "vehicle of a simulation": Reader("boat.toml", copied, TEXT),
    "trial to go on": Reader("trial.json", trial_to_go_on, TEXT),
    "mission": Reader("lake.toml", mission, TEXT),
    "library": Reader("lake.toml", library, TEXT),
    "scenario": Reader("storm.toml", scenario, TEXT),
    "campaign": Reader("campaign.toml", campaign, TEXT),
    "mission of a campaign": Reader("lake.toml", missions_campaign, TEXT),
    "head of a campaign's results": Reader("results/campaign.json", results, TEXT),
    "a campaign's results": Reader("results/part-000000.parquet", results, BINARY),
    "address on NMEA 2000": Reader("address", own_address, TEXT),
    "scenario's mission": Reader("lake.toml", scenarios_mission, TEXT),
    "encounters": Reader("imazu22-real.json", encounters, TEXT),
    **{
        f"way, {kind}": Reader(f"way.{kind}", way_of(f"way.{kind}"), BINARY if kind == "shp" else TEXT)
        for kind in ("geojson", "kml", "gpx", "plan", "waypoints", "shp")
    },
    "answers of a form": Reader("answers.json", form_of_new, TEXT),
    "area": Reader("dock.geojson", surveyed("dock.geojson"), TEXT),
    "area, KML": Reader("dock.kml", surveyed("dock.kml"), TEXT),
    "area, GPX": Reader("dock.gpx", surveyed("dock.gpx"), TEXT),
    "area of a plan": Reader("dock.plan", surveyed("dock.plan"), TEXT),
    "official chart": Reader("XX5TEST1.000", official_chart, (*BINARY, *TEXT)),
    "exchange set of charts": Reader("set.zip", exchange_set, BINARY),
    "update of an official chart": Reader("XX5TEST1.001", official_chart, (*BINARY, *TEXT)),
    "catalogue of official charts": Reader("CATALOG.031", official_chart, (*BINARY, *TEXT)),
    "dangers for the page": Reader("pelee.geojson", dangers, TEXT),
    "field of clearances": Reader("harbour.clearance", clearances, BINARY),
    "survey that goes on": Reader("dock.survey.json", survey_rest, TEXT),
    "soundings as CSV": Reader("soundings.csv", charted, TEXT),
    "depths that the console heard": Reader("soundings/1.csv", heard_depths, TEXT),
    "tide": Reader("tide.csv", tide, TEXT),
    "area, shapefile": Reader("dock.shp", surveyed("dock.shp"), BINARY),
    "mission to send": Reader("lake.toml", operators_mission, TEXT),
    "session": Reader("day.tlog", replayed, BINARY),
    "state log": Reader("log/*/state/*.state", logs(*LOG_VERBS), (*BINARY, *TEXT)),
    "state log to identify": Reader("log/*/state/*.state", identified, (*BINARY, *TEXT)),
    "state log, deflated": Reader("log/*/state/*.state.gz", logs(*LOG_VERBS), deflated((*BINARY, *TEXT))),
    "black box": Reader("log/*/lockstep/*.log.gz", logs(*BOX_VERBS), deflated(TEXT)),
    "black box, plain": Reader("log/*/lockstep/*.log", logs(*BOX_VERBS), (*BINARY, *TEXT)),
    "sidecar": Reader(
        "log/*/state/*.meta.jsonl",
        logs(("info",), ("cat", "--events"), ("export", "mcap", "--output", "out"), ("repair",)),
        TEXT,
    ),
    "run to repeat": Reader("log/*/lockstep/*.log.gz", logs(("replay", "--all")), deflated(TEXT)),
    "run to repeat, state": Reader("log/*/state/*.state.gz", logs(("replay", "--all")), deflated((*BINARY, *TEXT))),
    "run to repeat, sidecar": Reader("log/*/state/*.meta.jsonl", logs(("replay", "--all")), TEXT),
    "state log as a tape": Reader("log/*/state/*.state.gz", replayed, deflated((*BINARY, *TEXT))),
    "sidecar of a tape": Reader("log/*/state/*.meta.jsonl", replayed, TEXT),
    "serial line": Reader("log/*/-dev-gnss/*.jsonl", serial_line, TEXT),
    "chain of a log": Reader("log/*/state/*.chain", log_verb("check"), TEXT),
    "log with a chain": Reader("log/*/state/*.state.gz", log_verb("check"), BINARY),
    "system log": Reader("log/*/system/*.jsonl", log_verb("cat", "system"), TEXT),
    "last lines of the system log": Reader("system.jsonl", last_lines, TEXT),
    "candump": Reader("box.log", can_replay("box.log"), (*BINARY, *TEXT)),
    "candump, deflated": Reader("box.log.gz", can_replay("box.log.gz"), deflated(TEXT)),
    "CAN database": Reader("boat.dbc", database, TEXT),
    "PNG": Reader("chart.png", chart("chart.png"), (*BINARY, large_png)),
    "JPEG": Reader("chart.jpg", chart("chart.jpg"), BINARY),
    "GeoTIFF": Reader("chart.tif", chart("chart.tif"), BINARY),
    "control points": Reader("chart.toml", chart("chart.png"), TEXT),
    "world file": Reader("chart.pgw", chart("chart.png"), TEXT),
    "MBTiles": Reader("harbour.mbtiles", tiles, (*BINARY, odd_tables, odd_tables, odd_tables)),
    "image": Reader("new.image", image, BINARY),
    "boot environment": Reader("grub/grubenv", slot, (*BINARY, *TEXT)),
    "words of a Raspberry Pi": Reader("pi/autoboot.txt", slot_of_a_pi, (*BINARY, *TEXT)),
    "manifest of a slot": Reader("a/manifest.json", slot, TEXT),
    "user's ssh key": Reader("user.pub", users_key, TEXT),
    "numbers of DroneCAN devices": Reader("numbers", numbers, TEXT),
    "key in an inventory": Reader("key", inventoried, TEXT),
    "host key in an inventory": Reader("host_key", inventoried, TEXT),
    "certificate in an inventory": Reader("boat.pem", inventoried, TEXT),
    "signing key": Reader("key", key, TEXT),
    "password at a caster": Reader("ntrip", casters_password, TEXT),
    "stamps": Reader("stamps", stamps, TEXT),
    "kept pictures": Reader("bow.pictures", kept_pictures, BINARY),
    "message by satellite": Reader("message.sbd", by_satellite, BINARY),
    "host key": Reader("host_key", host_key, TEXT),
    "certificate": Reader("boat.pem", certificate, TEXT),
    "browsers to wake": Reader("push.json", browsers_to_wake, TEXT),
    "kept voyage": Reader("voyage-1", kept_voyage, (*BINARY, *TEXT)),
    "page's token": Reader("token", page_token, TEXT),
    "alerts of a console": Reader("alerts.json", alerts_of_console, TEXT),
    "log of the watch": Reader("20260921-100000.csv", log_of_watch, (*BINARY, *TEXT)),
    "operators of a console": Reader("operators.json", operators_of_console, TEXT),
    "supervisor's record": Reader("record", supervisors_record, TEXT),
}


def faults(said: Said) -> list[str]:
    """What is wrong with what was said."""
    wrong = [f"no line for people: {line[:200]!r}" for line in said if not line.isprintable() or len(line) > LINE_MAX]
    wrong += [f"traceback: {said}"] if any("Traceback" in line for line in said) else []
    return wrong + ([f"{len(said)} lines: {said[:3]}"] if len(said) > LINES_MAX else [])


def mutants(reader: Reader, data: bytes, count: int, name: str) -> Iterator[tuple[str, bytes]]:
    for number in range(count):
        random = Random(f"{name} {number}")
        how = random.choice(reader.how)
        yield f"{number} {how.__name__}", how(data, random)


class TooLong(BaseException):
    """Not caught by anyone."""


def _alarm(number: int, frame: FrameType | None) -> None:
    raise TooLong


def judged(read: Callable[[Path], Said], here: Path) -> list[str]:
    signal.setitimer(signal.ITIMER_PROF, PROCESSOR_S)
    try:
        return faults(read(here))
    except BaseException:
        return [traceback.format_exc()]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def tried(name: str, folder: Path, count: int) -> dict[str, list[str]]:
    """What a reader must not have done, by the mutation that made it."""
    reader = READERS[name]
    signal.signal(signal.SIGPROF, _alarm)
    reading.LOG_BYTES = LOG_BYTES  # type: ignore[misc]
    there = next(iter(sorted(folder.glob(reader.file))))
    data, here = there.read_bytes(), folder.with_name(f"{folder.name}, {name}")
    wrong = dict[str, list[str]]()

    def one(label: str, mutant: bytes) -> None:
        shutil.rmtree(here, ignore_errors=True)
        shutil.copytree(folder, here)
        place = here / there.relative_to(folder)
        place.write_bytes(mutant)
        if said := judged(reader.read, here):
            wrong[label] = said
        os.chdir(ROOT)

    one("sample", data)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, resource.RLIM_INFINITY))
    for label, mutant in mutants(reader, data, count, name):
        one(label, mutant)
    return wrong


def main() -> None:
    """Each reader in a process of its own, which has what most of them import already: that costs as much as to read."""
    for module in PRELOADED:
        importlib.import_module(module)
    for line in sys.stdin:
        name, sample, count = json.loads(line)
        if (child := os.fork()) == 0:
            print(json.dumps(tried(name, Path(sample), count)), flush=True)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
