"""Orders in the boat's own words on the console's link, and which of them a console's menu offers: both ends of it.

V2_EXTENSION carries them. An order is a number and a line of JSON as `delfim/vehicle/console.py` has it; the answer has the
same number, and why the order was refused. An order whose number comes again gets the answer that it had.
"""

import struct
from collections.abc import Iterable
from typing import Annotated, Any, Final

import msgspec

from delfim.base.errors import FormatError
from delfim.base.numberedorders import NumberKey, asked
from delfim.base.parts import OrderRow
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.vehicle import console

ORDER, ANSWER, OFFER = 0xDE10, 0xDE11, 0xDE12  # types of message, from the range that is free for everybody
EXTENSION: Final = int(dialect.MAVLINK_MSG_ID_V2_EXTENSION)
_SIZE: Final = 249
_number: Final = struct.Struct("<I")  # before an order's words, and before the reason
_place: Final = struct.Struct("BB")  # of an offer from 1, and their count
WORDS_MAX: Final = _SIZE - _number.size  # bytes of an order
OFFERS_MAX: Final = 64
Text = Annotated[str, msgspec.Meta(max_length=100)]


class Offer(msgspec.Struct, frozen=True, omit_defaults=True):
    """An entry of a console's menu: the order's word, what it asks for, and, where it is a part's, its name."""

    command: Text
    name: Text = ""
    title: Text = ""
    key: Text = ""
    keys: Annotated[tuple[NumberKey, ...], msgspec.Meta(max_length=20)] = ()

    def __post_init__(self) -> None:
        """Raises ValueError, also where what a boat told makes no sense."""
        if not all(-1e9 < key.least <= key.value <= key.most < 1e9 for key in self.keys):
            raise ValueError("its numbers make no sense")


def own_offers() -> list[Offer]:
    """Those that every boat of this version makes."""
    found = [(word, kind, asked(kind, optional=False)) for word, kind in console.KINDS.items() if kind.TITLE or kind.KEY]
    return [Offer(word, "", kind.TITLE, kind.KEY, keys) for word, kind, keys in found if keys is not None]


def offers(of_parts: Iterable[OrderRow], others: Iterable[str] = ()) -> list[Offer]:
    """All of a boat; `others` are orders without keys, by their names. An order of a part whose keys a form cannot ask for, or
    that is too long for a message, is not offered."""
    found = own_offers()
    for row in of_parts:
        if (keys := asked(row.table, optional=True)) is not None:
            found.append(Offer(str(console.PartOrder.__struct_config__.tag), row.name, keys=keys))
    found += [Offer(str(console.PartOrder.__struct_config__.tag), name) for name in others]
    return [each for each in found if len(msgspec.json.encode(each)) <= _SIZE - _place.size][:OFFERS_MAX]


def order(to: tuple[int, int], number: int, line: bytes) -> Message:
    """Raises FormatError."""
    if len(line) > WORDS_MAX:
        raise FormatError(f"the order is too long for the link: {len(line)} characters, and {WORDS_MAX} is the most")
    return _extension(to, ORDER, _number.pack(number) + line)


def answer(to: tuple[int, int], number: int, refused: str) -> Message:
    """`refused`: why, or empty."""
    return _extension(to, ANSWER, _number.pack(number) + refused.encode("ascii", "replace")[:WORDS_MAX])


def told(place: int, each: Offer, count: int) -> Message:
    """An offer, to everybody."""
    return _extension((0, 0), OFFER, _place.pack(place, count) + msgspec.json.encode(each))


def _extension(to: tuple[int, int], kind: int, data: bytes) -> Message:
    return dialect.MAVLink_v2_extension_message(0, *to, kind, list(data.ljust(_SIZE, b"\0")))


def extension(to: tuple[int, int], kind: int, number: int, line: bytes) -> Message:
    """A number and a line, of another kind."""
    return _extension(to, kind, _number.pack(number) + line)


def numbered(message: Any) -> tuple[int, bytes]:
    """The number and the words of an order or an answer."""
    data = bytes(message.payload)
    return _number.unpack_from(data)[0], data[_number.size :].rstrip(b"\0")


def offered(message: Any) -> tuple[int, int, Offer]:
    """The place, their count, and the offer. Raises FormatError."""
    data = bytes(message.payload)
    place, count = _place.unpack_from(data)
    try:
        found = msgspec.json.decode(data[_place.size :].rstrip(b"\0"), type=Offer)
    except (msgspec.MsgspecError, ValueError) as error:
        raise FormatError(f"no offer: {error}") from None
    if not 1 <= place <= count <= OFFERS_MAX:
        raise FormatError(f"no offer: {place} of {count}")
    return place, count, found
