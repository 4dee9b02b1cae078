"""`delfim actuate`: turns one thruster on the bench, while a key is held; through the boat's program where that runs."""

import argparse
import contextlib

from delfim.commands import seconds, vehicle_file

MOST = 0.3


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("name", metavar="NAME", help="The thruster, as the vehicle's file names it.")
    parser.add_argument("part", metavar="PART", type=part, help=f"Of full command, -{MOST} to {MOST}; below 0 is astern.")
    parser.add_argument("--for", type=seconds, dest="for_s", default=2.0, metavar="SECONDS", help="At most for so long.")


def part(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is no number") from None
    if not -MOST <= value <= MOST:
        raise argparse.ArgumentTypeError(f"{text} is not within -{MOST} and {MOST}: more is nothing for a bench")
    return value


def run(asked: argparse.Namespace) -> int:
    from delfim import config
    from delfim.services.bench import actuate, runs
    from delfim.vehicle.operator.link import Link

    settings = config.load(asked.file, asked.set)
    with contextlib.ExitStack() as held:
        boat = held.enter_context(Link(settings.console.socket)) if runs(settings) else None
        actuate(settings, asked.file, asked.set, asked.name, asked.part, asked.for_s, boat)
    return 0
