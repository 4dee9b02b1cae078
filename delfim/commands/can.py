"""`delfim can`: the tools of delfim/console/bus.py."""

import argparse


def options(parser: argparse.ArgumentParser) -> None:
    from delfim.console.bus import options

    options(parser)


def run(asked: argparse.Namespace) -> int:
    code: int = asked.run(asked)
    return code
