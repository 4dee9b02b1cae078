"""Propulsion (prop.c in the thesis): four frames to the starboard and port propellers and their batteries.

The limit is applied in the statement that sends: nothing leaves here that is not finite, within value and rate.
"""

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
from delfim.vehicle.control.control import limited
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, State


class Propulsion:
    def __init__(self, socket: CanSocket, limits: config.Propulsion, state: State) -> None:
        self._limits, self._state = limits, state
        self._sendto, self._rehearse = socket.sendto, socket.rehearse
        self._propellers = CanAddress(PROPELLER_STARBOARD), CanAddress(PROPELLER_PORT)
        self._batteries = CanAddress(BATTERIES_STARBOARD), CanAddress(BATTERIES_PORT)
        self._sent = STOP
        self._sent_s = 0.0
        self._counter = 0

    def rehearse(self, wanted: Actuation) -> None:
        """All that `send` does, but that nothing is sent and nothing remembered."""
        would = limited(wanted, self._sent, self._limits, 0.0)
        batteries = BATTERIES_COMMAND.pack(1, 0)
        for to, rpm in zip(self._propellers, (would.starboard_rpm, would.port_rpm), strict=True):
            self._rehearse(PROPELLER_COMMAND.pack(round(rpm), would.run, 0), to)
        for to in self._batteries:
            self._rehearse(batteries, to)

    def send(self, wanted: Actuation, now_s: float) -> Actuation:
        """Command the propellers; returns what was sent. A frame that the bus does not take is counted, never waited for."""
        dt_s = min(max(now_s - self._sent_s, 0.0), 1.0)
        sent = self._sent = limited(wanted, self._sent, self._limits, dt_s)
        self._sent_s = now_s
        self._counter = counter = self._counter + 1 & 0xFF
        batteries = BATTERIES_COMMAND.pack(1, counter)
        for to, data in (
            (self._propellers[0], PROPELLER_COMMAND.pack(round(sent.starboard_rpm), sent.run, counter)),
            (self._propellers[1], PROPELLER_COMMAND.pack(round(sent.port_rpm), sent.run, counter)),
            (self._batteries[0], batteries),
            (self._batteries[1], batteries),
        ):
            try:
                self._sendto(data, to)
            except OSError:  # one side's frame lost must not cost the other's
                self._state.count("propulsion_unsent")
        return sent
