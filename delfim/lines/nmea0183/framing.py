"""Framing of NMEA 0183: bytes of a line to sentences, with their checksum and a count of everything that is refused."""

from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.nmea0183.sentences import ENCAPSULATED, READERS, Message

LONGEST: Final = 200  # characters; the standard says 82, receivers with many decimals and multiplexers go beyond
NAMES_MAX, NAME_MAX = 64, 6  # addresses that are counted one by one, and characters of each
OTHERS: Final = "others"
_FOLDED: Final = 256  # characters that a checksum is made of at once
_DIGITS: Final = tuple(b"%02X" % each for each in range(256))
_new = tuple.__new__  # in half the time of Sentence(...)


class Sentence(NamedTuple):
    """A sentence that was parsed."""

    talker: str  # two characters
    formatter: str  # three
    message: Message


def checksum(body: bytes) -> int:
    """The checksum of the characters between "$" and "*"."""
    if len(body) > _FOLDED:
        return checksum(body[:_FOLDED]) ^ checksum(body[_FOLDED:])
    folded = int.from_bytes(body, "big")  # as one number, whose halves are laid on each other: a third of the time of a loop
    folded ^= folded >> 1024
    folded ^= folded >> 512
    folded ^= folded >> 256
    folded ^= folded >> 128
    folded ^= folded >> 64
    folded ^= folded >> 32
    folded ^= folded >> 16
    return (folded ^ folded >> 8) & 0xFF


def framed(body: str) -> bytes:
    """Frame a sentence as it goes over a line."""
    raw = body.encode("ascii")
    return b"$%b*%b\r\n" % (raw, _DIGITS[checksum(raw)])


class Sentences:
    """The sentences of one line. `heard` counts sound sentences by their address, whether we use them or not; `refused` counts
    the others by their reason. Both are bounded."""

    def __init__(self, needs_checksum: bool = True) -> None:
        """needs_checksum: a sentence without a checksum is refused. One with a wrong checksum always is."""
        self.heard, self.refused = dict[str, int](), dict[str, int]()
        self._needs_checksum, self._rest = needs_checksum, b""

    def feed(self, data: bytes) -> list[Sentence]:
        """Parse the sentences that end in these bytes, in their order. Never raises."""
        lines = (self._rest + data).splitlines()
        rest = lines.pop() if lines and data[-1:] not in (b"\r", b"\n") else b""
        if len(rest) > LONGEST:
            rest = b""
            self._refuse("line without an end")
        self._rest = rest
        found = []
        for line in lines:
            try:
                if line and (one := self._sentence(line)) is not None:
                    found.append(one)
            except FormatError as error:
                self._refuse(str(error))
        return found

    def reset(self) -> None:
        """Begin anew after the line was lost: what comes next does not continue what came before."""
        self._rest = b""

    def _sentence(self, line: bytes) -> Sentence | None:
        """Parse one sentence; None if we do not use its type. Raises FormatError."""
        start = max(line.rfind(b"$"), line.rfind(b"!"))  # noise, a tag block, or half of another one may stand before it
        if start < 0:
            raise FormatError("no sentence")
        body, star, digits = line[start + 1 :].partition(b"*")
        if len(body) > LONGEST:
            raise FormatError("too long")
        if star:
            right = _DIGITS[checksum(body)]
            if digits != right and digits.strip().upper() != right:
                raise FormatError("wrong checksum")
        elif self._needs_checksum:
            raise FormatError("no checksum")
        text = body.decode("latin-1")
        if not (text.isascii() and text.isprintable()):
            raise FormatError("not text")
        fields = text.split(",")
        name, heard = fields[0], self.heard
        if name in heard:
            heard[name] += 1
        else:
            known = name[:NAME_MAX] if name[:NAME_MAX] in heard or len(heard) < NAMES_MAX else OTHERS
            heard[known] = heard.get(known, 0) + 1
        formatter = name[2:]
        known_reader = READERS.get(formatter)
        if known_reader is None or len(name) != 5 or name[0] == "P" or (line[start] == 33) != (formatter in ENCAPSULATED):
            return None
        least, reader = known_reader
        try:
            if len(fields) < least:
                raise FormatError("too few fields")
            return _new(Sentence, (name[:2], formatter, reader(fields)))
        except FormatError as error:
            raise FormatError(f"{formatter}: {error}") from None

    def _refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1
