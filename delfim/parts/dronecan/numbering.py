"""numbering: gives numbers to the DroneCAN devices that come without one, and answers requests for this node's information
(docs/dronecan.md).

A process of its own: the numbers that were given away are kept on the disk, so that a device has the same one tomorrow, and no
tool on the bus takes time of the boat's program.
"""

import asyncio
import contextlib
import hashlib
import json
import logging
import platform
from pathlib import Path
from typing import Final

from delfim import __version__
from delfim.base.clock import Clock
from delfim.base.errors import BusError, FormatError
from delfim.base.input.untrusted import parse_json, read_file
from delfim.base.wholefile import replace_file
from delfim.canproxy.dronecan.datatypes import (
    ALLOCATION,
    NODE_STATUS,
    Message,
    NodeStatus,
    NumberRequest,
    decode,
    number_request,
)
from delfim.canproxy.dronecan.nodenumbers import Allocator
from delfim.canproxy.dronecan.nodeservices import Identity, NodeServices
from delfim.canproxy.dronecan.transfers import SERVICE, STATUS, Publisher, TransferReceiver
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.dronecan.table import Dronecan
from delfim.services.runtime import Runtime

REBIND_S: Final = 1.0
WARN_S: Final = 60.0
NAME: Final = "delfim.boat"
log = logging.getLogger(__name__)


class Numbering:
    """Answers the devices of a bus. Without `place` another server gives them their numbers."""

    def __init__(
        self, bus: CanSocket, receiver: TransferReceiver, node: NodeServices, place: Path | None, clock: Clock
    ) -> None:
        self._bus, self._receiver, self._node, self._place, self._clock = bus, receiver, node, place, clock
        self.allocator = Allocator(known_numbers(place) if place else {}, node.number)
        self._answers = Publisher(ALLOCATION, node.number, STATUS)
        self._warned_s = -WARN_S

    def on_frames(self) -> None:
        with contextlib.suppress(BusError):  # the bus is opened anew by and by
            while (frame := self._bus.receive()) is not None:
                now_s = self._clock.monotonic_s()
                if frame.arb >> 3 & SERVICE:
                    self._say(self._node.answer(frame, now_s))
                    self._warn(now_s)
                elif (transfer := self._receiver.feed(frame, now_s)) is not None:
                    with contextlib.suppress(FormatError):
                        self._hear(transfer.source, decode(transfer), now_s)

    def _hear(self, source: int, message: Message, now_s: float) -> None:
        if source:
            self.allocator.hear(source, now_s)
            if source == self._node.number and isinstance(message, NodeStatus):
                self._node.hear(message, now_s)
        elif self._place is not None and isinstance(message, NumberRequest):
            self._answer(message, self._place)

    def _warn(self, now_s: float) -> None:
        """Log, once a minute, the nodes that requested a restart."""
        nodes, self._node.restarts = self._node.restarts, []
        if nodes and now_s - self._warned_s >= WARN_S:
            self._warned_s = now_s
            log.warning("numbering: node %d asks this computer to start again: refused, for this is the operator's", nodes[0])

    def _answer(self, asked: NumberRequest, place: Path) -> None:
        known = dict(self.allocator.table)
        answer = self.allocator.feed(asked, self._clock.monotonic_s())
        if answer is None:
            return
        if self.allocator.table != known:
            log.info("numbering: %s gets number %d", answer.identity.hex(), answer.node)
            try:
                keep(place, self.allocator.table)
            except OSError as error:  # it has its number as long as this program runs
                log.warning("numbering: %s: %s; the number may be another one tomorrow", place, error.strerror)
        self._say(self._answers.frames(number_request(answer)))

    def _say(self, frames: list[tuple[int, bytes]]) -> None:
        for arb, data in frames:
            with contextlib.suppress(OSError):  # whoever it was asks again
                self._bus.sendto(data, CanAddress(arb))

    def report(self) -> dict[str, object]:
        numbers = {str(node): identity.hex() for identity, node in self.allocator.table.items()}
        refused = {"refused": self.allocator.refused, "requests_refused": self._node.refused}
        return {"numbers": numbers, **refused, "errors": dict(self._receiver.errors)}


def identity(machine: Path = Path("/etc/machine-id")) -> Identity:
    """The unique id of this computer: the same after each start; it does not reveal the machine's own, which is secret."""
    try:
        secret = read_file(machine)
    except OSError:
        secret = platform.node().encode()
    major, minor, *_ = __version__.split(".")
    return Identity(NAME, (int(major), int(minor)), hashlib.sha256(b"delfim on DroneCAN" + secret).digest()[:16])


def known_numbers(place: Path) -> dict[bytes, int]:
    """Read the numbers that were given away; none where the file is missing or damaged, which is logged."""
    try:
        told = parse_json(read_file(place))
        table = {bytes.fromhex(identity): int(node) for identity, node in told.items()}
        if all(len(identity) == 16 and 1 <= node <= 125 for identity, node in table.items()):
            return table
    except FileNotFoundError:
        return {}
    except (OSError, FormatError, AttributeError, TypeError, ValueError):
        pass
    log.warning("numbering: %s is damaged: devices may get other numbers than before", place)
    return {}


def keep(place: Path, table: dict[bytes, int]) -> None:
    """Write the numbers, whole or not at all. Raises OSError."""
    replace_file(place, json.dumps({identity.hex(): node for identity, node in table.items()}, indent=1))


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    receiver, node = TransferReceiver((ALLOCATION, NODE_STATUS)), NodeServices(settings.of(Dronecan).node, identity())
    with open_bound(settings.can, settings.of(Dronecan).interface, receiver.filters + node.filters) as bus:
        place = Path(settings.log.directory) / "dronecan-numbers.json" if settings.of(Dronecan).numbers else None
        numbering = Numbering(bus, receiver, node, place, runtime.clock)
        with runtime.reading(bus.fileno(), numbering.on_frames), runtime.publishing("numbering", numbering.report):
            while True:
                await asyncio.sleep(REBIND_S)
                bus.rebind()
