"""Logs over a bad radio: what is here stays, what was lost goes on, what arrives is verified."""

import random
import zlib
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.logging.ashore import fetch
from delfim.logging.ashore.fetch import ATTEMPTS, RemoteFile, opener, transfer, wanted
from delfim.logging.ashore.tree import ALWAYS, Span

T0_NS = 1_262_338_200_000_000_000  # 2010-01-01 09:30:00


def gz(content: bytes, *, cut: bool = False) -> bytes:
    stream = zlib.compressobj(wbits=31)
    return stream.compress(content) + stream.flush(zlib.Z_SYNC_FLUSH if cut else zlib.Z_FINISH)


class Radio:
    """A boat whose link breaks after so many bytes, again and again, and counts what went over it."""

    def __init__(self, files: dict[str, bytes], *, breaks_after: int = 1 << 30) -> None:
        self.files, self.breaks_after, self.sent, self.connected, self.flips = files, breaks_after, 0, 0, 0

    def connect(self) -> "Radio":
        self.connected += 1
        return self

    def entries(self) -> list[RemoteFile]:
        return [RemoteFile(path, len(data), T0_NS) for path, data in self.files.items()]

    def read(self, path, offset, sink) -> None:
        for at in range(offset, len(self.files[path]), 100):
            if self.sent and self.sent % self.breaks_after < 100:
                self.sent += 100
                raise ConnectionResetError("carrier lost")
            data = bytearray(self.files[path][at : at + 100])
            if self.flips:
                self.flips -= 1
                data[0] ^= 1
            self.sent += len(data)
            sink(bytes(data))

    def close(self) -> None:
        pass


FILES = {
    "20100101/can0/093000.log.gz": gz(bytes(range(256)) * 20),
    "20100101/state/093000.state.gz": gz(b"state" * 1000 + bytes(range(256))),
    "20100101/state/093000.meta.jsonl": b'{"t_ns": 1, "event": "start"}\n',
}


def quiet(words: str) -> None:
    pass


def arrived(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_everything_arrives_and_is_not_fetched_twice(tmp_path):
    radio = Radio(FILES)
    outcome = transfer(radio.connect, radio.entries(), tmp_path, quiet)
    assert arrived(tmp_path) == FILES
    assert outcome.bytes == sum(map(len, FILES.values()))
    assert not outcome.cut
    assert (tmp_path / "20100101/can0/093000.log.gz").stat().st_mtime_ns == T0_NS
    again = transfer(radio.connect, radio.entries(), tmp_path, quiet)
    assert (again.fetched, again.bytes) == ([], 0)


def test_a_lost_link_is_taken_up_where_it_stopped(tmp_path):
    data = {"20100101/can0/093000.log.gz": gz(random.Random(1).randbytes(60_000))}
    radio = Radio(data, breaks_after=1000)
    outcome = transfer(radio.connect, radio.entries(), tmp_path, quiet)
    assert arrived(tmp_path) == data
    assert radio.connected > 3
    assert outcome.bytes == len(next(iter(data.values()))), "no byte twice"


def test_what_came_before_the_link_died_is_kept_for_the_next_time(tmp_path):
    radio = Radio(FILES)
    path, data = next(iter(FILES.items()))
    part = tmp_path / (path + ".part")
    part.parent.mkdir(parents=True)
    part.write_bytes(data[:150])
    outcome = transfer(radio.connect, radio.entries(), tmp_path, quiet)
    assert outcome.bytes == sum(map(len, FILES.values())) - 150
    assert arrived(tmp_path) == FILES


def test_a_dead_link_is_given_up_with_a_word_of_hope(tmp_path):
    class Dead(Radio):
        def read(self, path, offset, sink) -> None:
            raise TimeoutError("timed out")

    dead = Dead(FILES)
    with pytest.raises(DelfimError, match="timed out; run the same command again to go on from here"):
        transfer(dead.connect, dead.entries(), tmp_path, quiet)
    assert dead.connected == ATTEMPTS


def test_a_file_that_has_grown_is_fetched_from_where_it_was(tmp_path):
    path, whole = "20100101/can0/093000.log.gz", FILES["20100101/can0/093000.log.gz"]
    early = Radio({path: whole[:200]})
    first = transfer(early.connect, early.entries(), tmp_path, quiet)
    assert first.cut == [path]
    later = Radio({path: whole})
    assert transfer(later.connect, later.entries(), tmp_path, quiet).bytes == len(whole) - 200
    assert arrived(tmp_path) == {path: whole}


def test_bytes_that_were_wrong_here_are_fetched_again(tmp_path):
    path, whole = "20100101/can0/093000.log.gz", FILES["20100101/can0/093000.log.gz"]
    part = tmp_path / (path + ".part")
    part.parent.mkdir(parents=True)
    part.write_bytes(bytes(200))
    radio = Radio({path: whole})
    assert not transfer(radio.connect, radio.entries(), tmp_path, quiet).cut
    assert arrived(tmp_path) == {path: whole}


def test_a_byte_that_falls_on_the_way_does_not_pass_for_the_truth(tmp_path):
    path = "20100101/can0/093000.log.gz"
    radio = Radio({path: FILES[path]})
    radio.flips = 1
    outcome = transfer(radio.connect, radio.entries(), tmp_path, quiet)
    assert arrived(tmp_path) == {path: FILES[path]}
    assert not outcome.cut


def test_state_logs_come_before_the_black_box_and_a_summary_is_only_them():
    entries = [RemoteFile(path, 1, T0_NS) for path in FILES]
    order = [entry.path.rpartition("/")[2] for entry in wanted(entries, [], ALWAYS, summary=False)]
    assert order == ["093000.meta.jsonl", "093000.state.gz", "093000.log.gz"]
    assert len(wanted(entries, [], ALWAYS, summary=True)) == 2
    assert [entry.path for entry in wanted(entries, ["can0"], ALWAYS, summary=False)] == ["20100101/can0/093000.log.gz"]
    assert wanted(entries, [], Span(T0_NS + 10_000_000_000), summary=False) == []
    strangers = [
        RemoteFile(path, 1, T0_NS) for path in ("readme", "20100101/KEEP", "../../etc/passwd", "20100101/x/../093000.log")
    ]
    assert wanted(strangers, [], ALWAYS, summary=False) == []


@pytest.mark.parametrize("url", ["http://boat/log", "ftp:///log", "boat"])
def test_what_is_no_address_is_refused(url):
    with pytest.raises(DelfimError, match="write ftp://"):
        opener(url)


def test_nobody_there_is_one_line(tmp_path):
    with pytest.raises(DelfimError, match=r"127\.0\.0\.1: .*refused"):
        fetch.fetch("ftp://127.0.0.1:1/log", tmp_path, [], ALWAYS, summary=True)
