"""The pages of the reference that the code writes itself: commands, keys, messages, metrics."""

import argparse
import inspect
import math
import os
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import cantools
import msgspec

from delfim.__main__ import declared
from delfim.audit import auditor
from delfim.base import tables
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.commands import GROUPS
from delfim.console.boats.requests import HALTS
from delfim.console.gateway import page_messages
from delfim.console.terminal.describe import describe
from delfim.parts.mavlink import telemetry
from delfim.parts.mavlink.codec import params
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.received import commands, handlers
from delfim.services.page import api, metrics
from delfim.vehicle import console

ROOT: Final = Path(__file__).parents[1]
COLUMNS: Final = "92"  # of the help of a command


def generated() -> dict[str, str]:
    """The pages' texts by path."""
    return {
        "docs/vehicle-file.md": re.sub(r"\bdocs/([\w-]+\.md)", r"[\1](\1)", describe()),
        "docs/commands.md": command_page(),
        "docs/mavlink-tables.md": mavlink_page(),
        "docs/websocket.md": websocket_page(),
        "docs/can-messages.md": can_page(),
        "docs/metrics.md": metrics_page(),
        "docs/audit-rules.md": audit_page(),
    }


def command_page() -> str:
    """Every command with its help, verbs of a command included."""
    os.environ["COLUMNS"] = COLUMNS
    page = ["# Commands", "", "What `delfim COMMAND --help` prints."]
    for group, names in GROUPS.items():
        page += ["", f"## {group}"]
        for name, sentence in names.items():
            parser = declared(name)[1]
            page += ["", f"### `delfim {name}`", "", sentence, "", *_help(parser)]
            for verb, below in _verbs(parser).items():
                page += ["", f"#### `delfim {name} {verb}`", "", *_help(below)]
    return "\n".join(page) + "\n"


def _help(parser: argparse.ArgumentParser) -> list[str]:
    return ["```text", parser.format_help().rstrip(), "```"]


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of `delfim log ls` and the like."""
    subparsers = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {name: below for action in subparsers for name, below in action.choices.items()}


def mavlink_page() -> str:
    """Numbers, names and intervals of the console's link."""
    names = {number: name.removeprefix("MAVLINK_MSG_ID_") for name, number in _constants("MAVLINK_MSG_ID_")}
    names |= {number: kind.msgname for number, kind in dialect.mavlink_map.items()}
    told = [
        (row.id, f"`{names[row.id]}`", *(f"{s:g}" if s else "–" for s in row[1:4]), "yes" if row.fresh else "")
        for row in telemetry.ROWS
    ]
    heard = [(number, f"`{names[number]}`") for number in sorted(handlers.HANDLERS)]
    words = {number: name.removeprefix("MAV_CMD_") for name, number in _constants("MAV_CMD_")}
    obeyed = [(number, f"`{words[number]}`") for number in sorted(commands.COMMANDS)]
    page = [
        "# MAVLink: numbers and parameters",
        "",
        "What the code has in its tables. What the messages contain and do is told in [the console's link](mavlink.md).",
    ]
    page += ["", "## Modes", "", *_table(("number", "mode"), sorted((mode.value, mode.name.lower()) for mode in Mode))]
    page += ["", "## Sent by itself", "", "Seconds between two, by the profile of the link."]
    page += ["", *_table(("id", "message", *telemetry.PROFILES, "only when new"), told)]
    page += ["", "## Understood", "", *_table(("id", "message"), heard)]
    page += [
        "",
        "## Commands",
        "",
        "Beside those by which a console asks for messages, and for the command of the boat.",
        "",
        *_table(("number", "command"), obeyed),
    ]
    page += [
        "",
        "## Parameters",
        "",
        "Real numbers; ranges are those of the keys in [the vehicle's file](vehicle-file.md).",
        "",
    ]
    page += _table(("parameter", "key", "unit, or its numbers"), _parameters())
    return "\n".join(page) + "\n"


def _constants(prefix: str) -> Iterator[tuple[str, int]]:
    return ((name, value) for name, value in vars(dialect).items() if name.startswith(prefix) and isinstance(value, int))


def _parameters() -> Iterator[Sequence[object]]:
    yield f"`{params.PROFILE}`", "of the console that sets it", _numbered(telemetry.PROFILES)
    for each in params.PARAMS:
        yield f"`{each.name}`", f"`{each.key}`", _numbered(each.choices) or each.unit


def _numbered(words: Sequence[str]) -> str:
    return ", ".join(f"{number} {word}" for number, word in enumerate(words))


def websocket_page() -> str:
    """What a page may say to the gateway."""
    page = [
        "# The page's WebSocket: what the page says",
        "",
        "JSON on `/ws`, one object a message; `t` is its name. Anything else is refused with the reason. What the page hears",
        "is in [the console](console.md#the-pages-websocket).",
    ]
    kinds = [
        *get_args(page_messages.Message),
        page_messages.Plan,
        page_messages.Waypoint,
        page_messages.PathPoint,
        page_messages.Obstacle,
        page_messages.ShownZone,
        page_messages.Place,
    ]
    for kind in kinds:
        told = " ".join((kind.__doc__ or "").split())
        page += ["", f"## `{_tag(kind)}`", "", *([told, ""] if told else [])]
        notes, hints = _notes(kind), get_type_hints(kind, include_extras=True)
        fields = msgspec.structs.fields(kind)
        page += _table(
            ("field", "", "without it", ""),
            [(f"`{each.name}`", _kind(hints[each.name]), _default(each), notes.get(each.name, "")) for each in fields],
        )
    page += ["", "## The words of a command", "", "Those of the boat, and of its parts: `order`."]
    page += ["", *_table(("`command`", "must have", "may have", "the boat is then in", "key"), _orders())]
    return "\n".join(page) + "\n"


def _orders() -> Iterator[Sequence[object]]:
    """The orders of a console."""
    for word, kind in console.KINDS.items():
        if issubclass(kind, console.OperatorOrder) or kind.TITLE:
            fields = msgspec.structs.fields(kind)
            needs, takes = (", ".join(each.name for each in fields if each.required is so) for so in (True, False))
            takes = "" if word in HALTS else takes
            yield f"`{word}`", needs, takes, kind.ENTERS, kind.KEY


def _tag(kind: Any) -> str:
    return str(kind.__struct_config__.tag or kind.__name__)


def _notes(kind: type) -> dict[str, str]:
    """The comments beside the fields of a class and of those that it extends."""
    found: dict[str, str] = {}
    for each in reversed([each for each in kind.__mro__ if each.__module__ == kind.__module__]):
        found |= dict(re.findall(r"^    (\w+): .*?  # (.+)$", inspect.getsource(each), re.MULTILINE))
    return found


def _kind(hint: Any) -> str:
    """What a field may be, in words."""
    if hint in (str, bool, NoneType):
        return {str: "text", bool: "true or false", NoneType: "null"}[hint]
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return f"`{_tag(hint)}`"
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(dict.fromkeys(map(_kind, get_args(hint))))
    if get_origin(hint) is Literal:
        return " ".join(map(str, get_args(hint)))
    inner = get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
    if get_origin(inner) in (list, tuple):
        bound = next((f"up to {each.max_length} " for each in getattr(hint, "__metadata__", ()) if each.max_length), "")
        return f"{bound}of " + _kind(get_args(inner)[0]) if get_origin(inner) is list else "[latitude, longitude]"
    if inner is str:
        return "text"
    return tables.allowed(hint)


def _default(field: Any) -> str:
    if field.default is not msgspec.NODEFAULT:
        return f"`{msgspec.json.encode(field.default).decode()}`"
    return "must be given" if field.default_factory is msgspec.NODEFAULT else "`[]`"


def can_page() -> str:
    """The frames of `etc/delfimx.dbc`, and the longer messages as the code packs them."""
    database: Any = cantools.database.load_file(ROOT / "etc/delfimx.dbc")
    page = [
        "# CAN messages",
        "",
        "The messages of the boat's own nodes, little endian. A number that a node does not know is the largest of its field.",
        "Frames of up to 8 bytes are those of `etc/delfimx.dbc`, which [`delfim can dump --dbc`](can-tools.md) reads; what is",
        "longer travels as [DSOR messages](dsor.md).",
        "",
        "## Frames",
    ]
    for frame in sorted(database.messages, key=lambda each: (each.is_extended_frame, each.frame_id)):
        identifier = f"{frame.frame_id:08X}" if frame.is_extended_frame else f"{frame.frame_id:03X}"
        told = f"Identifier `{identifier}`, {frame.length} bytes, from {' and '.join(frame.senders)}. {frame.comment or ''}"
        page += ["", f"### {frame.name}", "", told.strip(), ""]
        page += _table(("signal", "bits", "of", "a count is", "range, or its words", ""), map(_signal, frame.signals))
    page += ["", "## Messages", "", "Longer than a frame: identifier, node, and the bytes behind the header."]
    page += _packed(
        messages.NAVIGATION_ID, messages.Node.NAVIGATION, messages.NAVIGATION, messages.Navigation, messages.pack_navigation
    )
    page += _packed(
        messages.GPS_SYSSTAT_ID, messages.Node.GPS, messages.GPS_STATUS, messages.GpsStatus, messages.pack_gps_status
    )
    return "\n".join(page) + "\n"


def _signal(signal: Any) -> Sequence[object]:
    first, length, unit = signal.start, signal.length, signal.unit or ""
    words = ", ".join(f"{number} {word}" for number, word in (signal.choices or {}).items())
    counts = signal.minimum is not None and signal.maximum - signal.minimum >= len(signal.choices or {})
    bounds = "; ".join(filter(None, [f"{signal.minimum:g} to {signal.maximum:g} {unit}".strip() if counts else "", words]))
    bits = f"{first} to {first + length - 1}" if length > 1 else first
    kind = f"{'i' if signal.is_signed else 'u'}{length}"
    return f"`{signal.name}`", bits, kind, f"{signal.scale:g} {unit}".strip(), bounds, signal.comment or ""


def _packed(number: int, node: messages.Node, layout: struct.Struct, kind: Any, pack: Callable[[Any], bytes]) -> list[str]:
    """A message's fields. What a count is, and the word for unknown, are found by packing: the code has no table of them."""
    codes = layout.format.removeprefix("<")
    names = kind._fields[: len(codes.replace("x", ""))]
    hints, notes = get_type_hints(kind), _notes(kind)
    ones = dict(zip(names, layout.unpack(pack(kind(**dict.fromkeys(names, 1)))), strict=True))
    silent = {name: None if NoneType in get_args(hints[name]) else 1 for name in names}
    unknown = dict(zip(names, layout.unpack(pack(kind(**silent))), strict=True))
    rows, ahead = [], iter(names)
    for place, code in enumerate(codes):
        if code == "x":
            continue
        name, size = next(ahead), 8 * struct.calcsize(code)
        unit = name.rpartition("_")[2] if "_" in name else ""
        mark = f"{unknown[name]:#x}" if silent[name] is None else ""
        at = struct.calcsize(f"<{codes[:place]}")
        rows.append(
            (f"`{name}`", at, f"{'u' if code.isupper() else 'i'}{size}", _count(ones[name], unit), mark, notes.get(name, ""))
        )
    about = f"Message {number} of node {int(node)}, {layout.size} bytes. " + " ".join((kind.__doc__ or "").split())
    heads = ("field", "at byte", "of", "a count is", "unknown", "")
    return ["", f"### {kind.__name__}", "", about, "", *_table(heads, rows)]


def _count(one: int, unit: str) -> str:
    """What one count is, if `one` of them are one unit."""
    if unit == "rad" and one > 1e8:
        return f"{math.degrees(1 / one):.4g} degrees"
    return f"{1 / one:.4g} {unit}".strip()


def metrics_page() -> str:
    """What `/metrics` tells of a boat that has everything."""
    text = metrics.metrics(example(api.Report))
    rows = []
    for name, told in re.findall(r"^# HELP (\w+) (.+)$", text, re.MULTILINE):
        kind = re.findall(rf"^# TYPE {name} (\w+)$", text, re.MULTILINE)[0]
        samples = re.findall(rf"^{name}(?:_bucket)?\{{(.*?)\}} ", text, re.MULTILINE)
        labels = ", ".join(re.findall(r"(\w+)=", samples[0])) if samples else ""
        rows.append((f"`{name}`", kind, labels, told))
    about = "What the boat's page tells Prometheus at `/metrics`: base units, the unit in the name. What is unknown is missing."
    return "\n".join(["# Metrics", "", about, "", *_table(("name", "kind", "labels", ""), rows)]) + "\n"


def audit_page() -> str:
    """The rules of the second auditor."""
    rows = [(f"`{each.name}`", each.sentence, f"[{each.source}]({each.source})") for each in auditor.RULES]
    about = "What `delfim log audit` judges a log by, and the document that promises it ([how](logs.md#a-second-opinion))."
    return "\n".join(["# Rules of the second auditor", "", about, "", *_table(("rule", "what must hold", "by"), rows)]) + "\n"


def example(hint: Any) -> Any:
    """A value of this kind in which nothing is missing: a struct with all fields, a dict and a tuple with one entry."""
    hint = get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
    origin, inner = get_origin(hint), [each for each in get_args(hint) if each is not NoneType]
    if origin in (Union, UnionType):
        return example(inner[0])
    if origin is dict:
        return {example(inner[0]): example(inner[1])}
    if origin is tuple:
        return (example(inner[0]),) if Ellipsis in inner else tuple(map(example, inner))
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        hints = get_type_hints(hint, include_extras=True)
        return hint(**{name: example(hints[name]) for name in hint.__struct_fields__})
    return {str: "name", int: 1, float: 1.0, bool: True}.get(hint)


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return lines + ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows]
