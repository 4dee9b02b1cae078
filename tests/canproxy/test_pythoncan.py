"""canloop for python-can's tools, and python-can's adapters for CanSocket."""

import importlib.metadata
import itertools
import os
import subprocess
import sys
import threading
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, extended, standard
from delfim.canproxy.adapter import from_message, to_message
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.opening import open_can
from delfim.canproxy.pythoncan import CanloopBus, addresses
from delfim.canproxy.socket import ANYTHING, CanAddress, accepts

_numbers = itertools.count()


@pytest.fixture
def name() -> str:
    return f"test-python-{os.getpid()}-{next(_numbers)}"


def test_python_can_finds_the_plug_in() -> None:
    points = {point.name: point.value for point in importlib.metadata.entry_points(group="can.interface")}
    assert points["canloop"] == "delfim.canproxy.pythoncan:CanloopBus"


def test_both_directions(name: str) -> None:
    with can.Bus(interface="canloop", channel=name) as bus, open_canloop(name) as ours:
        assert isinstance(bus, CanloopBus)
        ours.settimeout(200.0)
        ours.bind(ANYTHING)
        bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"hello"))
        assert ours.recvfrom(8) == (b"hello", CanAddress(standard(0x123), 0, ours.ifindex))
        ours.sendto(b"back", CanAddress(extended(0x1234567)))
        message = bus.recv(5.0)
        assert message is not None
        assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (0x1234567, True, b"back")
        assert message.timestamp > 1e9
        assert message.channel == f"canloop:{name}"
        assert bus.recv(0) is None  # not its own
        assert bus.recv(0.01) is None


def test_two_buses_of_python_can_and_a_notifier(name: str) -> None:
    heard = threading.Event()
    with can.Bus(interface="canloop", channel=name) as one, can.Bus(interface="canloop", channel=name) as two:
        notifier = can.Notifier(two, [lambda message: heard.set()], timeout=0.1)
        one.send(can.Message(arbitration_id=1))
        assert heard.wait(200.0)
        notifier.stop()


def test_the_logger_of_python_can_in_another_process(name: str, tmp_path: Path) -> None:
    log = tmp_path / "can.log"
    command = [sys.executable, "-m", "can.logger", "-i", "canloop", "-c", name, "-f", str(log)]
    log.touch()
    pause = threading.Event()
    with open_canloop(name) as ours, subprocess.Popen(command, stdout=subprocess.DEVNULL) as logger:
        try:
            while logger.poll() is None and b"321#BEEF" not in log.read_bytes():
                for _ in range(20):  # the logger writes when its buffer is full
                    ours.sendto(b"\xbe\xef", CanAddress(standard(0x321)))
                pause.wait(0.01)
        finally:
            logger.kill()
    assert b"321#BEEF" in log.read_bytes()


def test_filters_are_set_and_changed(name: str) -> None:
    with (
        open_canloop(name) as ours,
        can.Bus(
            interface="canloop", channel=name, can_filters=[{"can_id": 0x100, "can_mask": 0x7F0, "extended": False}]
        ) as bus,
    ):
        for number in (0x200, 0x10F):
            ours.sendto(b"", CanAddress(standard(number)))
        ours.sendto(b"", CanAddress(extended(0x10F)))
        received = bus.recv(5.0)
        assert received is not None
        assert received.arbitration_id == 0x10F
        assert not received.is_extended_id
        assert bus.recv(0) is None
        bus.set_filters(None)
        ours.sendto(b"", CanAddress(standard(0x200)))
        assert bus.recv(5.0) is not None


numbers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF))


@given(numbers, st.integers(0, 0x1FFFFFFF), st.sampled_from([None, True, False]), numbers, st.booleans(), st.booleans())
def test_filters_mean_what_python_can_says(can_id, can_mask, only, number, wide, remote):
    entry = {"can_id": can_id, "can_mask": can_mask} | ({} if only is None else {"extended": only})
    for identifier in (number, number ^ can_id, can_id):
        is_extended = wide or identifier > 0x7FF
        expected = (only is None or only == is_extended) and not (can_id ^ identifier) & can_mask
        arb = (extended if is_extended else standard)(identifier, remote)
        assert any(accepts(address, arb) for address in addresses([entry])) == expected


@given(st.one_of(st.builds(standard, st.integers(0, 0x7FF), st.booleans()), st.builds(extended, st.integers(0, 0x1FFFFFFF))))
def test_messages_and_frames_are_the_same_thing(arb: int) -> None:
    assert from_message(to_message(arb, bytes(5))) == (arb, bytes(5))


def test_error_frames_survive_the_conversion() -> None:
    arb = 0x204 << 3 | CAN_IDE | CAN_ERR
    message = to_message(arb, bytes([0, 0x20, 0, 0, 0, 0, 130, 7]))
    assert message.is_error_frame
    assert from_message(message) == (arb, bytes([0, 0x20, 0, 0, 0, 0, 130, 7]))


def test_what_canloop_cannot_carry_is_refused(name: str) -> None:
    with can.Bus(interface="canloop", channel=name) as bus:
        with pytest.raises(can.CanOperationError, match="CAN FD"):
            bus.send(can.Message(is_fd=True, data=bytes(12)))
        with pytest.raises(can.CanOperationError, match="outside"):
            bus.send(can.Message(arbitration_id=0x800, is_extended_id=False, check=False))
    with pytest.raises(FormatError):
        to_message(standard(1), bytes(9))


def test_an_adapter_both_ways_with_filters(name: str) -> None:
    with open_can(f"python-can:virtual:{name}") as ours, can.Bus(interface="virtual", channel=name) as theirs:
        ours.settimeout(200.0)
        theirs.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=b"early"))
        ours.bind(CanAddress(standard(0x101)))
        theirs.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=b"refused"))
        theirs.send(can.Message(arbitration_id=0x101, is_extended_id=False, data=b"taken"))
        frame = ours.recvmsg()
        assert frame[:2] == (standard(0x101), b"taken")
        assert frame.ifindex == ours.ifindex > 0
        assert not frame.sent_here
        assert ours.receive() is None
        ours.sendto(b"out", CanAddress(extended(0x12345)))
        message = theirs.recv(5.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x12345, b"out")
        with pytest.raises(BusError, match="has index"):
            ours.bind(CanAddress(1, 0, 1))
        with pytest.raises(BusError, match="does not send"):
            ours.sendto(b"", CanAddress(1, 0, 1))


def test_an_adapter_drops_what_does_not_fit_and_counts_it(name: str) -> None:
    with open_can(f"python-can:virtual:{name}", receive_buffer_bytes=4096) as ours:
        ours.settimeout(200.0)
        ours.bind(ANYTHING)
        with can.Bus(interface="virtual", channel=name) as theirs:
            for _ in range(300):
                theirs.send(can.Message(arbitration_id=1))
            while ours.dropped == 0:
                os.sched_yield()
            queued = 0
            while ours.dropped + queued < 300:
                queued += len(list(iter(ours.receive, None)))
        assert 0 < queued < 300


class UnpluggedBus(can.BusABC):
    """An adapter that fails when it is told to."""

    unplugged = threading.Event()
    full = False

    def __init__(self, channel: str, **kwargs: object) -> None:
        if self.unplugged.is_set():
            raise can.CanInitializationError("no such device")
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.full:
            raise can.CanOperationError("Transmit buffer full", error_code=105)
        raise can.CanOperationError("cable cut")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.unplugged.wait(timeout):
            raise RuntimeError("the adapter is gone")
        return None, True


def test_an_adapter_that_goes_is_told_and_taken_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can, "Bus", lambda interface, channel, ignore_config: UnpluggedBus(channel))
    UnpluggedBus.unplugged.clear()
    with open_can("python-can:test:0") as ours:
        assert ours.rebind()
        with pytest.raises(BusError, match="cable cut"):
            ours.sendto(b"", CanAddress(standard(1)))
        monkeypatch.setattr(UnpluggedBus, "full", True)
        with pytest.raises(BlockingIOError):
            ours.sendto(b"", CanAddress(standard(1)), 0x40)
        UnpluggedBus.unplugged.set()
        ours.settimeout(200.0)
        with pytest.raises(BusError, match="python-can:test:0: the adapter is gone"):
            ours.recvmsg()
        with pytest.raises(BusError, match="the adapter is gone"):
            ours.sendto(b"", CanAddress(standard(1)))
        assert not ours.rebind()
        UnpluggedBus.unplugged.clear()
        assert ours.rebind()
        assert ours.receive() is None


@pytest.mark.parametrize("interface", ["python-can:pcan", "python-can:", "python-can:slcan:/dev/tty@fast"])
def test_what_an_adapter_needs_is_said(interface: str) -> None:
    with pytest.raises(BusError, match="write python-can:INTERFACE:CHANNEL"):
        open_can(interface)
