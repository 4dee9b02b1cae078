"""What a boat's message by satellite says, in words, for whoever gets it ashore."""

import hashlib
import hmac
import time
from collections.abc import Iterator
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.codec.signing import EPOCH_NS, PER_S

MOST: Final = 2048  # bytes of a file that are read


def in_words(data: bytes, key: bytes | None) -> Iterator[str]:
    """A line for each frame. `key`: None, and nothing is checked."""
    frames, whole = wire.frames(data)
    for frame in frames:
        try:
            message = wire.decode(frame)
        except FormatError as error:
            yield str(error)
            continue
        if message is None:
            yield "a message that is not known"
        elif message.get_type() == "HIGH_LATENCY2":
            yield f"{_when(frame)}: boat {message.get_srcSystem()}: {_report(message)}{_checked(frame, key)}"
        elif message.get_msgId() == ownorders.EXTENSION and message.message_type == ownorders.ANSWER:
            number, refused = ownorders.numbered(message)
            said = f"refused: {refused.decode('ascii', 'replace')}" if refused else "obeyed"
            yield f"{_when(frame)}: order {number or '?'}: {said}{_checked(frame, key)}"
        else:
            yield f"{message.get_type()}, which is neither a report nor an answer"
    if not whole:
        yield "the rest is no message of a boat"


def _report(message: wire.Message) -> str:
    mode = next((each.name.lower() for each in Mode if each == message.custom_mode), f"mode {message.custom_mode}")
    known = (message.latitude, message.longitude) != (0, 0)
    place = f"{message.latitude / 1e7:.5f}, {message.longitude / 1e7:.5f}" if known else "an unknown position"
    battery = f", battery {message.battery} %" if message.battery >= 0 else ""
    trouble = ", navigation is silent" if message.failure_flags else ""
    return f"{mode} at {place}, heading {message.heading * 2}, {message.groundspeed / 5:.1f} m/s{battery}{trouble}"


def _when(frame: bytes) -> str:
    """When it was signed, by the boat's clock."""
    if not frame[2] & wire.SIGNED:
        return "unsigned"
    utc = time.gmtime(EPOCH_NS / 1e9 + wire.stamp_of(frame) / PER_S)
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", utc)


def _checked(frame: bytes, key: bytes | None) -> str:
    if key is None:
        return " (not checked: no key)"
    is_right = frame[2] & wire.SIGNED and hmac.compare_digest(hashlib.sha256(key + frame[:-6]).digest()[:6], frame[-6:])
    return "" if is_right else " (NOT SIGNED WITH THIS KEY)"
