"""DroneCAN fields as bits (specification, chapter 3): one behind the other, in bytes filled from the highest bit.

A field of more than 8 bits is cut into bytes, the lowest first; what is left over, its highest bits, comes last.
"""

import struct
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from delfim.base.errors import FormatError

FLOAT16_MAX: Final = 65504.0
_FLOATS: Final = {16: struct.Struct("<e"), 32: struct.Struct("<f")}


class WireField(NamedTuple):
    kind: Literal["unsigned", "signed", "float", "void"]  # void: bits without meaning
    bits: int


class DataType(NamedTuple):
    """A message. `item` repeats until the end: how often is not sent, but follows from the length."""

    name: str
    id: int
    seed: int  # CRC-16-CCITT-FALSE of the 64-bit signature of the definition: a transfer's checksum starts from it
    fields: tuple[WireField, ...]
    item: tuple[WireField, ...] = ()
    items_max: int = 0


def unsigned(bits: int) -> WireField:
    return WireField("unsigned", bits)


def signed(bits: int) -> WireField:
    return WireField("signed", bits)


def void(bits: int) -> WireField:
    return WireField("void", bits)


F16: Final = WireField("float", 16)
F32: Final = WireField("float", 32)


def pack(kind: DataType, values: Sequence[float] = (), items: Sequence[float] = ()) -> bytes:
    """The payload. `values`: one for each field that is not void; `items`: those of the first item, of the second, and so on.
    A number beyond its field's range becomes the nearest one. Raises FormatError for another number of values."""
    stream = bits = 0
    given = iter((*values, *items))
    repeats = len(items) // len(kind.item) if kind.item else 0
    fields = (*kind.fields, *kind.item * repeats)
    if len(values) + len(items) != sum(field.kind != "void" for field in fields) or repeats > kind.items_max:
        raise FormatError(f"{kind.name} of {len(values)} values and {len(items)} of its items")
    for field in fields:
        stream = stream << field.bits | (0 if field.kind == "void" else _put(field, next(given)))
        bits += field.bits
    padding = -bits % 8
    return (stream << padding).to_bytes((bits + padding) // 8, "big")


def unpack(kind: DataType, payload: bytes) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The values of the fields, and those of the items. Further bytes are ignored: definitions grow at their end. Raises
    FormatError for a payload that is too short."""
    stream, left = int.from_bytes(payload, "big"), 8 * len(payload)
    values, items = list[float](), list[float]()
    for field in kind.fields:
        left -= field.bits
        if left < 0:
            raise FormatError(f"{kind.name} of {len(payload)} bytes is too short")
        if field.kind != "void":
            values.append(_get(field, stream >> left & ((1 << field.bits) - 1)))
    if kind.item:
        bits = sum(field.bits for field in kind.item)
        for _ in range(min(left // bits, kind.items_max)):
            for field in kind.item:
                left -= field.bits
                items.append(_get(field, stream >> left & ((1 << field.bits) - 1)))
    return tuple(values), tuple(items)


def _put(field: WireField, value: float) -> int:
    kind, bits = field
    if kind == "float":
        if bits == 16 and abs(value) > FLOAT16_MAX and value - value == 0.0:
            value = FLOAT16_MAX if value > 0 else -FLOAT16_MAX
        return int.from_bytes(_FLOATS[bits].pack(value), "big")
    low, high = (0, (1 << bits) - 1) if kind == "unsigned" else (-1 << (bits - 1), (1 << (bits - 1)) - 1)
    raw = min(max(int(value), low), high) & ((1 << bits) - 1)
    whole, odd = divmod(bits, 8)
    if not whole or bits == 8:
        return raw
    bytewise = 8 * whole
    low_bytes = (raw & ((1 << bytewise) - 1)).to_bytes(whole, "little")
    return int.from_bytes(low_bytes, "big") << odd | raw >> bytewise


def _get(field: WireField, raw: int) -> float:
    kind, bits = field
    if kind == "float":
        value: float = _FLOATS[bits].unpack(raw.to_bytes(bits // 8, "big"))[0]
        return value
    whole, odd = divmod(bits, 8)
    if whole and bits != 8:
        low_bytes = (raw >> odd).to_bytes(whole, "big")
        raw = int.from_bytes(low_bytes, "little") | (raw & ((1 << odd) - 1)) << 8 * whole
    return raw - (1 << bits) if kind == "signed" and raw >> (bits - 1) else raw
