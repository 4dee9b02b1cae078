"""`delfim describe`: every table and key of a vehicle's file with default, range and meaning, as Markdown.

The meaning is the comment beside the key in `delfim/config.py`, so that there is one list and it cannot go stale.
"""

import ast
import inspect
import re
import sys
from functools import cache
from typing import Any, get_args, get_origin

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.modes import Mode
from delfim.simulator.tables import SimulatedVessel, Vessels

LISTS = "thrusters", "simulation.traffic.vessel"  # tables of which there are several


def describe(kind: type[config.Vehicle] = config.Vehicle) -> str:
    """The page `docs/vehicle-file.md`; or that of a file that names parts of a laboratory, with their keys."""
    page = [
        "# The vehicle's file",
        "",
        "One TOML file describes a boat. Keys that are not here are refused, and so are values outside their range: the",
        "message names file, key, reason and what is allowed. `delfim check FILE` tells all of it at once without",
        "starting anything, and warns of what the file names and this computer does not have. A command takes",
        "`--set KEY=VALUE` instead of the file's value; text needs no quotes there. This page is written by",
        "`delfim describe`.",
    ]
    for name, table in _tables("", kind):
        if get_origin(table) is dict:
            names, values = map(tables.allowed, get_args(table))
            about = _comments(config.Vehicle)[name]
            page += ["", f"## `[{name}]`", "", f"{about[0].upper()}{about[1:]}: NAME = {values}; NAME is {names}."]
            continue
        heading = f"[[{name}]]" if name in LISTS else f"[{name}]"
        page += ["", f"## `{heading}`", *_described(table)]
    for row in (row for part in kind.aboard for row in part.orders):
        by = f"`delfim drive FILE order {row.name} KEY=VALUE ...`" + (f"; by MAVLink {row.number}" if row.number else "")
        page += ["", f"## The order `{row.name}`", "", f"{by}.", *_described(row.table)]
    return "\n".join(page) + "\n"


def meaning(key: str) -> str:
    """Of a key of the vehicle's file, in words; empty: this version does not know it."""
    *names, last = key.split(".")
    table: Any = config.Vehicle
    for name in names:
        table = tables.keys(table).get(name)
        if not _is_table(table):
            return ""
    return _comments(table).get(last, "").replace("\\|", "|")


def _described(table: Any) -> list[str]:
    """A table's sentence, and its keys."""
    lines = ["", _sentence(table), "", "| key | default | allowed | meaning |", "|---|---|---|---|"]
    comments, hints = _comments(table), tables.keys(table)
    for field in msgspec.structs.fields(table):
        if not _is_table(hints[field.name]):
            allowed = tables.allowed(hints[field.name]).replace("|", "\\|")
            lines.append(f"| `{field.name}` | {_default(field)} | {allowed} | {comments.get(field.name, '')} |")
    return lines


def _tables(prefix: str, kind: Any) -> list[tuple[str, Any]]:
    """(dotted name, class) of every table below a class, depth first."""
    found = []
    for name, hint in tables.keys(kind).items():
        if get_origin(hint) is dict and _is_table(hint):
            found.append((f"{prefix}{name}.NAME", get_args(hint)[1]))
        elif get_origin(hint) is dict:
            found.append((f"{prefix}{name}", hint))
        elif hint is Vessels:
            found.append((f"{prefix}{name}", SimulatedVessel))
        elif prefix + name in LISTS:
            found += [(name, get_args(get_args(hint)[0])[0]), (f"{name}.steer", config.Steer)]
        elif _is_table(hint):
            if any(not _is_table(inner) for inner in tables.keys(hint).values()):
                found.append((prefix + name, hint))
            found += _tables(f"{prefix}{name}.", hint)
    return found


def _is_table(hint: Any) -> bool:
    kind = get_args(hint)[1] if get_origin(hint) is dict else hint
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _sentence(table: type) -> str:
    """The class's docstring on one line; empty if neither it nor the one that a part's keys were added to has one."""
    named = [each for each in table.__mro__ if each.__name__ == table.__name__]
    text = next((text for each in named if (text := each.__dict__.get("__doc__"))), "")
    return " ".join(text.split())


def _comments(table: type) -> dict[str, str]:
    """The comments of the class and of those that it extends; the nearest one counts. Keys of modes have no comments."""
    found = {mode.name.lower(): f'in {mode.name.lower()} mode; "same": as `action`' for mode in Mode}
    for each in reversed([kind for kind in table.__mro__ if issubclass(kind, tables.Table)]):
        lines = _classes(each.__module__).get(each.__name__, "")  # none where it is made by a function
        found.update(re.findall(r"^    (\w+): .*?  # (.+)$", lines, re.MULTILINE))
    return {name: comment.replace("|", "\\|") for name, comment in found.items()}


@cache
def _classes(module: str) -> dict[str, str]:
    """The lines of each class of a module. Asked for a class, `inspect` reads the whole module again."""
    text = inspect.getsource(sys.modules[module])
    lines = text.splitlines()
    classes = (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
    return {node.name: "\n".join(lines[node.lineno - 1 : node.end_lineno]) for node in classes}


def _default(field: Any) -> str:
    value = field.default
    if value is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT:
        value = field.default_factory()
    if value is msgspec.NODEFAULT:
        return "must be given"
    if isinstance(value, tuple):
        value = list(value)
    return f"`{msgspec.json.encode(value).decode()}`"
