"""A picture with the place and time where it was taken, as Exif (CIPA DC-008, TIFF 6.0) that maps and photo programs read."""

import struct
import time
from typing import Final

_ASCII, _LONG, _RATIONAL = 2, 4, 5
_DESCRIPTION, _TIME, _GPS = 0x010E, 0x0132, 0x8825
_HEAD: Final = b"MM\0*\0\0\0\x08"
Field = tuple[int, int, int, bytes]  # tag, type, count, value


def with_place(jpeg: bytes, latitude_deg: float | None, longitude_deg: float | None, taken_ms: int, words: str) -> bytes:
    """The JPEG with Exif; without GPS fields where the place is not known."""
    moment = time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(taken_ms // 1000))
    fields = [_text(_DESCRIPTION, words), _text(_TIME, moment)]
    if latitude_deg is None or longitude_deg is None:
        tiff = _HEAD + _directory(fields, 8)
    else:
        gps = [_text(1, "N" if latitude_deg >= 0 else "S"), _angle(2, latitude_deg)]
        gps += [_text(3, "E" if longitude_deg >= 0 else "W"), _angle(4, longitude_deg)]
        size = len(_directory([*fields, (_GPS, _LONG, 1, bytes(4))], 8))
        tiff = _HEAD + _directory([*fields, (_GPS, _LONG, 1, struct.pack(">I", 8 + size))], 8) + _directory(gps, 8 + size)
    exif = b"Exif\0\0" + tiff
    return jpeg[:2] + struct.pack(">BBH", 0xFF, 0xE1, len(exif) + 2) + exif + jpeg[2:]


def _text(tag: int, words: str) -> Field:
    value = words.encode("ascii", "replace")[:200] + b"\0"
    return tag, _ASCII, len(value), value


def _angle(tag: int, degrees: float) -> Field:
    """Degrees, minutes and seconds, as fractions."""
    ticks = round(abs(degrees) * 3600 * 10_000)
    return tag, _RATIONAL, 3, struct.pack(">6I", ticks // 36_000_000, 1, ticks // 600_000 % 60, 1, ticks % 600_000, 10_000)


def _directory(fields: list[Field], at: int) -> bytes:
    """An image file directory that begins at this place, with its long values behind it."""
    rows, rest = struct.pack(">H", len(fields)), b""
    behind = at + 2 + 12 * len(fields) + 4
    for tag, kind, count, value in fields:
        if len(value) <= 4:
            rows += struct.pack(">HHI4s", tag, kind, count, value)
        else:
            rows += struct.pack(">HHII", tag, kind, count, behind + len(rest))
            rest += value + b"\0" * (len(value) % 2)
    return rows + bytes(4) + rest
