"""zpipe: a real child behind a real pipe, stopped, killed, starved of disk; the caller never waits and the sums are right."""

import json
import os
import resource
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.logging import pipelog
from delfim.logging.openlog import open_log
from delfim.logging.pipelog import PipeLog
from delfim.logging.reading import read_log
from delfim.logging.writer import LENGTH, NOTE, PipeMessages
from tests.logging.conftest import content, files, numbers, until


@pytest.fixture
def pipe_log(tmp_path, clock) -> Iterator[Callable[..., PipeLog]]:
    logs: list[PipeLog] = []

    def opened(**how: Any) -> PipeLog:
        limits = config.LogTable(directory=str(tmp_path / "log"), free_bytes_min=0)
        log = open_log(limits, "gps", ".log", "zpipe", clock, **how)
        assert isinstance(log, PipeLog)
        logs.append(log)
        return log

    yield opened
    for log in logs:
        log.close()


def pid(log: PipeLog) -> int:
    assert log._child
    return log._child.pid


def record(number: int, size: int = 0) -> bytes:
    return b"%06d %s\n" % (number, os.urandom(size).hex().encode())


def fill(log: PipeLog, start: int = 0) -> list[int]:
    """Put until the pipe is full; the numbers that were taken."""
    taken = []
    while log.put(record(start + len(taken), size=1000)):
        taken.append(start + len(taken))
        assert len(taken) < 5000, "this pipe has no end"
    return taken


@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=50))), st.lists(st.integers(1, 40), min_size=1))
def test_messages_are_cut_right_however_the_pipe_splits_them(sent, pieces):
    stream = b"".join(LENGTH.pack(len(text) | (NOTE if note else 0)) + text for note, text in sent)
    messages, got, turn = PipeMessages(), [], 0
    while stream:
        size = pieces[turn % len(pieces)]
        got += messages.feed(stream[:size])
        stream, turn = stream[size:], turn + 1
    assert got == sent


def test_records_arrive_behind_the_header(tmp_path, pipe_log, clock):
    log = pipe_log(header=b"head \xff\n")
    for number in range(1000):
        assert log.put(b"%06d\n" % number)
    log.note(b"{}\n")
    log.close()
    assert content(tmp_path / "log") == b"head \xff\n" + b"".join(b"%06d\n" % number for number in range(1000))
    assert log.status()[4:] == (1000, 0)
    assert log.status().reason == "closed"
    path = files(tmp_path / "log")[0]
    assert read_log(path)[1] == ""
    assert path.with_name(path.name.replace(".log.gz", ".meta.jsonl")).read_bytes() == b"{}\n"


def test_the_writer_reports_and_steps_back(pipe_log):
    log = pipe_log(nice=12)
    assert not log.status().writable
    assert log.status().reason == "the writer is starting"
    until(log, lambda: log.status().writable)
    assert os.getpriority(os.PRIO_PROCESS, pid(log)) == 12
    assert os.sched_getscheduler(pid(log)) == os.SCHED_BATCH


def test_large_records_pass(tmp_path, pipe_log):
    log = pipe_log()
    large = [record(number, size=100_000) for number in range(4)]
    assert all(log.put(each) for each in large)
    log.close()
    assert content(tmp_path / "log") == b"".join(large)


def test_a_record_larger_than_the_pipe_passes_in_pieces(tmp_path, pipe_log, monkeypatch):
    monkeypatch.setattr(pipelog, "PIPE_BYTES", (1 << 16,))
    log = pipe_log()
    large = record(1, size=300_000)
    assert log.put(large)
    assert not log.put(b"no room\n")
    log.close()
    assert content(tmp_path / "log") == large
    assert log.status()[4:] == (1, 1)


def test_a_writer_that_stands_still_never_holds_up_the_caller(tmp_path, pipe_log, clock):
    log = pipe_log()
    until(log, lambda: log.status().writable)
    os.kill(pid(log), signal.SIGSTOP)
    taken = fill(log)
    assert not any(log.put(b"no room for this" * 300) for _ in range(1000))
    assert log.status().dropped == 1001
    clock.advance(6.0)
    log.poll()
    assert log.status().reason == "the log's writer has not reported for 6 s: the disk hangs"
    os.kill(pid(log), signal.SIGCONT)
    until(log, lambda: log.status().records == len(taken))
    assert log.status().writable
    assert log.put(record(len(taken)))
    log.close()
    assert numbers(tmp_path / "log") == [*taken, len(taken)]
    assert log.status()[4:] == (len(taken) + 1, 1001)


def test_a_writer_that_stands_still_does_not_hold_up_the_end(pipe_log):
    log = pipe_log()
    until(log, lambda: log.status().writable)
    child = pid(log)
    os.kill(child, signal.SIGSTOP)
    taken = fill(log)
    log.close(timeout_s=0.1)
    assert log.status()[4:] == (0, len(taken) + 1)
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_a_killed_writer_is_followed_by_another_and_its_loss_counted(tmp_path, pipe_log, clock):
    log = pipe_log()
    for number in range(100):
        log.put(record(number))
    until(log, lambda: log.status().records == 100)
    first = pid(log)
    for number in range(100, 150):
        log.put(record(number))
    os.kill(first, signal.SIGKILL)
    assert log._child
    log._child.wait(200.0)
    assert not log.put(b"nobody reads this\n")
    clock.advance(0.5)
    log.poll()
    assert log.status().reason == "the writer ended (signal 9)"
    clock.advance(1.0)
    log.poll()
    assert pid(log) != first
    until(log, lambda: log.status().writable)
    assert log.put(record(200))
    log.close()
    assert log.status().records + log.status().dropped == 152
    assert set(numbers(tmp_path / "log")) >= {*range(100), 200}
    assert len(numbers(tmp_path / "log")) >= log.status().records
    assert len(files(tmp_path / "log")) == 2


def test_a_writer_killed_within_a_large_record_does_not_hold_up_the_end(pipe_log):
    log = pipe_log()
    until(log, lambda: log.status().writable)
    os.kill(pid(log), signal.SIGSTOP)
    assert log.put(record(1, size=4_000_000))
    os.kill(pid(log), signal.SIGKILL)
    assert log._child
    log._child.wait(200.0)
    log.close()
    assert log.status()[4:] == (0, 1)


def test_what_a_dead_parent_had_put_is_written(tmp_path):
    program = f"""
import os, signal
from delfim import config
from delfim.base.clock import SystemClock
from delfim.logging.openlog import open_log
log = open_log(config.LogTable(directory={str(tmp_path / "log")!r}, free_bytes_min=0), "gps", ".log", "zpipe", SystemClock())
for number in range(500):
    log.put(b"%06d\\n" % number)
print(log._child.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    parent = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, timeout=200)
    assert parent.returncode == -signal.SIGKILL  # and its output has ended, so the child that shares it has ended too
    assert numbers(tmp_path / "log") == list(range(500))
    assert read_log(files(tmp_path / "log")[0])[1] == ""


def test_signals_for_the_terminal_do_not_end_the_writer(tmp_path, pipe_log):
    log = pipe_log()
    until(log, lambda: log.status().writable)
    os.kill(pid(log), signal.SIGTERM)
    os.kill(pid(log), signal.SIGINT)
    log.put(b"000001\n")
    log.close()
    assert numbers(tmp_path / "log") == [1]
    assert log.status()[4:] == (1, 0)


def test_a_disk_that_takes_no_more_is_told_and_survived(tmp_path, pipe_log):
    log = pipe_log()
    until(log, lambda: log.status().writable)
    unlimited = resource.prlimit(pid(log), resource.RLIMIT_FSIZE)
    resource.prlimit(pid(log), resource.RLIMIT_FSIZE, (100, unlimited[1]))
    for number in range(5):
        assert log.put(record(number, size=1000))
    until(log, lambda: log.status().dropped == 5)
    assert "File too large" in log.status().reason
    resource.prlimit(pid(log), resource.RLIMIT_FSIZE, unlimited)
    until(log, lambda: log.status().writable)
    log.put(b"999999\n")
    log.close()
    assert numbers(tmp_path / "log") == [999999]
    assert log.status()[4:] == (1, 5)


def test_a_writer_that_cannot_be_started_is_told_and_tried_again(tmp_path, pipe_log, clock, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(tmp_path / "missing"))
        log = pipe_log()
    assert log.status().reason == "the writer cannot be started: No such file or directory"
    assert not log.put(b"lost\n")
    clock.advance(1.0)
    log.poll()
    until(log, lambda: log.status().writable)
    assert log.put(b"000001\n")
    log.close()
    assert numbers(tmp_path / "log") == [1]
    assert log.status()[4:] == (1, 1)


def test_the_place_of_reports_stays_the_same(pipe_log, clock):
    log = pipe_log()
    fileno = log.status_fileno()
    os.kill(pid(log), signal.SIGKILL)
    assert log._child
    log._child.wait(200.0)
    clock.advance(1.0)
    log.poll()
    assert log.status_fileno() == fileno
    until(log, lambda: log.status().writable)


def test_the_protocol_of_the_pipe_is_as_described(tmp_path):
    """Another program may be the parent: settings, records and notes in, one report a line out."""
    settings = {
        "directory": str(tmp_path / "log"),
        "id": "gps",
        "suffix": ".log",
        "header": "",
        "file_bytes": 1000,
        "file_s": 60.0,
        "free_bytes_min": 0,
        "when_full": "stop",
        "nice": 0,
    }
    messages = [json.dumps(settings).encode(), b"000001\n", b"000002\n"]
    stream = b"".join(struct.pack("=I", len(message)) + message for message in messages)
    child = subprocess.run(
        [sys.executable, "-m", "delfim.logging.writer", "gps"], input=stream, capture_output=True, timeout=200
    )
    assert child.stderr == b""
    report = json.loads(child.stdout.splitlines()[-1])
    assert report["records"] == 2
    assert numbers(tmp_path / "log") == [1, 2]
