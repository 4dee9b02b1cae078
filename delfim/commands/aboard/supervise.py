"""`delfim supervise`: runs the boat; its first command."""

import argparse

from delfim.commands import vehicle_file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--init", action="store_true", help="Be the machine's first process, which ends with the machine.")


def run(asked: argparse.Namespace) -> int:
    from delfim.services.suite import rescue, supervise

    if not asked.init:
        return supervise(asked.file, asked.set)
    try:
        return supervise(asked.file, asked.set, init=True)
    except Exception as error:
        rescue(error)
        raise
