"""MAVLink 2 as the console speaks it: bytes to messages and back, signed where there is a key.

Frames and signatures are the vehicle's (`delfim.parts.mavlink`): both ends judge alike. The messages of a boat:
docs/mavlink.md.
"""

import secrets
from collections.abc import Iterator
from pathlib import Path
from shlex import quote
from typing import Any, Final

from delfim.base.clock import Clock, SystemClock
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.keys import new_key, read_key
from delfim.parts.mavlink.codec import boatsize, ownorders, plans, questions, wayhome, wire
from delfim.parts.mavlink.codec.aisvessel import GUARD, GUARDED, NUMBERS, ORDERED, facts_of, kind_of, number_of, position_of
from delfim.parts.mavlink.codec.ardupilot import WaterDepth
from delfim.parts.mavlink.codec.ownorders import Offer, own_offers
from delfim.parts.mavlink.codec.params import (
    BOAT_NAME,
    BOAT_RUN,
    BOAT_SIZE,
    ENERGY,
    LINE,
    PARAMS,
    SAILS_BY,
    SENSED,
    SENSED_VALUES,
    STATIONS,
    TROUBLES,
    WAY_HOME,
)
from delfim.parts.mavlink.codec.plans import FENCE, ITEMS, MISSION, RALLY, Item
from delfim.parts.mavlink.codec.questions import BoatQuestion, ToldRow
from delfim.parts.mavlink.codec.signing import FrameVerdict, Signing, read_stamps, write_stamps

__all__ = [  # what the console needs of the link's other end, beside what is below
    "BOAT_NAME",
    "BOAT_RUN",
    "BOAT_SIZE",
    "ENERGY",
    "FENCE",
    "GUARD",
    "GUARDED",
    "ITEMS",
    "LINE",
    "MISSION",
    "NUMBERS",
    "ORDERED",
    "PARAMS",
    "RALLY",
    "SAILS_BY",
    "SENSED",
    "SENSED_VALUES",
    "STATIONS",
    "TROUBLES",
    "WAY_HOME",
    "BoatQuestion",
    "Item",
    "Offer",
    "ToldRow",
    "WaterDepth",
    "boatsize",
    "facts_of",
    "kind_of",
    "number_of",
    "own_offers",
    "ownorders",
    "plans",
    "position_of",
    "questions",
    "wayhome",
]

mavlink: Final = wire.dialect

SYSTEM: Final = 250  # of a console that has no other number; QGroundControl and MAVProxy call themselves 255
COMPONENT: Final = mavlink.MAV_COMP_ID_MISSIONPLANNER
BOAT: Final = mavlink.MAV_COMP_ID_AUTOPILOT1
STRANGERS: Final = {
    "forged": "is heard, and signs with another key than this console's (--key)",
    "unsigned": "is heard, and signs nothing: a console with a key (--key) believes only who signs with it",
}
STREAMS: Final = 1024  # of boats: some for each number
STAMPS_S: Final = 10.0  # between two writings of the time stamps


class Key:
    """A signing key in a file of 64 hexadecimal digits, and beside it the time stamps of its last signatures, which
    never go back, not even over a restart, and the link number: drawn once, it tells a boat that this console is one on all of
    its links, and another one of its number is not. `stamps`: where these are kept instead. Raises ConfigError.
    """

    def __init__(self, file: Path, clock: Clock | None = None, stamps: Path | None = None) -> None:
        try:
            self.secret = read_key(file)
        except ConfigError as error:
            hint = "" if file.exists() else f"; make one with: delfim console --keygen {quote(str(file))}"
            raise ConfigError(str(file), "key", f"{error.reason}{hint}") from None
        self._clock = clock or SystemClock()
        self._file = stamps or file.with_suffix(".stamps")
        self._signing = Signing(self.secret, self._clock, read_stamps(self._file), STREAMS)
        self._signing.link = self._signing.link or secrets.randbelow(255) + 1
        self._due_s = self._clock.monotonic_s()

    @property
    def link(self) -> int:
        return self._signing.link

    def stamp(self) -> int:
        """The time stamp of the next frame: ticks of 10 us since 2015, as the clock runs."""
        stamp = self._signing.stamp()
        if self._clock.monotonic_s() >= self._due_s:
            self._due_s = self._clock.monotonic_s() + STAMPS_S
            write_stamps(self._file, self._signing.kept())
        return stamp

    def judge(self, frame: bytes) -> FrameVerdict:
        """A received frame's signature. A frame is valid once."""
        return self._signing.judge(frame)


class Codec:
    """One end of one conversation. A `stream` may cut frames anywhere, datagrams hold whole ones. `counts`: the refused.
    `doubt`: why a boat is not believed whose key is right, or does not believe us, in words; empty: all do. `stranger`: why one
    is not believed whose key is another, or none: anybody may make such a frame."""

    def __init__(self, key: Key | None = None, *, stream: bool = False, me: int = SYSTEM) -> None:
        self.counts = {"heard": 0, "refused": 0}
        self.doubt = self.stranger = ""
        self._key, self._stream, self._cutter = key, stream, wire.Cutter()
        secret, stamp, link = (None, _no_stamp, 0) if key is None else (key.secret, key.stamp, key.link)
        self.encode = wire.Sender(me, COMPONENT, secret, stamp, link).pack

    def decode(self, data: bytes) -> Iterator[Any]:
        """The messages in these bytes. Other bytes are skipped one by one: no noise hides a whole frame."""
        cutter = self._cutter if self._stream else wire.Cutter()
        messages = [self._message(frame) for frame in cutter.cut(data) if frame[0] == wire.MARKER]
        return (message for message in messages if message is not None)

    def _message(self, frame: bytes) -> Any:
        """None for a damaged or unknown message, or one without a valid signature."""
        try:
            message = wire.decode(frame)
        except FormatError:
            self.counts["refused"] += 1
            return None
        if message is None:
            return None
        if self._key is not None and (verdict := self._key.judge(frame)).fault:
            self.counts["refused"] += 1
            self.doubt = f"boat {message.get_srcSystem()} {verdict.words}" if verdict.words else self.doubt
            if verdict.fault in STRANGERS and message.get_srcComponent() == BOAT:
                self.stranger = f"boat {message.get_srcSystem()} {STRANGERS[verdict.fault]}"
            return None
        if self._key is None and frame[2] & mavlink.MAVLINK_IFLAG_SIGNED and message.get_srcComponent() == BOAT:
            number = message.get_srcSystem()
            self.doubt = (
                f"boat {number} obeys nothing from here, no STOP either: she signs, and this console has no key (--key)"
            )
        self.counts["heard"] += 1
        return message


def _no_stamp() -> int:
    return 0


def keygen(file: Path) -> None:
    """A new key, which only its owner can read. Raises ConfigError where the file exists: a key is not lost by mistake."""
    try:
        new_key(file)
    except OSError as error:
        raise ConfigError(str(file), "key", str(error.strerror)) from None
