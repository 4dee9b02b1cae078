"""SLIP, RFC 1055: packets in a stream of bytes. The line has no checksum; the packets must have their own."""

from collections.abc import Iterator
from typing import Final

END, ESC, ESC_END, ESC_ESC = b"\xc0", b"\xdb", b"\xdb\xdc", b"\xdb\xdd"
PACKET_MAX: Final = 2048  # longer ones are noise


def framed(packet: bytes) -> bytes:
    """Frame a packet between two ENDs: the first flushes noise on the line."""
    return END + packet.replace(ESC, ESC_ESC).replace(END, ESC_END) + END


class Deframer:
    """Finds packets in bytes as they come. `errors` counts packets that were too long or escaped wrongly."""

    def __init__(self) -> None:
        self.errors = 0
        self._rest = b""

    @property
    def is_within(self) -> bool:
        """Whether a packet has begun and not ended."""
        return bool(self._rest)

    def feed(self, data: bytes) -> Iterator[bytes]:
        """The packets that end in these bytes, empty ones left out. Bounded: a line that never ends a packet is noise."""
        *whole, self._rest = (self._rest + data).split(END)
        if len(self._rest) > 2 * PACKET_MAX:
            self._rest = b""
            self.errors += 1
        for each in whole:
            packet = each.replace(ESC_END, END).replace(ESC_ESC, ESC) if ESC in each else each
            if len(packet) > PACKET_MAX or _is_escaped_wrongly(each):
                self.errors += 1
            elif packet:
                yield packet


def _is_escaped_wrongly(stuffed: bytes) -> bool:
    return stuffed.count(ESC) != stuffed.count(ESC_END) + stuffed.count(ESC_ESC)
