"""`delfim survey`: an area drawn on a map becomes the lines of a survey, as a mission; its soundings become a chart."""

import argparse
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.commands import OWN_FILE, Formatter, overrides, picture, place, shipped

MOST_M = 1000.0  # of a spacing, a swath, a run-in
SEEN = 0.0005  # a part of the area that the printed figure shows


def options(parser: argparse.ArgumentParser) -> None:
    tasks = parser.add_subparsers(dest="task", required=True, metavar="TASK")
    for declare, name, told in (
        (_lines_options, "lines", "Make the mission that sails an area line by line."),
        (_rest_options, "rest", "Make the mission of what a survey has left, by its logs."),
        (_chart_options, "chart", "Make a chart of the soundings in a log."),
        (_report_options, "report", "Tell how well each line of a mission was sailed, by a log."),
    ):
        declare(tasks.add_parser(name, help=told, description=told, formatter_class=Formatter))


def _lines_options(lines: argparse.ArgumentParser) -> None:
    lines.set_defaults(does=_lines)
    lines.add_argument(
        "area", metavar="AREA", type=shipped, help="GeoJSON, KML, GPX, a shapefile or a .plan of QGroundControl."
    )
    lines.add_argument(
        "--vehicle", default=OWN_FILE, metavar="FILE", type=shipped, help="The vehicle's file: speed, turns, fence."
    )
    overrides(lines)
    _boats_option(lines)
    lines.add_argument("--spacing", type=metres, metavar="M", help="Between lines; or else --swath.")
    lines.add_argument("--swath", type=metres, metavar="M", help="Covered by a line, to both sides together.")
    lines.add_argument(
        "--overlap", type=percent, default=20.0, metavar="PERCENT", help="Of the swaths, where no spacing is given."
    )
    lines.add_argument("--heading", type=float, metavar="DEG", help="Of the lines, from true north (default: the quickest).")
    lines.add_argument("--inside", action="store_true", help="End lines where they leave the area, covered to its edge or not.")
    lines.add_argument("--cross", type=metres, metavar="M", help="Cross lines, so far apart.")
    lines.add_argument(
        "--start", choices=("nw", "ne", "sw", "se"), help="Begin near this corner of the area (default: anywhere)."
    )
    told = "That the sensor looks to, from the line as far as the swath, or the spacing (default: both)."
    lines.add_argument("--side", choices=("port", "starboard"), help=told)
    lines.add_argument(
        "--run-in", type=metres, metavar="M", help="Straight before and behind each line (default: 12, or more)."
    )
    lines.add_argument(
        "--room", type=metres, metavar="M", help="Kept from holes and fences (default: what missions keep, and 6)."
    )
    lines.add_argument("--turn-radius", type=metres, metavar="M", help="The boat's smallest (default: by its thrusters).")
    lines.add_argument("--speed", type=metres, metavar="M/S", help="On the lines (default: that of the vehicle's file).")
    told = "Announce to payloads where each line begins: a number of MAVLink, and up to four of its own (206,10)."
    lines.add_argument("--at-begin", action="append", default=[], type=_action, metavar="COMMAND", help=told)
    lines.add_argument("--at-end", action="append", default=[], type=_action, metavar="COMMAND", help="And where each ends.")
    lines.add_argument("--output", metavar="FILE", help="Write the mission here (default: AREA.toml in this folder).")
    lines.add_argument("--picture", type=picture, metavar="FILE", help="Draw it, too, as .png or .svg.")


def _boats_option(parser: argparse.ArgumentParser) -> None:
    told = "Divide the lines among these boats, so that all are done at the same time, instead of --vehicle."
    parser.add_argument("--boats", metavar="FILE,FILE", help=told)


def _rest_options(rest: argparse.ArgumentParser) -> None:
    rest.set_defaults(does=_rest)
    rest.add_argument("--vehicle", default=OWN_FILE, metavar="FILE", type=shipped, help="The vehicle's file of who goes on.")
    overrides(rest)
    _boats_option(rest)
    told = "Where the boat is, or the next of --boats (default: where the last log ends)."
    rest.add_argument("--at", action="append", default=[], type=place(89.0), metavar="LAT,LON", help=told)
    rest.add_argument("--output", metavar="FILE", help="Write the mission here (default: NAME-rest.toml in this folder).")
    rest.add_argument("--picture", type=picture, metavar="FILE", help="Draw it, too, as .png or .svg.")
    rest.add_argument("survey", metavar="SURVEY", help="The file .survey.json that delfim survey lines wrote.")
    rest.add_argument("log", nargs="*", metavar="LOG", help="Logs since then: trees, days, folders, files, CSV of soundings.")
    rest.set_defaults(many="log")


def _chart_options(chart: argparse.ArgumentParser) -> None:
    chart.set_defaults(does=_chart)
    chart.add_argument("--vehicle", metavar="FILE", type=shipped, help="Its [sounder], instead of that in the log.")
    overrides(chart)
    chart.add_argument("--tide", metavar="FILE", help="A table of times and metres above the chart's datum.")
    told = "The tide by the height of the antenna with RTK: the datum is so far above the ellipsoid."
    chart.add_argument("--rtk-datum", type=float, metavar="M", help=told)
    chart.add_argument("--sound", type=_speed, metavar="M/S", help="Speed of sound in the water (default: the sounder's).")
    told = "Find by lines to and fro how late depths come, and use it."
    chart.add_argument("--patch-test", action="store_true", help=told)
    told = "A bar hung this deep from FROM to TO (09:30): finds the draught of the transducer. Two depths find the sound, too."
    chart.add_argument("--bar", action="append", nargs=3, default=[], metavar=("M", "FROM", "TO"), help=told)
    chart.add_argument("--cell", type=metres, default=2.0, metavar="M", help="Of the chart.")
    chart.add_argument("--spacing", type=metres, metavar="M", help="Between lines (default: as they were sailed).")
    chart.add_argument("--contours", type=metres, metavar="M", help="From one to the next (default: ten to twenty of them).")
    told = "NAME <name@place.pt>: write crowd-sourced bathymetry (IHO B-12), too, by this provider."
    chart.add_argument("--csb", metavar="PROVIDER", help=told)
    chart.add_argument("--from", dest="from_", metavar="TIME", help="From this time on: UTC, as 2010-01-01T09:30:00.")
    chart.add_argument("--to", metavar="TIME", help="Up to this time.")
    chart.add_argument("-o", "--output", required=True, metavar="FOLDER", help="Write the files and report.html here.")
    chart.add_argument("log", nargs="+", metavar="LOG", help="Trees, days, folders or files of logs, or a CSV of soundings.")
    chart.set_defaults(many="log")


def _report_options(report: argparse.ArgumentParser) -> None:
    report.set_defaults(does=_report)
    report.add_argument("mission", metavar="MISSION", help="As delfim survey lines wrote it, and the boat sailed it.")
    told = "A line counts as sailed so near to it (default: anywhere)."
    report.add_argument("--within", type=metres, default=MOST_M, metavar="M", help=told)
    report.add_argument("--from", dest="from_", metavar="TIME", help="From this time on: UTC, as 2010-01-01T09:30:00.")
    report.add_argument("--to", metavar="TIME", help="Up to this time.")
    report.add_argument("log", nargs="+", metavar="LOG", help="Trees, days, folders or files of logs.")
    report.set_defaults(many="log")


def _action(text: str) -> tuple[float, ...]:
    try:
        command, *numbers = map(float, text.split(","))
        if command == int(command) and len(numbers) <= 4:
            return int(command), *numbers, *[0.0] * (4 - len(numbers))
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not a number of MAVLink and up to four of its own, as 206,10")


def _speed(text: str) -> float:
    try:
        if 1300.0 <= float(text) <= 1700.0:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not a speed of sound in water, 1300 to 1700 m/s")


def metres(text: str) -> float:
    try:
        if 0.0 < float(text) <= MOST_M:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not more than 0 and up to {MOST_M:g}")


def percent(text: str) -> float:
    try:
        if 0.0 <= float(text) <= 90.0:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not 0 to 90")


def run(asked: argparse.Namespace) -> int:
    code: int = asked.does(asked)
    return code


def _lines(asked: argparse.Namespace) -> int:
    if asked.spacing is None and asked.swath is None:
        raise DelfimError("say --spacing, or --swath with its --overlap")
    from delfim.survey import missions, progress
    from delfim.survey.areafile import read_area

    wishes = progress.SurveyWishes(
        spacing_m=asked.spacing or asked.swath * (1.0 - asked.overlap / 100.0),
        swath_m=asked.swath or 0.0,
        heading_deg=asked.heading,
        edges=not asked.inside,
        cross_m=asked.cross or 0.0,
        start=asked.start or "",
        side=asked.side or "",
        run_in_m=asked.run_in,
        room_m=asked.room,
        radius_m=asked.turn_radius,
        speed_mps=asked.speed,
    )
    boats = missions.boats_of(_files(asked), asked.set)
    name, areas = Path(asked.area).stem, read_area(asked.area)
    plan, plans = missions.begun(areas, wishes, boats)
    actions = missions.LineAnnounced(asked.at_begin, asked.at_end)
    file = Path(asked.output or f"{name}.toml")
    print(*missions.written(plans, boats, name, file, actions), sep="\n")
    free, area = plan.covered()
    room = f", which is {100.0 * area:.1f} % of the area: {plan.wanted.room_m:g} m about holes and fences are left"
    print(f"  covered: {100.0 * free:.1f} % of what may be sailed{room if area < free - SEEN else ''}")
    if plan.rough:
        lines = f"{len(plan.rough)} lines begin" if len(plan.rough) > 1 else "a line begins"
        print(f"  {lines} at a hole, without room to settle: up to 3 m off at first")
    print(*missions.drawn(plans, boats, name, asked.picture), sep="\n", end="\n" if asked.picture else "")
    beside = file.with_suffix(".survey.json")
    survey = progress.kept([each for each in plans if each is not None], name, areas, wishes)
    survey.begin, survey.end = actions
    progress.write_survey(survey, beside)
    return 0


def _files(asked: argparse.Namespace) -> list[str]:
    return [shipped(file) for file in asked.boats.split(",")] if asked.boats else [asked.vehicle]


def _rest(asked: argparse.Namespace) -> int:
    from delfim.survey import missions, progress
    from delfim.survey.ground import in_plane, laid

    survey, boats = progress.read_survey(asked.survey), missions.boats_of(_files(asked), asked.set)
    last = missions.go_on(survey, asked.log)
    progress.write_survey(survey, Path(asked.survey))
    ground = laid(survey.areas)
    print(*progress.told(survey, survey.segments(ground)), sep="\n")
    starts = [in_plane(ground.at, *place) for place in asked.at]
    more = [last if len(boats) == 1 else None] * len(boats)
    plans = missions.rest(survey, boats, [*starts, *more][: len(boats)])
    if not plans:
        print("the survey is done")
        return 0
    file, name = Path(asked.output or f"{survey.name}-rest.toml"), f"{survey.name} rest"
    actions = missions.LineAnnounced(survey.begin, survey.end)
    print(*missions.written(plans, boats, name, file, actions), *missions.drawn(plans, boats, name, asked.picture), sep="\n")
    return 0


def _report(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore import tree
    from delfim.logging.ashore.table import table
    from delfim.survey import linefigures
    from delfim.vehicle.plans.mission import load_mission

    at, lines = linefigures.lines_of(load_mission(asked.mission))
    files = [file for file in tree.files(asked.log) if file.suffix.startswith(".state")]
    columns, _ = table(files, tree.span(asked.from_, asked.to, 0))
    found = linefigures.figures(lines, linefigures.track_of(columns, at), asked.within)
    print(*linefigures.told(found), sep="\n")
    return 0


def _once(logs: list[str]) -> list[str]:
    """The logs, none of them twice, nor beside its folder, where no table is read: what counts twice looks surer than it is."""
    places = {Path(log).resolve(): log for log in logs}
    return [log for place, log in places.items() if place.suffix == ".csv" or not places.keys() & {*place.parents}]


def _chart(asked: argparse.Namespace) -> int:
    from delfim import config
    from delfim.logging.ashore import tree
    from delfim.survey.chart import making, report, takehome, tide

    provider = takehome.provider_of(asked.csb) if asked.csb else None
    if asked.tide and asked.rtk_datum is not None:
        raise DelfimError("the tide is from --tide or from --rtk-datum, not from both")
    if asked.set and not asked.vehicle:
        raise DelfimError("--set changes the file that --vehicle names")
    levels = tide.read_tide(asked.tide) if asked.tide else None
    say = _steps(11)
    say("soundings")
    known = config.load(asked.vehicle, asked.set).sounder if asked.vehicle else None
    span = tree.span(asked.from_, asked.to, 0)
    parts = [making.read_part(log, span, known, asked.sound, levels, asked.rtk_datum) for log in _once(asked.log)]
    names = dict.fromkeys(read.boat for read, _ in parts)
    if len(names) > 1 and (asked.bar or asked.patch_test):
        raise DelfimError(f"a bar check and a patch test are of one boat, and these are logs of {', '.join(names)}")
    first_ns = round(parts[0][0].at_s[0] * 1e9)
    bars = [
        making.Bar(metres(deep), *(tree.instant(text, first_ns, "--bar") / 1e9 for text in times)) for deep, *times in asked.bar
    ]
    made = making.made(
        " and ".join(names),
        parts,
        cell_m=asked.cell,
        spacing_m=asked.spacing,
        interval_m=asked.contours,
        find_latency=asked.patch_test,
        bars=bars,
        say=say,
    )
    folder = Path(asked.output)
    files = making.write(made, folder, provider, say)
    say("report")
    report.depths(made).savefig(folder / "depth.png", dpi=120)
    files.append(folder / "depth.png")
    page = report.page(made, files, _again(asked))
    (folder / "report.html").write_text(page, encoding="utf-8")
    say("")
    print(*making.told(made), sep="\n")
    print(f"{folder}: report.html, {', '.join(file.name for file in files)}")
    return 0


def _again(asked: argparse.Namespace) -> str:
    """The command that makes the same chart."""
    words = ["delfim", "survey", "chart", *asked.log]
    for key in ("vehicle", "tide", "rtk_datum", "sound", "cell", "spacing", "contours", "csb", "from_", "to"):
        value = getattr(asked, key)
        words += [f"--{key.strip('_').replace('_', '-')}", str(value)] if value is not None else []
    words += [word for each in asked.set for word in ("--set", each)] + [
        word for each in asked.bar for word in ("--bar", *each)
    ]
    return shlex.join([*words, *(["--patch-test"] if asked.patch_test else []), "-o", asked.output])


def _steps(count: int) -> Callable[[str], None]:
    """Say on a terminal what is done now, and how much of it is done."""
    if not sys.stderr.isatty():
        return lambda words: None
    done = iter(range(count))

    def say(words: str) -> None:
        told = f"{100 * next(done, count) // count:3} % {words}" if words else ""
        print(f"\r{told:40}", end="" if words else "\r", file=sys.stderr, flush=True)

    return say
