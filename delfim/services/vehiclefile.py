"""Writes a vehicle's file with other values, as text: comments and order stay."""

import json
import re
from collections.abc import Mapping
from typing import Any

from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml, read_text


def changed(file: str, changes: Mapping[str, Any]) -> str:
    """The text of the file with these values: "table.key" -> text, number, true or false, or a list of those. A key that the
    file lacks is put at the end of its table, a table at the end of the file. Raises DelfimError where a value is not
    on one line."""
    text = read_text(file)
    wanted = parse_toml(text)
    for name, value in changes.items():
        *path, key = name.split(".")
        table = wanted
        for word in path:
            table = table.setdefault(word, {})
        table[key] = value
    lines, left = _replaced(text, changes)
    for name, value in left.items():
        table_name, _, key = name.rpartition(".")
        head = f"[{table_name}]"
        if head not in lines:
            lines += ["", head]
        lines.insert(_end(lines, lines.index(head)), f"{key} = {json.dumps(value)}")
    result = "\n".join(lines) + "\n"
    if parse_toml(result) != wanted:
        raise DelfimError(f"{file}: write each of {', '.join(changes)} on a line of its own, below the head of its table")
    return result


def _replaced(text: str, changes: Mapping[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Replace those keys that the lines have; returns the lines, and the changes that are left."""
    lines, left, table = list[str](), dict(changes), ""
    for line in text.splitlines():
        if head := re.fullmatch(r"\[([A-Za-z0-9_.-]+)\]\s*(#.*)?", line):
            table, line = head[1], f"[{head[1]}]"
        elif (key := re.match(r"([A-Za-z0-9_-]+)\s*=", line)) and f"{table}.{key[1]}" in left:
            comment = re.search(r"\s+#[^\"']*$", line)
            line = f"{key[1]} = {json.dumps(left.pop(f'{table}.{key[1]}'))}{comment[0] if comment else ''}"
        lines.append(line)
    return lines, left


def _end(lines: list[str], head: int) -> int:
    """The line where the table whose head is on this line ends: behind its last line that is not empty or a comment."""
    last = head
    for number in range(head + 1, len(lines)):
        if lines[number].startswith("["):
            break
        if lines[number].strip() and not lines[number].startswith("#"):
            last = number
    return last + 1
