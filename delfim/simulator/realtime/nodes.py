"""The boat's other nodes in real time, on the bus of the vehicle's file: `delfim nodes`.

One process, one loop, a socket for each bus: wait until a node has something to say or a command arrives. The vehicle cannot
tell it from the real nodes, on a loopback bus or on a real one. Devices of NMEA 2000, DroneCAN and VESC are played on loopback
buses only, instruments of NMEA 0183 on the ports of `delfim sim` only: the others have real devices.
"""

import contextlib
import select
import signal
from types import FrameType

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import BusError
from delfim.base.frames import Frame
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanSocket
from delfim.simulator.faults import Faults
from delfim.simulator.nodes import BusDevices, Nodes, nodes_of
from delfim.simulator.realtime.external_model import ExternalModel
from delfim.simulator.realtime.fault_socket import NODES, listening, obey, place
from delfim.simulator.realtime.instrument_lines import InstrumentLines
from delfim.simulator.realtime.lookout_pipes import LookoutPipes

BUS_RETRY_S = 0.5


def run_nodes(settings: config.Vehicle, seed: int) -> int:
    """Play the nodes until SIGTERM or SIGINT. Raises BusError when the bus cannot be opened at all."""
    ended: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        ended.append(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    with contextlib.ExitStack() as opened:
        bus = opened.enter_context(open_can(settings.can.interface))
        requests = opened.enter_context(listening(place(settings, NODES)))
        bus.setblocking(False)
        clock, poll = SystemClock(), select.poll()
        model = ExternalModel.of(settings)
        if model is not None:
            poll.register(model.fileno(), select.POLLIN)
        nodes = Faults(nodes_of(settings, seed, model), seed)
        beside = _beside(nodes.nodes, opened)
        instruments = nodes.nodes.instruments
        lines = opened.enter_context(InstrumentLines(settings, instruments.ports if instruments else ()))
        surroundings = nodes.nodes.surroundings
        pipes = opened.enter_context(LookoutPipes(settings, surroundings))
        bus.bind(*nodes.nodes.hears)
        for handle in (bus.fileno(), requests.fileno(), *(socket.fileno() for _, socket in beside)):
            poll.register(handle, select.POLLIN)
        while not ended:
            apart = [
                each.due_s for each in (*(devices for devices, _ in beside), instruments, surroundings) if each is not None
            ]
            wait_s = max(min((nodes.due_s, *apart)) - clock.monotonic_s(), 0.0)
            poll.poll(min(wait_s, 1.0) * 1000.0)
            if model is not None:
                model.listen()
            try:
                _turn(nodes, bus, clock)
                for devices, socket in beside:
                    _listen(devices, socket, clock)
                    _send(socket, devices.step(clock.monotonic_s(), clock.time_ns()))
                for port, data in instruments.step(clock.monotonic_s(), clock.time_ns()) if instruments else ():
                    lines.say(port, data, clock.monotonic_s())
                if surroundings is not None:
                    pipes.say(surroundings.step(clock.monotonic_s()))
            except BusError:  # the bus failed; boats survive that, so do the nodes
                select.select([], [], [], BUS_RETRY_S)
                bus.rebind()
            if model is not None:
                model.settle()
            obey(requests, nodes, NODES, clock)
    return 0


def _beside(nodes: Nodes, opened: contextlib.ExitStack) -> list[tuple[BusDevices, CanSocket]]:
    """Open a socket for each of the other buses' devices. Raises BusError."""
    found = list[tuple[BusDevices, CanSocket]]()
    for devices in nodes.beside:
        if devices.interface.startswith("canloop:"):
            socket = opened.enter_context(open_can(devices.interface))
            socket.setblocking(False)
            if devices.hears:
                socket.bind(*devices.hears)
            found.append((devices, socket))
    return found


def _turn(nodes: Faults, bus: CanSocket, clock: SystemClock) -> None:
    now_s = clock.monotonic_s()
    _listen(nodes, bus, clock)
    stepped_ns = round(nodes.on.get("clock_stepped", 0.0) * 1e9)  # other programs use this computer's clock, too
    _send(bus, nodes.step(now_s, clock.time_ns() - stepped_ns))


def _listen(nodes: Faults | BusDevices, bus: CanSocket, clock: SystemClock) -> None:
    now_s = clock.monotonic_s()
    while (frame := bus.receive()) is not None:
        nodes.feed(frame, now_s)


def _send(bus: CanSocket, frames: list[Frame]) -> None:
    for frame in frames:
        with contextlib.suppress(BlockingIOError):  # a full transmit queue: a real node loses the frame too
            bus.sendmsg(frame)
