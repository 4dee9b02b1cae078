"""`delfim run`: the boat's program, as the supervisor starts it."""

import argparse

from delfim.commands import vehicle_file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--service", metavar="NAME", help="Run only this service.")
    parser.add_argument("--beat-fd", type=int, default=-1, help=argparse.SUPPRESS)


def run(asked: argparse.Namespace) -> int:
    from delfim.services.suite import run

    return run(asked.file, asked.set, service=asked.service, beat_fd=asked.beat_fd)
