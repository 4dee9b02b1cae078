"""MAVLink 2 as the console speaks it: bytes to messages and back, signed where there is a key. Modes and their numbers.

The codec is pymavlink's, used without its links (mavutil): it does the framing, the checksums and the signatures. What a boat
says and obeys: docs/mavlink.md.
"""

import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from delfim.errors import ConfigError

__all__ = ["COMPONENT", "MODES", "NAMES", "SYSTEM", "Codec", "Key", "keygen", "mavlink"]

SYSTEM: Final = 250  # of this console; QGroundControl and MAVProxy call themselves 255
COMPONENT: Final = mavlink.MAV_COMP_ID_MISSIONPLANNER
KEY_BYTES: Final = 32
_EPOCH_2015_S: Final = 1_420_070_400
_STORE_EVERY: Final = 100_000 * 30  # ticks of 10 us: half a minute

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
            signing.secret_key, signing.link_id, signing.timestamp = key.secret, link_id, key.stamp()
            signing.sign_outgoing = True

    def encode(self, message: Any) -> bytes:
        data: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) & 0xFF  # which only pymavlink's own links count
        if self._key is not None:
            self._key.used(self._mav.signing.timestamp)
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
    """A signing key in a file of 64 hexadecimal digits, and beside it the time stamp of the last frame that was signed: it may
    never go back, whatever the clock does. Raises ConfigError."""

    def __init__(self, file: Path) -> None:
        try:
            self.secret = bytes.fromhex(file.read_text().strip())
        except (OSError, ValueError) as error:
            raise ConfigError(str(file), "key", f"{error}; make one with: delfim console --keygen {file}") from None
        if len(self.secret) != KEY_BYTES:
            raise ConfigError(str(file), "key", f"{len(self.secret)} bytes", f"{KEY_BYTES} bytes")
        self._stamp_file = file.with_suffix(".stamp")
        try:
            self._stored = int(self._stamp_file.read_text())
        except (OSError, ValueError):
            self._stored = 0

    def stamp(self) -> int:
        """Where to begin, in ticks of 10 us since 2015."""
        begin = max(round((time.time() - _EPOCH_2015_S) * 1e5), self._stored + _STORE_EVERY)
        self._store(begin)
        return begin

    def used(self, stamp: int) -> None:
        """A frame was signed with this."""
        if stamp >= self._stored + _STORE_EVERY:
            self._store(stamp)

    def _store(self, stamp: int) -> None:
        self._stored = stamp
        whole = self._stamp_file.with_suffix(".new")
        whole.write_text(str(stamp))
        os.replace(whole, self._stamp_file)


def keygen(file: Path) -> None:
    """A new key, which only its owner can read. Raises ConfigError where the file exists: a key is not lost by mistake."""
    try:
        with open(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as out:
            out.write(secrets.token_hex(KEY_BYTES) + "\n")
    except OSError as error:
        raise ConfigError(str(file), "key", str(error.strerror)) from None
