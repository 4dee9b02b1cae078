"""Motor controllers and servos on a DroneCAN bus (docs/dronecan.md).

A thruster's address is its controller's index (`ESC_INDEX`), that of what turns it the number of its actuator. Commands go out
with each control cycle, and again every `period_s`: most controllers stop 0.2 s after the last one.
"""

import math
from collections import Counter
from typing import Final

from delfim import config
from delfim.canproxy.dronecan import datatypes
from delfim.canproxy.dronecan.datatypes import OFF, ON, CommandKind, EscStatus, NodeStatus
from delfim.canproxy.dronecan.transfers import COMMAND, SENSOR, STATUS, Publisher, TransferReceiver
from delfim.canproxy.socket import BATCH, CanAddress, CanSocket
from delfim.parts.dronecan.receiving import messages
from delfim.parts.dronecan.table import Dronecan
from delfim.vehicle.links import Links, LoopInput, Readable
from delfim.vehicle.state import Actuation, State, ThrusterReport

ZERO_S: Final = 0.15  # armed, a controller wants to see a command of zero before it turns its motor
ARMING_S: Final = 0.5  # between two words on whether motors may turn
STATUS_S: Final = 1.0  # between two words of this node on itself
TWINS_S: Final = 2.0  # two nodes that report one motor within this time are one too many
HEALTH: Final = ("", "warns", "reports an error", "reports a critical error")


class DronecanMotors:
    """The thrusters of this driver, and the servos that turn them."""

    name = "dronecan"

    def __init__(self, settings: config.Vehicle, socket: CanSocket, receiver: TransferReceiver) -> None:
        table = settings.of(Dronecan)
        rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == self.name]
        is_rpm = table.command == "rpm"
        self.period_s: float | None = 1.0 / table.rate_hz
        self.input: Readable = socket
        self.inputs: tuple[LoopInput, ...] = (self,)
        self._socket, self._send_many, self._receiver = socket, socket.send_many, receiver
        self._motors = {
            row.name: (row.address, index, (-1.0 if row.reversed else 1.0) * (row.rpm_max if is_rpm else 1.0))
            for index, row in rows
        }
        self._still = [0.0] * (1 + max(row.address for _, row in rows))
        by_angle = table.steer == "position"
        self._turning = [
            (row.steer.address, index, 1.0 if by_angle else 1.0 / math.radians(row.steer.angle_max_deg), *row.steer.as_told)
            for index, row in rows
            if row.steer is not None
        ]
        self._turn_kind = CommandKind.POSITION if by_angle else CommandKind.UNITLESS
        self._named = {row.address: row for _, row in rows}
        self._pack = datatypes.rpm_command if is_rpm else datatypes.raw_command
        self._command = Publisher(datatypes.RPM_COMMAND if is_rpm else datatypes.RAW_COMMAND, table.node, COMMAND)
        self._turn = Publisher(datatypes.ARRAY_COMMAND, table.node, COMMAND)
        self._arming = Publisher(datatypes.ARMING_STATUS, table.node, SENSOR)
        self._safety = Publisher(datatypes.SAFETY_STATE, table.node, SENSOR)
        self._status = Publisher(datatypes.NODE_STATUS, table.node, STATUS)
        self._thrust, self._turned = self._pack(self._still), b""  # payloads of the last command
        self._armed, self._armed_s = False, -1e9
        self._arming_due_s = self._status_due_s = -1e9
        self._began_s: float | None = None
        self._node = table.node
        self._nodes: dict[int, NodeStatus] = {}
        self._speakers: dict[int, dict[int, float]] = {}  # by motor: the nodes that report it, and when they did last
        self._errors: Counter[str] = Counter()

    def send(self, sent: Actuation, now_s: float) -> int:
        thrust, angle_rad, run = sent
        frames: list[tuple[int, bytes]] = []
        if run is not self._armed:
            self._armed, self._armed_s = run, now_s
            frames += self._arming.frames(ON if run else OFF)
        values = self._still
        if run and now_s - self._armed_s >= ZERO_S:
            values = values.copy()
            for address, row, scale in self._motors.values():
                values[address] = thrust[row] * scale
        self._thrust = self._pack(values)
        frames += self._command.frames(self._thrust)
        if self._turning:
            commands = [
                (address, self._turn_kind, min(max(sign * angle_rad[row] + middle_rad, -most_rad), most_rad) * scale)
                for address, row, scale, sign, middle_rad, most_rad in self._turning
            ]
            self._turned = datatypes.array_command(commands)
            frames += self._turn.frames(self._turned)
        return self._say(frames)

    def repeat(self, now_s: float) -> int:
        if self._began_s is None:
            self._began_s = now_s
        frames = self._command.frames(self._thrust)
        if self._turned:
            frames += self._turn.frames(self._turned)
        if now_s >= self._arming_due_s:
            self._arming_due_s = now_s + ARMING_S
            frames += self._arming.frames(ON if self._armed else OFF) + self._safety.frames(ON)
        if now_s >= self._status_due_s:
            self._status_due_s = now_s + STATUS_S
            frames += self._status.frames(datatypes.node_status(now_s - self._began_s))
        return self._say(frames)

    def stop(self) -> None:
        """Stop all motors. The zero goes out twice: a receiver may take the first one for a repetition, by its number."""
        still = self._pack(self._still)
        for arb, data in self._command.frames(still) + self._arming.frames(OFF) + self._command.frames(still):
            self._socket.sendto(data, CanAddress(arb))

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Keep these motors at zero: nothing here cuts the power of a controller."""
        self._motors = {name: motor for name, motor in self._motors.items() if name not in names}

    def read(self, state: State, now_s: float) -> None:
        """Take the reports of the devices; malformed ones are counted."""
        for node, message in messages(self._socket, self._receiver, state, now_s):
            if node == self._node:
                self._errors["another device has the number of this computer"] += 1
            elif isinstance(message, EscStatus):
                self._hear(state, node, message, now_s)
            elif isinstance(message, NodeStatus):
                self._nodes[node] = message

    def _hear(self, state: State, node: int, status: EscStatus, now_s: float) -> None:
        row = self._named.get(status.motor)
        if row is None:
            self._errors["report of a motor that is not in the file"] += 1
            return
        speakers = self._speakers.get(status.motor)
        if speakers is None:
            speakers = self._speakers[status.motor] = {}
        speakers[node] = now_s
        faults: list[str] = []
        if len(speakers) > 1:
            for other in [each for each, at_s in speakers.items() if now_s - at_s > TWINS_S]:
                del speakers[other]
            if len(speakers) > 1:
                faults.append(f"nodes {' and '.join(map(str, sorted(speakers)))} are both motor {status.motor}")
        if status.errors:
            faults.append(f"{status.errors} errors since the motor started")
        if (known := self._nodes.get(node)) is not None and known.health:
            faults.append(f"node {node} {HEALTH[known.health]}")
        _, voltage_v, current_a, celsius, rpm, _, _ = status
        told = now_s, float(-rpm if row.reversed else rpm), current_a, voltage_v, celsius, None, tuple(faults) or None, ""
        state.thrusters[row.name] = tuple.__new__(ThrusterReport, told)  # half the time of ThrusterReport(...)

    def report(self) -> dict[str, object]:
        """The report: this computer's number, the devices heard, and what was refused."""
        nodes = {str(node): {"uptime_s": told.uptime_s, "health": told.health} for node, told in sorted(self._nodes.items())}
        return {"node": self._node, "devices": nodes, "errors": dict(self._receiver.errors + self._errors)}

    def _say(self, frames: list[tuple[int, bytes]]) -> int:
        if len(frames) <= BATCH:
            return self._send_many(frames)
        return sum(self._send_many(frames[at : at + BATCH]) for at in range(0, len(frames), BATCH))


def open_actuator(settings: config.Vehicle, links: Links) -> DronecanMotors:
    receiver = TransferReceiver((datatypes.ESC_STATUS, datatypes.NODE_STATUS))
    return DronecanMotors(settings, links.bus(settings.of(Dronecan).interface, receiver.filters), receiver)
