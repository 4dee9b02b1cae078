"""`delfim outlet`: the process between the boat's program and motors that keep their last command, as the supervisor starts
it."""

import argparse

from delfim.commands import vehicle_file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--beat-fd", type=int, default=-1, help=argparse.SUPPRESS)


def run(asked: argparse.Namespace) -> int:
    from delfim.services.suite import outlet

    return outlet(asked.file, asked.set, beat_fd=asked.beat_fd)
