"""Receives the messages for motors and batteries: both read them alike, within a bound."""

from collections.abc import Iterator

from delfim.base.errors import FormatError
from delfim.canproxy.dronecan.datatypes import Message, decode
from delfim.canproxy.dronecan.transfers import TransferReceiver
from delfim.canproxy.socket import CanSocket
from delfim.vehicle.links import received
from delfim.vehicle.state import State


def messages(socket: CanSocket, receiver: TransferReceiver, state: State, now_s: float) -> Iterator[tuple[int, Message]]:
    """The messages of the waiting frames, with their nodes; malformed ones are counted."""
    for frame in received(socket, state, "dronecan"):
        transfer = receiver.feed(frame, now_s)
        if transfer is None:
            continue
        try:
            message = decode(transfer)
        except FormatError:
            state.count("dronecan_malformed")
            continue
        yield transfer.source, message
