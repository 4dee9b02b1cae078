"""UBX frames among the other bytes of a receiver's line (u-blox F9 interface description, "UBX frame structure").

A frame is B5 62, class, number, length (2 bytes, little endian), payload, and two bytes of Fletcher's checksum over all
between. Nothing here raises: what is no sound frame is counted and passed over, so that no byte is looked at twice.
"""

from itertools import accumulate
from typing import Final, NamedTuple

SYNC: Final = b"\xb5\x62"
PAYLOAD_MAX: Final = 1024  # of all that a navigating receiver sends; a longer one is passed over as noise
_HEAD, _REST = 6, 8  # bytes before the payload, and in all beside it


class UbxFrame(NamedTuple):
    """A frame with a right checksum."""

    kind: int  # class * 256 + number
    payload: bytes


def checksum(body: bytes) -> bytes:
    """The checksum of class, number, length and payload."""
    return bytes((sum(body) & 0xFF, sum(accumulate(body)) & 0xFF))


def framed(kind: int, payload: bytes) -> bytes:
    """Frame a payload as it goes over a line."""
    body = kind.to_bytes(2, "big") + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + checksum(body)


class UbxFrames:
    """The frames of one line. `refused` counts what began as a frame and is none, by its reason."""

    def __init__(self) -> None:
        self.refused = dict[str, int]()
        self._rest = b""

    def feed(self, data: bytes) -> list[UbxFrame | bytes]:
        """The frames that end in these bytes, and between them all that belongs to none, in their order."""
        if data and not self._rest and SYNC[:1] not in data:  # all of a line that has sentences alone
            return [data]
        found: list[UbxFrame | bytes] = []
        data, at = self._rest + data, 0
        while (start := data.find(SYNC, at)) >= 0:
            if start > at:
                found.append(data[at:start])
            at = start
            length = int.from_bytes(data[start + 4 : start + 6], "little")
            end = start + _REST + length
            if len(data) < start + _HEAD:
                break  # the rest comes later
            if length > PAYLOAD_MAX:
                self._refuse("UBX: too long")
                at = start + len(SYNC)
                continue
            if len(data) < end:
                break
            if checksum(data[start + 2 : end - 2]) == data[end - 2 : end]:
                found.append(UbxFrame(data[start + 2] << 8 | data[start + 3], data[start + _HEAD : end - 2]))
            else:
                self._refuse("UBX: wrong checksum")
            at = end
        else:
            start = len(data) - (data[-1:] == SYNC[:1])
            if start > at:
                found.append(data[at:start])
        self._rest = data[start:]
        return found

    def _refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1
