"""Propulsion: the command to the drivers of all thrusters.

The limit is applied in the statement that sends: every value that leaves here is finite and within its limits.
"""

from delfim.canproxy.socket import CanSocket
from delfim.errors import Refused
from delfim.messages import RESET, pack_reset
from delfim.vehicle.actuators import Actuator
from delfim.vehicle.gate import GateLimits, limited
from delfim.vehicle.state import Actuation, State


class Propulsion:
    def __init__(self, actuators: tuple[Actuator, ...], nodes: CanSocket, limits: GateLimits, state: State) -> None:
        """`nodes` is a socket on the bus of the boat's own nodes."""
        self.actuators = actuators
        self._nodes, self._limits, self._state = nodes, limits, state
        self._sends = tuple(actuator.send for actuator in actuators)
        self.still = self._sent = limits.still
        self.sent_s = 0.0  # monotonic time of the last command

    def send(self, wanted: Actuation, now_s: float) -> Actuation:
        """Command the actuators; returns what was sent. A command not taken is counted; nothing waits."""
        dt_s = min(max(now_s - self.sent_s, 0.0), 1.0)
        sent = self._sent = limited(wanted, self._sent, self._limits, dt_s)
        self.sent_s = now_s
        for send in self._sends:
            if unsent := send(sent, now_s):
                self._state.count("propulsion_unsent", unsent)
        return sent

    def repeat(self, actuator: Actuator, now_s: float) -> None:
        """The last command again, for an actuator whose devices stop sooner than the loop commands."""
        if unsent := actuator.repeat(now_s):
            self._state.count("propulsion_unsent", unsent)

    def reset(self, node: int) -> None:
        """Ask a node of the bus, or all of them, to start again. Raises Refused if the bus does not take the frame."""
        if self._nodes.send_many(((RESET, pack_reset(node)),)):
            raise Refused("reset refused: the CAN bus did not take the frame")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Cut the power of these thrusters for good: they do not obey."""
        for actuator in self.actuators:
            actuator.disconnect(names)
