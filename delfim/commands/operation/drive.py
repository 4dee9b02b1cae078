"""`delfim drive`: commands a boat from a terminal."""

import argparse

from delfim.commands import example_file, simulated, there


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser)
    parser.add_argument("words", nargs="*", metavar="WORD", help="state | stop | heading DEG [M/S] | goto LAT LON | play | ...")
    parser.set_defaults(many="words")
    simulated(parser)


def run(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.console.terminal.drive import run

    run(load(asked.file, there(asked)).console.socket, asked.words)
    return 0
