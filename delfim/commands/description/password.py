"""`delfim password`: prints the hash of a password."""

import argparse


def options(parser: argparse.ArgumentParser) -> None:
    pass


def run(_: argparse.Namespace) -> int:
    import getpass

    from delfim.services.access.connection_limits import hashed

    print(hashed(getpass.getpass("password: ")))
    return 0
