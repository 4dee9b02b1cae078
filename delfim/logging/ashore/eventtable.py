"""The events of sidecars as a table for people: time, who, what, and what came of it."""

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from delfim.logging.ashore.summary import utc

HEADS: Final = ("UTC", "WHO", "WHAT", "RESULT")
LEFT_OUT: Final = ("watchdog", "vessels", "sounding")  # signs of life, where others were, and depths
BY_HAND: Final = "manual"  # ten a second while a joystick is held
LONG: Final = 60  # of what was ordered; a mission's text is longer


def table(events: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """The lines of the table, oldest first. Orders of a joystick that follow each other are one line."""
    yield _line(*HEADS)
    for row in rows(events):
        yield _line(*row)


def rows(events: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, str, str, str]]:
    """Time, who, what and result of each event, as `table` has them."""
    before: tuple[str, str, str] | None = None
    for event in sorted(events, key=lambda each: each["t_ns"]):
        if event["event"] in LEFT_OUT:
            continue
        row = _row(event)
        name = event["value"]["command"] if event["event"] == "command" else ""
        same = (row[0], name, row[2]) if name == BY_HAND else None
        if same is None or same != before:
            yield utc(event["t_ns"]), *row
        before = same


def _line(time: str, who: str, what: str, result: str) -> str:
    return f"{time:24}  {who:14}  {what:40}  {result}".rstrip()


def _row(event: Mapping[str, Any]) -> tuple[str, str, str]:
    """The origin, subject and result of an event."""
    kind, value = event["event"], event.get("value")
    if kind == "command" and isinstance(value, dict):
        words = [f"{key} {_short(each)}" for key, each in value.items() if key != "command" and each not in (None, "")]
        what = f"{value['command']} {', '.join(words)}".strip()
        return event.get("operator") or "?", what[:LONG], f"refused: {event['refused']}" if event["refused"] else "done"
    if kind == "mode":
        return "boat", f"mode {value}", str(event.get("reason", ""))
    if kind == "note":
        return "boat", *_parted(str(value))
    if kind == "start":
        return str(event["id"]), "start", f"version {event['version']}" if "version" in event else ""
    known = ("t_ns", "monotonic_s", "event", "id")
    return str(event["id"]), kind, ", ".join(f"{key} {_short(each)}" for key, each in event.items() if key not in known)


def _parted(note: str) -> tuple[str, str]:
    """Split a note into the trouble and its words."""
    name, _, words = note.partition(": ")
    return name, words


def _short(value: object) -> str:
    text = value if isinstance(value, str) else f"{value:.6g}" if isinstance(value, float) else json.dumps(value)
    return text if len(text) <= LONG else f"{text[:20]!r}..."
