"""The console's knowledge of a boat, with the age of each part. Messages in, one JSON-ready dictionary out."""

import math
import re
from collections import deque
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import msgspec

from delfim.base.modes import Mode
from delfim.console.boats.othervessels import VesselsTold
from delfim.console.boats.wayhome import HeardTrack, ToldWay
from delfim.console.link.mavlink import (
    BOAT_NAME,
    BOAT_SIZE,
    ENERGY,
    GUARDED,
    LINE,
    ORDERED,
    STATIONS,
    Offer,
    boatsize,
    mavlink,
    own_offers,
)
from delfim.console.link.reception import Reception
from delfim.console.link.statustext import Words
from delfim.vehicle.plans.mission import ROWS

COLOURS: Final = ("#f4f6f7", "#56b4e9", "#00835f", "#7a3fb5", "#13233f")  # every eye tells them apart; none is that of an alert
SILENT_S: Final = 3.5
WEAK_PCT, WEAK_MS = 10.0, 1000.0  # lost, round trip: from there on a stop may come late
CHECKSUM_S: Final = 6.0  # the time for a boat to send the checksum of its plans before they are read
NAME_MAX: Final = 32
TRACK_MAX: Final = 36_000  # points: ten hours at one a second
UNKNOWN_HEADING: Final = 65535
DIRECTIONS: Final = 36  # of a boat's range, from north clockwise
ENERGY_S: Final = 60.0  # an older word of its energy is none
MEASURED_MAX: Final = 32  # values of sensors, by name
STATION: Final = re.compile(r"station: waypoint (\d{1,4}): (.*)")  # what a boat says of a sample, by its log


class Measured(NamedTuple):
    """The last value of a sensor. The boat tells a value again while nothing new was measured: its stamp is then the same."""

    value: float
    stamp_ms: int  # of the boat
    at_s: float  # when it was heard first


class Boat:
    """One boat. `receive` takes any of its messages; none can do harm."""

    def __init__(self, number: int, now_s: float) -> None:
        self.number, self.name = number, f"boat {number}"
        self.colour = COLOURS[number % len(COLOURS)]
        self.heard_s = now_s
        self.mode, self.armed = "", False
        self.modes: dict[int, str] = {mode: mode.name.lower() for mode in Mode}  # until the boat has sent its own
        self.has_told_modes = False
        self._modes_told: dict[int, tuple[int, str]] = {}  # by their place in its list
        self.orders = own_offers()  # that its menu offers, until the boat has sent its own
        self.has_told_orders = False
        self._orders_told: dict[int, Offer] = {}  # by their place in its list
        self.commander = 0  # number of the console that commands; 0: none
        self.used = False  # the operator has commanded it
        self.twins: list[str] = []  # addresses of all boats that have this number, if there is more than one
        self.asked: str | None = None
        self.asked_s = -math.inf
        self.at_s: dict[str, float] = {}  # when each group of values was heard last
        self.has: set[str] = set()  # of rpm and battery, what it has ever told: motors on pulses tell neither
        self.values: dict[str, Any] = {}
        self.measured: dict[str, Measured] = {}
        self.reference: dict[str, Any] = {}
        self.lines_done: list[int] = []  # of the survey aboard, that were sailed to their ends while it was heard
        self.stations: dict[int, dict[str, str]] = {}  # of the mission aboard, by waypoints from 1
        self.energy: dict[str, Any] = {}  # empty: it reckons none
        self.others = VesselsTold()
        self.reason, self.words = "", Words()  # its last text
        self.reason_s = -math.inf  # when
        self.warning = ""  # its last text that was a warning, while something is wrong
        self.target_is_new = False  # a target came after the last message about steering
        self.failsafe, self.ready = "", False
        self.forced = ""  # its last text about a mode that it entered by itself
        self.link, self.signed = "udp", False  # "log": its own log is replayed
        self.links: list[dict[str, Any]] = []  # all of them, for the page
        self.track: deque[tuple[float, float, float]] = deque(maxlen=TRACK_MAX)
        self.heard_track = HeardTrack()
        self.told_way: ToldWay | None = None  # once somebody asked
        self.rtt_ms: float | None = None
        self.link_was_weak = False
        self.synced_s = -math.inf
        self.released = False
        self.before = ""  # the name that it had until now, as another boat
        self.is_named = False  # it has told its name since it was silent last
        self.profile = ""  # until it has told it
        self.size: boatsize.BoatSize | None = None  # the same
        self.asks = 0  # requests for its name, its modes and its profile
        self.checksum: int | None = None  # of the plans aboard, as the boat sends it
        self.read: int | None = None  # the same, when they were read
        self.read_due_s = now_s + CHECKSUM_S
        self.reception = Reception(now_s)  # on the link in use

    def has_weak_link(self, now_s: float) -> bool:
        """Whether a stop may come late (docs/operator.md). It ends when the link is twice as good as where it began."""
        part = 0.5 if self.link_was_weak else 1.0
        self.link_was_weak = self.reception.loss_pct(now_s) >= part * WEAK_PCT or (self.rtt_ms or 0.0) >= part * WEAK_MS
        return self.link_was_weak

    def receive(self, message: Any, now_s: float, utc_s: float) -> None:
        """Takes any message of this boat."""
        if now_s - self.heard_s > SILENT_S:  # it may be another boat with this number by now
            self.is_named, self.profile, self.asks, self.synced_s, self.has_told_orders = False, "", 0, -math.inf, False
            self._orders_told.clear()
        self.heard_s = now_s
        handler = _HANDLERS.get(message.get_type())
        if handler is not None:
            handler(self, message)
            self.at_s |= dict.fromkeys(_GROUPS.get(message.get_type(), (message.get_type(),)), now_s)
            if message.get_type() in ("GLOBAL_POSITION_INT", "HIGH_LATENCY2"):
                self._extend(utc_s)

    def measure(self, name: str, value: float, stamp_ms: int) -> None:
        """Takes a value of a sensor; one that is no number is not known."""
        was = self.measured.get(name)
        if not math.isfinite(value):
            self.measured.pop(name, None)
        elif (was is None and len(self.measured) < MEASURED_MAX) or (was is not None and was.stamp_ms != stamp_ms):
            self.measured[name] = Measured(round(value, 3), stamp_ms, self.heard_s)

    def rename(self, text: str) -> None:
        """Takes its name. If it is another boat than it was, what is known of that one is forgotten."""
        name = _printable(text) or self.name
        self.before = self.name if self.name not in (name, f"boat {self.number}") else ""
        self.name, self.is_named = name, True
        if self.before:
            for each in (
                self.values,
                self.measured,
                self.reference,
                self.energy,
                self.at_s,
                self.has,
                self._modes_told,
                self._orders_told,
            ):
                each.clear()
            self.heard_track, self.told_way, self.size = HeardTrack(), None, None
            self.orders, self.has_told_orders = own_offers(), False
            self.has_told_modes, self.asks, self.reason, self.failsafe, self.warning, self.forced = False, 0, "", "", "", ""

    def enter(self, number: int) -> None:
        """Enters a mode; the target of the mode before is forgotten."""
        mode = self.modes.get(number, f"mode {number}")
        if mode != self.mode:
            self.reference |= _NOWHERE
            self.mode = mode

    def take_line(self, line: int) -> None:
        """Takes the line of a survey that it sails, 0: none. The one before is done where the boat goes on with its mission."""
        was, goes_on = self.reference.get("line"), self.mode in ("play", "path") or self.reason.endswith(" done")
        if was and was != line and goes_on and was not in self.lines_done:
            self.lines_done.append(was)
        self.reference["line"] = line

    def take_station(self, text: str) -> None:
        """Takes what it says of a sample: it is asked for, taken, or given up."""
        if (told := STATION.fullmatch(text)) is not None and (number := int(told[1])) <= ROWS:
            words = told[2]
            state = "waiting" if " is asked for" in words else "failed" if words.startswith("no sample") else "sampled"
            if state != "sampled" or " has sample " in words:  # why a try failed: the next one is asked for at once
                self.stations[number] = {"state": state, "words": words}

    def take_stations(self, numbers: list[int]) -> None:
        """Takes the waypoints that have their sample, and below 0 those without: what was said when nobody heard it."""
        for number in numbers:
            state = "sampled" if number > 0 else "failed"
            if 0 < abs(number) <= ROWS and self.stations.get(abs(number), {}).get("state") != state:
                words = "it has its sample" if number > 0 else "no sample"
                self.stations[abs(number)] = {"state": state, "words": words}

    def age_s(self, kind: str, now_s: float) -> float | None:
        """Time since a message of this kind; None if there was none."""
        return None if kind not in self.at_s else round(now_s - self.at_s[kind], 2)

    def learn_mode(self, place: int, count: int, number: int, name: str) -> None:
        """Takes one of the boat's modes; once all are known, they become the list. The mode of STOP is idle, whatever the boat
        calls it."""
        self._modes_told[place] = number, name
        places = range(1, count + 1)
        if all(each in self._modes_told for each in places):
            self.modes = dict(self._modes_told[each] for each in places) | {Mode.IDLE: "idle"}
            self.has_told_modes = True

    def learn_offer(self, place: int, count: int, offer: Offer) -> None:
        """Takes one of the orders that it offers; once all are known, they become the list."""
        self._orders_told[place] = offer
        if all(each in self._orders_told for each in range(1, count + 1)):
            self.orders, self.has_told_orders = [self._orders_told[each] for each in range(1, count + 1)], True

    def snapshot(self, now_s: float) -> dict[str, Any]:
        """The boat as the page shows it."""
        v = self.values
        ages = {
            "heard": round(now_s - self.heard_s, 2),
            "position": self.age_s("GLOBAL_POSITION_INT", now_s),
            "attitude": self.age_s("ATTITUDE", now_s),
            "rpm": self.age_s("RAW_RPM", now_s) if "rpm" in self.has else None,
            "battery": self.age_s("SYS_STATUS", now_s) if "battery" in self.has else None,
        }
        if self.asked is not None and (self.asked == self.mode or now_s - self.asked_s > 10.0):
            self.asked = None
        return {
            "id": self.number,
            "name": self.name,
            "colour": self.colour,
            "size": self.size and self.size._asdict(),
            **{key: v.get(key) for key in _PLAIN},
            "mode": self.mode or None,
            "modes": list(self.modes.values()),
            "orders": [msgspec.structs.asdict(each) for each in self.orders],
            "asked": self.asked,
            "armed": self.armed,
            "owner": True,
            "commander": self.commander,
            "twins": self.twins,
            "ready": self.ready,
            "reason": self.reason,
            "reason_age_s": round(now_s - self.reason_s, 1) if self.reason else None,
            "failsafe": self.failsafe,
            "forced": self.forced.partition(": ")[2] if self.forced.startswith(f"{self.mode}: ") else "",
            "rpm": [v.get("port_rpm"), v.get("starboard_rpm")],
            "thrust_pct": [v.get("port_pct"), v.get("starboard_pct")],
            "reference": {key: self.reference.get(key) for key in _REFERENCE},
            "lines_done": self.lines_done,
            "stations": self.stations,
            "order": self.others.order(now_s),
            "guard": self.others.guard(now_s),
            "energy": self.energy if (self.age_s("DEBUG_FLOAT_ARRAY", now_s) or 0.0) < ENERGY_S and self.energy else None,
            "measured": {
                name: {"value": each.value, "age_s": round(now_s - each.at_s, 2)} for name, each in self.measured.items()
            },
            "age_s": ages,
            "link": {
                "kind": self.link,
                "signed": self.signed,
                "profile": self.profile,
                "rtt_ms": self.rtt_ms,
                "loss_pct": self.reception.loss_pct(now_s),
                "bytes_per_s": self.reception.bytes_per_s(now_s),
                "all": self.links,
            },
            "ghost": self._ghost(now_s),
            "released": self.released,
        }

    def _extend(self, utc_s: float) -> None:
        """Adds to the past track, a point a second."""
        latitude_deg, longitude_deg = self.values.get("latitude_deg"), self.values.get("longitude_deg")
        if latitude_deg is not None and longitude_deg is not None and (not self.track or utc_s - self.track[-1][0] >= 1.0):
            self.track.append((round(utc_s, 1), latitude_deg, longitude_deg))
            self.heard_track.add(latitude_deg, longitude_deg)

    def _ghost(self, now_s: float) -> dict[str, float] | None:
        """The estimated position of a silent boat on its last course, and the error of it."""
        silent_s, v = now_s - self.heard_s, self.values
        if silent_s < SILENT_S or v.get("latitude_deg") is None:
            return None
        run_m, course = (v.get("speed_mps") or 0.0) * silent_s, math.radians(v.get("course_deg") or 0.0)
        latitude_deg = v["latitude_deg"] + run_m * math.cos(course) / 111_200.0
        east_m_per_deg = 111_200.0 * max(math.cos(math.radians(latitude_deg)), 0.01)
        return {
            "latitude_deg": latitude_deg,
            "longitude_deg": v["longitude_deg"] + run_m * math.sin(course) / east_m_per_deg,
            "radius_m": 5.0 + 0.5 * run_m,
        }


_PLAIN: Final = (
    "latitude_deg",
    "longitude_deg",
    "heading_deg",
    "course_deg",
    "speed_mps",
    "speed_pct",
    "battery_v",
    "battery_pct",
    "roll_deg",
    "pitch_deg",
    "satellites",
    "fix",
)


_FIXES: Final = {1: "no fix", 2: "2D", 3: "3D", 4: "differential", 5: "RTK float", 6: "RTK"}  # GPS_FIX_TYPE
_REFERENCE: Final = (
    "speed_mps",
    "heading_deg",
    "course_deg",
    "latitude_deg",
    "longitude_deg",
    "cross_track_m",
    "distance_m",
    "leg",
    "line",
)
_NOWHERE: Final = dict.fromkeys(_REFERENCE[:-2])  # leg and line are kept
_GROUPS: Final = {"HIGH_LATENCY2": ("HIGH_LATENCY2", "GLOBAL_POSITION_INT", "SYS_STATUS")}  # one message has all of them


def _heartbeat(boat: Boat, m: Any) -> None:
    boat.enter(m.custom_mode)
    boat.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    boat.signed = bool(m.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED)
    is_critical = m.system_status == mavlink.MAV_STATE_CRITICAL
    boat.failsafe = (boat.failsafe or boat.warning or boat.reason) if is_critical else ""
    boat.warning = boat.warning if is_critical else ""


def _position(boat: Boat, m: Any) -> None:
    north_mps, east_mps = m.vx / 100.0, m.vy / 100.0
    known = (m.lat, m.lon) != (0, 0)
    boat.values |= {
        "latitude_deg": m.lat / 1e7 if known else None,
        "longitude_deg": m.lon / 1e7 if known else None,
        "heading_deg": m.hdg / 100.0 if m.hdg != UNKNOWN_HEADING else None,
        "course_deg": round(math.degrees(math.atan2(east_mps, north_mps)) % 360.0, 1),
        "speed_mps": round(math.hypot(north_mps, east_mps), 2),
    }


def _attitude(boat: Boat, m: Any) -> None:
    boat.values |= {"roll_deg": _degrees(m.roll), "pitch_deg": _degrees(m.pitch), "heading_deg": _degrees(m.yaw % math.tau)}


def _degrees(angle_rad: float) -> float | None:
    return round(math.degrees(angle_rad), 1) if math.isfinite(angle_rad) else None


def _rpm(boat: Boat, m: Any) -> None:
    if m.index in (0, 1):
        known = math.isfinite(m.frequency)
        boat.has |= {"rpm"} if known else set()
        boat.values["starboard_rpm" if m.index else "port_rpm"] = round(m.frequency) if known else None


def _servos(boat: Boat, m: Any) -> None:
    boat.values |= {"port_pct": round((m.servo1_raw - 1500) / 5), "starboard_pct": round((m.servo3_raw - 1500) / 5)}


def _hud(boat: Boat, m: Any) -> None:
    boat.values["speed_pct"] = m.throttle


def _power(boat: Boat, m: Any) -> None:
    boat.ready = bool(m.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
    boat.values["battery_v"] = m.voltage_battery / 1000.0 if m.voltage_battery != 65535 else None
    boat.values["battery_pct"] = m.battery_remaining if m.battery_remaining >= 0 else None
    boat.has |= {"battery"} if m.voltage_battery != 65535 or m.battery_remaining >= 0 else set()


def _gps(boat: Boat, m: Any) -> None:
    boat.values |= {"fix": _FIXES.get(m.fix_type), "satellites": m.satellites_visible if m.satellites_visible != 255 else None}


def _navigation(boat: Boat, m: Any) -> None:
    """The target's position comes in another message. If none came since the last time, the boat only keeps a heading."""
    if not boat.target_is_new:
        boat.reference |= _NOWHERE
    boat.target_is_new = False
    now_mps = boat.values.get("speed_mps")
    boat.reference |= {
        "speed_mps": round(max(now_mps + m.aspd_error, 0.0), 2) if now_mps is not None and m.aspd_error else None,
        "heading_deg": m.nav_bearing % 360,
        "course_deg": m.target_bearing % 360 if boat.mode == Mode.COURSE.name.lower() else None,
    }
    if boat.reference.get("latitude_deg") is not None:
        cross_m = round(m.xtrack_error, 2) if math.isfinite(m.xtrack_error) else None
        boat.reference |= {"distance_m": m.wp_dist, "cross_track_m": cross_m}


def _target(boat: Boat, m: Any) -> None:
    known = (m.lat_int, m.lon_int) != (0, 0)
    boat.target_is_new = known
    boat.reference["latitude_deg"] = m.lat_int / 1e7 if known else None
    boat.reference["longitude_deg"] = m.lon_int / 1e7 if known else None


def _current(boat: Boat, m: Any) -> None:
    boat.reference["leg"] = m.seq


def _named(boat: Boat, m: Any) -> None:
    if m.name == "OWNER":
        boat.commander = m.value
    elif m.name == LINE:
        boat.take_line(m.value)
    elif m.name == GUARDED.decode():
        boat.others.guarded(m.value, boat.heard_s)


def _float(boat: Boat, m: Any) -> None:
    if m.name == ORDERED.decode():
        boat.others.ordered(m.value, boat.heard_s)
    elif m.name != "OVERRIDE" and (name := _printable(m.name)):
        boat.measure(name, m.value, m.time_boot_ms)


def _depth(boat: Boat, m: Any) -> None:
    boat.measure("depth_m", m.distance, m.time_boot_ms)


def _array(boat: Boat, m: Any) -> None:
    name = m.name.rstrip("\0")
    if name == ENERGY:
        _energy(boat, m)
    elif name == STATIONS:
        boat.take_stations([int(each) for each in m.data if math.isfinite(each)])


def _energy(boat: Boat, m: Any) -> None:
    """What the boat has left and how far it gets with it; a boat that reckons nothing says nothing."""
    left, home, plan, reserve, *ranges_m = (round(each, 1) if math.isfinite(each) else None for each in m.data)
    ranges_m = [max(each or 0.0, 0.0) for each in ranges_m[:DIRECTIONS]]
    boat.energy = {"left_wh": left, "home_wh": home, "plan_wh": plan, "reserve_wh": reserve, "range_m": ranges_m}
    if left is None or not any(ranges_m):
        boat.energy["range_m"] = []


def _text(boat: Boat, m: Any) -> None:
    if m.param_id == BOAT_NAME:
        boat.rename(m.param_value)
    elif m.param_id == BOAT_SIZE:
        boat.size = boatsize.heard(m.param_value)


def _available(boat: Boat, m: Any) -> None:
    boat.learn_mode(m.mode_index, m.number_modes, m.custom_mode, _printable(m.mode_name).lower() or f"mode {m.custom_mode}")


def _printable(text: str) -> str:
    return "".join(filter(str.isprintable, text)).strip()[:NAME_MAX]


def _checksum(boat: Boat, m: Any) -> None:
    if m.mission_type == mavlink.MAV_MISSION_TYPE_ALL:
        boat.read_due_s = boat.read_due_s if m.checksum == boat.checksum else -math.inf
        if m.checksum != boat.checksum:  # other plans have other lines and stations
            boat.lines_done, boat.stations = [], {}
        boat.checksum = m.checksum


def _lean(boat: Boat, m: Any) -> None:
    """HIGH_LATENCY2: everything in one message, for radios on which every byte counts."""
    boat.commander = m.custom0 & 0xFF
    boat.enter(m.custom_mode)
    boat.reference["heading_deg"] = m.target_heading * 2.0
    boat.reference["distance_m"] = m.target_distance * 10.0 or None
    boat.has |= {"battery"} if m.battery >= 0 else set()
    boat.values |= {
        "latitude_deg": m.latitude / 1e7,
        "longitude_deg": m.longitude / 1e7,
        "heading_deg": m.heading * 2.0,
        "course_deg": m.heading * 2.0,
        "speed_mps": m.groundspeed / 5.0,
        "speed_pct": m.throttle,
        "battery_pct": m.battery if m.battery >= 0 else None,
        "port_pct": m.custom1,
        "starboard_pct": m.custom2,
    }


_HANDLERS: Final[dict[str, Callable[[Boat, Any], None]]] = {
    "HEARTBEAT": _heartbeat,
    "GLOBAL_POSITION_INT": _position,
    "ATTITUDE": _attitude,
    "RAW_RPM": _rpm,
    "SERVO_OUTPUT_RAW": _servos,
    "VFR_HUD": _hud,
    "SYS_STATUS": _power,
    "GPS_RAW_INT": _gps,
    "NAV_CONTROLLER_OUTPUT": _navigation,
    "POSITION_TARGET_GLOBAL_INT": _target,
    "MISSION_CURRENT": _current,
    "HIGH_LATENCY2": _lean,
    "NAMED_VALUE_INT": _named,
    "NAMED_VALUE_FLOAT": _float,
    "WATER_DEPTH": _depth,
    "DEBUG_FLOAT_ARRAY": _array,
    "PARAM_EXT_VALUE": _text,
    "AVAILABLE_MODES": _available,
    "MISSION_CHECKSUM": _checksum,
    "AIS_VESSEL": lambda boat, m: boat.others.hear(m, boat.heard_s),
    "STATUSTEXT": lambda boat, m: boat.others.say(m),
}
