"""The boat in ROS 2's messages, by REP 103 and 105: x ahead, y to port, z up; angles anticlockwise, yaw from east.

Each function takes the vehicle's state and gives the bytes, or None where the state does not know enough. The hashes are those
of the definitions of common_interfaces and geographic_info, the same from Iron to Kilted.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.geodesy import Origin, to_plane
from delfim.parts.ros.cdr import CdrReader, CdrWriter
from delfim.parts.ros.roskeys import RosType
from delfim.vehicle.report import BoatReport, NodeFacts

FIX: Final = RosType("sensor_msgs/msg/NavSatFix", "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404")
ODOMETRY: Final = RosType("nav_msgs/msg/Odometry", "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0")
IMU: Final = RosType("sensor_msgs/msg/Imu", "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b")
BATTERY: Final = RosType(
    "sensor_msgs/msg/BatteryState", "RIHS01_4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
)
DIAGNOSTICS: Final = RosType(
    "diagnostic_msgs/msg/DiagnosticArray", "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
)
TWIST: Final = RosType("geometry_msgs/msg/Twist", "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a")
GEO_POSE: Final = RosType(
    "geographic_msgs/msg/GeoPoseStamped", "RIHS01_a8e603c050fa992a74283bb462a96fe9d2b151b7a67b14d77250ed7cb4ed96b7"
)
SCAN: Final = RosType("sensor_msgs/msg/LaserScan", "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828")
SCAN_MOST: Final = 10_000  # directions of a scan
BODY, MAP = "base_link", "map"
OK, WARN, ERROR, STALE = range(4)  # of DiagnosticStatus
NO_FIX, HAS_FIX, APPROXIMATED = -1, 0, 1
_UNKNOWN: Final = -1.0  # first element of a covariance: there is no such value
NAN: Final = math.nan


class LaserScan(NamedTuple):
    """A scan in the boat's axes: angles from the bow to port."""

    first_rad: float
    step_rad: float
    least_m: float
    most_m: float
    ranges_m: Sequence[float]


def fix(state: BoatReport, utc_ns: int) -> bytes | None:
    if state.latitude_deg is None or state.longitude_deg is None:
        return None
    variance_m2 = (state.accuracy_m or 0.0) ** 2
    writer = _stamped(utc_ns, BODY).put("b", HAS_FIX if state.fix else NO_FIX).put("H", 1)
    writer.put("d", state.latitude_deg, state.longitude_deg, NAN)
    writer.put("d", variance_m2, 0.0, 0.0, 0.0, variance_m2, 0.0, 0.0, 0.0, 4.0 * variance_m2)
    return bytes(writer.put("B", APPROXIMATED if state.accuracy_m else 0).data)


def odometry(state: BoatReport, utc_ns: int, at: Origin) -> bytes | None:
    """Odometry: pose in the plane of the first position, speed in the boat's axes."""
    heading_deg, course_deg = state.heading_deg, state.course_deg
    if state.latitude_deg is None or state.longitude_deg is None or heading_deg is None or state.speed_mps is None:
        return None
    north_m, east_m = to_plane(at, math.radians(state.latitude_deg), math.radians(state.longitude_deg))
    drift = 0.0 if course_deg is None else math.radians(course_deg - heading_deg)
    ahead_mps, port_mps = state.speed_mps * math.cos(drift), -state.speed_mps * math.sin(drift)
    variance_m2 = (state.accuracy_m or 0.0) ** 2
    writer = _stamped(utc_ns, MAP).text(BODY).put("d", east_m, north_m, 0.0, *attitude(state, heading_deg))
    writer.put("d", *_diagonal(6, variance_m2, variance_m2))
    writer.put("d", ahead_mps, port_mps, 0.0, 0.0, 0.0, _turn_radps(state))
    return bytes(writer.put("d", *_diagonal(6)).data)


def imu(state: BoatReport, utc_ns: int) -> bytes | None:
    if state.heading_deg is None:
        return None
    writer = _stamped(utc_ns, BODY).put("d", *attitude(state, state.heading_deg)).put("d", *_diagonal(3))
    has_turn = state.turn_dps is not None
    writer.put("d", 0.0, 0.0, _turn_radps(state)).put("d", *_diagonal(3, 0.0 if has_turn else _UNKNOWN))
    return bytes(writer.put("d", 0.0, 0.0, 0.0).put("d", *_diagonal(3, _UNKNOWN)).data)


def batteries(state: BoatReport, utc_ns: int) -> Iterator[bytes]:
    """Battery states, one for each node that reports a charge; `location` is its name."""
    for name, node in state.sysstat.items():
        if node.charge is not None:
            yield _battery(name, node, utc_ns)


def _battery(name: str, node: NodeFacts, utc_ns: int) -> bytes:
    voltage, heat, drawn = (NAN if each is None else each for each in (node.voltage_v, node.temperature_c, node.current_a))
    writer = _stamped(utc_ns, BODY)
    writer.put("f", voltage, heat, -drawn, NAN, NAN, NAN, NAN if node.charge is None else node.charge)
    return bytes(writer.put("B", 0, 0, 0).put("?", True).put("I", 0).put("I", 0).text(name, "").data)


class Diagnosis(NamedTuple):
    level: int
    name: str
    message: str
    values: tuple[tuple[str, str], ...] = ()


def diagnosis(state: BoatReport) -> Iterator[Diagnosis]:
    """Diagnostics: the mode, the checks that failed, and each trouble: an error where the boat does something about it."""
    whose = (("payload", state.helmsman),) if state.helmsman else ()
    yield Diagnosis(OK, "mode", state.mode, (("reason", state.reason), ("operator", state.operator), *whose))
    for check in state.checks:
        yield Diagnosis(OK if check.ok else WARN, f"check {check.name}", check.reason)
    for notice in state.notices:
        yield Diagnosis(WARN if notice.action == "warn" else ERROR, notice.name, notice.reason, (("action", notice.action),))


def diagnostics(boat: str, rows: Iterable[Diagnosis], utc_ns: int) -> bytes:
    told = list(rows)
    writer = _stamped(utc_ns, "").put("I", len(told))
    for each in told:
        writer.put("B", each.level).text(f"{boat}: {each.name}", each.message, boat).put("I", len(each.values))
        for name, value in each.values:
            writer.text(name, value)
    return bytes(writer.data)


def attitude(state: BoatReport, heading_deg: float) -> tuple[float, float, float, float]:
    """The quaternion x, y, z, w of yaw, pitch and roll; the last two are 0 where nobody measures them."""
    roll = 0.5 * math.radians(state.roll_deg or 0.0)
    pitch = -0.5 * math.radians(state.pitch_deg or 0.0)  # bow up is a turn about the axis to port, the other way round
    yaw = 0.5 * math.radians(90.0 - heading_deg)
    cr, sr, cp, sp, cy, sy = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def twist(data: bytes) -> tuple[float, float]:
    """Parse a Twist to speed ahead, m/s, and rate of turn to starboard, rad/s. Raises FormatError."""
    ahead_mps, *_, turn_radps = CdrReader(data).get("d", 6)
    return ahead_mps, -turn_radps


def geo_pose(data: bytes) -> tuple[float, float]:
    """Parse a GeoPose to latitude and longitude in degrees. Raises FormatError."""
    reader = CdrReader(data)
    reader.get("i")
    reader.get("I")
    reader.text()
    latitude_deg, longitude_deg = reader.get("d", 2)
    reader.get("d", 5)  # height and orientation, which a boat does not choose; they must be there all the same
    return latitude_deg, longitude_deg


def laser_scan(data: bytes) -> LaserScan:
    """Parse a LaserScan. Raises FormatError."""
    reader = CdrReader(data)
    reader.get("i")
    reader.get("I")
    reader.text()
    first_rad, _last_rad, step_rad, _step_s, _scan_s, least_m, most_m = reader.get("f", 7)
    (count,) = reader.get("I")
    if count > SCAN_MOST:
        raise FormatError(f"a scan of {count:.0f} directions")
    return LaserScan(first_rad, step_rad, least_m, most_m, reader.get("f", int(count)))


def _stamped(utc_ns: int, frame: str) -> CdrWriter:
    """Write a std_msgs/Header."""
    return CdrWriter().put("i", utc_ns // 1_000_000_000).put("I", utc_ns % 1_000_000_000).text(frame)


def _diagonal(size: int, *variances: float) -> list[float]:
    """A covariance with these first elements of the diagonal; the others are 0, which is unknown."""
    found = [0.0] * size * size
    found[: len(variances) * (size + 1) : size + 1] = variances
    return found


def _turn_radps(state: BoatReport) -> float:
    return -math.radians(state.turn_dps or 0.0)
