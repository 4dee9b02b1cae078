"""Propulsion: forces to the commands of all thrusters, and the commands to their drivers.

The limit is applied in the statement that sends: every value that leaves here is finite and within its limits.
"""

import math
from collections.abc import Collection, Sequence
from operator import call

from delfim.base.errors import Refused
from delfim.canproxy.dsor.messages import RESET, pack_reset
from delfim.canproxy.socket import CanSocket
from delfim.config import ThrusterTable
from delfim.vehicle.control.allocation import Allocation, Thruster, thruster
from delfim.vehicle.control.solver import Force
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.propulsion.gate import GateLimits, limited
from delfim.vehicle.propulsion.thrusters import AHEAD_DEG, MIDDLE_M
from delfim.vehicle.state import Actuation, State, Wanted

_new = tuple.__new__  # half the time of Actuation(...)


class Propulsion:
    def __init__(self, actuators: tuple[Actuator, ...], nodes: CanSocket, rows: Sequence[ThrusterTable], state: State) -> None:
        """`nodes` is a socket on the bus of the boat's own nodes, `rows` are the thrusters of the vehicle's file."""
        self.actuators = actuators
        self._nodes, self._limits, self._state = nodes, GateLimits(rows), state
        self._sends = tuple(actuator.send for actuator in actuators)
        self._names = tuple(row.name for row in rows)
        self.allocation = Allocation([thruster(row) for row in rows])
        self._allocate = self.allocation.allocate
        self._commands = tuple(each.curve.command for each in self.allocation.thrusters)
        self._by_hand = self._both_sides = tuple(map(by_hand, self.allocation.thrusters))
        self.still = self._sent = self._limits.still
        self.sent_s = 0.0  # monotonic time of the last command
        self.short: Force | None = None  # what the thrusters could not give of it

    def send(self, wanted: Wanted, now_s: float) -> Actuation:
        """Command the actuators; returns what was sent. A command not taken is counted; nothing waits."""
        dt_s, was = now_s - self.sent_s, self._sent  # plain statements: this is on the critical path
        if not 0.0 <= dt_s <= 1.0:
            dt_s = 1.0 if dt_s > 1.0 else 0.0
        surge_n, sway_n, yaw_nm, run, hand, parts = wanted
        if not run:
            asked, self.short = self.still, None
        elif hand is not None:
            asked, self.short = self._driven(*hand), None
        elif parts is not None:
            asked, self.short = self._tried(parts), None
        else:
            forces, angles, self.short = self._allocate(surge_n, sway_n, yaw_nm, was.angle_rad, dt_s)
            asked = _new(Actuation, (tuple(map(call, self._commands, forces)), angles, True))
        sent = self._sent = limited(asked, was, self._limits, dt_s)
        self.sent_s = now_s
        for send in self._sends:
            if unsent := send(sent, now_s):
                self._state.count("propulsion_unsent", unsent)
        return sent

    def again(self, now_s: float) -> Actuation:
        """The last command once more, as it was sent."""
        self.sent_s = now_s
        for send in self._sends:
            if unsent := send(self._sent, now_s):
                self._state.count("propulsion_unsent", unsent)
        return self._sent

    def _driven(self, starboard: float, port: float) -> Actuation:
        """The operator's thrust of both sides, directly."""
        turn = 0.5 * (port - starboard)
        thrust = tuple(a * starboard + b * port for a, b, _ in self._by_hand)
        return Actuation(thrust, tuple(turn * angle_rad for _, _, angle_rad in self._by_hand), True)

    def _tried(self, parts: tuple[float, ...]) -> Actuation:
        """The parts of a trial, directly: of all thrusters, then of the greatest angles of those that turn."""
        angles, count = list(self.still.angle_rad), len(self._names)
        for limits, part in zip(self._limits.turning, parts[count:], strict=True):
            angles[limits.row] = part * limits.most_rad
        return Actuation(parts[:count], tuple(angles), True)

    def alone(self, row: int | None) -> None:
        """Thrust by hand, that of starboard, goes to this thruster alone; None: to all again, as their places are."""
        only = ((float(row == index), 0.0, 0.0) for index in range(len(self._names)))
        self._by_hand = self._both_sides if row is None else tuple(only)

    def repeat(self, actuator: Actuator, now_s: float) -> None:
        """The last command again, for an actuator whose devices stop sooner than the loop commands."""
        if unsent := actuator.repeat(now_s):
            self._state.count("propulsion_unsent", unsent)

    def drop(self, names: Collection[str]) -> str:
        """Do without these thrusters, and with all others. Returns why the boat cannot be steered then, or nothing."""
        failed = frozenset(i for i, name in enumerate(self._names) if name in names)
        self.allocation = self.allocation.without(failed)
        self._allocate = self.allocation.allocate
        return self.allocation.steerable() if failed else ""

    def follow(self, other: "Propulsion") -> None:
        """Go on from the last command of another boat's propulsion, with its thrusters."""
        self._sent, self._allocate, self._commands, self._limits = other._sent, other._allocate, other._commands, other._limits

    def reset(self, node: int) -> None:
        """Ask a node of the bus, or all of them, to start again. Raises Refused if the bus does not take the frame."""
        if self._nodes.send_many(((RESET, pack_reset(node)),)):
            raise Refused("reset refused: the CAN bus did not take the frame")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Cut the power of these thrusters for good: they do not obey."""
        for actuator in self.actuators:
            actuator.disconnect(names)


def by_hand(pushes: Thruster) -> tuple[float, float, float]:
    """The parts that a thruster takes of starboard and of port thrust, and its angle, rad, at a full turn to starboard. What
    pushes across the boat turns it; in the middle it is the mean of both sides."""
    along, across = math.cos(pushes.angle_rad), math.sin(pushes.angle_rad)
    angle_rad = 0.0
    if pushes.pivot is not None:
        angle_rad = math.copysign(min(pushes.pivot.angle_max_rad, 0.5 * math.pi), pushes.x_m * along + pushes.y_m * across)
    if abs(along) < math.cos(math.radians(AHEAD_DEG)):
        half = math.copysign(0.5, pushes.x_m * across - pushes.y_m * along)
        return -half, half, angle_rad
    ahead = math.copysign(1.0, along)
    if abs(pushes.y_m) < MIDDLE_M:
        return 0.5 * ahead, 0.5 * ahead, angle_rad
    return (ahead, 0.0, angle_rad) if pushes.y_m > 0.0 else (0.0, ahead, angle_rad)
