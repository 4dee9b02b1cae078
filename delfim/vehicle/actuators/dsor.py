"""The boat's own propellers and batteries (prop.c in the thesis): four frames on its bus."""

from delfim import config
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.messages import (
    BATTERIES_COMMAND,
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    PROPELLER_COMMAND,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
)
from delfim.vehicle.links import Links, LoopInput
from delfim.vehicle.state import Actuation


class Propellers:
    """The starboard and the port propeller, and the batteries of each."""

    name = "dsor"
    period_s: float | None = None  # its nodes wait for PROPELLER_TIMEOUT_S, longer than the loop does between commands
    inputs: tuple[LoopInput, ...] = ()

    def __init__(self, socket: CanSocket) -> None:
        self._socket, self._send_many = socket, socket.send_many
        self._contactors = True, True  # starboard, port: closed
        self._counter = 0

    def send(self, sent: Actuation, now_s: float) -> int:
        self._counter = counter = self._counter + 1 & 0xFF
        starboard, port = self._contactors
        return self._send_many(
            (
                (PROPELLER_STARBOARD, PROPELLER_COMMAND.pack(round(sent.starboard_rpm), sent.run, counter)),
                (PROPELLER_PORT, PROPELLER_COMMAND.pack(round(sent.port_rpm), sent.run, counter)),
                (BATTERIES_STARBOARD, BATTERIES_COMMAND.pack(starboard, counter)),
                (BATTERIES_PORT, BATTERIES_COMMAND.pack(port, counter)),
            )
        )

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        for arb in (PROPELLER_STARBOARD, PROPELLER_PORT):
            self._socket.sendto(PROPELLER_COMMAND.pack(0, 0, 0), CanAddress(arb))

    def disconnect(self, sides: tuple[str, ...]) -> None:
        """The contactors open with the next command."""
        starboard, port = self._contactors
        self._contactors = starboard and "starboard" not in sides, port and "port" not in sides

    def report(self) -> dict[str, object]:
        return {}


def open_actuator(settings: config.Vehicle, links: Links) -> Propellers:
    return Propellers(links.bus(settings.can.interface, ()))
