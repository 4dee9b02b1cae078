"""What a power cut left: every file opens afterwards, nothing flushed is lost, nothing is made up, the originals stay."""

import gzip
import json
import random
import subprocess
import zlib
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim.logging.ashore.repair import mended, pieces, repair
from delfim.logging.ashore.tree import files
from delfim.logging.reading import read_log
from delfim.logging.statelog import Schema, read_state

SCHEMA = Schema([("n", "I", "", "number"), ("x", "d", "m", "place")])


def member(content: bytes, *, cut: bool = False) -> bytes:
    """As liblog writes them, flushed every 1,000 bytes; `cut`: never ended."""
    stream = zlib.compressobj(wbits=31)
    flushed = (
        stream.compress(content[at : at + 1000]) + stream.flush(zlib.Z_SYNC_FLUSH) for at in range(0, len(content), 1000)
    )
    return b"".join(flushed) + stream.flush(zlib.Z_SYNC_FLUSH if cut else zlib.Z_FINISH)


def frames(first: int, count: int) -> bytes:
    return b"".join(b"(1262304000.%06d) can0 123#%08X R\n" % (n, n) for n in range(first, first + count))


def records(first: int, count: int) -> bytes:
    return b"".join(SCHEMA.struct.pack(n, n / 3) for n in range(first, first + count))


def test_a_whole_file_is_left_alone():
    data = member(frames(0, 100)) + member(frames(100, 100))
    assert mended(data, ".log.gz") == (data, "")
    assert mended(frames(0, 5), ".log") == (frames(0, 5), "")


def test_a_cut_file_keeps_its_members_and_everything_up_to_the_last_flush():
    whole = member(frames(0, 100))
    data = whole + member(frames(100, 50), cut=True)
    kept, complaint = mended(data, ".log.gz")
    assert kept.startswith(whole)
    assert gzip.decompress(kept) == frames(0, 150)
    assert "cut after" in complaint


def test_half_a_line_goes_and_half_a_record():
    kept, _ = mended(member(frames(0, 3) + b"(1262304000.0000", cut=True), ".log.gz")
    assert gzip.decompress(kept) == frames(0, 3)
    content = SCHEMA.header + records(0, 3)
    kept, complaint = mended(content + b"\0\0", ".state")
    assert kept == content
    assert "2 bytes" in complaint
    assert mended(b'{"a": 1}\n{"a"', ".jsonl")[0] == b'{"a": 1}\n'


def test_what_lies_behind_a_damage_is_found_again():
    first, second, third = (bytearray(member(frames(n, 1000))) for n in (0, 1000, 2000))
    second[len(second) // 2 :] = b"\xff" * (len(second) - len(second) // 2)
    kept, complaint = mended(bytes(first + second + third), ".log.gz")
    lines = gzip.decompress(kept).splitlines(keepends=True)
    assert lines[:1000] == frames(0, 1000).splitlines(keepends=True)
    assert lines[-1000:] == frames(2000, 1000).splitlines(keepends=True)
    assert len(lines) > 2200, "half of the damaged member can be read"
    assert "damaged" in complaint


def test_records_behind_a_damage_are_in_step():
    first, second = bytearray(member(SCHEMA.header + records(0, 3000))), member(records(3000, 10), cut=True)
    first[-300:] = bytes(300)
    kept, _ = mended(bytes(first) + second, ".state.gz")
    content = gzip.decompress(kept)[len(SCHEMA.header) :]
    numbers = [n for n, _ in SCHEMA.struct.iter_unpack(content)]
    assert numbers == [*range(len(numbers) - 10), *range(3000, 3010)]
    assert len(numbers) > 2500


@pytest.mark.parametrize("data", [b"", bytes(4096), b"\x1f\x8b", member(b"", cut=True)])
@pytest.mark.parametrize("suffix", [".log.gz", ".state.gz"])
def test_a_file_without_content_opens_too(data, suffix):
    kept, complaint = mended(data, suffix)
    assert gzip.decompress(kept) == b""
    assert complaint


def test_zeros_that_the_file_system_left_at_the_end_go():
    whole = member(frames(0, 10))
    kept, _ = mended(whole + bytes(1000), ".log.gz")
    assert kept == whole


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**9))
def test_a_torn_write_makes_no_records_that_never_were(seed):
    """Sectors of what was written since the last sync are zeros: gzip inflates them to something."""
    chance = random.Random(seed)
    stream = zlib.compressobj(wbits=31)
    data, synced, count = stream.compress(SCHEMA.header) + stream.flush(zlib.Z_SYNC_FLUSH), 0, 0
    for _ in range(chance.randrange(2, 8)):
        synced, begin = count, len(data)
        count += chance.randrange(20, 200)
        data += stream.compress(records(synced, count - synced)) + stream.flush(zlib.Z_SYNC_FLUSH)
    torn = bytearray(data)
    for at in range((begin // 512 + 1) * 512, len(torn), 512):
        if chance.random() < 0.5:
            torn[at : at + 512] = bytes(min(512, len(torn) - at))
    content = gzip.decompress(mended(bytes(torn), ".state.gz")[0])[len(SCHEMA.header) :]
    numbers = [n for n, _ in SCHEMA.struct.iter_unpack(content)]
    assert numbers == [*range(len(numbers))]
    assert len(numbers) >= synced


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9), st.booleans())
def test_cut_anywhere_nothing_flushed_is_lost(seed, torn):
    """Whatever the last bytes are, the file opens, and holds all that any reader has of it but for what was not flushed."""
    chance = random.Random(seed)
    content = frames(0, chance.randrange(1, 400))
    half = content.rfind(b"\n", 0, len(content) // 2) + 1
    data = member(content[:half]) + member(content[half:], cut=True)
    data = data[: chance.randrange(len(data) + 1)]
    if torn and len(data) > 64:
        data = data[: len(data) // 64 * 64] + chance.randbytes(64)
    kept, _ = mended(data, ".log.gz")
    got = gzip.decompress(kept)
    assert got == content[: len(got)]
    assert torn or len(got) > len(of_any_reader(data)) - 1000 - 64  # a flush, and a line
    assert b"".join(piece.raw for piece in pieces(data)) == data
    assert not mended(kept, ".log.gz")[1]


def of_any_reader(data: bytes) -> bytes:
    content = b""
    while data[:2] == b"\x1f\x8b":
        stream = zlib.decompressobj(wbits=31)
        content, data = content + stream.decompress(data), stream.unused_data
    return content


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for id_, suffix, content in (("can0", ".log.gz", frames(0, 500)), ("state", ".state.gz", SCHEMA.header + records(0, 500))):
        folder = tmp_path / "20100101" / id_
        folder.mkdir(parents=True)
        (folder / f"093000{suffix}").write_bytes(member(content, cut=True)[:-40])
        (folder / "093000.meta.jsonl").write_bytes(b'{"t_ns": 1, "event": "start"}\n{"t_ns"')
    return tmp_path


@pytest.mark.parametrize("in_place", [False, True])
def test_public_readers_open_what_was_repaired(tree, in_place):
    before = {path: path.read_bytes() for path in tree.rglob("*.*")}
    stamps = {file.id: file.end_ns for file in files([tree])}
    readable = {file.id: read_log(file.path)[0] for file in files([tree])}
    results = [result for file in files([tree]) for result in repair(file, in_place=in_place)]
    assert all(result.complaint and Path(result.target).exists() for result in results)
    assert all((path.read_bytes() == data) != in_place for path, data in before.items())
    assert {file.id: file.end_ns for file in files([tree])} == stamps, "listings do not change"
    box, state = (file.path for file in files([tree]))
    with can.LogReader(box) as reader:
        count = sum(1 for _ in reader)
    assert count == readable["can0"].count(b"\n") > 300
    text = subprocess.run(["zcat", box], capture_output=True, check=True).stdout
    assert text == frames(0, count)
    schema, read, complaint = read_state(state)
    assert not complaint
    assert len(list(read)) == (len(readable["state"]) - len(schema.header)) // schema.struct.size > 100
    for file in files([tree]):
        assert [json.loads(line)["event"] for line in Path(file.sidecar).read_text().splitlines()] == ["start"]
        assert not any(result.complaint for result in repair(file)), "nothing is left to repair"
