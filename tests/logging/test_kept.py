"""A record that survives: slots torn at every byte, disks that fail, a writer that dies or hangs."""

import asyncio
import contextlib
import errno
import os
import subprocess
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.logging.kept import writer
from delfim.logging.kept.record import Keeper, newest
from delfim.logging.kept.writer import NewestRecord, keep, packed, slot, store, unpacked

KEY = bytes(range(32))
NEVER = threading.Event()


@given(st.integers(0, 1 << 60), st.binary(max_size=400), st.binary(max_size=40))
def test_a_slot_is_read_as_it_was_written(sequence, record, key):
    assert unpacked(packed(sequence, record, key), key) == (sequence, record)
    assert unpacked(packed(sequence, record, key) + b"the end of a longer one before", key) == (sequence, record)


@given(st.binary(max_size=60), st.data())
def test_a_slot_that_was_changed_is_not_read(record, data):
    content = bytearray(packed(7, record, KEY))
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(FormatError):
        unpacked(bytes(content), KEY)
    with pytest.raises(FormatError):
        unpacked(packed(7, record, KEY), b"another key")


def test_a_write_that_is_cut_at_any_byte_leaves_the_record_before(tmp_path):
    store(str(tmp_path), "voyage", 1, packed(1, b"one", KEY))
    store(str(tmp_path), "voyage", 2, packed(2, b"two", KEY))
    before = Path(slot(str(tmp_path), "voyage", 3)).read_bytes()
    content = packed(3, b"three, which is longer", KEY)
    for cut in range(len(content) + 1):
        torn = content[:cut] + before[cut:]
        Path(slot(str(tmp_path), "voyage", 3)).write_bytes(torn)
        assert newest([str(tmp_path)], "voyage", KEY) in ((2, b"two"), (3, b"three, which is longer"))
    assert newest([str(tmp_path)], "voyage", KEY) == (3, b"three, which is longer")


def test_no_slot_is_no_voyage_and_no_whole_slot_is_told(tmp_path):
    assert newest([str(tmp_path), "/nowhere"], "voyage", KEY) == (0, None)
    for number in (0, 1):
        Path(slot(str(tmp_path), "voyage", number)).write_bytes(b"delfim kept 1 3 00\nabc")
    with pytest.raises(FormatError, match="torn, or not written by this boat"):
        newest([str(tmp_path)], "voyage", KEY)


def until(keeper: Keeper, directory: Path, record: bytes) -> None:
    for _ in range(6000):
        keeper.poll()
        with contextlib.suppress(FormatError):  # the first record is being written
            if newest([str(directory)], "voyage", KEY)[1] == record:
                return
        NEVER.wait(0.01)
    raise AssertionError(f"{record!r} was not kept in {directory}")


def keeping(directory: Path) -> tuple[Keeper, subprocess.Popen[bytes]]:
    """A keeper that has kept its first record, and its child."""
    keeper = Keeper([str(directory)], "voyage", KEY, 0)
    keeper.put(b"first")
    until(keeper, directory, b"first")
    assert keeper._child is not None
    return keeper, keeper._child


def test_the_newest_record_is_kept_in_both_places_and_goes_on_in_the_next_run(tmp_path):
    places = [tmp_path / "memory", tmp_path / "disk"]
    for place in places:
        place.mkdir()
    keeper = Keeper([str(place) for place in places], "voyage", KEY, 0)
    for number in range(5):
        assert keeper.put(b"record %d" % number)
    asyncio.run(keeper.close(60.0))
    assert {newest([str(place)], "voyage", KEY)[1] for place in places} == {b"record 4"}
    sequence, _ = newest([str(place) for place in places], "voyage", KEY)
    again = Keeper([str(places[0])], "voyage", KEY, sequence)
    again.put(b"of the next run")
    asyncio.run(again.close(60.0))
    assert newest([str(place) for place in places], "voyage", KEY)[1] == b"of the next run"


def test_a_place_that_fails_does_not_keep_the_record_from_the_other(tmp_path):
    keeper = Keeper([str(tmp_path / "nowhere"), str(tmp_path)], "voyage", KEY, 0)
    assert keeper.put(b"here")
    until(keeper, tmp_path, b"here")
    while not keeper.troubles:
        keeper.poll()
        NEVER.wait(0.01)
    assert keeper.troubles == {str(tmp_path / "nowhere"): "No such file or directory"}
    (tmp_path / "nowhere").mkdir()
    keeper.put(b"there, too")
    until(keeper, tmp_path / "nowhere", b"there, too")
    asyncio.run(keeper.close(60.0))


def test_a_writer_that_died_is_started_again(tmp_path):
    keeper, child = keeping(tmp_path)
    child.kill()
    while keeper._child is not None:
        keeper.poll()
    assert keeper.put(b"after")
    until(keeper, tmp_path, b"after")
    asyncio.run(keeper.close(60.0))


def test_a_pipe_that_is_full_does_not_hold_the_caller(tmp_path):
    """The child is stopped: of all that it is given it gets what the pipe holds, and the next record says the rest."""
    keeper, child = keeping(tmp_path)
    os.kill(child.pid, 19)
    taken = [keeper.put(bytes(400_000)) for _ in range(20)]
    assert True in taken
    assert taken[-1] is False
    os.kill(child.pid, 18)
    while not keeper.put(b"last"):
        keeper.poll()
        NEVER.wait(0.01)
    until(keeper, tmp_path, b"last")
    asyncio.run(keeper.close(60.0))


async def test_the_loop_turns_while_the_child_writes_its_last(tmp_path):
    """The child is stopped, with more in hand than the pipe holds, and goes on when the loop says so."""
    keeper, child = keeping(tmp_path)
    os.kill(child.pid, 19)
    last = bytes(4 << 20)
    assert keeper.put(last)
    closing = asyncio.create_task(keeper.close(60.0))
    for _ in range(10):
        await asyncio.sleep(0)
    assert not closing.done()
    os.kill(child.pid, 18)
    await closing
    assert child.returncode == 0
    assert newest([str(tmp_path)], "voyage", KEY)[1] == last


def test_a_child_that_hangs_is_not_waited_for(tmp_path):
    keeper, child = keeping(tmp_path)
    os.kill(child.pid, 19)
    keeper.put(b"last")
    asyncio.run(keeper.close(0.0))
    assert newest([str(tmp_path)], "voyage", KEY)[1] == b"first"
    os.kill(child.pid, 18)
    assert child.wait(60.0) == 0, "it finishes what it was given"
    assert newest([str(tmp_path)], "voyage", KEY)[1] == b"last"


@pytest.mark.parametrize("call", ["open", "pwrite", "ftruncate", "fsync"])
def test_each_call_may_fail_and_the_next_record_is_written(tmp_path, monkeypatch, call):
    newest_record, said = NewestRecord(0), list[bytes]()
    failed = threading.Event()

    def failing(*words: object) -> object:
        if failed.is_set():
            return getattr(os, call)(*words)
        failed.set()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    ours = SimpleNamespace(**{name: getattr(os, name) for name in dir(os)} | {call: failing})
    monkeypatch.setattr(writer, "os", ours)
    monkeypatch.setattr(writer, "_say", lambda directory, why: said.append(why.encode()))
    newest_record.put(b"lost")
    thread = threading.Thread(target=keep, args=(newest_record, str(tmp_path), "voyage", KEY))
    thread.start()
    assert failed.wait(200)
    newest_record.put(b"kept")
    newest_record.end()
    thread.join(60)
    assert newest([str(tmp_path)], "voyage", KEY)[1] == b"kept"
    assert said == [b"No space left on device", b""]
