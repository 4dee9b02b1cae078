"""TOML files as tables: a table is one frozen class that declares its keys with type, default and range.

An unknown key, a wrong type and a value out of range are refused with file, key, reason and what is allowed.
"""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from delfim.base.errors import ConfigError, FormatError, did_you_mean
from delfim.base.input.untrusted import parse_toml, read_text


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a TOML file. Unknown keys are refused."""

    MOVED: ClassVar[dict[str, str]] = {}  # keys of the past, and where their meaning is now

    def of(self, kind: "type[T]") -> "T":
        """The table of this class within, such as that of a laboratory's part in a vehicle's file. Raises LookupError."""
        for name in self.__struct_fields__:
            if isinstance(inner := getattr(self, name), kind):
                return inner
        raise LookupError(f"{type(self).__name__} has no {kind.__name__}")

    def settled(self, vehicle: Any) -> "Table":
        """The table as it applies beside the others of its vehicle's file. Raises ValueError where it contradicts one."""
        return self


T = TypeVar("T", bound=Table)
SHOWN = 60  # characters at most of a value that is refused


def text(pattern: str, words: str, **extra: str) -> msgspec.Meta:
    """The type of a text that matches the pattern; the words tell a person what may be written."""
    return msgspec.Meta(pattern=rf"^{pattern}\Z", description=words, extra=extra or None)


def shown(table: Table) -> dict[str, Any]:
    """All keys and values as everybody may read them, JSON-ready and fit for `decode`; a secret is replaced by the text in its
    declaration (`extra={"shown": ...}`)."""
    fields: dict[str, Any] = _shown(table, type(table))
    return fields


def _shown(value: Any, hint: Any) -> Any:
    if get_origin(hint) is Annotated:
        instead = (get_args(hint)[1].extra or {}).get("shown")
        return _shown(value, get_args(hint)[0]) if instead is None else instead
    if isinstance(value, Table):
        hints = get_type_hints(type(value), include_extras=True)
        return {name: _shown(getattr(value, name), hints[name]) for name in value.__struct_fields__}
    if isinstance(value, dict):
        return {key: _shown(each, get_args(hint)[1]) for key, each in value.items()}
    if isinstance(value, tuple):
        return [_shown(each, get_args(hint)[0]) for each in value]
    return value


def read_toml(path: str | Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Read the file's tables, with "key.key=TOML value" overrides laid over them. Raises ConfigError where the file is missing,
    unreadable or no TOML."""
    try:
        tree = parse_toml(read_text(path))
    except OSError as error:
        raise ConfigError(str(path), "file", error.strerror or str(error)) from None
    except FormatError as error:
        raise ConfigError(str(path), "file", str(error)) from None
    for override in overrides:
        _override(tree, override)
    return tree


def read_override(override: str) -> dict[str, Any]:
    """Parse one "key.key=TOML value" into its tables. Raises ConfigError."""
    tree = dict[str, Any]()
    _override(tree, override)
    return tree


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, value = override.partition("=")
    try:
        if not equals:
            raise ValueError("no =")
        if not value.strip():
            raise ValueError('nothing after =; write a number, true, a word, "" for no text or [] for no list')
        *tables, last = key.strip().split(".")
        for table in tables:
            tree = tree.setdefault(table, {})
        tree[last] = _value(value.strip())
    except (ValueError, AttributeError, TypeError) as error:
        raise ConfigError("--set", override, f"not KEY=VALUE with a TOML value: {error}") from None


def _value(text: str) -> Any:
    """Parse a TOML value; text needs no quotes, which a shell would take away."""
    try:
        return parse_toml(f"value = {text}")["value"]
    except FormatError:
        if not text or text[0] in "\"'[{":
            raise
        return text


def inline(value: Any) -> str:
    """Write a value as TOML in one line; what is None is left out."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {inline(each)}" for key, each in value.items() if each is not None) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(inline, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False, default=str)


def text_of(tree: dict[str, Any], path: str = "") -> str:
    """Write a tree as the text of a TOML file; what is None is left out."""
    lines, below = list[str](), list[str]()
    for key, value in tree.items():
        place = f"{path}{_key(key)}"
        if isinstance(value, dict):
            below.append(f"\n[{place}]\n{text_of(value, f'{place}.')}")
        elif isinstance(value, list | tuple) and value and all(isinstance(each, dict) for each in value):
            rows = [
                "".join(f"{_key(name)} = {inline(each)}\n" for name, each in row.items() if each is not None) for row in value
            ]
            below += [f"\n[[{place}]]\n{row}" for row in rows]
        elif value is not None:
            lines.append(f"{_key(key)} = {inline(value)}\n")
    return "".join([*lines, *below])


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def decode(tree: dict[str, object], kind: type[T], file: str) -> T:
    """Decode a table from parsed TOML. Raises ConfigError with the first of its `complaints`."""
    try:
        return msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        raise next(complaints(tree, kind, file), ConfigError(file, "file", str(error))) from None


def complaints(tree: object, kind: type[Table], file: str) -> Iterator[ConfigError]:
    """List all faults of a table from parsed TOML."""
    for wrong in _wrong(tree, kind, ""):
        reason, key = wrong.reason, wrong.key.lstrip(".")
        guess = reason.partition("; did you mean ")
        if guess[0] == UNKNOWN and (elsewhere := _elsewhere(key, kind)) and (not guess[1] or _is_named(elsewhere, key)):
            reason = f"{UNKNOWN}; did you mean {elsewhere}?"
        yield ConfigError(file, key, reason, "" if reason != wrong.reason else wrong.allowed)


def _is_named(path: str, key: str) -> bool:
    """Whether path and key end in the same word, which is better than one that resembles it."""
    return path.rpartition(".")[2] == key.rpartition(".")[2]


def _elsewhere(key: str, kind: type[Table]) -> str:
    """Where in the whole file a key of this name stands, its unit apart, nearest to the root; empty: nowhere."""
    word, ahead = key.rpartition(".")[2], [("", kind)]
    while ahead:
        within = [(f"{path}.{name}".lstrip("."), hint) for path, table in ahead for name, hint in keys(table).items()]
        if found := [path for path, _ in within if re.fullmatch(rf"{re.escape(word)}(_[a-z0-9]+)?", path.rpartition(".")[2])]:
            return min(found, key=lambda path: len(path.rpartition(".")[2]))
        ahead = [(path, bare) for path, hint in within if isinstance(bare := _bare(hint), type) and issubclass(bare, Table)]
    return ""


UNKNOWN: Final = "unknown key"
ALL: Final = "the tables of docs/vehicle-file.md, which `delfim describe` prints"


class Wrong(NamedTuple):
    key: str
    reason: str
    allowed: str = ""


def _wrong(value: Any, hint: Any, key: str) -> Iterator[Wrong]:
    """List the faults of a value: of its parts, or else of the whole. msgspec stops at the first one."""
    refused, parts = _refused(value, hint, key), list[Wrong]()
    if refused is None:
        return
    kind = _bare(hint)
    if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, Table):
        parts = list(_wrong_in_table(value, kind, key))
    elif isinstance(value, dict) and get_origin(kind) is dict:
        name, each = get_args(kind)
        parts = [Wrong(f"{key}.{word}", "not a name for a table", allowed(name)) for word in value if _refused(word, name, key)]
        parts += [wrong for word, one in value.items() for wrong in _wrong(one, each, f"{key}.{word}")]
    elif isinstance(value, list) and get_origin(kind) is tuple:
        hints = get_args(kind)
        hints = hints[:1] * len(value) if hints[-1] is ... else hints
        pairs = enumerate(zip(value, hints, strict=False))
        parts = [wrong for i, (one, each) in pairs for wrong in _wrong(one, each, f"{key}[{i}]")]
    yield from parts or [refused]


def _wrong_in_table(value: dict[str, Any], kind: type[Table], key: str) -> Iterator[Wrong]:
    hints = keys(kind)
    for word, one in value.items():
        if word in hints:
            yield from _wrong(one, hints[word], f"{key}.{word}")
        else:
            near = f"; it is now {kind.MOVED[word]}" if word in kind.MOVED else did_you_mean(word, hints)
            yield Wrong(f"{key}.{word}", f"{UNKNOWN}{near}", "" if near else ", ".join(hints) if key else ALL)
    for field in msgspec.structs.fields(kind):
        if field.required and field.name not in value:
            yield Wrong(f"{key}.{field.name}", "missing")


def keys(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """The keys of a table and their types."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hints[name] for name in kind.__struct_fields__}


def _bare(hint: Any) -> Any:
    """A type without its range, and without the None of an optional value."""
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if isinstance(hint, UnionType) or get_origin(hint) is Union:
        return _bare(next(part for part in get_args(hint) if part is not NoneType))
    return hint


def _refused(value: object, hint: Any, key: str) -> Wrong | None:
    """The reason, in words, why a value as a whole is refused; None if it is accepted."""
    try:
        msgspec.convert(value, hint)
    except msgspec.ValidationError as error:
        text = str(error).partition(" - at ")[0]
        if kinds := re.fullmatch(r"Expected `(.*)`, got `(.*)`", text):
            wanted, got = (_KINDS.get(kind, kind) for kind in kinds.groups())
            told = "this" if isinstance(value, list | dict) else _as_written(value)
            return Wrong(key, f"{told} is {got}, not {wanted}", allowed(hint))
        if re.match("Expected|Invalid|Integer|Number|Object", text):
            return Wrong(key, f"{_as_written(value)} is not allowed", allowed(hint))
        return Wrong(key, text)  # from the table's own check
    return None


_KINDS = {"bool": "true or false", "int": "a whole number", "float": "a number", "str": "text", "array": "a list"}
_KINDS |= {"object": "a table", "date": "a date", "datetime": "a date", "time": "a time of day", "null": "nothing"}


def _as_written(value: object) -> str:
    """Show a value as its file has it, no longer than a line."""
    if isinstance(value, list | dict):
        kind = "list" if isinstance(value, list) else "table"
        return f"a {kind} of {len(value)}" if value else f"an empty {kind}"
    text = str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 4 :]}"


def allowed(hint: Any) -> str:
    """Describe the range of a type in words: "0.0 to 1.0", "dsor, nmea2000"."""
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if get_origin(hint) is tuple:
        parts = get_args(hint)
        return f"any number of {allowed(parts[0])}" if parts[-1] is ... else f"[{', '.join(map(allowed, parts))}]"
    if isinstance(hint, UnionType) or get_origin(hint) is Union:
        return " or ".join(allowed(part) for part in get_args(hint) if part is not NoneType)
    if get_origin(hint) is not Annotated:
        if isinstance(hint, type) and issubclass(hint, Table):
            return f"a table of {', '.join(field.encode_name for field in msgspec.structs.fields(hint))}"
        return {bool: "true or false", str: "text", float: "a number", int: "a whole number", dict: "a table"}.get(
            get_origin(hint) or hint, getattr(hint, "__name__", str(hint))
        )
    meta = get_args(hint)[1]
    if meta.description:
        return str(meta.description)
    if meta.max_length is not None and get_args(hint)[0] is str:
        return f"text of up to {meta.max_length} characters"
    if meta.max_length is not None:
        return f"{meta.min_length or 0} to {meta.max_length} of {allowed(get_args(get_args(hint)[0])[0])}"
    low = f"{meta.ge}" if meta.ge is not None else f"more than {meta.gt}" if meta.gt is not None else ""
    return f"{low} to {meta.le}" if meta.le is not None else f"{low} or more"
