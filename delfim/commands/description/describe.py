"""`delfim describe`: explains the vehicle's file, key by key."""

import argparse

from delfim.commands import shipped


def options(parser: argparse.ArgumentParser) -> None:
    told = "A vehicle's file: the keys of the parts that it names, too (docs/own-parts.md)."
    parser.add_argument("file", metavar="FILE", nargs="?", type=shipped, help=told)


def run(asked: argparse.Namespace) -> int:
    from delfim import config
    from delfim.base import tables
    from delfim.console.terminal.describe import describe

    kind = config.kind_of(tables.read_toml(asked.file), asked.file) if asked.file else config.Vehicle
    print(describe(kind), end="")
    return 0
