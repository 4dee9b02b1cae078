"""MAVLink 2 as the console speaks it: bytes to messages and back, signed where there is a key. Modes and their numbers.

The codec is pymavlink's, used without its links (mavutil): it does the framing, the checksums and the signatures. What a boat
says and obeys: docs/mavlink.md.
"""

import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from delfim.clock import Clock, SystemClock
from delfim.errors import ConfigError

__all__ = ["COMPONENT", "MODES", "NAMES", "SYSTEM", "Codec", "Key", "keygen", "mavlink"]

SYSTEM: Final = 250  # of this console; QGroundControl and MAVProxy call themselves 255
COMPONENT: Final = mavlink.MAV_COMP_ID_MISSIONPLANNER
KEY_BYTES: Final = 32
TICK_NS: Final = 10_000
_EPOCH_NS: Final = 1_420_070_400_000_000_000
_STORE_EVERY: Final = 100_000 * 30  # ticks: half a minute

MODES: Final = {
    "idle": 4,
    "manual": 0,
    "heading": 3,
    "hold": 5,
    "play": 10,
    "home": 11,
    "goto": 15,
    "path": 100,
    "grex": 101,
}
NAMES: Final = {number: name for name, number in MODES.items()}


class Codec:
    """One end of one conversation. `counts` says what was refused."""

    def __init__(self, key: "Key | None" = None, link_id: int = 0) -> None:
        self.counts = {"heard": 0, "refused": 0}
        self._mav = mavlink.MAVLink(None, SYSTEM, COMPONENT)
        self._mav.robust_parsing = True
        self._key = key
        if key is not None:
            signing = self._mav.signing
            signing.secret_key, signing.link_id = key.secret, link_id
            signing.sign_outgoing = True

    def encode(self, message: Any) -> bytes:
        if self._key is not None:
            self._mav.signing.timestamp = self._key.stamp()
        data: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) & 0xFF  # which only pymavlink's own links count
        return data

    def decode(self, data: bytes) -> Iterator[Any]:
        """The messages in these bytes; a stream may be cut anywhere. What is damaged, unsigned or replayed is counted."""
        try:
            messages = self._mav.parse_buffer(data) or []
        except mavlink.MAVError:
            self.counts["refused"] += 1
            return
        for message in messages:
            if message.get_type() == "BAD_DATA":
                self.counts["refused"] += 1
            else:
                self.counts["heard"] += 1
                yield message


class Key:
    """A signing key in a file of 64 hexadecimal digits, and the time stamps of the frames that are signed with it.

    A stamp is the time in ticks of 10 us since 2015, as a boat judges by it how long a command was on its way; so it runs with
    the clock, by which it begins, but never back or twice: the last is kept in a file beside the key. Raises ConfigError.
    """

    def __init__(self, file: Path, clock: Clock | None = None) -> None:
        try:
            self.secret = bytes.fromhex(file.read_text().strip())
        except (OSError, ValueError) as error:
            raise ConfigError(str(file), "key", f"{error}; make one with: delfim console --keygen {file}") from None
        if len(self.secret) != KEY_BYTES:
            raise ConfigError(str(file), "key", f"{len(self.secret)} bytes", f"{KEY_BYTES} bytes")
        self._clock = clock or SystemClock()
        self._stamp_file = file.with_suffix(".stamp")
        try:
            self._last = self._stored = int(self._stamp_file.read_text())
        except (OSError, ValueError):
            self._last = self._stored = 0
        self._begin = (self._clock.time_ns() - _EPOCH_NS) // TICK_NS - self._ticks()

    def stamp(self) -> int:
        """For the next frame that is sent."""
        self._last = max(self._last + 1, self._begin + self._ticks())
        if self._last >= self._stored + _STORE_EVERY:
            self._store()
        return self._last

    def _ticks(self) -> int:
        return int(self._clock.monotonic_s() * 1e9) // TICK_NS

    def _store(self) -> None:
        self._stored = self._last
        new = self._stamp_file.with_suffix(".new")
        new.write_text(str(self._stored))
        os.replace(new, self._stamp_file)


def keygen(file: Path) -> None:
    """A new key, which only its owner can read. Raises ConfigError where the file exists: a key is not lost by mistake."""
    try:
        with open(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as out:
            out.write(secrets.token_hex(KEY_BYTES) + "\n")
    except OSError as error:
        raise ConfigError(str(file), "key", str(error.strerror)) from None
