"""Fast packets: NMEA 2000 messages of up to 223 bytes, put together from their frames, and taken apart into them."""

from collections import Counter
from typing import Final


class _Flight:
    """A message under way."""

    __slots__ = ("frames", "sequence", "started_s")

    def __init__(self, sequence: int, started_s: float) -> None:
        self.sequence, self.started_s = sequence, started_s
        self.frames: dict[int, bytes] = {}


class FastPacket:
    """Reassembly of one PGN's fast packets: 3 bits sequence, 5 bits frame number, then data; frame 0 begins with the length
    1..223. Frames may come in any order and twice. At most `IN_FLIGHT` messages per source are under way, the oldest is
    dropped, and so is one that is not complete after `TIMEOUT_S`. Nothing is raised; `errors` counts by reason."""

    IN_FLIGHT: Final = 2
    TIMEOUT_S: Final = 0.75
    LENGTH_MAX: Final = 223

    def __init__(self, errors: Counter[str]) -> None:
        self.errors = errors
        self._flights: dict[int, list[_Flight]] = {}

    def feed(self, source: int, data: bytes, now_s: float) -> bytes | None:
        """Take a frame, and return the message that it completes."""
        if len(data) != 8 or (not data[0] & 31 and not 1 <= data[1] <= self.LENGTH_MAX):
            self.errors["fast packet: malformed frame"] += 1
            return None
        flight = self._flight(source, data, now_s)
        frames = flight.frames
        frames[data[0] & 31] = data
        first = frames.get(0)
        if first is None:
            return None
        needed = 1 + first[1] // 7  # the length and the data, seven bytes a frame
        if len(frames) < needed:
            return None
        self._flights[source].remove(flight)
        if max(frames) >= needed:
            self.errors["fast packet: frame beyond the end"] += 1
            return None
        return (first[2:] + b"".join([frames[number][1:] for number in range(1, needed)]))[: first[1]]

    def _flight(self, source: int, data: bytes, now_s: float) -> _Flight:
        """The message that a frame belongs to, started afresh if the old one can no longer be completed."""
        flights = self._flights.setdefault(source, [])
        sequence = data[0] >> 5
        for flight in flights:
            if flight.sequence != sequence:
                continue
            held = flight.frames.get(data[0] & 31)
            if now_s - flight.started_s > self.TIMEOUT_S:
                self.errors["fast packet: timed out"] += 1
            elif held is None:
                return flight
            elif held == data:
                self.errors["fast packet: duplicated frame"] += 1
                return flight
            else:
                self.errors["fast packet: incomplete"] += 1  # the sequence number came round again
            flights.remove(flight)
            break
        if len(flights) == self.IN_FLIGHT:
            self.errors["fast packet: incomplete"] += 1
            del flights[0]
        flights.append(_Flight(sequence, now_s))
        return flights[-1]


def split(data: bytes, sequence: int) -> list[bytes]:
    """The data of the frames of a message of 1..223 bytes. `sequence` counts the messages of a PGN; 3 bits of it are sent."""
    head, rest = (sequence & 7) << 5, bytes((len(data),)) + data
    return [(bytes((head | i,)) + rest[7 * i : 7 * i + 7]).ljust(8, b"\xff") for i in range(-(-len(rest) // 7))]
