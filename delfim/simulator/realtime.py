"""The boat's other nodes in real time, on whatever bus the vehicle's file names: `delfim nodes`.

One process, one socket, one loop: wait until a node has something to say or a command arrives. The vehicle cannot tell it from
the real nodes, on a loopback bus or on a real one.
"""

import contextlib
import select
import signal
from types import FrameType

from delfim import config
from delfim.canproxy.socket import CanSocket, open_can
from delfim.clock import SystemClock
from delfim.errors import BusError
from delfim.simulator.nodes import COMMANDS, Nodes, nodes_of

BUS_RETRY_S = 0.5


def run_nodes(settings: config.Vehicle, seed: int) -> int:
    """Play the nodes until SIGTERM or SIGINT. Raises BusError when the bus cannot be opened at all."""
    ended: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        ended.append(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    with open_can(settings.can.interface) as socket:
        socket.setblocking(False)
        socket.bind(*COMMANDS)
        nodes, clock = nodes_of(settings, seed), SystemClock()
        poll = select.poll()
        poll.register(socket.fileno(), select.POLLIN)
        while not ended:
            wait_s = max(nodes.due_s - clock.monotonic_s(), 0.0)
            poll.poll(min(wait_s, 1.0) * 1000.0)
            try:
                _turn(nodes, socket, clock)
            except BusError:  # the bus went away; boats survive that, so do we
                select.select([], [], [], BUS_RETRY_S)
                socket.rebind()
    return 0


def _turn(nodes: Nodes, socket: CanSocket, clock: SystemClock) -> None:
    now_s = clock.monotonic_s()
    while (frame := socket.receive()) is not None:
        nodes.feed(frame, now_s)
    for frame in nodes.step(now_s, clock.time_ns()):
        with contextlib.suppress(BlockingIOError):  # a full transmit queue: a real node loses the frame too
            socket.sendmsg(frame)
