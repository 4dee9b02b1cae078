"""Orders of a laboratory's parts as numbers, for MAVLink and a console's form: each key is a number with two limits."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Final, NamedTuple, Self, get_args, get_origin

import msgspec

from delfim.base import tables

NUMBERS: Final = range(31010, 31015)  # MAV_CMD_USER_1 to MAV_CMD_USER_5
KEYS_MAX: Final = 7  # that a MAVLink command carries
TEXT_MAX: Final = 128  # characters of a MAVLink text
OF_THE_PAGE: Final = ("t", "seq", "boat", "command")  # names that its messages have already
PARAM: Final = "ORDER_"  # begins the name of the text that tells of an order; then comes its number


class NumberKey(NamedTuple):
    """A key of an order."""

    name: str
    least: float
    most: float
    value: float  # unless another one is given


class NumberedOrder(NamedTuple):
    """An order by its number."""

    number: int
    name: str
    keys: tuple[NumberKey, ...]

    @property
    def param(self) -> str:
        return f"{PARAM}{self.number}"

    @property
    def text(self) -> str:
        """It in words, as a boat tells it to a console: "pay_out metres 0 50 5"."""
        return ", ".join([self.name, *(f"{key.name} {key.least:g} {key.most:g} {key.value:g}" for key in self.keys)])

    def values(self, numbers: Sequence[float]) -> dict[str, float]:
        """The keys of these numbers; NaN: not given. Raises ValueError for infinity, or a number without a key."""
        if any(number and not math.isnan(number) for number in numbers[len(self.keys) :]):
            raise ValueError(f"{self.name} takes {len(self.keys)} numbers")
        if any(math.isinf(number) for number in numbers):
            raise ValueError(f"{self.name}: infinity is no number")
        given = zip(self.keys, numbers, strict=False)
        return {key.name: int(number) if number.is_integer() else number for key, number in given if not math.isnan(number)}

    @classmethod
    def told(cls, param: str, text: str) -> Self:
        """Of a boat's text. Raises ValueError."""
        name, *rows = text.split(", ")
        number = int(param.removeprefix(PARAM))
        if number not in NUMBERS or not re.fullmatch("[a-z][a-z0-9_]*", name) or len(rows) > KEYS_MAX:
            raise ValueError("it is no order")
        keys = list[NumberKey]()
        for key, *numbers in (row.split(" ") for row in rows):
            least, most, value = map(float, numbers)
            if not -1e9 < least <= value <= most < 1e9:
                raise ValueError("its numbers make no sense")
            keys.append(NumberKey(key, least, most, value))
        return cls(number, name, tuple(keys))


def numbered(number: int, name: str, table: type[tables.Table]) -> NumberedOrder:
    """Raises ValueError for an order that numbers cannot give."""
    if number not in NUMBERS:
        raise ValueError(f"order {name} has number {number}; MAVLink has {NUMBERS[0]} to {NUMBERS[-1]} for users")
    fields = {field.name: field.default for field in msgspec.structs.fields(table)}
    keys = tuple(_key(key, hint, fields[key]) for key, hint in tables.keys(table).items())
    found = NumberedOrder(number, name, keys)
    if len(keys) > KEYS_MAX or len(found.text) > TEXT_MAX:
        raise ValueError(f"order {name} has too many keys for its number: MAVLink carries {KEYS_MAX}, in {TEXT_MAX} characters")
    return found


def _key(name: str, hint: Any, default: Any) -> NumberKey:
    if name in OF_THE_PAGE:
        raise ValueError(f"key {name} of an order with a number needs another name: it is one of the page's own")
    kind, *metas = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    least, most = (next((v for m in metas if (v := getattr(m, key, None)) is not None), None) for key in ("ge", "le"))
    if kind not in (int, float) or least is None or most is None:
        raise ValueError(f"key {name} of an order with a number is a number from (ge) to (le)")
    return NumberKey(name, least, most, default if isinstance(default, int | float) else max(least, min(0.0, most)))
