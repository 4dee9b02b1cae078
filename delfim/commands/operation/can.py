"""`delfim can`: the tools of delfim/console/terminal/bus.py."""

import argparse

from delfim.commands import shipped


def options(parser: argparse.ArgumentParser) -> None:
    from delfim.console.terminal.bus import options

    options(parser)


def run(asked: argparse.Namespace) -> int:
    if "dbc" in asked and asked.dbc:
        asked.dbc = shipped(asked.dbc)
    code: int = asked.run(asked)
    return code
