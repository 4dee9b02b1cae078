"""Propulsion (prop.c in the thesis): four frames to the starboard and port propellers and their batteries.

The limit is applied in the statement that sends: nothing leaves here that is not finite, within value and rate.
"""

from delfim import config
from delfim.canproxy.socket import CanSocket
from delfim.errors import Refused
from delfim.messages import (
    BATTERIES_COMMAND,
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    PROPELLER_COMMAND,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    RESET,
    pack_reset,
)
from delfim.vehicle.control.control import limited
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, State


class Propulsion:
    def __init__(self, socket: CanSocket, limits: config.Propulsion, state: State) -> None:
        self._limits, self._state = limits, state
        self._send_many = socket.send_many
        self._contactors = True, True  # starboard, port: closed
        self._sent = STOP
        self._sent_s = 0.0
        self._counter = 0

    def send(self, wanted: Actuation, now_s: float) -> Actuation:
        """Command the propellers; returns what was sent. A frame that the bus does not take is counted, never waited for."""
        dt_s = min(max(now_s - self._sent_s, 0.0), 1.0)
        sent = self._sent = limited(wanted, self._sent, self._limits, dt_s)
        self._sent_s = now_s
        self._counter = counter = self._counter + 1 & 0xFF
        starboard, port = self._contactors
        unsent = self._send_many(
            (
                (PROPELLER_STARBOARD, PROPELLER_COMMAND.pack(round(sent.starboard_rpm), sent.run, counter)),
                (PROPELLER_PORT, PROPELLER_COMMAND.pack(round(sent.port_rpm), sent.run, counter)),
                (BATTERIES_STARBOARD, BATTERIES_COMMAND.pack(starboard, counter)),
                (BATTERIES_PORT, BATTERIES_COMMAND.pack(port, counter)),
            )
        )
        if unsent:
            self._state.count("propulsion_unsent", unsent)
        return sent

    def reset(self, node: int) -> None:
        """Ask a node of the bus, or all of them, to start again. Raises Refused where the bus does not take the frame."""
        if self._send_many(((RESET, pack_reset(node)),)):
            raise Refused("reset refused: the bus takes no frame")

    def disconnect(self, sides: tuple[str, ...]) -> None:
        """Open the batteries' contactors of these sides with the next command, for good: a propeller there does not obey."""
        starboard, port = self._contactors
        self._contactors = starboard and "starboard" not in sides, port and "port" not in sides
