"""`delfim parts`: a laboratory's own parts: lists those that are installed, writes a package to begin with, tries one."""

import argparse
import keyword
import re
import shutil
import sys
from pathlib import Path
from shlex import quote
from typing import Final

from delfim.base.errors import DelfimError
from delfim.commands import OWN_FILE, PACKAGE, shipped

EXAMPLES: Final = PACKAGE / "etc/parts"
KINDS: Final = ("mode", "motor", "order", "sensor", "service", "source", "trouble")

USED: Final = {  # where the vehicle's file uses a part of a kind; the others need their row in [parts] alone
    "motor": 'driver = "{}" in [[thrusters]]',
    "sensor": 'names = ["{}"] in [sensors]',
    "source": 'sources = ["{}"] in [navigation]',
}


def options(parser: argparse.ArgumentParser) -> None:
    tasks = parser.add_subparsers(dest="task", required=True, metavar="list|new|check")
    tasks.add_parser("list", help="List the parts that are installed.")
    new = tasks.add_parser("new", help="Write a package with a part that works, to be changed, with its test.")
    new.add_argument("kind", choices=KINDS, help=f"what it is: {', '.join(KINDS)}")
    new.add_argument("name", help="its name, as the vehicle's file shall have it: small letters, digits and _")
    new.add_argument("--output", default=".", metavar="DIRECTORY", help="where its folder is made")
    check = tasks.add_parser("check", help="Try a part: silence, garbage, a line that takes nothing, stop, a voyage.")
    check.add_argument("name", help="of the part")
    check.add_argument("file", nargs="?", default=OWN_FILE, help="the vehicle's file of a boat that has it")


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns 1 where a part is not as it must be."""
    return {"list": _list, "new": _new, "check": _check}[asked.task](asked)


def _list(_: argparse.Namespace) -> int:
    from delfim.base.parts import installed, version_of

    found = installed()
    for name, entries in sorted(found.items()):
        for entry in entries:
            package = entry.dist.name if entry.dist is not None else "?"
            print(f"{name:20} {version_of(entry):10} of the package {package} ({entry.value})")
    if not found:
        print('no package with a part is installed; "delfim parts new motor acme" writes one to begin with')
    return 0


def _new(asked: argparse.Namespace) -> int:
    from delfim.config import is_taken

    if not re.fullmatch("[a-z][a-z0-9_]{0,31}", asked.name):
        raise DelfimError(f"{asked.name!r} is no name for a part: a small letter, then up to 31 small letters, digits or _")
    if is_taken(asked.name) or asked.name == "delfim":
        raise DelfimError(f"{asked.name} is a name of the boat's own; the part needs another one")
    if keyword.iskeyword(asked.name) or asked.name in sys.stdlib_module_names:
        raise DelfimError(
            f"{asked.name} is a name of Python's own, which would be imported instead; the part needs another one"
        )
    example, place = f"example_{asked.kind}", Path(asked.output) / f"delfim-{asked.name}"  # no name that Python would import
    if place.exists():
        raise DelfimError(f"{place} is there already")
    shutil.copytree(EXAMPLES / asked.kind, place, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "build"))
    for path in [*place.rglob("*")]:
        if path.is_file():
            text = path.read_text().replace(f"delfim-{example.replace('_', '-')}", f"delfim-{asked.name}")
            path.write_text(text.replace(example, asked.name))
    for path in sorted(place.rglob("*"), reverse=True):
        if example in path.name:
            path.rename(path.with_name(path.name.replace(example, asked.name)))
    print(f"{place} has a part of the kind {asked.kind} that works. Now:")
    print(f"  pip install -e {quote(str(place))}")
    print(f"  delfim parts check {asked.name}")
    used = f", and use it: {USED[asked.kind].format(asked.name)}" if asked.kind in USED else ""
    print(f'Then name it in the vehicle\'s file, [parts] {asked.name} = "1.0"{used}.')
    print(f"Make {place}/{asked.name} your {asked.kind}.")
    return 0


def _check(asked: argparse.Namespace) -> int:
    from delfim.simulator.contract import tried, version_of

    wrong = 0
    for each in tried(asked.name, version_of(asked.name), shipped(asked.file)):
        took = f"  {1e3 * each.worst_s:.2f} ms at most" if each.worst_s else ""
        print(f"{'WRONG' if each.fault else 'good':6} {each.what}{': ' + each.fault if each.fault else took}", flush=True)
        wrong += bool(each.fault)
    print(f"{asked.name}: {f'{wrong} things are wrong' if wrong else 'nothing is wrong with this part'}")
    return 1 if wrong else 0
