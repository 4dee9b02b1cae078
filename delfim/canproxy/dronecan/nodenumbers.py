"""Numbers for DroneCAN devices that have none (specification, chapter 5.3: Allocation), as a pure object.

A device sends the 16 bytes of its identity in parts of 6, 6 and 4; the answer repeats what was heard so far, and with all of
them gives the number. A part that comes too late starts again. A device that comes back gets the number it had.
"""

from typing import Final

from delfim.canproxy.dronecan.datatypes import NumberRequest
from delfim.canproxy.dronecan.transfers import NODE_MAX

FOLLOW_UP_S: Final = 0.5
IDENTITY_BYTES: Final = 16
_PART_BYTES: Final = {0: 6, 6: 6, 12: 4}  # by how many are known


class Allocator:
    """`table` has the number of each identity; keep it over a restart of the program. `taken` are numbers that speak on the
    bus, our own among them."""

    def __init__(self, table: dict[bytes, int], own: int) -> None:
        self.table, self.taken = table, {own}
        self.refused = 0  # devices that got none, because all numbers are given away
        self._heard, self._heard_s = b"", 0.0

    def feed(self, asked: NumberRequest, now_s: float) -> NumberRequest | None:
        """A request of a device without a number; returns the answer for all to hear, if there is one."""
        if asked.is_first:
            self._heard = b""
        elif not self._heard or now_s - self._heard_s > FOLLOW_UP_S:
            self._heard = b""
            return None  # of another server's talk, or too late: the device begins again by itself
        if len(asked.identity) != _PART_BYTES[len(self._heard)]:
            self._heard = b""
            return None
        self._heard, self._heard_s = self._heard + asked.identity, now_s
        if len(self._heard) < IDENTITY_BYTES:
            return NumberRequest(0, False, self._heard)
        identity, self._heard = self._heard, b""
        number = self.table.get(identity) or self._free(asked.node or NODE_MAX)
        if not number:
            self.refused += 1
            return None
        self.table[identity] = number
        return NumberRequest(number, False, identity)

    def _free(self, preferred: int) -> int:
        """Upward from the number that the device would like, then downward; 0: there is none."""
        taken = self.taken.union(self.table.values())
        first = min(preferred, NODE_MAX)
        return next((each for each in (*range(first, NODE_MAX + 1), *range(first, 0, -1)) if each not in taken), 0)
