"""`delfim declare`: writes the declaration of a boat under MGN 702 or MGN 705 as a form to print (docs/compliance.md)."""

import argparse
from pathlib import Path

from delfim import __version__, config
from delfim.commands import example_file


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser)
    parser.add_argument("--output", metavar="FILE", help="Write this page (default: the boat's name, .html).")


def run(asked: argparse.Namespace) -> int:
    from delfim.desk.declaration import form, notice

    settings = config.load(asked.file, asked.set)
    place = Path(asked.output or f"{settings.boat.name}.html")
    place.write_text(form(settings, __version__), encoding="utf-8")
    which = notice(settings.boat.length_m) or "neither MGN 702 nor MGN 705"
    print(f"{place}: {which}, for {settings.boat.length_m} m; what the file does not know is blank")
    return 0
