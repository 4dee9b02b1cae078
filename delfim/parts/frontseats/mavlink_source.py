"""Position, heading and motion of a Pixhawk or another board with ArduPilot or PX4, by MAVLink (docs/front-seat.md).

The board has combined its sensors itself: each GLOBAL_POSITION_INT is a message of navigation, with the newest ATTITUDE and
GPS_RAW_INT beside it. Where it drives the motors, too, its line is shared with `mavlink_motors.py`.
"""

import math
from typing import Any, Final

from pymavlink.dialects.v20 import development as dialect

from delfim import config
from delfim.base.input.ratelimit import PIECE_BYTES
from delfim.canproxy.dsor.messages import Navigation
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.vehicle.links import Links, LoopInput, ReadableLine, SecondEnd
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.state import State

SLOW_S: Final = 2.5  # the receiver's own words may come once a second, whatever the vehicle's `stale_s`
ASK_S: Final = 10.0  # between two requests for its messages: it forgets them when it starts again
SLOW_HZ: Final = 2.0
UNKNOWN_U16: Final = 0xFFFF
UNKNOWN_SATELLITES: Final = 0xFF
SINCE_NS: Final = 1_577_836_800_000_000_000  # 2020: a clock before that has not been set
FIXES: Final = {2: 2, 3: 3, 4: 4, 5: 6, 6: 5, 7: 3, 8: 4}  # GPS_FIX_TYPE as in Navigation.fix: float is 5 there, RTK 6, PPP 8


class BoardNavigation:
    """Navigation by a board's messages. A value older than its limit is None in the message."""

    name = "mavlink_front_seat"

    def __init__(self, settings: config.Vehicle, line: ReadableLine, state: State) -> None:
        table, limits = settings.of(MavlinkFrontSeat), settings.navigation
        self.input, self.device, self._state = line, table.device, state
        self._line, self._board, self._stale_s, self._rate_hz = line, table.board, limits.stale_s, limits.rate_hz
        self._codec: Any = dialect.MAVLink(None, table.system, dialect.MAV_COMP_ID_MISSIONPLANNER)
        self._codec.robust_parsing = True  # noise is a message of its own, and raises nothing
        self.heard_s, self._asked_s = -1e9, -1e9
        self._attitude: tuple[Any, float] = None, -1e9  # and when it came
        self._receiver: tuple[Any, float] = None, -1e9
        self._clock_ns: int | None = None  # of the board's start; None: its clock is not set
        self._boot_ms, self._counter, self._heard = -1, 0, dict[str, int]()
        self._second: SecondEnd | None = None
        self._shares_with: tuple[LoopInput, ...] = ()

    def share(self) -> SecondEnd:
        """The line for the board's driver."""
        self._second = SecondEnd(self._line)
        return self._second

    def hand_on_to(self, inputs: tuple[LoopInput, ...]) -> None:
        """Set the readers of the line's second end."""
        self._shares_with = inputs

    def read(self, now_s: float) -> Fix | None:
        """Read the newest position of the board, None while there is none."""
        fix, taken = None, 0
        while taken < PIECE_BYTES and (data := self._line.read()):
            taken += len(data)
            for message in self._codec.parse_buffer(data) or ():
                if message.get_type() == "BAD_DATA":
                    self._state.count("mavlink_front_seat_malformed")
                elif (message.get_srcSystem(), message.get_srcComponent()) == (self._board, 1):
                    navigation = self._hear(message, now_s)
                    fix = fix if navigation is None else Fix(navigation, self._line.t_ns, now_s)
            if self._second is not None:
                self._second.hand(data)
        for each in self._shares_with:
            each.read(self._state, now_s)
        return fix

    def report(self, now_s: float) -> dict[str, object]:
        """The report: how many messages of each kind came, and the age of the receiver's last one."""
        receiver, at_s = self._receiver
        told = None if receiver is None else {"fix": receiver.fix_type, "age_s": round(now_s - at_s, 1)}
        return {"heard": dict(self._heard), "receiver": told}

    def _hear(self, m: Any, now_s: float) -> Navigation | None:
        kind = m.get_type()
        if kind == "ATTITUDE":
            self._attitude = m, now_s
        elif kind == "GPS_RAW_INT":
            self._receiver = m, now_s
        elif kind == "SYSTEM_TIME":
            utc_ns = m.time_unix_usec * 1000
            self._clock_ns = utc_ns - m.time_boot_ms * 1_000_000 if utc_ns > SINCE_NS else None
        elif kind == "HEARTBEAT":
            self._ask(now_s)
        elif kind != "GLOBAL_POSITION_INT":
            return None
        self._heard[kind] = self._heard.get(kind, 0) + 1
        if kind != "GLOBAL_POSITION_INT":
            return None
        if m.time_boot_ms == self._boot_ms:
            self._state.count("mavlink_front_seat_repeated")  # of a relay that says it again: the board is silent
            return None
        self._boot_ms, self.heard_s = m.time_boot_ms, now_s
        return self._message(m, now_s)

    def _message(self, m: Any, now_s: float) -> Navigation:
        """The message of navigation. Its position counts while its receiver has one: without it the board reckons on for a
        while."""
        receiver, at_s = self._receiver
        if receiver is None or now_s - at_s > max(self._stale_s, SLOW_S):
            receiver = None
        fix = FIXES.get(receiver.fix_type, 0) if receiver is not None else 0
        is_placed = fix > 0 and (m.lat, m.lon) != (0, 0)
        attitude, at_s = self._attitude
        if now_s - at_s > self._stale_s:
            attitude = None
        told_rad = None if m.hdg > 36_000 else math.radians(m.hdg / 100.0)
        yaw_rad = _finite(attitude, "yaw")
        self._counter = self._counter + 1 & 0xFF
        return Navigation(
            0 if self._clock_ns is None else self._clock_ns + m.time_boot_ms * 1_000_000,
            math.radians(m.lat / 1e7) if is_placed else None,
            math.radians(m.lon / 1e7) if is_placed else None,
            m.vx / 100.0 if is_placed else None,
            m.vy / 100.0 if is_placed else None,
            None if told_rad is None else (told_rad if yaw_rad is None else yaw_rad) % math.tau,
            _finite(attitude, "yawspeed"),
            _finite(attitude, "roll"),
            _finite(attitude, "pitch"),
            fix,
            receiver.satellites_visible if fix and receiver.satellites_visible != UNKNOWN_SATELLITES else 0,
            receiver.eph / 100.0 if fix and receiver.eph != UNKNOWN_U16 else None,
            self._counter,
            receiver.h_acc / 1000.0 if is_placed and receiver.h_acc else None,
        )

    def _ask(self, now_s: float) -> None:
        """Request the messages that are needed, at their rates: those of its parameters may be slower, or none."""
        if now_s - self._asked_s < ASK_S:
            return
        self._asked_s = now_s
        quick, slow = (
            (dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, dialect.MAVLINK_MSG_ID_ATTITUDE),
            (dialect.MAVLINK_MSG_ID_GPS_RAW_INT, dialect.MAVLINK_MSG_ID_SYSTEM_TIME),
        )
        for numbers, rate_hz in ((quick, self._rate_hz), (slow, SLOW_HZ)):
            for number in numbers:
                told = number, 1e6 / rate_hz, 0.0, 0.0, 0.0, 0.0, 0.0
                asked = dialect.MAVLink_command_long_message(self._board, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, *told)
                self._line.write(asked.pack(self._codec))
                self._codec.seq = self._codec.seq + 1 & 0xFF


def _finite(attitude: Any, name: str) -> float | None:
    value = getattr(attitude, name, math.nan)
    return value if math.isfinite(value) else None


def open_source(settings: config.Vehicle, links: Links, state: State) -> BoardNavigation:
    table = settings.of(MavlinkFrontSeat)
    return BoardNavigation(settings, links.line(table.device, table.baud), state)
