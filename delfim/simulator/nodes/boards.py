"""A board with ArduRover that sends its position by MAVLink, as `parts/frontseats/mavlink_source.py` receives it."""

import math
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from delfim.simulator.nodes.measuring import AntennaMotion, GnssReceiver, Turn
from delfim.simulator.nodes.navigation import HDOP

SLOW: Final = 5  # of so many positions, one comes with a heartbeat and the clock
RTK_M: Final = 0.1  # a receiver that states less has RTK


class PlayedBoard:
    """The messages of a board about its own measurements: no motor, no battery."""

    def __init__(self, number: int) -> None:
        self._codec: Any = dialect.MAVLink(None, number, dialect.MAV_COMP_ID_AUTOPILOT1)
        self._count, self._start_ns = 0, 0
        self._heading_rad: float | None = None

    def moved(self, moved: AntennaMotion, receiver: GnssReceiver, utc_ns: int) -> bytes:
        """The messages GPS_RAW_INT and GLOBAL_POSITION_INT; now and then HEARTBEAT and SYSTEM_TIME before them."""
        boot_ms = self._boot_ms(utc_ns)
        at = round(math.degrees(moved.latitude_rad) * 1e7), round(math.degrees(moved.longitude_rad) * 1e7)
        over = round(moved.north_mps * 100.0), round(moved.east_mps * 100.0)
        speed, course = round(math.hypot(*over)), round(math.degrees(math.atan2(over[1], over[0])) * 100.0) % 36_000
        fix = dialect.GPS_FIX_TYPE_RTK_FIXED if receiver.stated_m < RTK_M else dialect.GPS_FIX_TYPE_3D_FIX
        stated_mm = round(receiver.stated_m * 1000.0 * math.sqrt(2.0))
        hdg = 0xFFFF if self._heading_rad is None else round(math.degrees(self._heading_rad) * 100.0) % 36_000
        said = [
            dialect.MAVLink_gps_raw_int_message(
                boot_ms * 1000, fix, *at, 0, round(HDOP * 100.0), 0xFFFF, speed, course, receiver.satellites, 0, stated_mm
            ),
            dialect.MAVLink_global_position_int_message(boot_ms, *at, 0, 0, *over, 0, hdg),
        ]
        if self._count % SLOW == 0:
            armed = dialect.MAV_MODE_FLAG_SAFETY_ARMED | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
            kind = dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
            said[:0] = [
                dialect.MAVLink_heartbeat_message(*kind, armed, 0, dialect.MAV_STATE_ACTIVE, 3),
                dialect.MAVLink_system_time_message(utc_ns // 1000, boot_ms),
            ]
        self._count += 1
        return self._packed(said)

    def turned(self, turn: Turn, utc_ns: int) -> bytes:
        self._heading_rad = turn.heading_rad
        yaw_rad = math.remainder(turn.heading_rad, math.tau)
        attitude = 0.0, 0.0, yaw_rad, 0.0, 0.0, turn.rate_radps
        return self._packed([dialect.MAVLink_attitude_message(self._boot_ms(utc_ns), *attitude)])

    def _boot_ms(self, utc_ns: int) -> int:
        self._start_ns = self._start_ns or utc_ns - 1_000_000_000
        return (utc_ns - self._start_ns) // 1_000_000 & 0xFFFF_FFFF

    def _packed(self, said: list[Any]) -> bytes:
        data = b""
        for each in said:
            data += each.pack(self._codec)
            self._codec.seq = self._codec.seq + 1 & 0xFF
        return data
