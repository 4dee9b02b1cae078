"""What a console asks a boat about itself, on its link: the keys that may change under way, the checks before the start. Both
ends of it.

V2_EXTENSION carries a question and its answer, each a number and a line of JSON. Asked again with the same number it is not
obeyed again, and has the same answer.
"""

from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.errors import FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import ownorders
from delfim.parts.mavlink.codec.wire import Message

ASK, TOLD = 0xDE13, 0xDE14  # types of message
ROWS_MAX: Final = 200
_CUT: Final = 20  # characters
Short = Annotated[str, msgspec.Meta(max_length=100)]
Value = None | bool | float | Annotated[str, msgspec.Meta(max_length=64)]


class BoatQuestion(msgspec.Struct, frozen=True, omit_defaults=True):
    """`settings`, `checks`: the row at that place of the list. `change`: a key gets this value for the voyage; the answer is
    its row. `note`: words for the boat's log."""

    of: Literal["settings", "checks", "change", "note"]
    at: Annotated[int, msgspec.Meta(ge=0, lt=ROWS_MAX)] = 0
    key: Annotated[str, msgspec.Meta(max_length=64)] = ""
    value: Value = ""
    text: Short = ""


class ToldRow(msgspec.Struct, frozen=True, omit_defaults=True):
    """A row of a list of `count`. `refused`: why it is not so, or why a check fails."""

    count: Annotated[int, msgspec.Meta(ge=0, le=ROWS_MAX)] = 0
    key: Short = ""
    value: Value = ""  # in force
    file: Value = ""  # what the vehicle's file says
    allowed: Annotated[str, msgspec.Meta(max_length=250)] = ""  # in words
    words: Annotated[str, msgspec.Meta(max_length=250)] = ""
    refused: Annotated[str, msgspec.Meta(max_length=250)] = ""


@cache
def changeable(kind: type[config.Vehicle]) -> dict[str, str]:
    """The keys that may change while the boat sails, and what each may be, in words. An action for one mode alone is not among
    them."""
    found = {key: words for key, words in _below("", kind) if key.startswith(config.CHANGEABLE)}
    return {key: words for key, words in found.items() if key.rpartition(".")[2].upper() not in Mode.__members__}


def _below(prefix: str, kind: Any) -> list[tuple[str, str]]:
    found = []
    for name, hint in tables.keys(kind).items():
        if isinstance(hint, type) and issubclass(hint, tables.Table):
            wanted = any(
                each.startswith(f"{prefix}{name}.") or f"{prefix}{name}.".startswith(each) for each in config.CHANGEABLE
            )
            found += _below(f"{prefix}{name}.", hint) if wanted else []
        elif _is_scalar(hint):
            found.append((f"{prefix}{name}", tables.allowed(hint)))
    return found


def _is_scalar(hint: Any) -> bool:
    """A number, yes or no, or a word; also one that the boat reckons where the file has none."""
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if isinstance(hint, UnionType) or get_origin(hint) is Union:
        return all(each is NoneType or _is_scalar(each) for each in get_args(hint))
    return hint in (float, bool, str) or get_origin(hint) is Literal


def value_of(settings: config.Vehicle, key: str) -> Any:
    found: Any = settings
    for name in key.split("."):
        found = getattr(found, name)
    return found


def ask(to: tuple[int, int], number: int, question: BoatQuestion) -> Message:
    return ownorders.extension(to, ASK, number, msgspec.json.encode(question))


def heard(message: Any) -> tuple[int, ToldRow]:
    """The number and the answer. Raises FormatError."""
    number, line = ownorders.numbered(message)
    try:
        return number, msgspec.json.decode(line, type=ToldRow)
    except UNREADABLE as error:
        raise FormatError(f"no answer: {error}") from None


def told(to: tuple[int, int], number: int, row: ToldRow) -> Message:
    """Words that are too long for a message are cut."""
    while len(line := msgspec.json.encode(row)) > ownorders.WORDS_MAX:
        longest = max(("allowed", "words", "refused"), key=lambda name: len(getattr(row, name)))
        row = msgspec.structs.replace(row, **{longest: getattr(row, longest)[:-_CUT]})
    return ownorders.extension(to, TOLD, number, line)
