"""The boat's own propellers and batteries (prop.c in the thesis): four frames on its bus."""

from typing import Final

from delfim import config
from delfim.canproxy.dsor.messages import (
    BATTERIES_COMMAND,
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    PROPELLER_COMMAND,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
)
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.dsor.table import Dsor
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import Actuation

_PROPELLER, _BATTERIES = PROPELLER_COMMAND.pack, BATTERIES_COMMAND.pack
_ARBS: Final = ((PROPELLER_STARBOARD, BATTERIES_STARBOARD), (PROPELLER_PORT, BATTERIES_PORT))  # by address


class Propellers:
    """The starboard and the port propeller, or one of them, and the batteries of each."""

    name = "dsor"
    period_s: float | None = None  # its nodes wait for PROPELLER_TIMEOUT_S, longer than the loop does between commands
    inputs: tuple[LoopInput, ...] = ()

    def __init__(self, settings: config.Vehicle, socket: CanSocket) -> None:
        self._socket, self._send_many = socket, socket.send_many
        rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == self.name]
        rpm_max = settings.of(Dsor).rpm_max
        self._propellers = tuple((_ARBS[row.address][0], -rpm_max if row.reversed else rpm_max, i) for i, row in rows)
        self._batteries = tuple((_ARBS[row.address][1], True, row.name) for _, row in rows)  # contactor closed
        self._counter = 0

    def send(self, sent: Actuation, now_s: float) -> int:
        self._counter = counter = self._counter + 1 & 0xFF
        thrust, _, run = sent
        frames: list[tuple[int, bytes]] = []
        for arb, rpm, row in self._propellers:  # loops, because a comprehension costs half a microsecond more
            frames.append((arb, _PROPELLER(round(thrust[row] * rpm), run, counter)))
        for arb, closed, _ in self._batteries:
            frames.append((arb, _BATTERIES(closed, counter)))
        return self._send_many(frames)

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        for arb, _, _ in self._propellers:
            self._socket.sendto(PROPELLER_COMMAND.pack(0, 0, 0), CanAddress(arb))

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Open the contactors with the next command."""
        self._batteries = tuple((arb, closed and name not in names, name) for arb, closed, name in self._batteries)

    def report(self) -> dict[str, object]:
        return {}


def open_actuator(settings: config.Vehicle, links: Links) -> Propellers:
    return Propellers(settings, links.bus(settings.can.interface, ()))
