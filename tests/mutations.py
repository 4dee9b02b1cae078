"""Files as no program of ours writes them: cut, flipped, spliced, nested, blown up. The same seed gives the same file."""

import gzip
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import cache
from random import Random

BOMB_BYTES = 64 << 20  # once it is inflated
NUMBERS = ("1e400", "-1e400", "nan", "inf", "9" * 25, "9" * 5000, "-1", "0", "1e-320", "0x7fffffffffffffff", "4294967296")
INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, (1 << 63) - 1, (1 << 64) - 1)
VALUES = (
    *("true", '"text"', "1979-05-27T07:32:00Z", "07:32:00", "[]", "[[]]", "{}", "[1, 'a']", "-3", "3.5", "null"),
    '"\\u001b[2J\\n"',
)
STRANGE = (
    *(b"\x00" * 40, b"\xff\xfe\xfd", b"\xc3\x28", b"\xed\xa0\x80", b"\x1b[2J\x07", b"\r\n\r\n", b"../" * 30, b"\xe2\x80\xae"),
    b"A" * 200_000,
)

Mutation = Callable[[bytes, Random], bytes]


def _place(data: bytes, random: Random) -> int:
    return random.randrange(len(data) + 1)


def flipped(data: bytes, random: Random) -> bytes:
    bits = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8, 40)) if bits else 0):
        bits[random.randrange(len(bits))] ^= 1 << random.randrange(8)
    return bytes(bits)


def cut(data: bytes, random: Random) -> bytes:
    return data[: _place(data, random)] if random.random() < 0.7 else data[_place(data, random) :]


def spliced(data: bytes, random: Random) -> bytes:
    """A piece of it once more, or instead of another."""
    begin, to = _place(data, random), _place(data, random)
    piece = data[begin : begin + random.choice((4, 30, 400, 5000))]
    return data[:to] + piece * random.choice((1, 1, 1, 50)) + data[to + random.choice((0, len(piece))) :]


def dropped(data: bytes, random: Random) -> bytes:
    begin = _place(data, random)
    return data[:begin] + data[begin + random.choice((1, 2, 20, 300)) :]


def stuffed(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + random.choice(STRANGE) + data[at:]


def counted(data: bytes, random: Random) -> bytes:
    """Another integer somewhere, in either order of bytes."""
    number, size = random.choice(INTEGERS), random.choice((1, 2, 4, 8))
    at = _place(data, random)
    return data[:at] + (number & ((1 << 8 * size) - 1)).to_bytes(size, random.choice(("little", "big"))) + data[at + size :]


def numbered(data: bytes, random: Random) -> bytes:
    """Another number in a text."""
    found = list(re.finditer(rb"[0-9][0-9.]*", data[:100_000]))
    if not found:
        return stuffed(data, random)
    one = random.choice(found)
    return data[: one.start()] + random.choice(NUMBERS).encode() + data[one.end() :]


def exchanged(data: bytes, random: Random) -> bytes:
    """A value of another type behind = or : of a text."""
    found = list(re.finditer(rb"[=:] *([^\n,}\]]+)", data[:100_000]))
    if not found:
        return spliced(data, random)
    one = random.choice(found)
    return data[: one.start(1)] + random.choice(VALUES).encode() + data[one.end(1) :]


def nested(data: bytes, random: Random) -> bytes:
    depth = random.choice((20, 500, 3000, 60_000))
    form = random.choice(("[", "{", '{"a":', "a=[", "[a.", "{a="))
    deep = (form * depth + random.choice(("", "1" + {"[": "]", "{": "}"}.get(form[0], "") * depth))).encode()
    if random.random() < 0.5:
        found = list(re.finditer(rb"[=:] *([^\n,}\]]+)", data[:100_000]))
        if found:
            one = random.choice(found)
            return data[: one.start(1)] + deep + data[one.end(1) :]
    at = data.rfind(b"\n", 0, _place(data, random)) + 1
    return data[:at] + deep + b"\n" + data[at:]


def shuffled(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    random.shuffle(lines)
    return b"".join(lines)


BINARY: tuple[Mutation, ...] = (flipped, flipped, cut, spliced, dropped, stuffed, counted, counted)
TEXT: tuple[Mutation, ...] = (flipped, cut, spliced, dropped, stuffed, numbered, exchanged, exchanged, nested, shuffled)


@cache
def bomb() -> bytes:
    """A small gzip member that inflates to a large one."""
    stream = zlib.compressobj(9, wbits=31)
    block = bytes(1 << 20)
    return b"".join([*(stream.compress(block) for _ in range(BOMB_BYTES >> 20)), stream.flush()])


def deflated(inside: Iterable[Mutation]) -> tuple[Mutation, ...]:
    """Mutations of a gzip file: of its bytes, and of what it holds."""

    def content(data: bytes, random: Random) -> bytes:
        return gzip.compress(random.choice(tuple(inside))(gzip.decompress(data), random), 1, mtime=0)

    def members(data: bytes, random: Random) -> bytes:
        text = gzip.decompress(data)
        at = _place(text, random)
        parts = [gzip.compress(each, 1, mtime=0) for each in (text[:at], text[at:])]
        between = random.choice((b"", b"\0" * 9))
        return random.choice((parts[0] + between + parts[1], parts[1] + parts[0], parts[0] + flipped(parts[1], random)))

    def crowd(data: bytes, random: Random) -> bytes:
        return gzip.compress(b"", mtime=0) * random.choice((100, 20_000)) + data

    def false_heads(data: bytes, random: Random) -> bytes:
        return random.choice((data, b"")) + b"\x1f\x8b\x08\0\0\0\0\0\0\x03" * random.choice((10, 3000)) + data

    def blown_up(data: bytes, random: Random) -> bytes:
        return random.choice((bomb(), data + bomb(), bomb()[:-30], bomb() + data))

    return (*BINARY, content, content, content, content, members, crowd, false_heads, blown_up)


def large_png(data: bytes, random: Random) -> bytes:
    """A picture that says to be larger than a memory; its rows are a few zeros."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    width, height = (random.choice((1, 4000, 13_000, 60_000, 2**31 - 1)) for _ in range(2))
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i"
TILES = "DROP TABLE tiles; CREATE VIEW tiles AS"
ODDITIES = (
    f"{TILES} {ENDLESS} AS zoom_level, 0 AS tile_column, 0 AS tile_row, x'00' AS tile_data FROM n",
    f"DROP TABLE metadata; CREATE VIEW metadata AS {ENDLESS} AS name, i AS value FROM n",
    f"{TILES} SELECT 12 AS zoom_level, 1943 AS tile_column, 2513 AS tile_row, zeroblob(900000000) AS tile_data",
    f"{TILES} SELECT * FROM tiles",
    *(f"UPDATE tiles SET zoom_level = {value}" for value in ("9e999", "'deep'", "NULL", "x'ff'", "1 << 62", "-5")),
    *(f"UPDATE tiles SET tile_data = {value}" for value in ("NULL", "'text'", "7", "zeroblob(9000000)")),
    *(
        f"UPDATE metadata SET value = {value}"
        for value in ("'1e999,1,2,3'", "'nan,nan,nan,nan'", "NULL", "x'ff00'", "'\x1b[2J'")
    ),
    "UPDATE metadata SET value = '{}', name = 'format'",
    "DROP TABLE tiles",
    "DROP TABLE metadata",
    "DELETE FROM tiles",
)


def odd_tables(data: bytes, random: Random) -> bytes:
    """A whole database with tables that are none."""
    with closing(sqlite3.connect(":memory:")) as base:
        base.deserialize(data)
        base.executescript(random.choice(ODDITIES))
        return base.serialize()
