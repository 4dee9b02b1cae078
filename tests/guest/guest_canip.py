"""IP over CAN between two computers: two network namespaces, a CAN cable (vxcan) between them, and the service in each.

Runs in the guest, as root, with the modules vxcan and tun.
"""

import ctypes
import errno
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FIRST, SECOND = "192.168.1.2", "192.168.1.3"
PORT = 4747
_NEW_NETWORK = 0x40000000  # linux/sched.h: CLONE_NEWNET


def run(command: str) -> str:
    return subprocess.run(command.split(), check=True, capture_output=True, text=True, timeout=20).stdout


def udp(namespace: str, address: str) -> socket.socket:
    """A socket lives in the namespace in which it was made."""
    libc = ctypes.CDLL(None, use_errno=True)
    here = os.open("/proc/self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    try:
        assert libc.setns(there, _NEW_NETWORK) == 0
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        made.bind((address, PORT))
        made.settimeout(60.0)
    finally:
        assert libc.setns(here, _NEW_NETWORK) == 0
        os.close(here)
        os.close(there)
    return made


def service(namespace: str, address: str, node: int, peer: str) -> "subprocess.Popen[bytes]":
    overrides = (
        f'can.interface="{namespace}"',
        "canip.enabled=true",
        f'canip.address="{address}/24"',
        f"can.node={node}",
        f'canip.peers={{other={{address="{peer}",node={7 - node}}}}}',
    )
    words = [word for override in overrides for word in ("--set", override)]
    command = [sys.executable, "-m", "delfim", "run", "etc/delfimx.toml", "--service", "canip", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(["ip", "netns", "exec", namespace, *command], cwd=ROOT, env=environment)


@pytest.fixture(scope="module")
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """A UDP socket in each of two namespaces that nothing but CAN connects."""
    run("ip link add first type vxcan peer name second")
    for name in ("first", "second"):
        run(f"ip netns add {name}")
        run(f"ip link set {name} netns {name}")
        run(f"ip -n {name} link set {name} up txqueuelen 1000")
    services = [service("first", FIRST, 3, SECOND), service("second", SECOND, 4, FIRST)]
    deadline_s = time.monotonic() + 60.0
    for name, address in (("first", FIRST), ("second", SECOND)):
        while address not in run(f"ip -n {name} -o address") or ",UP" not in run(f"ip -n {name} -o link"):
            assert time.monotonic() < deadline_s
            assert all(each.poll() is None for each in services)
            time.sleep(0.1)
    with udp("first", FIRST) as first, udp("second", SECOND) as second:
        yield first, second
    for each in services:
        each.terminate()
    assert [each.wait(20) for each in services] == [0, 0]
    for name in ("first", "second"):
        run(f"ip netns del {name}")


def round_trip_s(first: socket.socket, second: socket.socket, data: bytes) -> float:
    began_s = time.monotonic()
    first.sendto(data, (SECOND, PORT))
    asked, where = second.recvfrom(65_535)
    assert (asked, where) == (data, (FIRST, 0))  # the source port does not travel
    second.sendto(asked, (where[0], PORT))
    assert first.recvfrom(65_535) == (data, (SECOND, 0))
    return time.monotonic() - began_s


def test_the_device_is_as_configured(ends: tuple[socket.socket, socket.socket]) -> None:
    line = run("ip -n first -o link show canip0")
    assert "mtu 65535" in line
    assert "POINTOPOINT" in line
    assert f"inet {FIRST}/24" in run("ip -n first -o address show canip0")


@pytest.mark.parametrize("size", [0, 1, 8, 1472, 5000])
def test_round_trips(ends: tuple[socket.socket, socket.socket], size: int) -> None:
    round_trip_s(*ends, os.urandom(size))


def test_the_largest_datagram(ends: tuple[socket.socket, socket.socket]) -> None:
    data = os.urandom(65_507)
    ends[0].sendto(data, (SECOND, PORT))
    assert ends[1].recv(65_535) == data


def test_figures(ends: tuple[socket.socket, socket.socket]) -> None:
    trips_s = sorted(round_trip_s(*ends, bytes(16)) for _ in range(100))
    bulk = 5000
    spent_s = round_trip_s(*ends, bytes(bulk))
    print(
        f"measured: round trip of 16 bytes {trips_s[50] * 1e3:.2f} ms (p50), {trips_s[98] * 1e3:.2f} ms (p99);"
        f" {2 * bulk / spent_s / 1e3:.0f} kB/s in datagrams of {bulk} bytes"
    )
    assert trips_s[50] < 1.0


def test_datagrams_in_a_row_arrive_in_order(ends: tuple[socket.socket, socket.socket]) -> None:
    first, second = ends
    for i in range(16):
        first.sendto(bytes([i]) * 100, (SECOND, PORT))
    assert [second.recv(65_535) for _ in range(16)] == [bytes([i]) * 100 for i in range(16)]


def test_what_is_too_large_is_refused_by_the_kernel(ends: tuple[socket.socket, socket.socket]) -> None:
    with pytest.raises(OSError, match="too long") as error:
        ends[0].sendto(bytes(65_508), (SECOND, PORT))
    assert error.value.errno == errno.EMSGSIZE


def test_with_a_smaller_mtu_larger_datagrams_do_not_arrive(ends: tuple[socket.socket, socket.socket]) -> None:
    first, second = ends
    run("ip -n first link set canip0 mtu 576")
    try:
        first.sendto(bytes(1000), (SECOND, PORT))  # the kernel makes fragments of it
        first.sendto(bytes(548), (SECOND, PORT))
        assert len(second.recv(65_535)) == 548
        first.setsockopt(socket.IPPROTO_IP, 10, 2)  # IP_MTU_DISCOVER, IP_PMTUDISC_DO: whoever wants to be told
        with pytest.raises(OSError, match="too long"):
            first.sendto(bytes(1000), (SECOND, PORT))
    finally:
        run("ip -n first link set canip0 mtu 65535")


def test_ping_and_tcp_do_not_cross(ends: tuple[socket.socket, socket.socket]) -> None:
    ping = subprocess.run(
        ["ip", "netns", "exec", "first", "busybox", "ping", "-c", "1", "-W", "1", SECOND], capture_output=True
    )
    assert ping.returncode == 1
    round_trip_s(*ends, b"still here")
