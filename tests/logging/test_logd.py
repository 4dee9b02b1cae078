"""logd: nodes that talk DSOR, a log each, and every message answered."""

import json
import os
import signal
import subprocess
import sys
from collections import deque
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import BusError
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import LOG_ID, NAVIGATION_ID, Node
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.opening import open_can
from delfim.config import LogTable
from delfim.logging import nodelog
from delfim.logging.nodelog import LogMessages, line
from delfim.logging.openlog import open_log
from delfim.logging.reading import read_log
from tests.logging.conftest import files

T0 = 1_262_304_000_000_000_000


class Wire:
    def __init__(self) -> None:
        self.queue, self.sent, self.up, self.full = deque(), [], True, False

    def receive(self) -> Frame | None:
        if not self.up:
            raise BusError("can0 is down")
        return self.queue.popleft() if self.queue else None

    def sendmsg(self, frame: Frame) -> None:
        if self.full:
            raise BlockingIOError
        self.sent.append(frame)

    def rebind(self) -> bool:
        return self.up


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def daemon(tmp_path, wire, clock, monkeypatch):
    def opened(limits, id, suffix, method, clock):  # noqa: A002
        assert method == "zpipe", "logd lives in the runtime, which must not wait"
        return open_log(limits, id, suffix, "write", clock)

    monkeypatch.setattr(nodelog, "open_log", opened)
    receiver = Receiver(Node.VEHICLE, lambda message: message.id == LOG_ID)
    names = {Node.GPS: "gps", 0x33: "node-51"}
    return LogMessages(wire, receiver, names, LogTable(directory=str(tmp_path), free_bytes_min=0), clock)


def say(wire: Wire, daemon: LogMessages, source: int, data: bytes, number: int = 0, identifier: int = LOG_ID) -> None:
    frames = segments(Message(200, source, Node.VEHICLE, identifier, data), number)
    wire.queue.extend(frame._replace(t_ns=T0 + i) for i, frame in enumerate(frames))
    while wire.queue:
        daemon.on_readable()


def told(tmp_path, name: str) -> list[dict[str, object]]:
    return [json.loads(row) for path in files(tmp_path) if path.parent.name == name for row in read_log(path)[0].splitlines()]


def test_each_node_has_its_own_log(tmp_path, wire, daemon):
    say(wire, daemon, Node.GPS, "rover at 38.69°".encode())
    say(wire, daemon, 0x33, b"\xff\x00\x01")
    say(wire, daemon, Node.GPS, b"second\n", 1)
    daemon.close()
    assert [row["text"] for row in told(tmp_path, "gps")] == ["rover at 38.69°", "second\n"]
    assert told(tmp_path, "node-51") == [{"t_ns": T0 + 1, "hex": "ff0001"}]
    assert daemon.messages == 3


def test_what_it_wrote_is_printed_by_the_command(tmp_path, wire, daemon, capsys):
    say(wire, daemon, Node.GPS, b"first")
    say(wire, daemon, Node.GPS, b"second", 1)
    daemon.close()
    for words in ((), ("--from", "2010-01-01T00:00:00", "--to", "2010-01-01T00:00:01")):
        assert main(["log", "cat", "--id", "gps", *words, str(tmp_path)]) == 0
        rows = [json.loads(row) for row in capsys.readouterr().out.splitlines()]
        assert [row["text"] for row in rows] == ["first", "second"]
    assert main(["log", "cat", "--id", "gps", "--from", "2010-01-01T00:00:02", str(tmp_path)]) == 2


def test_frames_are_answered_so_that_the_node_goes_on(wire, daemon):
    say(wire, daemon, Node.GPS, b"12345678" * 3)
    assert len(wire.sent) == 5, "a header, three segments and the end with the CRC"
    wire.full = True
    say(wire, daemon, Node.GPS, b"x", 1)
    assert daemon.unanswered == 2


def test_other_nodes_and_other_messages_are_not_logged(tmp_path, wire, daemon):
    say(wire, daemon, Node.PROPELLER_PORT, b"not asked for")
    say(wire, daemon, Node.GPS, b"navigation", 1, NAVIGATION_ID)
    assert daemon.messages == 0
    assert told(tmp_path, "gps") == []


def test_a_bus_that_goes_down_is_taken_up_again(wire, daemon, tmp_path, clock):
    wire.up = False
    daemon.on_readable()
    daemon.poll()
    wire.up = True
    daemon.poll()
    say(wire, daemon, Node.GPS, b"back")
    assert [row["text"] for row in told(tmp_path, "gps")] == ["back"]


def test_start_and_end_are_noted_and_the_status_has_names(tmp_path, daemon):
    assert set(daemon.status()) == {"gps", "node-51"}
    assert daemon.report() == {"messages": 0, "lost": 0, "unanswered": 0, "not_writable": {}}
    daemon.close()
    sidecars = sorted(tmp_path.glob("*/*/*.meta.jsonl"))
    assert [[json.loads(row)["event"] for row in path.read_text().splitlines()] for path in sidecars] == [["start", "end"]] * 2


def test_a_line_is_one_line_whatever_is_in_it():
    row = line(5, b"a\nb\xe2\x80\xa8c")
    assert row.count(b"\n") == 1
    assert json.loads(row) == {"t_ns": 5, "text": "a\nb\u2028c"}


def test_the_service_by_itself_on_a_bus(tmp_path):
    """A broadcast is repeated until the service has come up and heard it."""
    bus, vehicle = f"canloop:logd-{os.getpid()}", Path(__file__).parents[2] / "etc/delfimx.toml"
    settings = {
        "can.interface": f'"{bus}"',
        "log.directory": f'"{tmp_path}/log"',
        "logd.nodes": "[1]",
        "log.free_bytes_min": "0",
    }
    overrides = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "delfim", "run", str(vehicle), "--service", "logd", *overrides]
    with subprocess.Popen(command) as service, open_can(bus) as node:
        for number in range(1000):
            for frame in segments(Message(200, Node.GPS, Node.BROADCAST, LOG_ID, b"fix %d" % number), number):
                node.sendmsg(frame)
            if any(path.stat().st_size > 60 for path in tmp_path.glob("log/*/gps/*.jsonl.gz")):
                break
            with pytest.raises(subprocess.TimeoutExpired):
                service.wait(0.02)
        service.send_signal(signal.SIGTERM)
        assert service.wait(200) == 0
    rows = told(tmp_path / "log", "gps")
    assert rows[-1]["text"] == f"fix {number}"
