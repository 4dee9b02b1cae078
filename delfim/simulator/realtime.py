"""The boat's other nodes in real time, on whatever bus the vehicle's file names: `delfim nodes`.

One process, one socket, one loop: wait until a node has something to say or a command arrives. The vehicle cannot tell it from
the real nodes, on a loopback bus or on a real one.
"""

import contextlib
import json
import math
import os
import select
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from delfim import config
from delfim.canproxy.socket import CanSocket, open_can
from delfim.clock import SystemClock
from delfim.errors import BusError, DelfimError, FormatError, Refused
from delfim.simulator.external import ExternalModel
from delfim.simulator.faults import AROUND, Faults, fault
from delfim.simulator.model import hull_of
from delfim.simulator.nodes import COMMANDS, nodes_of

BUS_RETRY_S = 0.5
ANSWER_S = 2.0
WORDS_BYTES = 1024  # of a request to break something


def run_nodes(settings: config.Vehicle, seed: int) -> int:
    """Play the nodes until SIGTERM or SIGINT. Raises BusError when the bus cannot be opened at all."""
    ended: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        ended.append(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    with open_can(settings.can.interface) as bus, _requests(socket_path(settings)) as requests:
        bus.setblocking(False)
        bus.bind(*COMMANDS)
        clock, poll = SystemClock(), select.poll()
        model = _external(settings, clock)
        if model is not None:
            poll.register(model.fileno(), select.POLLIN)
        nodes = Faults(nodes_of(settings, seed, model), seed)
        poll.register(bus.fileno(), select.POLLIN)
        poll.register(requests.fileno(), select.POLLIN)
        while not ended:
            wait_s = max(nodes.due_s - clock.monotonic_s(), 0.0)
            poll.poll(min(wait_s, 1.0) * 1000.0)
            if model is not None:
                model.listen()
            try:
                _turn(nodes, bus, clock)
            except BusError:  # the bus went away; boats survive that, so do we
                select.select([], [], [], BUS_RETRY_S)
                bus.rebind()
            _obey(nodes, requests, clock)
    return 0


def _external(settings: config.Vehicle, clock: SystemClock) -> ExternalModel | None:
    """The model in another program, where the vehicle's file names an address for it."""
    there = settings.simulation
    if not there.external:
        return None
    hull, start = hull_of(settings.boat), (math.radians(there.latitude_deg), math.radians(there.longitude_deg))
    return ExternalModel(hull, clock, there.external, *start)


def _turn(nodes: Faults, bus: CanSocket, clock: SystemClock) -> None:
    now_s = clock.monotonic_s()
    while (frame := bus.receive()) is not None:
        nodes.feed(frame, now_s)
    for frame in nodes.step(now_s, clock.time_ns()):
        with contextlib.suppress(BlockingIOError):  # a full transmit queue: a real node loses the frame too
            bus.sendmsg(frame)


# Faults by command: a datagram of JSON over a local socket, answered with a line of words.


def socket_path(settings: config.Vehicle) -> str:
    """Where the nodes of this vehicle's file listen."""
    return str(Path(settings.runtime.run_directory) / "nodes")


def tell(path: str, kind: str, where: str = "", value: float | None = None, for_s: float | None = None) -> str:
    """Ask running nodes to break; what they say. Raises Refused with their reason, DelfimError where nobody listens."""
    words = json.dumps({"kind": kind, "where": where, "value": value, "for_s": for_s}).encode()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.bind("")  # an address of the kernel's choice, so that the answer finds back
        asking.settimeout(ANSWER_S)
        try:
            asking.sendto(words, path)
            answer = json.loads(asking.recv(WORDS_BYTES))
        except OSError as error:
            raise DelfimError(f"no nodes at {path}: {error.strerror or error}; are they running?") from None
    if not answer["ok"]:
        raise Refused(answer["text"])
    return str(answer["text"])


@contextlib.contextmanager
def _requests(path: str) -> Iterator[socket.socket]:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as listening:
        Path(path).unlink(missing_ok=True)
        listening.bind(path)
        os.chmod(path, 0o660)
        try:
            yield listening
        finally:
            Path(path).unlink(missing_ok=True)


def _obey(nodes: Faults, requests: socket.socket, clock: SystemClock) -> None:
    """All requests that wait. Nothing that comes in ends the nodes."""
    while True:
        try:
            data, sender = requests.recvfrom(WORDS_BYTES)
        except BlockingIOError:
            return
        try:
            answer = {"ok": True, "text": _break(nodes, data, clock.monotonic_s())}
        except FormatError as error:
            answer = {"ok": False, "text": str(error)}
        with contextlib.suppress(OSError):  # gone, or does not read
            requests.sendto(json.dumps(answer).encode(), sender)


def _break(nodes: Faults, data: bytes, now_s: float) -> str:
    try:
        words: dict[str, Any] = json.loads(data)
        kind = words.pop("kind")
        if kind == "end":
            for present in list(nodes.faults):
                nodes.end(*present)
            return "all faults are over; charge that was lost stays lost"
        broken = fault(kind, **words)
    except (TypeError, AttributeError, KeyError, ValueError) as error:
        raise FormatError(str(error)) from None
    if broken.kind in AROUND:
        raise FormatError(f"{broken.kind} is nothing of the nodes: it exists in scenarios")
    nodes.begin(broken, now_s)
    lasts = "until it is ended" if broken.for_s == float("inf") else f"for {broken.for_s:g} s"
    return f"{broken.kind} {broken.where}".rstrip() + f" {lasts}"
