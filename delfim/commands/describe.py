"""`delfim describe`: explains the vehicle's file, key by key."""

import argparse


def options(parser: argparse.ArgumentParser) -> None:
    pass


def run(_: argparse.Namespace) -> int:
    from delfim.console.describe import describe

    print(describe(), end="")
    return 0
