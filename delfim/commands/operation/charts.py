"""`delfim charts`: official charts become what a boat must keep out of, with reasons, and the field that she takes along."""

import argparse
from collections.abc import Callable
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.commands import OWN_FILE, overrides, picture, place, shipped


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--at", required=True, type=place(85.0), metavar="LAT,LON", help="The middle of the water: 10 km about it."
    )
    told = "The vehicle's file: [boat] draught_m and air_draught_m."
    parser.add_argument("--vehicle", default=OWN_FILE, metavar="FILE", type=shipped, help=told)
    overrides(parser)
    parser.add_argument("--draught", type=_up_to(20.0), metavar="M", help="Instead of that of the vehicle's file.")
    parser.add_argument(
        "--air-draught", type=_up_to(100.0), metavar="M", help="From the water to her top (default: the file's)."
    )
    parser.add_argument("--under-keel", type=_up_to(20.0), default=0.5, metavar="M", help="Kept under the keel.")
    told = "The least water above the chart's datum while she is out; -0.3 is below it."
    parser.add_argument("--tide", type=float, default=0.0, metavar="M", help=told)
    told = "Kept from dangers at most, where the chart's zone of confidence asks for more."
    parser.add_argument("--margin", type=_up_to(500.0), default=50.0, metavar="M", help=told)
    told = "Make a field with this band of depths open, too, as 0-1.8: for missions that open it."
    parser.add_argument("--open", action="append", default=[], metavar="BAND", help=told)
    told = "Write FILE.geojson and FILE.clearance (default: the first cell's name in this folder)."
    parser.add_argument("-o", "--output", metavar="FILE", help=told)
    parser.add_argument("--picture", type=picture, metavar="FILE", help="Draw it, too, as .png or .svg.")
    told = "Cells of S-57 (.000); their updates .001 ... lie beside them."
    parser.add_argument("cell", nargs="+", metavar="CELL", help=told)
    parser.set_defaults(many="cell")


def _up_to(most: float) -> Callable[[str], float]:
    def metres(text: str) -> float:
        try:
            if 0.0 <= float(text) <= most:
                return float(text)
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"{text} is not 0 to {most:g}")

    return metres


def run(asked: argparse.Namespace) -> int:
    from delfim import config
    from delfim.survey.enc import making
    from delfim.survey.enc.dangers import Need

    boat = config.load(asked.vehicle, asked.set).boat
    draught_m = boat.draught_m if asked.draught is None else asked.draught
    air_m = boat.air_draught_m if asked.air_draught is None else asked.air_draught
    if draught_m == 0.0:
        raise DelfimError("say the boat's --draught, or draught_m in [boat] of her file: nobody knows it")
    if not -20.0 <= asked.tide <= 20.0:
        raise DelfimError(f"--tide {asked.tide:g}: -20 to 20 m")
    need = Need(draught_m, asked.under_keel, air_m, asked.tide, asked.margin)
    output = asked.output or Path(asked.cell[0]).stem
    print(making.make(making.ChartJob(asked.cell, asked.at, need, asked.open, output, asked.picture or "")), end="")
    return 0
