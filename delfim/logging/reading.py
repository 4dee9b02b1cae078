"""Reading log files, on any computer: the writers need Linux, those who look at logs afterwards do not."""

import zlib
from collections.abc import Iterable
from pathlib import Path


def read_log(path: str | Path) -> tuple[bytes, str]:
    """What a log file holds, deflated or not, and what is wrong with it, in words; empty when nothing is. Raises OSError.

    A file that a power cut left without its end gives everything up to the last flush.
    """
    data = Path(path).read_bytes()
    if data[:2] != b"\x1f\x8b":
        return data, ""
    text = bytearray()
    while data:
        member = zlib.decompressobj(wbits=31)
        try:
            text += member.decompress(data)
        except zlib.error as error:
            return bytes(text), f"{path}: damaged after {len(text)} bytes of content: {error}"
        if not member.eof:
            return bytes(text), f"{path}: cut after {len(text)} bytes of content"
        data = member.unused_data
    return bytes(text), ""


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Log files in the order in which they were made; plain sorting puts hhmmss-1 before hhmmss."""

    def key(path: Path) -> tuple[str, str, int]:
        time_, _, number = path.name.partition(".")[0].partition("-")
        return path.parts[-3] if len(path.parts) > 2 else "", time_, int(number) if number.isdecimal() else 0

    return sorted(paths, key=key)
