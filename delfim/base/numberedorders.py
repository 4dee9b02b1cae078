"""Orders that are given in numbers, by a console's form or by MAVLink's seven numbers: each key has two limits."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Final, NamedTuple, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

from delfim.base import tables

NUMBERS: Final = range(31010, 31015)  # MAV_CMD_USER_1 to MAV_CMD_USER_5
KEYS_MAX: Final = 7  # that a MAVLink command carries


class NumberKey(NamedTuple):
    """A key of an order, with its two limits."""

    name: str
    least: float
    most: float
    value: float  # unless another one is given


class NumberedOrder(NamedTuple):
    """An order of a part, with its number."""

    name: str
    keys: tuple[NumberKey, ...]

    def values(self, numbers: Sequence[float]) -> dict[str, float]:
        """The keys that these numbers set; NaN: not given. Raises ValueError for infinity, or a number without a key."""
        if any(number and not math.isnan(number) for number in numbers[len(self.keys) :]):
            raise ValueError(f"{self.name} takes {len(self.keys)} numbers")
        if any(math.isinf(number) for number in numbers):
            raise ValueError(f"{self.name}: infinity is no number")
        given = zip(self.keys, numbers, strict=False)
        return {key.name: int(number) if number.is_integer() else number for key, number in given if not math.isnan(number)}


def numbered(number: int, name: str, table: type[tables.Table]) -> NumberedOrder:
    """The order with its keys as numbers. Raises ValueError for an order that numbers cannot give."""
    if number not in NUMBERS:
        raise ValueError(f"order {name} has number {number}; MAVLink has {NUMBERS[0]} to {NUMBERS[-1]} for users")
    keys = tuple(_key(*row) for row in _rows(table))
    if len(keys) > KEYS_MAX:
        raise ValueError(f"order {name} has too many keys for its number: MAVLink carries {KEYS_MAX}")
    return NumberedOrder(name, keys)


def asked(table: type[msgspec.Struct], *, optional: bool) -> tuple[NumberKey, ...] | None:
    """The keys that a form asks for, with or without those that need not be given; None: it cannot ask for all that must be."""
    found = list[NumberKey]()
    for field, hint in _rows(table):
        try:
            found += [_key(field, hint)] if field.required or optional else []
        except ValueError:
            if field.required:
                return None
    return tuple(found)


def _rows(table: type[msgspec.Struct]) -> Iterator[tuple[FieldInfo, Any]]:
    """Each key, and its type."""
    return zip(msgspec.structs.fields(table), tables.keys(table).values(), strict=True)


def _key(field: FieldInfo, hint: Any) -> NumberKey:
    """The key of a field. Raises ValueError."""
    name, default = field.name, field.default
    kind, *metas = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    least, most = (next((v for m in metas if (v := getattr(m, key, None)) is not None), None) for key in ("ge", "le"))
    if kind not in (int, float) or least is None or most is None:
        raise ValueError(f"key {name} of an order with a number is a number from (ge) to (le)")
    return NumberKey(name, least, most, default if isinstance(default, int | float) else max(least, min(0.0, most)))
