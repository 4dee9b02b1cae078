"""`delfim survey`: an area drawn on a map becomes the lines of a survey, as a mission."""

import argparse
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.commands import OWN_FILE, overrides, shipped

MOST_M = 1000.0  # of a spacing, a swath, a run-in


def options(parser: argparse.ArgumentParser) -> None:
    tasks = parser.add_subparsers(dest="task", required=True, metavar="lines")
    lines = tasks.add_parser("lines", help="Make the mission that sails an area line by line.")
    lines.add_argument(
        "area", metavar="AREA", type=shipped, help="GeoJSON, KML, GPX, a shapefile or a .plan of QGroundControl."
    )
    lines.add_argument(
        "--vehicle", default=OWN_FILE, metavar="FILE", type=shipped, help="The vehicle's file: speed, turns, fence."
    )
    overrides(lines)
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
    lines.add_argument(
        "--run-in", type=metres, metavar="M", help="Straight before and behind each line (default: 12, or more)."
    )
    lines.add_argument(
        "--room", type=metres, metavar="M", help="Kept from holes and fences (default: what missions keep, and 6)."
    )
    lines.add_argument("--turn-radius", type=metres, metavar="M", help="The boat's smallest (default: by its thrusters).")
    lines.add_argument("--speed", type=metres, metavar="M/S", help="On the lines (default: that of the vehicle's file).")
    lines.add_argument("--output", metavar="FILE", help="Write the mission here (default: AREA.toml in this folder).")
    lines.add_argument("--picture", metavar="FILE", help="Draw it, too, as .png or .svg.")


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
    if asked.spacing is None and asked.swath is None:
        raise DelfimError("say --spacing, or --swath with its --overlap")
    from delfim import config
    from delfim.survey import planning
    from delfim.survey.areafile import read_area
    from delfim.survey.ground import laid
    from delfim.vehicle.plans.estimate import in_hours
    from delfim.vehicle.plans.mission import save_mission

    settings = config.load(asked.vehicle, asked.set)
    wanted = planning.wanted_of(
        settings,
        spacing_m=asked.spacing or asked.swath * (1.0 - asked.overlap / 100.0),
        swath_m=asked.swath or 0.0,
        heading_deg=asked.heading,
        edges=not asked.inside,
        cross_m=asked.cross or 0.0,
        start=asked.start or "",
        run_in_m=asked.run_in,
        room_m=asked.room,
        radius_m=asked.turn_radius,
        speed_mps=asked.speed,
    )
    name = Path(asked.area).stem
    plan = planning.planned(laid(read_area(asked.area)), wanted, settings.fence)
    mission = planning.mission(plan, name)
    planning.check(mission, plan, settings)
    file = Path(asked.output or f"{name}.toml")
    save_mission(mission, file)
    free, area = plan.covered()
    across = f", {plan.across} of them across" if plan.across else ""
    print(f"{file}: {len(plan.lines)} lines {wanted.spacing_m:g} m apart at {plan.heading_deg:.0f}°{across}")
    print(f"  {plan.line_m:,.0f} m of lines, {plan.way_m:,.0f} m in all, {in_hours(plan.time_s)} at {wanted.speed_mps:g} m/s")
    kept = (
        f", which is {100.0 * area:.1f} % of the area: {wanted.room_m:g} m about holes and fences are left"
        if area < free
        else ""
    )
    print(f"  covered: {100.0 * free:.1f} % of what may be sailed{kept}")
    if asked.picture:
        from delfim.survey.picture import draw

        draw(plan, f"{name}: {len(plan.lines)} lines, {in_hours(plan.time_s)}", Path(asked.picture))
        print(asked.picture)
    return 0
