"""The system log: what a program says comes into the pipe at once or not at all, and from there onto the disk."""

import contextlib
import gzip
import json
import logging
import os
import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.base.clock import ManualClock
from delfim.logging import systemlog
from delfim.logging.ashore import systemlines, tree
from delfim.logging.liblog import LogSettings
from delfim.logging.systemlog import BURST, RATE_HZ, RECENT, RECENT_BYTES, SystemHandler, open_pipe, recent
from delfim.logging.systemlog.writer import WAITING_BYTES, SystemWriter

LEVELS = {"": logging.INFO, "ftpd": logging.DEBUG, "httpd": logging.ERROR}


class Program:
    """A program that logs, its pipe, and its standard error, which is a pipe, too."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock(1000.0)
        self.pipe = open_pipe(str(folder / systemlog.PIPE))
        self.shown, self.terminal = os.pipe()
        os.set_blocking(self.shown, False)
        self.service = "runtime"
        self.handler = SystemHandler(
            self.pipe, "supervisor", self.clock, levels=LEVELS, service=lambda: self.service, terminal=self.terminal
        )
        self.log = logging.Logger("delfim.test", logging.DEBUG)
        self.log.addHandler(self.handler)

    def lines(self) -> list[dict]:
        data = b""
        while select.select([self.pipe], [], [], 0)[0]:
            data += os.read(self.pipe, 1 << 16)
        return [json.loads(line) for line in data.splitlines()]

    def texts(self) -> list[str]:
        return [line["text"] for line in self.lines()]

    def seen(self) -> str:
        return os.read(self.shown, 1 << 16).decode() if select.select([self.shown], [], [], 0)[0] else ""


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    program = Program(tmp_path)
    yield program
    for fd in (program.pipe, program.shown, program.terminal):
        os.close(fd)


def test_a_line_has_its_time_by_both_clocks_its_level_and_who_says_it(program):
    program.log.warning("httpd: %s", "http://127.0.0.1")
    program.clock.advance(0.5)
    program.service = ""
    program.log.info("runtime: started")
    assert program.lines() == [
        {
            "t_ns": 1_262_304_000_000_000_000,
            "monotonic_s": 1000.0,
            "level": "warning",
            "pid": os.getpid(),
            "service": "runtime",
            "text": "httpd: http://127.0.0.1",
        },
        {
            "t_ns": 1_262_304_000_500_000_000,
            "monotonic_s": 1000.5,
            "level": "info",
            "pid": os.getpid(),
            "service": "supervisor",
            "text": "runtime: started",
        },
    ]
    assert program.seen() == "httpd: http://127.0.0.1\n", "a terminal shows warnings, and no time"


def test_a_service_does_not_name_itself_twice(program):
    program.service = "ftpd"
    program.log.warning("ftpd: ana logged in")
    assert program.texts() == ["ana logged in"]
    assert program.seen() == "ftpd: ana logged in\n"


@pytest.mark.parametrize(
    ("service", "kept"),
    [("ftpd", ["debug", "info", "warning", "error"]), ("sshd", ["info", "warning", "error"]), ("httpd", ["error"])],
)
def test_each_service_has_its_own_level(program, service, kept):
    program.service = service
    for level in ("debug", "info", "warning", "error"):
        program.log.log(getattr(logging, level.upper()), level)
    assert program.texts() == kept


def test_text_from_outside_steers_nothing_and_pretends_nothing(program):
    program.log.warning(
        "wrong password for %s", '\x1b[2J"\x00\n{"t_ns": 1, "level": "info", "text": "all is well"}\r\u202e\ud800'
    )
    first, second = program.texts()
    assert first == 'wrong password for \\x1b[2J"\\x00'
    assert second == '  | {"t_ns": 1, "level": "info", "text": "all is well"}\\r\\u202e\\ud800'
    assert program.seen() == f"{first}\n{second}\n"


def test_a_line_is_shorter_than_what_the_kernel_takes_whole(program):
    for letter in ("x", '"', "\\", "\x01", "\U0001f6a4", "\U000e0001"):
        program.log.error(letter * 5000)
        assert select.select([program.pipe], [], [], 0)[0]
        assert len(os.read(program.pipe, 1 << 16)) < select.PIPE_BUF


def test_an_exception_comes_with_its_stack_and_each_line_of_it_is_marked(program):
    try:
        raise ValueError("bad\nvalue")
    except ValueError:
        program.log.exception("defect in the program")
    first, *more = program.texts()
    assert first == "defect in the program"
    assert all(line.startswith("  | ") for line in more)
    assert "  | ValueError: bad" in more


def test_a_wrong_call_does_not_end_the_program(program, capsys):
    program.log.info("%d metres", "ten")
    assert "'%d metres'" in capsys.readouterr().err
    assert program.texts() == []


def test_a_flood_is_cut_off_counted_and_told_and_leaves_room_for_warnings(program):
    for number in range(5000):
        program.log.info("noise %d", number)
    program.log.error("still heard")
    *noise, told, heard = program.texts()
    assert len(noise) < BURST
    assert told == f"{5000 - len(noise)} lines of this program were lost: too many at once"
    assert heard == "still heard"
    program.clock.advance(10.0)
    for number in range(5000):
        program.log.info("noise %d", number)
    assert len(program.texts()) <= 10.0 * RATE_HZ + 1


def test_a_flood_of_debug_lines_leaves_room_for_what_happened(program):
    program.service = "ftpd"
    for number in range(5000):
        program.log.debug("noise %d", number)
    program.log.info("ana logged in")
    assert program.texts()[-1] == "ana logged in"


def fill(end: int) -> None:
    """Until nothing more goes in."""
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(end, b"." * 4096)


def test_a_full_pipe_and_a_stuck_terminal_hold_up_nobody(program):
    os.set_blocking(program.terminal, False)
    for end in (program.pipe, program.terminal):
        fill(end)
    os.set_blocking(program.terminal, True)  # as the one that is inherited
    for _ in range(3):
        program.log.error("trouble")
    while select.select([program.pipe], [], [], 0)[0]:
        os.read(program.pipe, 1 << 16)
    program.log.info("room again")
    assert program.texts() == ["3 lines of this program were lost: too many at once", "room again"]


def test_without_a_pipe_warnings_are_still_shown(tmp_path, monkeypatch):
    (tmp_path / systemlog.PIPE).write_text("in the way")
    root, ours = logging.getLogger(), logging.getLogger("delfim")
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(ours, "level", ours.level)
    monkeypatch.setattr("sys.excepthook", None)
    shown, terminal = os.pipe()
    saved = os.dup(2)
    os.dup2(terminal, 2)
    try:
        systemlog.begin(str(tmp_path), "supervisor", {"ftpd": "debug"})
    finally:
        os.dup2(saved, 2)
    assert b"no system log: " in os.read(shown, 4096)
    assert ours.level == logging.DEBUG
    for fd in (shown, terminal, saved):
        os.close(fd)


class Written:
    """A writer, its pipe and its log."""

    def __init__(self, folder: Path, directory: Path) -> None:
        self.folder, self.directory, self.clock = folder, directory, ManualClock(1000.0)
        self.pipe = open_pipe(str(folder / systemlog.PIPE))
        self.warned: list[str] = []
        self.writer = self.started()

    def started(self) -> SystemWriter:
        settings = LogSettings(str(self.directory), "system", ".jsonl", b"", 1_000_000, 600.0, 0, "stop")
        return SystemWriter(self.pipe, settings, str(self.folder), self.clock, {"version": "1"}, self.warned.append)

    def say(self, text: str, level: str = "info") -> bytes:
        line = {"t_ns": self.clock.time_ns(), "monotonic_s": self.clock.monotonic_s(), "level": level, "pid": 7}
        told = json.dumps(line | {"service": "ftpd", "text": text}).encode() + b"\n"
        assert os.write(self.pipe, told) == len(told)
        return told

    def turn(self) -> None:
        self.clock.advance(1.0)
        self.writer.turn()

    def on_disk(self) -> list[bytes]:
        paths = sorted(self.directory.glob("*/system/*.jsonl.gz"))
        return [line for path in paths for line in gzip.decompress(path.read_bytes() or gzip.compress(b"")).splitlines(True)]


@pytest.fixture
def written(tmp_path: Path) -> Iterator[Written]:
    written = Written(tmp_path, tmp_path / "log")
    yield written
    os.close(written.pipe)


def test_lines_are_on_the_disk_and_at_hand_for_the_page(written):
    told = [written.say(f"line {number}") for number in range(3)]
    written.turn()
    assert recent(str(written.folder)) == [line.rstrip() for line in reversed(told)]
    written.writer.close()
    assert written.on_disk() == told
    assert written.writer.figures() == {
        "lines": 3,
        "bytes": written.writer.figures()["bytes"],
        "lost": 0,
        "waiting": 0,
        "trouble": "closed",
    }
    (sidecar,) = written.directory.glob("*/system/*.meta.jsonl")
    assert [json.loads(line)["event"] for line in sidecar.read_text().splitlines()] == ["start", "end"]
    (run,) = tree.runs(tree.files([written.directory]), written.clock.time_ns())
    assert (run.id, run.end) == ("system", "clean")


def test_what_is_no_line_is_left_out_and_a_line_in_two_reads_is_whole(written, monkeypatch):
    monkeypatch.setattr("delfim.logging.systemlog.writer.READ_BYTES", 7)
    os.write(written.pipe, b"nonsense\n")
    told = written.say("whole")
    for _ in range(10):
        written.turn()
    written.writer.close()
    assert written.on_disk() == [told]


def test_while_the_disk_takes_nothing_lines_wait_in_memory_and_then_go_on_it(tmp_path):
    (tmp_path / "log").write_text("no folder")
    written = Written(tmp_path, tmp_path / "log")
    told = [written.say("before /log was there")]
    written.turn()
    assert written.warned == [f"{tmp_path}/log: File exists"]
    assert recent(str(tmp_path)) == [told[0].rstrip()], "the page has them"
    (tmp_path / "log").unlink()
    written.turn()
    assert written.warned[1:] == ["is written again"]
    written.writer.close()
    assert written.on_disk() == told
    os.close(written.pipe)


def test_after_a_flood_the_last_lines_are_the_newest_ones(written, monkeypatch):
    monkeypatch.setattr("delfim.logging.systemlog.writer.RECENT_BYTES", 1000)
    monkeypatch.setattr("delfim.logging.systemlog.RECENT_BYTES", 1000)
    told = [written.say(f"line {number}") for number in range(100)]
    written.turn()
    found = recent(str(written.folder))
    assert found[0] == told[-1].rstrip()
    assert sum(map(len, found)) <= 1000
    written.writer.close()


def test_where_nobody_says_anything_no_file_is_opened(written):
    written.turn()
    assert not any((written.folder / name).exists() for name in RECENT)
    written.say("now")
    written.turn()
    assert (written.folder / RECENT[0]).exists()
    written.writer.close()


def test_nobody_else_may_write_into_the_pipe(written):
    assert (written.folder / systemlog.PIPE).stat().st_mode & 0o777 == 0o600


def test_memory_is_bounded_and_what_was_forgotten_is_told(tmp_path):
    (tmp_path / "log").write_text("no folder")
    written = Written(tmp_path, tmp_path / "log")
    told = []
    for number in range(20):
        told += [written.say(f"{number} {'x' * 800} {each}") for each in range(50)]
        written.turn()
    assert sum(map(len, told)) > 2 * WAITING_BYTES
    (tmp_path / "log").unlink()
    written.turn()
    kept = written.writer.figures()
    assert f"{kept['lost']} lines were lost on their way to the disk" in written.warned
    written.writer.close()
    assert written.on_disk() == told[-len(written.on_disk()) :]
    assert len(told) - len(written.on_disk()) == kept["lost"]
    assert WAITING_BYTES / 2 < sum(map(len, written.on_disk())) <= WAITING_BYTES
    assert all((tmp_path / name).stat().st_size < 2 * RECENT_BYTES for name in RECENT)
    os.close(written.pipe)


def test_a_writer_that_is_started_again_finds_what_was_said_meanwhile(written):
    first = written.say("before")
    written.turn()
    second = written.say("while it was dead")
    written.writer = written.started()
    written.turn()
    written.writer.close()
    paths = sorted(written.directory.glob("*/system/*.jsonl.gz"))
    assert len(paths) == 2, "a new file: the old one may lack its end"
    assert gzip.decompress(paths[-1].read_bytes()) == second
    assert recent(str(written.folder)) == [second.rstrip(), first.rstrip()]


def test_a_step_of_the_clock_does_not_change_the_order(written):
    written.say("first")
    written.turn()
    written.clock.step(-3600.0)
    written.say("second", "error")
    written.turn()
    written.writer.close()
    files = tree.files([written.directory])
    runs = tree.runs(files, written.clock.time_ns())
    assert [text.partition("]: ")[2] for text in systemlines.texts(runs, tree.ALWAYS, "debug")] == ["first", "second"]
    assert list(systemlines.texts(runs, tree.ALWAYS, "warning")) == ["2009-12-31 23:00:01.000000 error    ftpd[7]: second"]


@pytest.mark.parametrize(
    "line", [b"{}", b"[]", b'{"t_ns": "x"}', b'{"t_ns": 1e400}', b"\xff", b'{"t_ns": 99999999999999999999999999}']
)
def test_damaged_lines_are_left_out(written, line):
    written.say("\x1b[31mred")
    written.turn()
    written.writer.close()
    (path,) = written.directory.glob("*/system/*.jsonl.gz")
    with path.open("ab") as file:
        file.write(
            gzip.compress(
                line + b"\n" + b'{"level": "info", "monotonic_s": 1, "t_ns": 1, "service": "a", "pid": 1, "text": "b"}\n'
            )
        )
    runs = tree.runs(tree.files([written.directory]), written.clock.time_ns())
    texts = list(systemlines.texts(runs, tree.ALWAYS, "debug"))
    assert [text.partition("]: ")[2] for text in texts] == ["b", "\\x1b[31mred"]
