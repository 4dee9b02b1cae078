"""The verbs of `delfim log` by which logs are believed: `check`, `evidence`."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from delfim.commands import Formatter
from delfim.logging.ashore import tree

PATHS = f"Trees, days, folders or files (default: {' or '.join(tree.PLACES)})."


def verbs(parsers: Any) -> None:
    """Declare the verbs. `parsers`: what `add_subparsers` gave."""
    text = "Say what was changed in logs since they were written, by their chains; exit code 1: something was."
    check: argparse.ArgumentParser = parsers.add_parser("check", help=text, description=text, formatter_class=Formatter)
    check.set_defaults(verb=_check, many="path")
    check.add_argument("--json", action="store_true", help="Print a line of JSON for each file, for programs.")
    told = "A head that was noted earlier, or its first digits, must be in the chain; may be repeated."
    check.add_argument("--head", action="append", default=[], metavar="HEAD", help=told)
    check.add_argument("path", nargs="*", metavar="PATH", help=PATHS)
    text = "Write one folder or zip to hand over: logs as they are, who commanded when, hashes, the check (docs/logs.md)."
    proof: argparse.ArgumentParser = parsers.add_parser("evidence", help=text, description=text, formatter_class=Formatter)
    proof.set_defaults(verb=_evidence, many="path")
    told = "From this time on: UTC, as 2010-01-01T09:30:00, or 09:30 of the last day (default: twelve hours before the end)."
    proof.add_argument("--from", dest="from_", metavar="TIME", help=told)
    proof.add_argument("--to", metavar="TIME", help="Up to this time (default: the last record).")
    proof.add_argument("--output", metavar="PLACE", default="evidence.zip", help="A new folder, or a file that ends in .zip.")
    proof.add_argument("path", nargs="*", metavar="PATH", help=PATHS)


def _paths(asked: argparse.Namespace) -> list[str]:
    if asked.path:
        return list(asked.path)
    place = tree.default_place()
    print(f"delfim: the logs of {place}", file=sys.stderr)
    return [place]


def _check(asked: argparse.Namespace) -> int:
    from delfim.logging.ashore import chaincheck

    verdicts = chaincheck.check(_paths(asked), time.time_ns())
    if asked.json:
        print(*(json.dumps(each._replace(links=each.links[-1:])._asdict()) for each in verdicts), sep="\n")
    else:
        print(*chaincheck.text(verdicts), sep="\n")
    unknown = [head for head in asked.head if not chaincheck.knows(verdicts, head)]
    if unknown:
        print(f"delfim: no link here is {', '.join(unknown)}: the chain is not the one that was noted", file=sys.stderr)
    return int(bool(unknown) or any(each.found in chaincheck.BAD for each in verdicts))


def _evidence(asked: argparse.Namespace) -> int:
    from delfim.desk.evidence import evidence
    from delfim.logging.ashore import chaincheck

    paths, span = _paths(asked), None
    if asked.from_ or asked.to:
        span = tree.span(asked.from_, asked.to, max((file.end_ns for file in tree.files(paths)), default=0))
    verdicts = evidence(paths, span, Path(asked.output), time.time_ns())
    print(*chaincheck.text(verdicts), sep="\n")
    print(f"{asked.output}: {len(verdicts)} logs; begin with index.html")
    return int(any(each.found in chaincheck.BAD for each in verdicts))
