"""Proprietary sentences, such as those of a boat's front seat, as their fields. Only those with a right checksum are taken:
without one, a damaged figure would look like a figure."""

from delfim.lines.nmea0183.framing import LONGEST, checksum


def fields(line: bytes) -> list[str] | None:
    """The fields of a line, without "$" and checksum; None where it is no whole sentence."""
    text, star, told = line.strip().rpartition(b"*")
    if not star or text[:1] != b"$" or len(told) != 2 or len(line) > LONGEST:
        return None
    try:
        return text[1:].decode("ascii").split(",") if int(told, 16) == checksum(text[1:]) else None
    except ValueError:
        return None


def number(text: str) -> float | None:
    """A finite number; None for an empty field. Raises ValueError for anything else."""
    if not text:
        return None
    if not -1e9 < (value := float(text)) < 1e9:
        raise ValueError(f"{text[:20]} is out of range")
    return value


class FieldReader:
    """Reads the sentences of a port that delivers them in pieces."""

    def __init__(self) -> None:
        self.malformed = 0  # lines that were no sentences
        self._rest = b""

    def feed(self, data: bytes) -> list[list[str]]:
        """The fields of each sentence that these bytes complete. Never raises."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = [fields(line) for line in lines if line.strip()]
        if len(self._rest) > LONGEST:
            self._rest, found = b"", [*found, None]
        self.malformed += sum(each is None for each in found)
        return [each for each in found if each is not None]
