"""numbering: numbers for the DroneCAN devices that come without one (docs/dronecan.md).

A process of its own: the numbers that were given away are kept on the disk, so that a device has the same one tomorrow.
"""

import asyncio
import contextlib
import json
import logging
import os
from pathlib import Path
from typing import Final

from delfim.canproxy.dronecan.datatypes import ALLOCATION, NODE_STATUS, NumberRequest, decode, number_request
from delfim.canproxy.dronecan.nodenumbers import Allocator
from delfim.canproxy.dronecan.transfers import STATUS, Publisher, TransferReceiver
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.clock import Clock
from delfim.errors import BusError, FormatError
from delfim.outside import parse_json, read_file
from delfim.services.runtime import Runtime

REBIND_S: Final = 1.0
log = logging.getLogger(__name__)


class Numbering:
    """Answers the devices of a bus."""

    def __init__(self, bus: CanSocket, receiver: TransferReceiver, own: int, place: Path, clock: Clock) -> None:
        self._bus, self._receiver, self._place, self._clock = bus, receiver, place, clock
        self.allocator = Allocator(known_numbers(place), own)
        self._answers = Publisher(ALLOCATION, own, STATUS)

    def on_frames(self) -> None:
        with contextlib.suppress(BusError):  # the bus is opened anew by and by
            while (frame := self._bus.receive()) is not None:
                transfer = self._receiver.feed(frame, self._clock.monotonic_s())
                if transfer is None:
                    continue
                if transfer.source:
                    self.allocator.taken.add(transfer.source)
                    continue
                with contextlib.suppress(FormatError):
                    message = decode(transfer)
                    if isinstance(message, NumberRequest):
                        self._answer(message)

    def _answer(self, asked: NumberRequest) -> None:
        known = len(self.allocator.table)
        answer = self.allocator.feed(asked, self._clock.monotonic_s())
        if answer is None:
            return
        if len(self.allocator.table) > known:
            log.info("numbering: %s gets number %d", answer.identity.hex(), answer.node)
            try:
                keep(self._place, self.allocator.table)
            except OSError as error:  # it has its number as long as this program runs
                log.warning("numbering: %s: %s; the number may be another one tomorrow", self._place, error.strerror)
        for arb, data in self._answers.frames(number_request(answer)):
            with contextlib.suppress(OSError):  # the device asks again
                self._bus.sendto(data, CanAddress(arb))

    def report(self) -> dict[str, object]:
        numbers = {str(node): identity.hex() for identity, node in self.allocator.table.items()}
        return {"numbers": numbers, "refused": self.allocator.refused, "errors": dict(self._receiver.errors)}


def known_numbers(place: Path) -> dict[bytes, int]:
    """The numbers that were given away; none where the file is missing or damaged, which is logged."""
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
    part = place.with_suffix(".part")
    with open(part, "w") as file:
        json.dump({identity.hex(): node for identity, node in table.items()}, file, indent=1)
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, place)


async def serve(runtime: Runtime) -> None:
    """Until it is cancelled."""
    settings = runtime.config
    receiver = TransferReceiver((ALLOCATION, NODE_STATUS))
    with open_bound(settings.can, settings.dronecan.interface, receiver.filters) as bus:
        place = Path(settings.log.directory) / "dronecan-numbers.json"
        numbering = Numbering(bus, receiver, settings.dronecan.node, place, runtime.clock)
        with runtime.reading(bus.fileno(), numbering.on_frames), runtime.publishing("numbering", numbering.report):
            while True:
                await asyncio.sleep(REBIND_S)
                bus.rebind()
