"""Logs fetched from a boat that lies: no file leaves its folder, no listing and no size is believed, and all of it in words."""

import socket
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

import pytest

from delfim.__main__ import main
from delfim.base.errors import DelfimError
from delfim.logging import reading
from delfim.logging.ashore import fetch
from delfim.logging.ashore.fetch import RemoteFile, transfer, wanted
from delfim.logging.ashore.repair import condition
from delfim.logging.ashore.tree import ALWAYS

DAY = "20100101"
FACTS = "type=file;size=5;modify=20100101093000; "


class Liar:
    """An FTP server that lists and sends what it is told to."""

    def __init__(self, listings: dict[str, list[str]], files: dict[str, bytes], endless: str | None) -> None:
        self._listings, self._files, self._endless = listings, files, endless
        self._listen = socket.create_server(("127.0.0.1", 0))
        self.url = f"ftp://127.0.0.1:{self._listen.getsockname()[1]}/log"

    def serve(self) -> None:
        """Until the socket is closed."""
        while True:
            try:
                visitor, _ = self._listen.accept()
            except OSError:
                return
            with suppress(OSError), visitor:  # who asked may have seen enough
                self._talk(visitor)

    def _talk(self, visitor: socket.socket) -> None:
        visitor.sendall(b"220 here\r\n")
        with socket.create_server(("127.0.0.1", 0)) as data, visitor.makefile("r", encoding="latin-1", newline="\r\n") as lines:
            for line in lines:
                word, _, rest = line.strip().partition(" ")
                if word in ("MLSD", "RETR"):
                    visitor.sendall(b"150 comes\r\n")
                    with data.accept()[0] as out:
                        self._send(out, word, rest.removeprefix("/log").strip("/"))
                    visitor.sendall(b"226 done\r\n")
                else:
                    port = data.getsockname()[1]
                    answers = {"USER": "230 in", "PASV": f"227 (127,0,0,1,{port >> 8},{port & 255})", "REST": "350 ok"}
                    visitor.sendall(f"{answers.get(word, '200 ok')}\r\n".encode())

    def _send(self, out: socket.socket, word: str, path: str) -> None:
        if word == "RETR":
            out.sendall(self._files[path])
            return
        out.sendall("".join(f"{each}\r\n" for each in self._listings.get(path, ())).encode("latin-1"))
        while path == self._endless:
            out.sendall(f"{FACTS}093000.log\r\n".encode() * 1000)

    @contextmanager
    def running(self) -> Iterator["Liar"]:
        thread = Thread(target=self.serve, daemon=True)
        thread.start()
        yield self
        self._listen.shutdown(socket.SHUT_RDWR)
        self._listen.close()


def lying(*entries: str, id_: str = "can0", endless: str | None = None) -> Liar:
    listings = {"": [f"type=dir; {DAY}"], DAY: [f"type=dir; {id_}"], f"{DAY}/{id_}": list(entries)}
    return Liar(listings, {f"{DAY}/{id_}/093000.log": b"hello"}, endless)


def fetched(liar: Liar, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str], str]:
    """The end of `delfim log fetch`, the files that came, and what it said of errors."""
    with liar.running():
        code = main(["log", "fetch", liar.url, str(folder / "here")])
    return code, sorted(str(each.relative_to(folder)) for each in folder.rglob("*") if each.is_file()), capsys.readouterr().err


def test_an_honest_listing_arrives(tmp_path, capsys):
    assert fetched(lying(f"{FACTS}093000.log"), tmp_path, capsys)[:2] == (0, [f"here/{DAY}/can0/093000.log"])


@pytest.mark.parametrize("name", ["..", "..\\..\\..", "a:b", "-\x1b[31m", "con.", "x" * 300, "Ã¼", ".hidden", "a b"])
def test_an_id_that_no_log_has_is_left_out_in_words(tmp_path, capsys, name):
    code, files, said = fetched(lying(f"{FACTS}093000.log", id_=name), tmp_path, capsys)
    assert (code, files) == (0, [])
    assert "left out: no log has such a name" in said
    assert "\x1b" not in said


@pytest.mark.parametrize(
    "entry",
    [
        "type=file;size=5; 093000.log",
        "type=file;size=5;modify=20109999999999; 093000.log",
        "type=file;size=5;modify=00010101000000; 093000.log",
        "type=file;modify=20100101093000; 093000.log",
        "type=file;size=-5;modify=20100101093000; 093000.log",
        "type=file;size=\xc2\xb2;modify=20100101093000; 093000.log",
        "type=file;size=1000000000000000;modify=20100101093000; 093000.log",
        f"type=file;size={'9' * 5000};modify=20100101093000; 093000.log",
    ],
)
def test_a_log_with_impossible_facts_is_left_out_in_words(tmp_path, capsys, entry):
    code, files, said = fetched(lying(entry), tmp_path, capsys)
    assert (code, files) == (0, [])
    assert f"{DAY}/can0/093000.log: left out: no log has its size or time as the boat tells them" in said


def test_a_listing_that_is_no_text_is_refused_in_words(tmp_path, capsys):
    code, files, said = fetched(lying("type=file;size=\xb2; 093000.log"), tmp_path, capsys)
    assert (code, files, "127.0.0.1: 'utf-8' codec can't decode" in said) == (2, [], True)


@pytest.mark.parametrize("name", ["093000.bat", "093000.state.exe", "../093000.log", "093000.log\x07", "093000.log:x"])
def test_a_name_that_no_log_has_is_not_fetched(tmp_path, capsys, name):
    assert fetched(lying(f"{FACTS}{name}"), tmp_path, capsys)[:2] == (0, [])


@pytest.mark.parametrize("path", ["", DAY, f"{DAY}/can0"])
def test_a_listing_without_an_end_is_ended(tmp_path, capsys, monkeypatch, path):
    monkeypatch.setattr(fetch, "ENTRIES", 5000)
    code, files, said = fetched(lying(endless=path), tmp_path, capsys)
    assert (code, files) == (2, [])
    assert "the boat lists more than 5000 files: these are no logs" in said


def test_more_than_the_disk_has_room_for_is_not_begun(tmp_path):
    many = [RemoteFile(f"{DAY}/state/093000.state", 10**18, 0)]
    with pytest.raises(DelfimError, match=r"has room for .* MB: fetch a part, by --id, --from and --to"):
        transfer(lambda: pytest.fail("nothing is asked for"), many, tmp_path, lambda words: None)


def test_a_file_that_goes_on_is_ended_where_the_listing_says(tmp_path):
    class Endless:
        def entries(self):
            return [RemoteFile(f"{DAY}/state/093000.state", 70_000, 0)]

        def read(self, path, offset, sink):
            while True:
                sink(bytes(1000))

        def close(self):
            pass

    boat = Endless()
    transfer(lambda: boat, wanted(boat.entries(), [], ALWAYS, summary=False), tmp_path, lambda words: None)
    assert (tmp_path / DAY / "state/093000.state").stat().st_size == 70_000


def bomb(mbytes: int) -> bytes:
    stream = zlib.compressobj(9, wbits=31)
    return b"".join(stream.compress(bytes(1 << 20)) for _ in range(mbytes)) + stream.flush()


def test_a_small_file_that_inflates_to_much_takes_no_memory(tmp_path):
    """It is verified, and read line by line, a piece at a time."""
    data = bomb(100)
    (tmp_path / "093000.jsonl.gz").write_bytes(data)
    tracemalloc.start()
    try:
        assert condition(data) == ""
        assert list(reading.read_lines(tmp_path / "093000.jsonl.gz")) == []
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert condition(bomb(2 + (reading.LOG_BYTES >> 20))) == "damaged"
