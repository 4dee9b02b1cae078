"""A board with ArduRover or PX4 as front seat: throttle and steering by MANUAL_CONTROL, by TCP or a serial line
(docs/front-seat.md).

Its mixer, limits and remote control stay its own. It obeys while it is armed and in its manual mode, and for a time of its own
after the last message. Sources: ArduPilot's Rover/GCS_MAVLink_Rover.cpp, handle_manual_control_axes; PX4's handling of the
message in mavlink_receiver.cpp, and DifferentialManualMode.cpp.

The two read the throttle in two ways: what stops the one is full astern, or half ahead, to the other. So a board is told
nothing before it has said which one it is, and a PX4 nothing before it has said its version.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import development as dialect

from delfim import config
from delfim.base.input.ratelimit import PIECE_BYTES
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, Status
from delfim.parts.frontseats.frontseat import FrontSeatLine, SeatSide, sides
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

FULL: Final = 1000
AUTOPILOT: Final = dialect.MAV_COMP_ID_AUTOPILOT1  # a gimbal or a camera of the board has its system number, too
HEARTBEAT_TICKS: Final = 5  # of `repeat`: once a second
OLDEST: Final = (1, 16)  # PX4 before it had no such manual mode of boats, or read the throttle in another way
UNKNOWN_V, UNKNOWN_A, UNKNOWN_CHARGE = 0xFFFF, -1, -1
Sticks = tuple[int, int, int, int]  # x, y, z, r of MANUAL_CONTROL


class Autopilot(NamedTuple):
    """The commands that a board takes, and the reports that it sends."""

    name: str
    number: int  # in its heartbeat
    shift: int  # bits of its mode's number below the main mode
    manual: int  # the main mode in which it obeys
    sticks: Callable[[int, int], Sticks]  # of throttle and steering, in thousandths


KINDS: Final = {
    "ardupilot": Autopilot("ArduPilot", dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, lambda ahead, turn: (0, turn, ahead, 0)),
    # 0 is full astern, 500 still, 1000 full ahead; two sticks steer, because versions differ in which one does
    "px4": Autopilot("PX4", dialect.MAV_AUTOPILOT_PX4, 16, 1, lambda ahead, turn: (0, turn, (FULL + ahead) // 2, turn)),
}


NUMBERS: Final = frozenset(kind.number for kind in KINDS.values())


class MavlinkBoard:
    """The motors of a board, as two sides."""

    name = "mavlink_front_seat"
    period_s: float | None = 0.2

    def __init__(self, table: MavlinkFrontSeat, starboard: SeatSide, port: SeatSide, line: ReadableLine) -> None:
        self._starboard, self._port, self._board, self._kind = starboard, port, table.board, KINDS[table.autopilot]
        self.input, self.inputs, self._line = line, (self,), line
        self._codec: Any = dialect.MAVLink(None, table.system, dialect.MAV_COMP_ID_MISSIONPLANNER)
        self._codec.robust_parsing = True  # noise is a message of its own, and raises nothing
        self._is_px4 = table.autopilot == "px4"
        self._seat = FrontSeatLine(self.name, (starboard, port), line, self._packed(0.0, 0.0), stays=self._is_px4)
        self._ticks, self._sent = 0, Actuation((), (), False)
        self._number: int | None = None  # of its autopilot, as it says
        self._version: tuple[int, int] | None = None
        self._wrong = "not heard yet"  # why it must not be told anything
        self._faults: tuple[str, ...] = (self._wrong,)
        self._voltage_v: float | None = None
        self._current_a: float | None = None
        self._is_boats_battery = table.battery

    def send(self, sent: Actuation, now_s: float) -> int:
        self._sent = sent
        if self._wrong:
            return 2 if sent.run else 0
        return self._seat.send(sent, lambda starboard, port: self._packed((starboard + port) / 2.0, (port - starboard) / 2.0))

    def repeat(self, now_s: float) -> int:
        """Send the heartbeat of a ground station, whose loss is the board's own failsafe. A PX4 gets its command again: by
        default it waits 0.5 s for one."""
        self._ticks += 1
        if self._ticks % HEARTBEAT_TICKS == 0:
            kind, none, active = dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, dialect.MAV_STATE_ACTIVE
            self._line.write(self._frame(dialect.MAVLink_heartbeat_message(kind, none, 0, 0, active, 3)))
            if self._is_px4 and self._version is None:
                self._command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        return self.send(self._sent, now_s) if self._is_px4 else 0

    def stop(self) -> None:
        """Stop the motors. A PX4 is disarmed first: whatever its version, its motors are off then."""
        if self._is_px4:
            self._command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        self._seat.stop()

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: disarming it is for its operator."""

    def read(self, state: State, now_s: float) -> None:
        """Read its heartbeat and its battery into the state. Other messages are ignored; malformed ones are counted. What is
        left over stays readable."""
        taken = 0
        while taken < PIECE_BYTES and (data := self._line.read()):
            taken += len(data)
            for message in self._codec.parse_buffer(data) or ():
                if message.get_type() == "BAD_DATA":
                    state.count("mavlink_front_seat_malformed")
                elif (message.get_srcSystem(), message.get_srcComponent()) == (self._board, AUTOPILOT):
                    self._hear(message, state, now_s)

    def report(self) -> dict[str, object]:
        return {"why_not": ", ".join(self._faults)}

    def _packed(self, ahead: float, to_starboard: float) -> bytes:
        throttle, steering = (round(FULL * min(max(each, -1.0), 1.0)) for each in (ahead, to_starboard))
        return self._frame(dialect.MAVLink_manual_control_message(self._board, *self._kind.sticks(throttle, steering), 0))

    def _command(self, number: int, first: float) -> None:
        told = dialect.MAVLink_command_long_message(self._board, 1, number, 0, first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._line.write(self._frame(told))

    def _frame(self, message: Any) -> bytes:
        frame: bytes = message.pack(self._codec)
        self._codec.seq = self._codec.seq + 1 & 0xFF
        return frame

    def _hear(self, message: Any, state: State, now_s: float) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot in NUMBERS:
            self._number = message.autopilot
            self._wrong = self._judged()
            self._faults = (self._wrong,) if self._wrong else self._why_not(message)
        elif kind == "AUTOPILOT_VERSION":
            self._version = message.flight_sw_version >> 24, message.flight_sw_version >> 16 & 0xFF
            self._wrong = self._judged()
            return
        elif kind == "SYS_STATUS":
            volts, amperes = message.voltage_battery, message.current_battery
            self._voltage_v = None if volts == UNKNOWN_V else volts / 1000.0
            self._current_a = None if amperes == UNKNOWN_A else amperes / 100.0
            if self._is_boats_battery and message.battery_remaining != UNKNOWN_CHARGE:
                charge = min(max(message.battery_remaining / 100.0, 0.0), 1.0)
                told = BatteriesStatus(Status.GOOD, Fault(0), self._voltage_v, self._current_a, charge, None)
                state.sysstat[NAMES[Node.BATTERIES_STARBOARD]] = told, now_s
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

    def _judged(self) -> str:
        """The reason, in words, why it must not get any command; empty: it may."""
        if self._number is None:
            return "not heard yet"
        if self._number != self._kind.number:
            return f"it is no {self._kind.name}, as mavlink_front_seat.autopilot has it"
        if not self._is_px4:
            return ""
        if self._version is None:
            return "its version is not known yet"
        old, (major, minor) = self._version < OLDEST, self._version
        return f"PX4 {major}.{minor} is older than {OLDEST[0]}.{OLDEST[1]}" if old else ""

    def _why_not(self, heartbeat: Any) -> tuple[str, ...]:
        """The reason, in words, why it does not obey."""
        if not heartbeat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED:
            return ("not armed",)
        mode = heartbeat.custom_mode >> self._kind.shift & 0xFF
        return () if mode == self._kind.manual else (f"its mode is {mode}, not MANUAL ({self._kind.manual})",)


def open_actuator(settings: config.Vehicle, links: Links) -> MavlinkBoard:
    """Open the driver. Raises DelfimError."""
    table = settings.of(MavlinkFrontSeat)
    return MavlinkBoard(table, *sides(settings, MavlinkBoard.name), links.line(table.device, table.baud))
