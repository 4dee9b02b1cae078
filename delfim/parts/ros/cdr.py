"""CDR, the bytes of ROS 2 messages (OMG DDS-XTypes 7.4, XCDR1, little endian): each number is aligned to its size.

Only what the messages of `rosmessages` need. A message begins with four bytes that name the form; alignment counts from behind
them.
"""

import struct
from collections.abc import Sequence
from typing import Final

from delfim.base.errors import FormatError

HEAD: Final = b"\x00\x01\x00\x00"
_SIZES: Final = {"b": 1, "B": 1, "?": 1, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8}
TEXT_BYTES: Final = 1024  # of a string that comes in


class CdrWriter:
    """Writes one message; `data` is its bytes."""

    def __init__(self) -> None:
        self.data = bytearray(HEAD)

    def put(self, code: str, *numbers: float) -> "CdrWriter":
        """Write numbers of one type, by its letter in `struct`."""
        size = _SIZES[code]
        self.data += bytes(-(len(self.data) - len(HEAD)) % size if numbers else 0)
        self.data += struct.pack(f"<{len(numbers)}{code}", *numbers)
        return self

    def text(self, *texts: str) -> "CdrWriter":
        """Write strings: length with the zero at the end, UTF-8."""
        for each in texts:
            coded = each.encode() + b"\0"
            self.put("I", len(coded))
            self.data += coded
        return self


class CdrReader:
    """Reads one message. Each call raises FormatError where the bytes do not go so far."""

    def __init__(self, data: bytes) -> None:
        if data[:4] != HEAD:
            raise FormatError(f"not CDR in little endian: it begins with {data[:4].hex()}")
        self._data, self._at = data, len(HEAD)

    def get(self, code: str, count: int = 1) -> Sequence[float]:
        size = _SIZES[code]
        start = self._at + -(self._at - len(HEAD)) % size
        self._at = start + size * count
        if self._at > len(self._data):
            raise FormatError(f"{len(self._data)} bytes: the message is longer")
        return struct.unpack_from(f"<{count}{code}", self._data, start)

    def text(self) -> str:
        (length,) = self.get("I")
        if not 1 <= length <= TEXT_BYTES or self._at + length > len(self._data):
            raise FormatError(f"a string of {length} bytes")
        start, self._at = self._at, self._at + int(length)
        try:
            return self._data[start : self._at - 1].decode()
        except UnicodeDecodeError:
            raise FormatError("a string that is not UTF-8") from None
