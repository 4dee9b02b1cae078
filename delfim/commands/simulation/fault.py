"""`delfim fault`: injects a fault into a simulated boat."""

import argparse

from delfim.commands import example_file, seconds, simulated, there


def options(parser: argparse.ArgumentParser) -> None:
    from delfim.simulator.faults import KINDS, WHERE

    example_file(parser)
    parser.add_argument("kind", metavar="KIND", help=f'One of {", ".join(KINDS)}; or "end", which ends all faults.')
    places = ", ".join(dict.fromkeys(place for its in WHERE.values() for place in its))
    which = f"Which part, if there are several: {places}; or a thruster by its name."
    parser.add_argument("where", metavar="WHERE", nargs="?", default="", help=which)
    parser.add_argument("--value", type=float, help="Size of the fault, for a kind that has one.")
    parser.add_argument("--for", type=seconds, dest="for_s", metavar="SECONDS", help="End the fault after this time.")
    simulated(parser)


def run(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.simulator.realtime.fault_socket import tell

    print(f"delfim: {tell(load(asked.file, there(asked)), asked.kind, asked.where, asked.value, asked.for_s)}")
    return 0
