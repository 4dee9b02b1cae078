"""A board with ArduRover as front seat: throttle and steering by MANUAL_CONTROL, by TCP or a serial line (docs/front-seat.md).

Its mixer, limits and remote control stay its own. It obeys while it is armed and in its mode MANUAL, and for RC_OVERRIDE_TIME
after the last message. Source: ArduPilot's Rover/GCS_MAVLink_Rover.cpp, handle_manual_control_axes.
"""

from typing import Any, Final

from pymavlink.dialects.v20 import development as dialect

from delfim import config
from delfim.vehicle.frontseat import FrontSeatLine, SeatSide, sides
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

MANUAL: Final = 0  # its mode in which it obeys
FULL: Final = 1000
HEARTBEAT_TICKS: Final = 5  # of `repeat`: once a second
UNKNOWN_V, UNKNOWN_A = 0xFFFF, -1


class ArduRover:
    """Its motors, as two sides."""

    name = "mavlink_front_seat"
    period_s: float | None = 0.2

    def __init__(self, table: config.MavlinkFrontSeat, starboard: SeatSide, port: SeatSide, line: ReadableLine) -> None:
        self._starboard, self._port, self._board = starboard, port, table.board
        self.input, self.inputs, self._line = line, (self,), line
        self._codec: Any = dialect.MAVLink(None, table.system, dialect.MAV_COMP_ID_MISSIONPLANNER)
        self._codec.robust_parsing = True  # noise is a message of its own, and raises nothing
        self._seat = FrontSeatLine(self.name, (starboard, port), line, self._packed(0.0, 0.0))
        self._ticks = 0
        self._faults: tuple[str, ...] = ("not heard yet",)
        self._voltage_v: float | None = None
        self._current_a: float | None = None

    def send(self, sent: Actuation, now_s: float) -> int:
        return self._seat.send(sent, lambda starboard, port: self._packed((starboard + port) / 2.0, (port - starboard) / 2.0))

    def repeat(self, now_s: float) -> int:
        """Its heartbeat, as a ground station, whose loss is its own failsafe; commands come often enough without."""
        self._ticks += 1
        if self._ticks % HEARTBEAT_TICKS:
            return 0
        kind, none, active = dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, dialect.MAV_STATE_ACTIVE
        self._line.write(self._frame(dialect.MAVLink_heartbeat_message(kind, none, 0, 0, active, 3)))
        return 0

    def stop(self) -> None:
        self._seat.stop()

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Disarming it is its operator's."""

    def read(self, state: State, now_s: float) -> None:
        """Its heartbeat and its battery into the state. Other messages are its own affair; malformed ones are counted."""
        while data := self._line.read():
            for message in self._codec.parse_buffer(data) or ():
                if message.get_type() == "BAD_DATA":
                    state.count("mavlink_front_seat_malformed")
                elif message.get_srcSystem() == self._board:
                    self._hear(message, state, now_s)

    def report(self) -> dict[str, object]:
        return {"why_not": ", ".join(self._faults)}

    def _packed(self, ahead: float, to_starboard: float) -> bytes:
        throttle, steering = (round(FULL * min(max(each, -1.0), 1.0)) for each in (ahead, to_starboard))
        return self._frame(dialect.MAVLink_manual_control_message(self._board, 0, steering, throttle, 0, 0))

    def _frame(self, message: Any) -> bytes:
        frame: bytes = message.pack(self._codec)
        self._codec.seq = self._codec.seq + 1 & 0xFF
        return frame

    def _hear(self, message: Any, state: State, now_s: float) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
            self._faults = tuple(_why_not(message))
        elif kind == "SYS_STATUS":
            volts, amperes = message.voltage_battery, message.current_battery
            self._voltage_v = None if volts == UNKNOWN_V else volts / 1000.0
            self._current_a = None if amperes == UNKNOWN_A else amperes / 100.0
        else:
            return
        for side in (self._starboard, self._port):
            state.thrusters[side.name] = ThrusterReport(
                now_s,
                current_a=self._current_a,
                voltage_v=self._voltage_v,
                faults=self._faults or None,
                refuses=", ".join(self._faults),
            )


def _why_not(heartbeat: Any) -> list[str]:
    """Why it does not obey, in words."""
    armed = heartbeat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED
    mode = heartbeat.custom_mode
    return [] if armed and mode == MANUAL else ["not armed"] if not armed else [f"its mode is {mode}, not MANUAL (0)"]


def open_actuator(settings: config.Vehicle, links: Links) -> ArduRover:
    """Raises DelfimError."""
    table = settings.mavlink_front_seat
    return ArduRover(table, *sides(settings, ArduRover.name), links.line(table.device, table.baud))
