"""Two motor controllers on a DroneCAN bus, played by pydronecan: what the boat says is understood by others' code.

    python -m tests.esc_pair INTERFACE [seconds without a command until they stop by themselves]

They turn only while they are armed and have seen a command of zero since, as AM32 does. What happens to them is printed, a line
each: "zero" (told to stand still), "turns", "disarmed", "silent" (no command any more, so they stopped).
"""

import os
import select
import signal
import sys
import time

from dronecan import uavcan
from dronecan.driver.common import AbstractDriver, CANFrame, TxQueueFullError
from dronecan.node import Node
from dronecan.transport import TransferError

from delfim.base.frames import extended
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING

NODE, MOTORS, RPM_MAX = 20, 2, 1400
PERIOD_S = 0.04
MESSAGES = uavcan.equipment


class Bus(AbstractDriver):
    """A bus of Delfim's for pydronecan: its own drivers know no canloop."""

    def __init__(self, interface):
        super().__init__()
        self.can = open_can(interface)
        self.can.setblocking(False)
        self.can.bind(ANYTHING)

    def receive(self, timeout=None):
        frame = self.can.receive()
        if frame is None:
            select.select([self.can.fileno()], [], [], timeout)
            frame = self.can.receive()
        return None if frame is None else CANFrame(frame.identifier, frame.data, frame.extended)

    def send_frame(self, frame):
        try:
            self.can._send(extended(frame.id), bytes(frame.data), 0)
        except BlockingIOError:
            raise TxQueueFullError from None

    def close(self):
        self.can.close()


class EscPair:
    def __init__(self, interface, silent_s):
        self.silent_s = silent_s
        self.armed = self.seen_zero = False
        self.commanded_s, self.raw, self.rpm = -1e9, [0] * MOTORS, [0.0] * MOTORS
        self.said = ""
        self.node = Node(Bus(interface), node_id=NODE, mode=uavcan.protocol.NodeStatus().MODE_OPERATIONAL)
        self.node.add_handler(MESSAGES.esc.RawCommand, self.on_command)
        self.node.add_handler(MESSAGES.safety.ArmingStatus, self.on_arming)
        self.node.periodic(PERIOD_S, self.turn)

    def say(self, word):
        if word != self.said:
            self.said = word
            print(word, flush=True)

    def on_command(self, event):
        raw = [*event.message.cmd, *[0] * MOTORS][:MOTORS]
        self.commanded_s = time.monotonic()
        if not any(raw):
            self.seen_zero = self.armed
            self.say("zero")
        self.raw = raw if self.armed and self.seen_zero else [0] * MOTORS
        if any(self.raw):
            self.say("turns")

    def on_arming(self, event):
        self.armed = event.message.status == event.message.STATUS_FULLY_ARMED
        if not self.armed:
            self.seen_zero, self.raw = False, [0] * MOTORS
            if self.said == "turns":
                self.say("disarmed")

    def turn(self):
        if time.monotonic() - self.commanded_s > self.silent_s:
            self.raw, self.seen_zero = [0] * MOTORS, False
            self.say("silent")
        for motor, raw in enumerate(self.raw):
            self.rpm[motor] += 0.3 * (raw / 8191 * RPM_MAX - self.rpm[motor])
            status = MESSAGES.esc.Status(
                voltage=24.0,
                current=abs(self.rpm[motor]) / 100.0,
                temperature=300.0,
                rpm=round(self.rpm[motor]),
                esc_index=motor,
            )
            self.node.broadcast(status, priority=20)


def main():
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    pair = EscPair(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 0.25)
    while True:
        try:
            pair.node.spin(0.02)
        except (TransferError, ValueError) as error:  # it raises on frames that a device ignores
            print(error, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
