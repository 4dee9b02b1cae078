"""Frames are taken from a bus up to a bound, and those before a failure count."""

from delfim.base.clock import ManualClock
from delfim.base.errors import BusError
from delfim.base.frames import Frame, standard
from delfim.canproxy.socket import ANYTHING, CanSocket
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.links import FRAMES_PER_READ, received
from delfim.vehicle.state import State


def heard(count: int) -> CanSocket:
    """A socket where so many frames wait."""
    bus = LockstepBus(ManualClock())
    socket, sender = bus.bound(ANYTHING), bus.socket("nodes")
    for number in range(count):
        sender.sendmsg(Frame(standard(number)))
    return socket


def test_a_flooded_bus_is_read_in_turns():
    state, socket = State(), heard(FRAMES_PER_READ + 3)
    assert [frame.identifier for frame in received(socket, state, "motors")] == list(range(FRAMES_PER_READ))
    assert [frame.identifier for frame in received(socket, state, "motors")] == list(
        range(FRAMES_PER_READ, FRAMES_PER_READ + 3)
    )
    assert received(socket, state, "motors") == []
    assert not state.counts


def test_the_frames_before_a_failure_count_and_so_does_the_failure():
    state, socket = State(), heard(9)
    waiting = socket.receive

    def receive() -> Frame | None:
        if (frame := waiting()) is not None and frame.identifier == 2:
            raise BusError("down")
        return frame

    socket.receive = receive
    assert [frame.identifier for frame in received(socket, state, "motors")] == [0, 1]
    assert state.counts == {"motors_bus_errors": 1}
    assert [frame.identifier for frame in received(socket, state, "motors")] == [3, 4, 5, 6, 7, 8]
