"""Writes what was found into a vehicle's file: comments and order stay, the old value stands beside the new one.

The text is changed line by line, then read again: it must say what the old one said but for these keys, or nothing is written.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml
from delfim.base.tables import inline

ROWS: Final = "thrusters"  # of which there are several: found by their names
FOUND: Final = "# found "  # how the comment of a value that was found begins
_HEAD: Final = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_.-]+)\s*\]\]?\s*(#.*)?")
_LINE: Final = re.compile(r"\s*([A-Za-z0-9_-]+)\s*=\s*(.*?)\s*")


Key = tuple[str, ...]  # of the file: ("boat", "inertia_kgm2"), ("thrusters", NAME, "dead")


class FoundKey(NamedTuple):
    """A value for the vehicle's file."""

    key: Key
    value: Any
    spread: float | None  # standard deviation of it, or of the last of two; None: it is no measurement
    told: Any  # the file's own value; None: it has none

    @property
    def name(self) -> str:
        return ".".join(self.key)


def with_keys(text: str, keys: Sequence[FoundKey], words: str, file: str) -> str:
    """The text with these keys. `words` stand behind each new value: when, and of what. Raises DelfimError where the text has
    no place for a key."""
    told = {each.key: (each.value, words if each.spread is None else f"{words}: ±{each.spread:.2g}") for each in keys}
    return changed(text, told, file)


def changed(text: str, told: Mapping[Key, tuple[Any, str]], file: str) -> str:
    """The text with these keys: value, and the words behind it."""
    wanted = parse_toml(text)
    for key, (value, _) in told.items():
        _put(wanted, key, value)
    lines, places = text.splitlines(), _places(text)
    later = dict[Key, list[str]]()  # new lines, by their table
    for key, (value, words) in told.items():
        line = f"{key[-1]} = {inline(value)}  # {words}"
        if key in places:
            lines[places[key]] = f"{line}; was {_was(lines[places[key]])}"
        else:
            later.setdefault(key[:-1], []).append(line)
    for table, new in sorted(later.items(), key=lambda item: -places.get(item[0], len(lines))):
        if table in places:
            lines[places[table] + 1 : places[table] + 1] = new
        elif table[0] != ROWS:
            lines += ["", f"[{'.'.join(table)}]", *new]
    result = "\n".join(lines) + "\n"
    if _plain(parse_toml(result)) != _plain(wanted):
        where = ", ".join(sorted({".".join(key) for key in told}))
        raise DelfimError(f"{file}: write each of {where} on a line of its own, below the head of its table")
    return result


def put_back(text: str, keys: Sequence[Key], file: str) -> str:
    """The text with the old values of these keys, which `changed` left in their comments; one that it added is taken out. A key
    that somebody has changed since stays."""
    places, lines = _places(text), text.splitlines()
    out = set[int]()
    for key in keys:
        if key not in places or FOUND not in lines[places[key]]:
            continue
        now, _, was = lines[places[key]].partition("; was ")
        if was:
            lines[places[key]] = f"{now.partition('=')[0].rstrip()} = {was}"
        else:
            out.add(places[key])
    result = "\n".join(line for number, line in enumerate(lines) if number not in out) + "\n"
    parse_toml(result)
    return result


def _put(tree: dict[str, Any], key: Key, value: Any) -> None:
    if key[0] == ROWS:
        row = next((row for row in tree.get(ROWS, ()) if row.get("name") == key[1]), None)
        if row is None:
            raise DelfimError(
                f"the file has no [[{ROWS}]] of the name {key[1]}: write its rows first, for they are written into"
            )
        row[key[2]] = value
        return
    for word in key[:-1]:
        tree = tree.setdefault(word, {})
    tree[key[-1]] = value


def _places(text: str) -> dict[Key, int]:
    """The lines of keys and, by the same names, of the last line of each table that is not empty or a comment."""
    found, table, head = dict[Key, int](), tuple[str, ...](), -1
    names = iter([row.get("name", "") for row in parse_toml(text).get(ROWS, ())])
    for number, line in enumerate(text.splitlines()):
        if match := _HEAD.fullmatch(line):
            path = tuple(match[2].split("."))
            if match[1] == "[[" and path == (ROWS,):
                path = (ROWS, next(names, ""))
            elif path[0] == ROWS:
                path = ("", *path)  # a table within a row: none of ours
            table, head = path, number
            found[table] = number
        elif match := _LINE.fullmatch(line):
            found[(*table, match[1])] = number
        if head >= 0 and line.strip() and not line.lstrip().startswith("#"):
            found[table] = number
    return found


def _was(line: str) -> str:
    """A key's old value with its comment, without what an earlier fit left behind it."""
    match = _LINE.fullmatch(line)
    return match[2].partition("; was ")[0] if match else line.strip()


def _plain(value: Any) -> Any:
    """A tree with lists in place of tuples, as TOML reads them."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
