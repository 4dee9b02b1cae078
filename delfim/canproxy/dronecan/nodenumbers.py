"""Allocates numbers to DroneCAN devices that have none (specification, chapter 5.3: Allocation); a pure object.

A device sends the 16 bytes of its identity in parts of 6, 6 and 4; the answer repeats what was heard so far, and with all of
them gives the number. A part that comes too late starts again. A device that comes back gets the number it had, unless all were
given away meanwhile: then the one whose number was silent for longest has lost it.
"""

import math
from typing import Final

from delfim.canproxy.dronecan.datatypes import NumberRequest
from delfim.canproxy.dronecan.transfers import NODE_MAX

FOLLOW_UP_S: Final = 0.5
SILENT_S: Final = 60.0  # a number that is not heard for so long may be given away; each device says something every second
IDENTITY_BYTES: Final = 16
_PART_BYTES: Final = {0: 6, 6: 6, 12: 4}  # by how many are known


class Allocator:
    """Allocates numbers. `table` has the number of each identity; keep it over a restart of the program."""

    def __init__(self, table: dict[bytes, int], own: int) -> None:
        self.table = table
        self._spoke_s = {own: math.inf}  # by number
        self.refused = 0  # devices that got none, because all numbers are given away
        self._heard, self._heard_s = b"", 0.0
        self._began_s: float | None = None

    def hear(self, number: int, now_s: float) -> None:
        """Note that the node with this number sends on the bus."""
        self._spoke_s[number] = max(now_s, self._spoke_s.get(number, now_s))

    def feed(self, asked: NumberRequest, now_s: float) -> NumberRequest | None:
        """Take the request of a device without a number; return the answer to broadcast, if there is one."""
        self._began_s = now_s if self._began_s is None else self._began_s
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
        number = self.table.get(identity) or self._free(asked.node or NODE_MAX) or self._left(now_s)
        if not number:
            self.refused += 1
            return None
        self.table[identity] = number
        self.hear(number, now_s)
        return NumberRequest(number, False, identity)

    def _free(self, preferred: int) -> int:
        """A free number, searched upward from the one that the device prefers, then downward; 0: there is none."""
        taken = {*self._spoke_s, *self.table.values()}
        first = min(preferred, NODE_MAX)
        return next((each for each in (*range(first, NODE_MAX + 1), *range(first, 0, -1)) if each not in taken), 0)

    def _left(self, now_s: float) -> int:
        """Take the number of a device that is absent; 0: all are there. Otherwise a sender of made-up identities would have
        them all for ever."""
        began_s = now_s if self._began_s is None else self._began_s
        silent_s = {identity: now_s - self._spoke_s.get(number, began_s) for identity, number in self.table.items()}
        longest = max(silent_s, key=silent_s.__getitem__, default=b"")
        return self.table.pop(longest) if silent_s.get(longest, 0.0) > SILENT_S else 0
