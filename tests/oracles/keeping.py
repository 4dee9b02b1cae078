"""Kept things as text: files that people can read and git can compare."""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from typing import Final

from tests.oracles.traces import Row, Trace

KEPT: Final = Path(__file__).parent / "kept"
Lines = dict[str, list[str]]  # lines by the name of what they are of


@cache
def arithmetic() -> str:
    """A digest of what this machine's mathematics gives: elsewhere sine and logarithm may have another last bit."""
    random, told = Random(1), hashlib.blake2b(digest_size=8)
    for _ in range(5000):
        x, y = random.uniform(-10.0, 10.0), random.uniform(1e-6, 1e3)
        values = math.sin(x), math.cos(x), math.tan(x), math.atan2(x, y), math.exp(x), math.log(y), math.hypot(x, y), y**0.7
        told.update(" ".join(value.hex() for value in (*values, math.asin(x / 10.0))).encode())
    return told.hexdigest()


def keep_lines(kind: str, kept: Lines) -> None:
    """A file of lines."""
    whole = {"arithmetic": [arithmetic()]} | kept
    parts = [f"== {name}\n" + "".join(f"{line}\n" for line in lines) for name, lines in whole.items()]
    (KEPT / f"{kind}.txt").write_text("\n".join(parts))


def kept_lines(kind: str) -> Lines:
    found: Lines = {}
    for part in (KEPT / f"{kind}.txt").read_text().split("== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        found[name] = lines
    return found


def keep_traces(kind: str, traces: Mapping[str, Trace]) -> None:
    """A file of voyages. Most have the same fields, which are written once."""
    fields, parts = list[dict[str, tuple[str, ...]]](), list[str]()
    for name, trace in traces.items():
        digits = next(iter(trace.ends.values()), {})
        groups = trace.groups | {"digits": tuple(digits)}
        if groups not in fields:
            fields.append(groups)
        parts.append("\n".join([f"[{_quoted(name)}]", f"fields = {fields.index(groups)}", *_trace_lines(trace), ""]))
    head = [f"arithmetic = {_quoted(arithmetic())}", ""]
    for groups in fields:
        head += ["[[fields]]", *(f"{group} = {_quoted(' '.join(names))}" for group, names in groups.items()), ""]
    (KEPT / f"{kind}.toml").write_text("\n".join([*head, *parts]))


def _trace_lines(trace: Trace) -> Iterable[str]:
    yield f"rate_hz = {trace.rate_hz:g}"
    yield f"seconds = {trace.seconds!r}"
    yield _block("marks", (f"{cycle} {' '.join(mark)}" for cycle, mark in trace.marks.items()))
    yield _block("told", (f"{at_s:g} {words}" for at_s, words in trace.told))
    if trace.failures:
        yield _block("failures", trace.failures)
    yield _block("ends", (f"{c} {' '.join(f'{value:.5g}' for value in values.values())}" for c, values in trace.ends.items()))
    yield _block("rows", (f"{row.end} {row.letters} {row.commands}" for row in trace.rows))


def kept_traces(kind: str) -> tuple[dict[str, Trace], str]:
    """The voyages of a file by name, and the arithmetic of the machine that made it."""
    tree = tomllib.loads((KEPT / f"{kind}.toml").read_text())
    fields = [{group: tuple(names.split()) for group, names in groups.items()} for groups in tree.pop("fields")]
    made = tree.pop("arithmetic")
    found = dict[str, Trace]()
    for name, told in tree.items():
        marks = {int(cycle): (digest, letters) for cycle, digest, letters in map(str.split, told["marks"].splitlines())}
        rows = [Row(int(end), letters, commands) for end, letters, commands in map(str.split, told["rows"].splitlines())]
        groups, ends = dict(fields[told["fields"]]), dict[int, dict[str, float]]()
        digits = groups.pop("digits")
        for cycle, *values in map(str.split, told["ends"].splitlines()):
            ends[int(cycle)] = dict(zip(digits, map(float, values), strict=True))
        words = [line.split(" ", 1) for line in told["told"].splitlines()]
        found[name] = Trace(
            groups,
            told["seconds"],
            told["rate_hz"],
            marks,
            rows,
            ends,
            [(float(at_s), text) for at_s, text in words],
            told.get("failures", "").splitlines(),
            {},
            (),
        )
    return found, made


def _block(key: str, lines: Iterable[str]) -> str:
    return "\n".join([f"{key} = '''", *lines, "'''"])


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
