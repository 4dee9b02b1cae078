"""Fields of DroneCAN as bits (specification, chapter 3): one behind the other, in bytes filled from the highest bit.

A field of more than 8 bits is cut into bytes, the lowest first; what is left over, its highest bits, comes last.

Buses carry hundreds of messages a second, so each layout becomes two Python functions when it is met first: fields that are
whole bytes go through one `struct`, the bits between them through shifts. For a field of 8 bits and one of 14 they are

    def write(values, items):
        v0, v1, = *values, *items
        v0 = int(v0)
        if not 0 <= v0 <= 255: v0 = nearest(v0, 0, 255)
        v1 = int(v1)
        if not 0 <= v1 <= 16383: v1 = nearest(v1, 0, 16383)
        return join(v0, ((v1 >> 0 & 255) << 8 | (v1 >> 8 & 63) << 2).to_bytes(2, 'big'))

    def read(payload):
        v0, g1, = split(payload)
        g1 = number(g1, 'big')
        return (v0, (g1 >> 8 & 255) << 0 | (g1 >> 2 & 63) << 8, ), ()
"""

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

from delfim.base.errors import FormatError

FLOAT16_MAX: Final = 65504.0
Read = Callable[[bytes], tuple[tuple[float, ...], tuple[float, ...]]]
Write = Callable[[Sequence[float], Sequence[float]], bytes]


class WireField(NamedTuple):
    kind: Literal["unsigned", "signed", "float", "void"]  # void: bits without meaning
    bits: int


@dataclass(slots=True, eq=False)
class DataType:
    """A message type. `item` repeats until the end: how often is not sent, but follows from the length."""

    name: str
    id: int
    seed: int  # CRC-16-CCITT-FALSE of the 64-bit signature of the definition: a transfer's checksum starts from it
    fields: tuple[WireField, ...]
    item: tuple[WireField, ...] = ()
    items_max: int = 0
    readers: dict[int, Read] = field(default_factory=dict)  # by the payload's length
    writers: dict[tuple[int, int], Write] = field(default_factory=dict)  # by the number of values and of those of items


_CODES: Final = {  # of the struct module, for fields that begin with a byte
    **{WireField("unsigned", bits): code for bits, code in ((8, "B"), (16, "H"), (32, "I"))},
    **{WireField("signed", bits): code for bits, code in ((8, "b"), (16, "h"), (32, "i"))},
    **{WireField("float", bits): code for bits, code in ((16, "e"), (32, "f"))},
}


def unsigned(bits: int) -> WireField:
    return WireField("unsigned", bits)


def signed(bits: int) -> WireField:
    return WireField("signed", bits)


def void(bits: int) -> WireField:
    return WireField("void", bits)


F16: Final = WireField("float", 16)
F32: Final = WireField("float", 32)


def pack(kind: DataType, values: Sequence[float] = (), items: Sequence[float] = ()) -> bytes:
    """Pack a payload. `values`: one for each field that is not void; `items`: those of the first item, of the second, and so
    on. A number beyond its field's range becomes the nearest one. Raises FormatError for another number of values."""
    write = kind.writers.get((len(values), len(items)))
    return write(values, items) if write is not None else _writer(kind, len(values), len(items))(values, items)


def unpack(kind: DataType, payload: bytes) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Unpack the values of the fields, and those of the items. Further bytes are ignored: definitions grow at their end. Raises
    FormatError for a payload that is too short."""
    read = kind.readers.get(len(payload))
    return read(payload) if read is not None else _reader(kind, len(payload))(payload)


def _writer(kind: DataType, values: int, items: int) -> Write:
    repeats = items // len(kind.item) if kind.item else 0
    fields = kind.fields + kind.item * repeats
    count = sum(each.kind != "void" for each in fields)
    if values + items != count or repeats > kind.items_max:
        raise FormatError(f"{kind.name} of {values} values and {items} of its items")
    lines, codes, parts = list[str](), "<", list[str]()
    for code, group in _groups(fields):
        codes += code
        terms, left = list[str](), sum(each.bits for _, each in group)
        left += -left % 8
        size = left // 8
        for name, each in group:
            left -= each.bits
            if each.kind == "void":
                continue
            if each.kind != "float":
                low, high = _range(each)
                lines += [f"{name} = int({name})", f"if not {low} <= {name} <= {high}: {name} = nearest({name}, {low}, {high})"]
            elif each.bits == 16:
                lines.append(f"if not -{FLOAT16_MAX} <= {name} <= {FLOAT16_MAX}: {name} = half({name})")
            if each.kind == "float" and code[-1] == "s":  # it begins within a byte
                lines.append(f"{name} = number(struct.pack('<{_CODES[each]}', {name}), 'little')")
            terms += [f"({name} >> {at} & {(1 << bits) - 1}) << {left + to}" for at, to, bits in _pieces(each.bits)]
        parts.append(group[0][0] if code[-1] != "s" else f"({' | '.join(terms) or 0}).to_bytes({size}, 'big')")
    head = [f"{''.join(f'v{i}, ' for i in range(count))} = *values, *items"] if count else []
    body = [*head, *lines, f"return join({', '.join(parts)})"]
    known = {"join": struct.Struct(codes).pack, "half": _half, "nearest": _nearest, "number": int.from_bytes, "struct": struct}
    write: Write = _made("write(values, items)", body, known)
    return kind.writers.setdefault((values, items), write)


def _reader(kind: DataType, length: int) -> Read:
    bits, each_bits = (sum(each.bits for each in fields) for fields in (kind.fields, kind.item))
    if bits > 8 * length:
        raise FormatError(f"{kind.name} of {length} bytes is too short")
    repeats = min((8 * length - bits) // each_bits, kind.items_max) if kind.item else 0
    lines, codes, targets, found = list[str](), "<", list[str](), list[str]()
    for number, (code, group) in enumerate(_groups(kind.fields + kind.item * repeats)):
        codes += code
        if code[-1] != "s":
            targets.append(group[0][0])
            found.append(group[0][0])
            continue
        left = 8 * int(code[:-1])
        targets.append(f"g{number}")
        lines.append(f"g{number} = number(g{number}, 'big')")
        for _, each in group:
            left -= each.bits
            if each.kind == "void":
                continue
            raw = " | ".join(f"(g{number} >> {left + to} & {(1 << size) - 1}) << {at}" for at, to, size in _pieces(each.bits))
            half = 1 << (each.bits - 1)
            if each.kind == "float":
                raw = f"struct.unpack('<{_CODES[each]}', ({raw}).to_bytes({each.bits // 8}, 'little'))[0]"
            found.append(f"(({raw}) ^ {half}) - {half}" if each.kind == "signed" else raw)
    count = sum(each.kind != "void" for each in kind.fields)
    head = [f"{''.join(f'{name}, ' for name in targets)} = split(payload)"] if targets else []
    values, items = (f"({''.join(f'{each}, ' for each in part)})" for part in (found[:count], found[count:]))
    known = {"split": struct.Struct(codes).unpack_from, "number": int.from_bytes, "struct": struct}
    read: Read = _made("read(payload)", [*head, *lines, f"return {values}, {items}"], known)
    return kind.readers.setdefault(length, read)


def _groups(fields: Sequence[WireField]) -> Iterator[tuple[str, list[tuple[str, WireField]]]]:
    """Fields that are whole bytes one by one, those between them together, up to the next whole byte: (code of the struct
    module, (name, field) of each)."""
    group, number = list[tuple[str, WireField]](), 0
    for each in fields:
        group.append((f"v{number}", each))
        number += each.kind != "void"
        bits = sum(one.bits for _, one in group)
        if bits % 8 == 0:
            yield _CODES.get(each, f"{bits // 8}s") if len(group) == 1 else f"{bits // 8}s", group
            group = []
    if group:
        yield f"{(sum(one.bits for _, one in group) + 7) // 8}s", group


def _pieces(bits: int) -> list[tuple[int, int, int]]:
    """Where the bits of a number lie: (place in the number, place from the field's last bit, how many), its bytes first."""
    whole, odd = divmod(bits, 8)
    low = [(8 * i, bits - 8 * (i + 1), 8) for i in range(whole)]
    return [*low, (8 * whole, 0, odd)] if odd else low


def _range(each: WireField) -> tuple[int, int]:
    return (0, (1 << each.bits) - 1) if each.kind == "unsigned" else (-1 << (each.bits - 1), (1 << (each.bits - 1)) - 1)


def _nearest(value: int, low: int, high: int) -> int:
    return low if value < low else high


def _half(value: float) -> float:
    """A number that 16 bits do not hold: the largest one; infinity and NaN stay."""
    return math.copysign(FLOAT16_MAX, value) if math.isfinite(value) else value


def _made(head: str, body: Sequence[str], known: dict[str, Any]) -> Any:
    """A function of these lines, which consist of this module's own names and numbers."""
    exec("\n    ".join((f"def {head}:", *body)), known)
    return known[head.split("(")[0]]
