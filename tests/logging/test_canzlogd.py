"""The black box: every frame, in order, and in the sidecar what is none."""

import gzip
import json
import shutil
import subprocess
from collections import deque
from types import SimpleNamespace

import can
import pytest

from delfim.base.errors import BusError
from delfim.base.frames import CAN_ERR, CAN_IDE, Frame, extended, standard
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanSocket, bus_state
from delfim.config import LogTable
from delfim.logging import blackbox
from delfim.logging.blackbox import FRAMES_A_CALL, BlackBox
from delfim.logging.candump import format_line, parse_line
from delfim.logging.openlog import open_log
from tests.logging.conftest import content, files


class Wire:
    """A socket whose frames are put there by the test."""

    def __init__(self, name: str) -> None:
        self.name, self.dropped, self.queue, self.up = name, 0, deque(), True

    def receive_many(self) -> list[Frame]:
        if not self.up:
            raise BusError(f"{self.name} is down")
        return [self.queue.popleft() for _ in range(min(6, len(self.queue)))]

    def rebind(self) -> bool:
        return self.up


def frame(number: int) -> Frame:
    return Frame(standard(0x100), number.to_bytes(4), 1_262_304_000_000_000_000 + number * 1000)


def warning(state: int) -> Frame:
    return Frame(4 << 3 | CAN_IDE | CAN_ERR, bytes((0, state, 0, 0, 0, 0, 0, 0)), 1_262_304_000_000_000_000)


@pytest.fixture
def wire() -> Wire:
    return Wire("can0")


@pytest.fixture
def box(tmp_path, wire, clock, monkeypatch):
    """A black box of one bus whose files are written here and now, and whose log can be made to fail."""
    made = []

    def opened(limits, id, suffix, method, clock):  # noqa: A002
        assert method == "zpipe", "the black box lives in the runtime, which must not wait"
        made.append(open_log(limits, id, suffix, "write", clock))
        return made[-1]

    monkeypatch.setattr(blackbox, "open_log", opened)
    box = BlackBox([wire], LogTable(directory=str(tmp_path), free_bytes_min=0), clock, bus_state)
    yield SimpleNamespace(on_readable=box.on_readable, poll=box.poll, figures=box.figures, close=box.close, log=made[0])
    box.close()


def notes(directory) -> list[dict[str, object]]:
    return [json.loads(line) for path in sorted(directory.glob("*/*/*.meta.jsonl")) for line in path.read_text().splitlines()]


def events(directory) -> list[tuple[object, object]]:
    return [(note["event"], note.get("value")) for note in notes(directory)]


def test_every_frame_is_logged_in_order(tmp_path, box, wire):
    wire.queue.extend(frame(number) for number in range(150))
    while wire.queue:
        box.on_readable(wire)
    assert content(tmp_path) == "".join(format_line(frame(number), "can0") for number in range(150)).encode()
    assert files(tmp_path) == [tmp_path / "20100101/can0/000000.log"]


def test_one_call_takes_a_bounded_number(box, wire):
    wire.queue.extend(frame(number) for number in range(1000))
    box.on_readable(wire)
    assert FRAMES_A_CALL <= 1000 - len(wire.queue) < FRAMES_A_CALL + 6


def test_nothing_readable_logs_nothing(tmp_path, box, wire):
    box.on_readable(wire)
    assert content(tmp_path) == b""


def test_a_start_is_noted(tmp_path, box):
    assert notes(tmp_path) == [{"t_ns": 1_262_304_000_000_000_000, "monotonic_s": 100.0, "event": "start"}]


def test_a_step_of_the_clock_is_noted_once(tmp_path, box, clock):
    clock.step(0.4)
    box.poll()
    clock.step(3600.0)
    for _ in range(3):
        clock.advance(1.0)
        box.poll()
    assert events(tmp_path)[1:] == [("clock step", pytest.approx(3600.0))]


def test_frames_that_the_socket_lost_are_noted(tmp_path, box, wire):
    for dropped in (0, 3, 3, 10):
        wire.dropped = dropped
        box.poll()
    assert events(tmp_path)[1:] == [
        ("frames lost before the socket was read", 3),
        ("frames lost before the socket was read", 10),
    ]


def test_changes_of_the_bus_are_noted_and_its_error_frames_logged(tmp_path, box, wire):
    for states in ((0x04,), (0x04, 0x08), (0x40, 0x10)):
        wire.queue.extend(warning(state) for state in states)
        box.on_readable(wire)
        box.poll()
    assert events(tmp_path)[1:] == [("bus state", "error warning"), ("bus state", "error passive")]
    assert content(tmp_path).count(b" 20000004#") == 5


def test_a_bus_that_goes_down_is_noted_and_taken_up_again(tmp_path, box, wire):
    wire.queue.append(frame(1))
    box.on_readable(wire)
    wire.up = False
    box.on_readable(wire)
    box.poll()
    wire.up = True
    wire.queue.append(frame(2))
    box.poll()
    box.on_readable(wire)
    assert events(tmp_path)[1:] == [("bus error", "can0 is down"), ("bus error", "")]
    assert content(tmp_path) == (format_line(frame(1), "can0") + format_line(frame(2), "can0")).encode()


def test_what_the_log_lost_is_noted_when_it_writes_again(tmp_path, box, wire, clock):
    files(tmp_path)[0].unlink()
    clock.advance(1.0)
    box.poll()
    wire.queue.extend(frame(number) for number in range(100))
    box.on_readable(wire)
    box.on_readable(wire)
    clock.advance(1.0)
    box.poll()
    assert events(tmp_path)[1:] == [("frames lost for want of room in the pipe", 100), ("blocks of frames lost by the log", 2)]
    assert "can0" not in box.figures(), "no trouble"


@pytest.mark.parametrize(
    ("name", "device"),
    [("can0", "can0"), ("canloop:doca-1", "doca-1"), ("python-can:slcan:/dev/ttyUSB0@500000", "-dev-ttyUSB0-500000")],
)
def test_devices_are_names_of_folders_without_blanks(tmp_path, clock, monkeypatch, name, device):
    monkeypatch.setattr(blackbox, "open_log", lambda *place: open_log(*place[:3], "write", clock))
    wire = Wire(name)
    box = BlackBox([wire], LogTable(directory=str(tmp_path), free_bytes_min=0), clock)
    wire.queue.append(frame(1))
    box.on_readable(wire)
    box.close()
    assert files(tmp_path)[0].parent.name == device
    assert parse_line(content(tmp_path).decode())[0] == device


def test_recorded_traffic_through_the_whole_black_box(tmp_path, clock, recordings):
    """Two buses, real writers, real files; python-can reads every frame of them."""
    with gzip.open(recordings / "can0-1.candump.log.gz", "rt") as lines:
        frames = [parse_line(next(lines))[1] for _ in range(5000)]
    wires = [Wire("can0"), Wire("can1")]
    box = BlackBox(wires, LogTable(directory=str(tmp_path), free_bytes_min=0), clock)
    for wire in wires:
        wire.queue.extend(frames)
        while wire.queue:
            box.on_readable(wire)
    box.close()
    for wire in wires:
        (path,) = tmp_path.glob(f"*/{wire.name}/*.log.gz")
        with can.LogReader(path) as reader:
            read = [(message.arbitration_id, bytes(message.data)) for message in reader]
        assert read == [(each.identifier, each.data) for each in frames]
        (sidecar,) = tmp_path.glob(f"*/{wire.name}/*.meta.jsonl")
        assert [json.loads(line)["event"] for line in sidecar.read_text().splitlines()] == ["start", "end"]


def test_can_utils_read_what_zcat_unpacks(tmp_path, clock):
    if not shutil.which("log2asc"):
        pytest.skip("log2asc of can-utils is missing (make system installs it on Debian)")
    wire = Wire("can0")
    box = BlackBox([wire], LogTable(directory=str(tmp_path), free_bytes_min=0), clock)
    sent = frame(2)._replace(arb=extended(0x18EF2A10), sent_here=True)
    wire.queue.extend([frame(1), sent, Frame(standard(0x7FF, remote=True), b"", sent.t_ns), warning(4)])
    box.on_readable(wire)
    box.close()
    (path,) = tmp_path.glob("*/can0/*.log.gz")
    text = subprocess.run(["zcat", path], capture_output=True, check=True).stdout
    told = subprocess.run(["log2asc", "can0"], input=text, capture_output=True, check=True).stdout.decode()
    words = [line.split()[2:5] for line in told.splitlines() if line.startswith("   ")]
    assert words == [["100", "Rx", "d"], ["18EF2A10x", "Tx", "d"], ["7FF", "Rx", "r"], ["ErrorFrame"]]


def test_a_can_socket_is_such_a_socket(tmp_path, box, wire, clock):
    with open_can("canloop:canzlogd-test") as listening, open_can("canloop:canzlogd-test") as talking:
        assert isinstance(listening, CanSocket)
        listening.bind(ANYTHING)
        box = BlackBox([listening], LogTable(directory=str(tmp_path / "loop"), free_bytes_min=0), clock)
        talking.sendmsg(frame(7))
        while not (waiting := listening.receive()):
            pass
        talking.sendmsg(frame(8))
        assert waiting.data == frame(7).data
        while not content(tmp_path / "loop"):
            box.on_readable(listening)
        box.close()
        line = content(tmp_path / "loop").decode()
        assert parse_line(line)[1].data == frame(8).data
        assert line.endswith(" T\n")
