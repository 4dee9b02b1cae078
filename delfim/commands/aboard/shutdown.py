"""`delfim shutdown`: ends everything in order."""

import argparse

from delfim.commands import vehicle_file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--reboot", action="store_true", help="Restart the computer afterwards.")


def run(asked: argparse.Namespace) -> int:
    from delfim.services.suite import shut_down

    return shut_down(asked.file, asked.set, "reboot" if asked.reboot else "off")
