"""CAN sockets against the kernel's own SocketCAN. Runs inside the guest, as root, with vcan0 and vcan1 up."""

import itertools
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.base.errors import BusError
from delfim.base.frames import CAN_IDE, extended, standard
from delfim.canproxy.dsor.endpoint import CanPort, CanSegm
from delfim.canproxy.dsor.sockets import open_dsor
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.canproxy.socketcan import restart

sys.path.append(str(Path(__file__).parents[1] / "canproxy"))
from test_socket import *  # noqa: F403  (what is true of canloop is true of vcan0)

_numbers = itertools.count()


def run(command: str) -> str:
    return subprocess.run(command.split(), check=True, capture_output=True, text=True, timeout=20).stdout


@pytest.fixture
def interface() -> Iterator[str]:
    """A vcan interface of the test's own."""
    name = f"test{next(_numbers)}"
    run(f"ip link add {name} type vcan")
    run(f"ip link set {name} up")
    yield name
    if name in (existing for _, existing in socket.if_nameindex()):
        run(f"ip link del {name}")


@pytest.fixture
def sockets(interface: str) -> Iterator[tuple[CanSocket, CanSocket]]:
    """A sender and a receiver of identifiers 0x100..0x1FF, on one interface."""
    with open_can(interface) as sender, open_can(interface) as receiver:
        receiver.settimeout(30.0)
        receiver.bind(CanAddress(standard(0x100), standard(0xFF)))
        yield sender, receiver


def test_the_real_interface_is_among_those_tested() -> None:
    assert "vcan0" in INTERFACES  # noqa: F405


def test_messages_go_between_two_buses_by_the_router_and_are_answered() -> None:
    root = Path(__file__).parents[2]
    table = (
        "can.interface=vcan0",
        'routing.buses.sonars={interface="vcan1", nodes=[0x30]}',
        "runtime.run_directory=/tmp/routed",
    )
    words = [word for value in table for word in ("--set", value)]
    beat, told = os.pipe()
    command = [sys.executable, "-m", "delfim", "run", str(root / "etc/delfimx.toml"), "--service", "router", *words]
    environment = os.environ | {"PYTHONPATH": str(root)}
    with subprocess.Popen([*command, "--beat-fd", str(told)], pass_fds=(told,), env=environment) as router:
        os.close(told)
        assert os.read(beat, 1), "it has opened its buses"
        with open_dsor("vcan1", 0x30) as sonar, open_dsor("vcan0", 2) as other:
            for each in (sonar, other):
                each.settimeout(30.0)
            other.bind(CanPort(512 * 2 + 5))
            sonar.bind(CanSegm(0, 0x30, 7))
            got = list[bytes]()

            def answers() -> None:
                got.append(other.recvfrom(65_535)[0])
                other.sendto(b"understood", CanSegm(0x80, 0x30, 7))

            thread = threading.Thread(target=answers)
            thread.start()
            sonar.sendto(bytes(range(250)) * 4, CanPort(512 * 2 + 5))
            assert sonar.recvfrom(100)[0] == b"understood"
            thread.join()
            assert got == [bytes(range(250)) * 4]
        router.terminate()
    os.close(beat)


def test_any_hears_all_interfaces_and_names_them() -> None:
    with open_can("any") as every, open_can("vcan0") as vcan0, open_can("vcan1") as vcan1:
        every.settimeout(30.0)
        every.bind(CanAddress(standard(0x123)))
        vcan0.sendto(b"0", CanAddress(standard(0x123)))
        vcan1.sendto(b"1", CanAddress(standard(0x123)))
        assert every.recvfrom(8) == (b"0", CanAddress(standard(0x123), 0, socket.if_nametoindex("vcan0")))
        assert every.recvfrom(8) == (b"1", CanAddress(standard(0x123), 0, socket.if_nametoindex("vcan1")))
        assert (every.ifindex, vcan1.ifindex) == (0, socket.if_nametoindex("vcan1"))


def test_any_sends_by_all_interfaces_or_by_the_one_named(interface: str) -> None:
    run(f"ip link set {interface} down")  # an interface that is down is passed over
    with open_can("any") as every, open_can("vcan0") as vcan0, open_can("vcan1") as vcan1:
        for each in (vcan0, vcan1):
            each.settimeout(30.0)
            each.bind(CanAddress(standard(5)))  # another test's frame may still come
        assert every.sendto(b"all", CanAddress(standard(5))) == 3
        every.sendto(b"one", CanAddress(standard(5), 0, vcan1.ifindex))
        assert vcan0.recv(8) == b"all"
        assert [vcan1.recv(8), vcan1.recv(8)] == [b"all", b"one"]
        assert vcan0.receive() is None
        with pytest.raises(BusError):
            every.sendto(b"", CanAddress(standard(5), 0, 999))


def test_any_bound_to_an_index_hears_that_interface_only() -> None:
    with open_can("any") as every, open_can("vcan0") as vcan0, open_can("vcan1") as vcan1:
        every.settimeout(30.0)
        every.bind(CanAddress(standard(1), 0, vcan1.ifindex))
        vcan0.sendto(b"0", CanAddress(standard(1)))
        vcan1.sendto(b"1", CanAddress(standard(1)))
        assert every.recv(8) == b"1"
        every.bind(ANYTHING)
        vcan0.sendto(b"0", CanAddress(standard(1)))
        assert every.recv(8) == b"0"
        with pytest.raises(BusError, match="several interfaces"):
            every.bind(ANYTHING, CanAddress(1, 0, vcan1.ifindex))
        with pytest.raises(BusError, match="no interface"):
            every.bind(CanAddress(1, 0, 999))


def test_interface_down_is_told_once_and_it_comes_back(interface: str, sockets: tuple[CanSocket, CanSocket]) -> None:
    sender, receiver = sockets
    run(f"ip link set {interface} down")
    with pytest.raises(BusError, match=f"{interface} is down"):
        receiver.receive()
    assert receiver.receive() is None
    assert not receiver.rebind()
    assert receiver.receive() is None  # asking is no failure of its own
    with pytest.raises(BusError, match=f"{interface} is down"):
        sender.sendto(b"", CanAddress(standard(0x100)))
    run(f"ip link set {interface} up")
    assert receiver.rebind()
    assert sender.rebind()
    sender.sendto(b"no", CanAddress(standard(0x200)))
    sender.sendto(b"yes", CanAddress(standard(0x123)))
    assert receiver.recv(8) == b"yes"


def test_interface_comes_back_without_rebind(interface: str, sockets: tuple[CanSocket, CanSocket]) -> None:
    sender, receiver = sockets
    run(f"ip link set {interface} down")
    run(f"ip link set {interface} up")
    for each in sockets:
        with pytest.raises(BusError, match="is down"):
            each.receive()
    sender.sendto(b"yes", CanAddress(standard(0x123)))
    assert receiver.recv(8) == b"yes"


def test_a_waiting_reader_is_woken_when_its_interface_goes(interface: str, sockets: tuple[CanSocket, CanSocket]) -> None:
    with subprocess.Popen(["sh", "-c", f"sleep 0.3; ip link set {interface} down"]), pytest.raises(BusError, match="is down"):
        sockets[1].recvmsg()


def test_a_replugged_adapter_is_found_again(interface: str, sockets: tuple[CanSocket, CanSocket]) -> None:
    sender, receiver = sockets
    descriptor, index = receiver.fileno(), receiver.ifindex
    run(f"ip link del {interface}")
    with pytest.raises(BusError, match=f"no interface {interface}"):
        receiver.receive()
    assert receiver.receive() is None
    assert not receiver.rebind()
    with pytest.raises(BusError, match=f"no interface {interface}"):
        sender.sendto(b"", CanAddress(standard(0x100)))
    run(f"ip link add {interface} type vcan")
    assert not receiver.rebind()  # there, and still down
    run(f"ip link set {interface} up")
    assert receiver.rebind()
    assert sender.rebind()
    assert receiver.fileno() == descriptor
    assert receiver.ifindex != index
    sender.sendto(b"no", CanAddress(standard(0x200)))  # the filters are those of before
    sender.sendto(b"yes", CanAddress(standard(0x123)))
    assert receiver.recvfrom(8) == (b"yes", CanAddress(standard(0x123), 0, socket.if_nametoindex(interface)))


def test_reasons_for_not_opening(interface: str) -> None:
    run(f"ip link set {interface} down")
    with pytest.raises(BusError, match=f"{interface} is down; it comes back when it is set up"):
        open_can(interface)
    with pytest.raises(BusError, match="lo is not a CAN interface"):
        open_can("lo")
    with pytest.raises(BusError, match="no interface can77"):
        open_can("can77")


def test_a_full_interface_queue_is_eagain_and_a_blocking_socket_waits_for_it(
    interface: str, sockets: tuple[CanSocket, CanSocket]
) -> None:
    run(f"tc qdisc add dev {interface} root netem delay 200ms limit 2")
    sender, receiver = sockets
    address = CanAddress(standard(0x100))
    sender.sendto(b"1", address, socket.MSG_DONTWAIT)
    sender.sendto(b"2", address, socket.MSG_DONTWAIT)
    with pytest.raises(BlockingIOError):
        sender.sendto(b"3", address, socket.MSG_DONTWAIT)
    sender.sendto(b"4", address)
    assert [receiver.recv(8) for _ in range(3)] == [b"1", b"2", b"4"]


def test_restart_says_why_not() -> None:
    with pytest.raises(BusError, match="vcan0 has no controller to restart"):
        restart("vcan0")
    with pytest.raises(BusError, match="no interface can77"):
        restart("can77")


def test_too_many_filters_are_refused_with_a_reason(interface: str) -> None:
    with open_can(interface) as one, pytest.raises(BusError):
        one.bind(*(CanAddress(standard(number)) for number in range(513)))


def test_candump_sees_the_same_bytes(interface: str) -> None:
    command = ["candump", "-L", "-n", "3", interface]
    with open_can(interface) as sender, subprocess.Popen(command, stdout=subprocess.PIPE) as candump:
        while not re.search(rf"^ *{interface} ", Path("/proc/net/can/rcvlist_all").read_text(), re.MULTILINE):
            time.sleep(0.01)
        sender.sendto(bytes.fromhex("0123456789abcdef"), CanAddress(standard(0x7FF)))
        sender.sendto(b"\0", CanAddress(extended(0x1FFFFFFE)))
        sender.sendto(bytes(8), CanAddress(standard(0x12, remote=True)))
        lines = candump.communicate(timeout=10)[0].decode().splitlines()
    assert [line.split()[2] for line in lines] == ["7FF#0123456789ABCDEF", "1FFFFFFE#00", "012#R8"]


def test_cansend_is_heard(sockets: tuple[CanSocket, CanSocket], interface: str) -> None:
    run(f"cansend {interface} 123#DEADBEEF")
    frame = sockets[1].recvmsg()
    assert frame[:2] == (standard(0x123), bytes.fromhex("DEADBEEF"))
    assert frame.sent_here
    assert abs(time.time_ns() - frame.t_ns) < 5_000_000_000


def test_filters_are_the_kernels(interface: str) -> None:
    with open_can(interface) as receiver:
        receiver.bind(CanAddress(standard(0x123)), CanAddress(extended(0x7), CAN_IDE))
        lists = "".join(path.read_text() for path in Path("/proc/net/can").glob("rcvlist_*"))
        mine = [line.split()[1:3] for line in lists.splitlines() if line.split()[:1] == [interface]]
        assert sorted(mine) == [["123", "c00007ff"], ["80000007", "dfffffff"]]


def test_an_adapter_of_python_can_on_the_same_interface(interface: str) -> None:
    with open_can(interface) as kernel, open_can(f"python-can:socketcan:{interface}") as adapter:
        for each in (kernel, adapter):
            each.settimeout(30.0)
            each.bind(CanAddress(standard(1)))
        kernel.sendto(b"out", CanAddress(standard(1)))
        assert adapter.recv(8) == b"out"
        adapter.sendto(b"back", CanAddress(standard(1)))
        assert kernel.recv(8) == b"back"
