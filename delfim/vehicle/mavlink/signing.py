"""Signed MAVLink 2 frames: only holders of the key, no frame twice or late (mavlink.io/en/guide/message_signing.html).

A signature is the first 48 bits of SHA-256 over key and frame, with a time stamp that only grows: authentication, not secrecy.
Hashing a frame takes about a microsecond, so the loop does it.
"""

import hashlib
import hmac
import os
import secrets
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from delfim.clock import Clock
from delfim.errors import ConfigError
from delfim.outside import UNREADABLE, read_file

KEY_BYTES: Final = 32
EPOCH_NS: Final = 1_420_070_400_000_000_000  # time stamps count 10 us since 2015
PER_S: Final = 100_000  # of them
NEW_STREAM_S: Final = 60.0  # a new speaker may be this far behind this clock
STREAMS: Final = 64  # speakers at most
DRIFT: Final = 1e-4  # of two clocks against each other, generously

Stream = tuple[int, int, int]  # link, system, component


class FrameVerdict(NamedTuple):
    """`fault` names the error of a frame, under which it is counted; empty: none. `age_s`: how much longer than the fastest
    frame of its speaker it was on the way."""

    fault: str
    age_s: float = 0.0


class Signing:
    """The time stamps heard of each speaker, of so many at most, and the next one to send. `stamps`: each speaker's last in the
    run before."""

    def __init__(self, key: bytes, clock: Clock, stamps: dict[Stream, int], streams: int = STREAMS) -> None:
        self.key, self._clock, self._streams = key, clock, streams
        self.stamps = dict(stamps)
        self._sent = max(stamps.values(), default=0)
        self._ahead_s: dict[Stream, tuple[float, float]] = {}  # least delay, clocks' difference included; and when

    def stamp(self) -> int:
        """The stamp of the next frame to send: this clock's time, but later than the stamp before."""
        self._sent = max(self._sent + 1, self._now())
        return self._sent

    def judge(self, frame: bytes) -> FrameVerdict:
        """A frame as it came. A valid frame is remembered, and is not valid a second time."""
        if not frame[2] & 1:
            return FrameVerdict("unsigned")
        signature = hashlib.sha256(self.key + frame[:-6]).digest()[:6]
        if not hmac.compare_digest(signature, frame[-6:]):
            return FrameVerdict("forged")
        stream, stamp = (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        last = self.stamps.get(stream)
        if last is None and (len(self.stamps) >= self._streams or stamp < max(self._sent, self._now()) - NEW_STREAM_S * PER_S):
            return FrameVerdict("replayed")
        if last is not None and stamp <= last:
            return FrameVerdict("replayed")
        self.stamps[stream] = stamp
        return FrameVerdict("", self._age_s(stream, stamp))

    def _age_s(self, stream: Stream, stamp: int) -> float:
        now_s = self._clock.monotonic_s()
        delay_s = now_s - stamp / PER_S
        least_s, at_s = self._ahead_s.get(stream, (delay_s, now_s))
        least_s = min(least_s + DRIFT * (now_s - at_s), delay_s)
        self._ahead_s[stream] = least_s, now_s
        return delay_s - least_s

    def _now(self) -> int:
        return max(self._clock.time_ns() - EPOCH_NS, 0) // (1_000_000_000 // PER_S)


def new_key(path: str | Path) -> None:
    """Write a new key, for its owner alone. Raises OSError, FileExistsError too: a key that boats know is not replaced."""
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_hex(KEY_BYTES) + "\n")


def read_key(path: str | Path) -> bytes:
    """The key in a file of 64 hexadecimal digits. Raises ConfigError, for a file that others may read, too."""
    try:
        if os.name == "posix" and Path(path).stat().st_mode & 0o077:
            raise ConfigError(str(path), "key", "others may read it", "mode 0600")
        key = bytes.fromhex(read_file(path).decode("ascii").strip())
    except OSError as error:
        raise ConfigError(str(path), "key", error.strerror or str(error)) from None
    except ValueError:
        raise ConfigError(str(path), "key", "no key", f"{2 * KEY_BYTES} hexadecimal digits") from None
    if len(key) != KEY_BYTES:
        raise ConfigError(str(path), "key", f"{len(key)} bytes", f"{2 * KEY_BYTES} hexadecimal digits")
    return key


def read_stamps(path: str | Path, streams: int = STREAMS) -> dict[Stream, int]:
    """The last stamps of the run before; none if the file is missing or unreadable."""
    try:
        rows = msgspec.json.decode(read_file(path), type=list[tuple[Stream, int]])
    except (OSError, *UNREADABLE):
        return {}
    return dict(rows[:streams])


def write_stamps(path: str | Path, stamps: dict[Stream, int]) -> None:
    """Write the file whole or not at all. Raises OSError."""
    fresh = Path(f"{path}.new")
    fresh.write_bytes(msgspec.json.encode(list(stamps.items())))
    fresh.replace(path)
