"""Orders by satellite: which there are, and who may give them.

A message to the boat is a signed MAVLink frame with an order in the boat's own words, as consoles send it. It may be an hour
old when it comes, so it is judged here: by the boat's key, by its time stamp, which must be newer than the last one that was
taken, and by its age.
"""

import hashlib
import hmac
from collections.abc import Callable
from typing import Final

import msgspec

from delfim.base.errors import FormatError
from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.codec.signing import EPOCH_NS, OFF_S, PER_S, Signing
from delfim.vehicle import console

SATELLITE: Final = 254  # the number of the satellite's console; the boat knows it as one that commands
COMPONENT: Final = int(wire.dialect.MAV_COMP_ID_MISSIONPLANNER)
MODES: Final = ("home", "hold")
ONLY: Final = "by satellite there are home, hold, stop and a position"
WORDS: Final[dict[str, console.OperatorOrder]] = {
    "stop": console.Stop(),
    "home": console.SetMode("home"),
    "hold": console.SetMode("hold"),
}


def meant(words: str) -> console.OperatorOrder:
    """The order of these words: one of WORDS, or a position as 38.69,-9.21. Raises FormatError."""
    if words in WORDS:
        return WORDS[words]
    try:
        latitude_deg, longitude_deg = map(float, words.split(","))
    except ValueError:
        raise FormatError(f"{words}: {ONLY}, as 38.69,-9.21") from None
    return console.asked(console.Goto, latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def is_allowed(order: console.OperatorOrder) -> bool:
    """Whether this order is one of those that may come by satellite."""
    if isinstance(order, console.SetMode):
        return order.mode in MODES and order.piece is None
    return isinstance(order, console.Stop) or (isinstance(order, console.Goto) and order.latitude_deg is not None)


def opened(frame: bytes, key: bytes, last: int, age_max_s: float, time_ns: int) -> int:
    """The time stamp of a frame that may be obeyed. Raises FormatError with the reason."""
    if len(frame) < 25 or frame[0] != wire.MARKER or not frame[2] & wire.SIGNED:
        raise FormatError("unsigned")
    signature = hashlib.sha256(key + frame[:-6]).digest()[:6]
    if not hmac.compare_digest(signature, frame[-6:]):
        raise FormatError("forged")
    stamp = wire.stamp_of(frame)
    if stamp <= last:
        raise FormatError("it came before, or after a later one")
    age_s = (time_ns - EPOCH_NS) / 1e9 - stamp / PER_S
    if not -OFF_S <= age_s <= age_max_s:
        raise FormatError(f"it is {age_s:.0f} s old by this clock, and {age_max_s:.0f} s is the most")
    return stamp


def order_in(frame: bytes, system: int) -> tuple[int, bytes]:
    """The number and the words of the order in a frame for this boat. Raises FormatError."""
    message = wire.decode(frame)
    if message is None or message.get_msgId() != ownorders.EXTENSION or message.message_type != ownorders.ORDER:
        raise FormatError("no order")
    if message.target_system != system:
        raise FormatError(f"it is for boat {message.target_system}")
    number, words = ownorders.numbered(message)
    if not is_allowed(console.parse_order(words)):
        raise FormatError(ONLY)
    return number, words


def sealed(order: console.OperatorOrder, boat: int, number: int, signing: Signing) -> bytes:
    """The message that is sent to the boat."""
    return pack(signing)(ownorders.order((boat, 1), number, msgspec.json.encode(order)))


def pack(signing: Signing) -> Callable[[wire.Message], bytes]:
    """Makes frames of the satellite's console."""
    return wire.Sender(SATELLITE, COMPONENT, signing.key, signing.stamp).pack
