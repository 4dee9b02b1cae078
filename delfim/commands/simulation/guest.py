"""`delfim guest`: a guest computer that steers a zigzag."""

import argparse

from delfim.commands import example_file


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser)
    parser.add_argument("--course", type=float, default=90.0, metavar="DEGREES", help="Zigzag about this course.")


def run(asked: argparse.Namespace) -> int:
    import asyncio

    from delfim.base.input.keys import read_key
    from delfim.base.ranges import address
    from delfim.config import load
    from delfim.services.tables import GuestTable
    from delfim.simulator.guest import Zigzag, guest

    table = load(asked.file, asked.set).of(GuestTable)
    key = read_key(table.key) if table.key else None
    zigzag = Zigzag(course_deg=asked.course, amplitude_deg=30.0, leg_s=20.0, speed_mps=1.2)
    asyncio.run(guest(*address(table.listen), zigzag, key=key))
    return 0
