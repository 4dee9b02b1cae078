"""canloop between processes, with losses, strangers and too many filters."""

import itertools
import os
import re
import socket
import struct
import subprocess
import sys
import time

import pytest

from delfim.base.errors import BusError
from delfim.base.frames import CAN_RTR, extended, standard
from delfim.canproxy import mmsg
from delfim.canproxy.canloop import CanLoop, group_of, open_canloop, stable_index
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket

_numbers = itertools.count()

ECHO = """
import sys
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress
from delfim.base.frames import standard
bus = open_can(sys.argv[1])
bus.bind(CanAddress(standard(0x100), standard(0xFF)))
bus.sendto(b"ready", CanAddress(standard(1)))
while data := bus.recv(8):
    bus.sendto(data[::-1], CanAddress(standard(0x200)))
"""


@pytest.fixture
def bus() -> str:
    return f"test-loop-{os.getpid()}-{next(_numbers)}"


def test_two_processes_on_one_bus(bus: str) -> None:
    with open_can(f"canloop:{bus}") as here:
        here.settimeout(200.0)
        here.bind(ANYTHING)
        with subprocess.Popen([sys.executable, "-c", ECHO, f"canloop:{bus}"]) as there:
            assert here.recv(8) == b"ready"
            here.sendto(b"ignored", CanAddress(standard(0x300)))
            here.sendto(b"12345678", CanAddress(standard(0x1AB)))
            frame = here.recvmsg()
            here.sendto(b"", CanAddress(standard(0x100)))
            assert there.wait(200) == 0
    assert frame[:2] == (standard(0x200), b"87654321")
    assert not frame.sent_here  # another process of this computer
    assert abs(time.time_ns() - frame.t_ns) < 20_000_000_000
    assert frame.ifindex == stable_index(bus)


def test_frames_of_a_socket_that_was_closed_meanwhile_are_still_ours(bus: str) -> None:
    with open_can(f"canloop:{bus}") as here:
        here.bind(ANYTHING)
        here.settimeout(200.0)
        with open_can(f"canloop:{bus}") as gone:
            gone.sendto(b"last", CanAddress(standard(1)))
        assert here.recvmsg().sent_here


def test_two_buses_do_not_hear_each_other(bus: str) -> None:
    with open_canloop(bus) as one, open_canloop(f"{bus}-2") as two, open_canloop(f"{bus}-2") as three:
        for each in (one, two, three):
            each.bind(ANYTHING)
        two.sendto(b"two", CanAddress(standard(1)))
        three.settimeout(200.0)
        assert three.recv(8) == b"two"
        assert one.receive() is None
        assert one.ifindex != two.ifindex


def received(sender: CanSocket, receiver: CanSocket, count: int) -> list[int]:
    for number in range(count):
        sender.sendto(bytes([number]), CanAddress(standard(1)))
    return [frame.data[0] for frame in iter(receiver.receive, None)]


def test_droprate_is_repeated_by_its_seed(bus: str) -> None:
    runs = []
    for seed in (1, 1, 2):
        with open_canloop(bus, droprate=0.3, seed=seed) as sender, open_canloop(bus) as receiver:
            receiver.bind(ANYTHING)
            runs.append(received(sender, receiver, 200))
            assert receiver.dropped == 0  # lost on the bus, not in the receiver's queue
    assert runs[0] == runs[1] != runs[2]
    assert 100 < len(runs[0]) < 180


def test_droprate_one_loses_everything(bus: str) -> None:
    with open_canloop(bus, droprate=1.0) as sender, open_canloop(bus) as receiver:
        receiver.bind(ANYTHING)
        assert received(sender, receiver, 20) == []


def test_verbose_prints_what_is_sent_as_candump_does(bus: str, capsys: pytest.CaptureFixture[str]) -> None:
    with open_canloop(bus, verbose=True) as sender:
        sender.sendto(b"\xde\xad", CanAddress(standard(0x12)))
        sender.sendto(bytes(3), CanAddress(extended(0x1234, remote=True)))
    first, second = capsys.readouterr().err.splitlines()
    assert re.fullmatch(rf"\(\d+\.\d{{6}}\) canloop:{bus} 012#DEAD", first)
    assert second.endswith(" 00001234#R3")


@pytest.mark.parametrize("kernel_filter", [True, False])
@pytest.mark.parametrize("datagram", [b"", b"x", bytes(16), bytes(8) + b"\x09" + bytes(8), bytes(18), bytes(1400)])
def test_what_is_no_frame_does_not_arrive(bus: str, kernel_filter: bool, datagram: bytes) -> None:
    with CanSocket(CanLoop(bus, kernel_filter=kernel_filter)) as receiver, open_canloop(bus) as sender:
        receiver.bind(ANYTHING)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            stranger.sendto(datagram, group_of(bus))
        sender.sendto(b"frame", CanAddress(standard(1)))
        receiver.settimeout(200.0)
        assert receiver.recv(8) == b"frame"
        assert receiver.receive() is None
        assert receiver.dropped == 0


def test_refused_frames_are_not_counted_as_dropped(bus: str) -> None:
    with open_canloop(bus) as sender, open_canloop(bus) as receiver:
        receiver.bind(CanAddress(standard(1)))
        for number in range(50):
            sender.sendto(b"", CanAddress(standard(2 + number)))
            sender.sendto(b"", CanAddress(standard(1)))
        assert len(list(iter(receiver.receive, None))) == 50
        assert receiver.dropped == 0
        receiver.bind(CanAddress(standard(2)))
        sender.sendto(b"", CanAddress(standard(1)))
        receiver.bind(ANYTHING)
        sender.sendto(b"", CanAddress(standard(1)))
        assert receiver.receive() is not None
        assert receiver.dropped == 0  # what the filter of the time refused was not lost either


def test_hundreds_of_filters_work_and_too_many_have_a_reason(bus: str) -> None:
    with open_canloop(bus) as sender, open_canloop(bus) as receiver:
        receiver.bind(*(CanAddress(standard(number)) for number in range(300)))
        sender.sendto(b"no", CanAddress(standard(300)))
        sender.sendto(b"yes", CanAddress(standard(299)))
        receiver.settimeout(200.0)
        assert receiver.recv(8) == b"yes"
        with pytest.raises(BusError, match="2048 acceptance filters refused"):
            receiver.bind(*(CanAddress(standard(number)) for number in range(2048)))
        sender.sendto(b"still", CanAddress(standard(299)))
        assert receiver.recv(8) == b"still"


@pytest.mark.parametrize("cuts", [True, False])
def test_frames_that_are_sent_at_once_arrive_each_for_itself(bus: str, cuts: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel takes them as one datagram and cuts it for each receiver, whose filter then looks at each; an old kernel takes
    them one by one."""
    if not cuts:
        monkeypatch.setattr(mmsg, "_UDP_SEGMENT", 9999)
    frames = [(standard(number), bytes([number])) for number in range(4)]
    with open_canloop(bus) as sender, open_canloop(bus) as all_of_them, open_canloop(bus) as one:
        assert isinstance(sender._transport._given, mmsg.SegmentBatch) == cuts
        all_of_them.bind(ANYTHING)
        one.bind(CanAddress(standard(2)))
        assert sender.send_many(frames) == 0
        sender.rehearse()
        assert [frame[:2] for frame in all_of_them.receive_many()] == frames
        assert [frame[:2] for frame in one.receive_many()] == frames[2:3]
        assert one.receive() is None
        assert (all_of_them.dropped, one.dropped) == (0, 0)


def test_numbering_stays_small_with_endless_identifiers(bus: str) -> None:
    with open_canloop(bus) as sender, open_canloop(bus) as receiver:
        receiver.bind(ANYTHING)
        for number in range(10_000):
            sender.sendto(b"", CanAddress(extended(number)))
            assert receiver.receive() is not None
        assert receiver.dropped == 0
        assert len(receiver._transport._seen) <= 4096
        assert len(sender._transport._sent) <= 4096


def test_another_interface_is_not_sent_by(bus: str) -> None:
    with open_canloop(bus) as one, pytest.raises(BusError, match="does not send by interface 1"):
        one.sendto(b"", CanAddress(standard(1), 0, 1))


def test_without_loopback_there_is_a_reason(bus: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    with pytest.raises(BusError, match="Network is unreachable; it needs the loopback interface"):
        open_canloop(bus)


@pytest.mark.parametrize("name", ["delfimx", "a", "boat.2"])
def test_groups_are_local_and_ports_below_the_ephemeral_ones(name: str) -> None:
    group, port = group_of(name)
    assert re.fullmatch(r"239\.255\.\d{1,3}\.\d{1,3}", group)
    assert 16384 <= port < 32768
    assert 0x40000000 <= stable_index(name) < 0x80000000


def test_the_datagram_is_as_written_down(bus: str) -> None:
    group = group_of(bus)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire, open_canloop(bus) as sender:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        wire.bind(group)
        membership = socket.inet_aton(group[0]) + socket.inet_aton("127.0.0.1")
        wire.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        wire.settimeout(200.0)
        sender.sendto(b"", CanAddress(standard(0x7F0)))
        sender.sendto(b"ab", CanAddress(standard(0x7F0) | CAN_RTR))
        sender.sendto(b"abc", CanAddress(standard(0x7F0)))
        datagrams = [struct.unpack("!IIB8s", wire.recv(100)) for _ in range(3)]
    assert datagrams == [
        (0, standard(0x7F0), 0, bytes(8)),
        (0, standard(0x7F0, remote=True), 2, b"ab" + bytes(6)),
        (1, standard(0x7F0), 3, b"abc" + bytes(5)),
    ]
