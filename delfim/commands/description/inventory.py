"""`delfim inventory`: lists a boat's hosts, ports, lines, programs, versions and keys (docs/sea.md)."""

import argparse
import hashlib
import json

from delfim import config
from delfim.commands import OWN_FILE, example_file

TITLES = {
    "host": "Hosts that the file names:",
    "port": "Ports and doors:",
    "line": "Buses and lines:",
    "program": "Programs:",
    "version": "Versions on this computer:",
    "key": "Keys, certificates, passwords:",
}


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser, nargs="?", default=OWN_FILE)
    parser.add_argument("--json", action="store_true", help="For programs: JSON, with the digest of the vehicle's file.")


def run(asked: argparse.Namespace) -> int:
    from delfim.base import tables
    from delfim.base.input.untrusted import read_file
    from delfim.services.access.inventory import inventory

    settings = config.load(asked.file, asked.set)
    found = inventory(settings, tables.read_toml(asked.file, asked.set))
    digest = hashlib.sha256(read_file(asked.file)).hexdigest()
    if asked.json:
        items = [item._asdict() for item in found]
        print(json.dumps({"boat": settings.boat.name, "file": asked.file, "sha256": digest, "items": items}, indent=1))
        return 0
    print(f"{settings.boat.name}, {asked.file}, sha256 {digest}")
    for kind, title in TITLES.items():
        rows = [item for item in found if item.kind == kind]
        names, places = (max((len(item[at]) for item in rows), default=0) for at in (1, 2))
        lines = [f"  {item.name:{names}}  {item.place:{places}}  {item.what}" for item in rows]
        print(title, *(lines or ["  none"]), sep="\n")
    return 0
