"""The C programs of the benchmark: they compile without a warning and speak the boat's protocol as the Python does."""

import contextlib
import json
import os
import random
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.critical_path import build
from delfim.base.frames import Frame
from delfim.canproxy.canloop import group_of
from delfim.canproxy.dsor.messages import (
    BATTERIES_PORT,
    NAVIGATION,
    NAVIGATION_ID,
    NAVIGATION_PRIORITY,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    SYSSTAT_MASK,
    Node,
    Status,
    sysstat_arb,
    unpack_navigation,
    unpack_sysstat,
)
from delfim.canproxy.dsor.protocol import Message, message_filter, segments
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.logging.statelog import columns

FIELDS = ("utc", "latitude", "longitude", "north_speed", "east_speed", "heading", "yaw_rate", "roll", "pitch")
FIELDS += ("fix", "satellites", "hdop", "counter")
READY_S = 60.0


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Compiled with -Wall -Wextra -Werror."""
    return build(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def bus() -> str:
    return f"bench-test-{os.getpid()}"


def wire(bus: str) -> str:
    return "{}:{}".format(*group_of(bus))


@contextlib.contextmanager
def loop(programs: dict[str, Path], bus: str, log: Path) -> Iterator[None]:
    with subprocess.Popen([programs["loop"], wire(bus), log], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        try:
            yield
        finally:
            child.terminate()


def navigation_messages(draw: random.Random, count: int) -> list[list[Frame]]:
    """Broadcasts of the navigation node, most of them damaged: lost, doubled, swapped, changed, cut, and other lengths."""
    sent = []
    for number in range(count):
        size = draw.choice([NAVIGATION.size] * 6 + [0, 3, 33, 200])
        identifier = draw.choice([NAVIGATION_ID] * 8 + [77])
        data = draw.randbytes(size)
        frames = segments(Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, identifier, data), number)
        at = draw.randrange(len(frames))
        match draw.choice(["whole", "whole", "lost", "doubled", "swapped", "changed", "cut", "late header"]):
            case "lost":
                del frames[at]
            case "doubled":
                frames.insert(at, frames[at])
            case "swapped":
                frames[at], frames[-1] = frames[-1], frames[at]
            case "changed" if frames[at].data:
                spoilt = bytes([frames[at].data[0] ^ 1 << draw.randrange(8)]) + frames[at].data[1:]
                frames[at] = frames[at]._replace(data=spoilt)
            case "cut" if at:
                frames[at] = frames[at]._replace(data=frames[at].data[:-1])
            case "late header":
                frames.insert(at, frames[0])
        sent.append(frames)
    return sent


@pytest.mark.parametrize("seed", range(4))
def test_c_puts_together_what_python_does(programs: dict[str, Path], bus: str, tmp_path: Path, seed: int) -> None:
    log = tmp_path / "c.state"
    receiver = Receiver(Node.VEHICLE, lambda message: message.id == NAVIGATION_ID)
    expected = []
    with open_can(f"canloop:{bus}") as world, loop(programs, bus, log):
        world.bind(CanAddress(BATTERIES_PORT))  # the last frame of each answer
        world.settimeout(200.0)
        said = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, bytes(NAVIGATION.size))
        for frames in [*navigation_messages(random.Random(seed), 150), segments(said, 150)]:
            for frame in frames:
                message = receiver.feed(frame, 0.0)
                world.sendmsg(frame)
                if message is not None and len(message.data) == NAVIGATION.size:
                    expected.append(NAVIGATION.unpack(message.data))
                    world.recvmsg()
    data = columns([log])
    heard = list(zip(*(data[name] for name in FIELDS), strict=True))
    assert heard[: len(expected) - 1] == expected[:-1]  # the program may end before it has written the last record
    assert len(expected) > 30


def test_c_steers_as_python_does(programs: dict[str, Path], bus: str, tmp_path: Path) -> None:
    """A boat that heads north-east and wants to go east turns to starboard: port ahead of starboard, within the limits."""
    log = tmp_path / "c.state"
    with open_can(f"canloop:{bus}") as world, loop(programs, bus, log):
        world.bind(CanAddress(PROPELLER_STARBOARD), CanAddress(PROPELLER_PORT))
        world.settimeout(200.0)
        for number in range(50):
            fields = (0, 386_925_000, -92_150_000, 0, 0, 7_854, 0, 0, 0, 3, 10, 9, number)
            message = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, NAVIGATION.pack(*fields))
            for frame in segments(message, number):
                world.sendmsg(frame)
            starboard, port = world.recvmsg(), world.recvmsg()
            assert (starboard.arb, port.arb) == (PROPELLER_STARBOARD, PROPELLER_PORT)
            assert starboard.data[2:] == port.data[2:] == bytes([1, number + 1])
    data = columns([log])
    sailed_s = (data["t3"][-1] - data["t2"][0]) / 1e9  # it steers between t2 and t3
    assert 0 < data["port_rpm"][-1] <= 800 * sailed_s * 1.2 + 1
    assert data["starboard_rpm"][-1] < data["port_rpm"][-1]


def test_feeder_sends_what_python_understands(programs: dict[str, Path], bus: str) -> None:
    with open_can(f"canloop:{bus}") as navigation, open_can(f"canloop:{bus}") as status:
        navigation.bind(CanAddress(*message_filter(source=Node.NAVIGATION)))
        status.bind(CanAddress(sysstat_arb(Node.VEHICLE), SYSSTAT_MASK))
        command = [programs["feeder"], wire(bus), "200", "0.1", "0.4", "2000", "0"]
        told = json.loads(subprocess.run(command, capture_output=True, check=True, timeout=READY_S).stdout)
        receiver = Receiver(Node.VEHICLE)
        fixes = []
        while frame := navigation.receive():
            if message := receiver.feed(frame, 0.0):
                fixes.append((message.t_ns, unpack_navigation(message.data)))
        reports = []
        while frame := status.receive():
            reports.append(unpack_sysstat(frame.arb >> 15 & 0x7F, frame.data))
    assert told["messages"] == len(fixes) == 100
    assert not receiver.errors
    assert [fix.counter for _, fix in fixes] == list(range(100))
    assert sum(told["begin_ns"] <= t_ns <= told["end_ns"] for t_ns, _ in fixes) == 80
    assert 900 <= told["frames"] <= 1100
    assert told["unsent"] == 0
    assert len(reports) >= 5
    assert all(report.status is Status.GOOD for report in reports)


def test_feeder_keeps_time(programs: dict[str, Path], bus: str) -> None:
    started_s = time.monotonic()
    subprocess.run(
        [programs["feeder"], wire(bus), "50", "0", "0.4", "0", "0"], capture_output=True, check=True, timeout=READY_S
    )
    assert time.monotonic() - started_s >= 0.4
