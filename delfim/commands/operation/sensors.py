"""`delfim sensors`: shows the values of the boat's sensors, and makes the first connection of one (docs/sensors.md)."""

import argparse
import sys

from delfim.base.errors import DelfimError
from delfim.commands import example_file, seconds, simulated, there


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser, nargs="?")
    parser.add_argument("--once", action="store_true", help="Print the table once; so it is, too, where no terminal shows it.")
    parser.add_argument(
        "--for",
        type=seconds,
        dest="for_s",
        metavar="SECONDS",
        help="Listen for so long (default: 5; for a turn, 60).",
    )
    parser.add_argument(
        "--find", metavar="DEVICE", help="Find the baud rate and the talkers of a serial port that nothing else uses."
    )
    parser.add_argument(
        "--turn", action="store_true", help="Have the boat turned to starboard, and judge what the sensors say."
    )
    simulated(parser)


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns 1 where a turn was reported with the wrong sign, or not at all."""
    from delfim.base.clock import SystemClock

    clock = SystemClock()
    if asked.find:
        from delfim.desk.firstcontact import find

        for line in find(asked.find, clock):
            print(line, flush=True)
        return 0
    if asked.file is None:
        raise DelfimError("name the vehicle's file, or a port with --find")
    from delfim.config import load
    from delfim.desk.firstcontact import judged, turned
    from delfim.desk.listen import listener
    from delfim.desk.sensor_table import table

    settings = load(asked.file, there(asked))
    hearing = listener(settings, clock)
    try:
        if asked.turn:
            print("Turn the boat to starboard, by a quarter of a turn or more, in about ten seconds.", flush=True)
            is_right, words = judged(turned(hearing, asked.for_s or 60.0))
            print(*words, sep="\n")
            return 0 if is_right else 1
        before = hearing.reports(0.5)
        if asked.once or not sys.stdout.isatty():
            print(*table(settings, hearing.where, before, hearing.reports(asked.for_s or 5.0)), sep="\n")
            return 0
        while True:
            now = hearing.reports(asked.for_s or 2.0)
            print("\x1b[H\x1b[J", *(f"{line}\n" for line in table(settings, hearing.where, before, now)), "Ctrl-C ends", sep="")
            before = now
    finally:
        hearing.close()
