"""The messages that the vehicle sends by itself: one row a message, with its interval on each kind of link.

A `fresh` row is sent only after a new measurement: a console knows the age of a value by when it came.
Angles, speeds and lengths leave here in MAVLink's units, unknown values as MAVLink marks them.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Final, Literal, NamedTuple

from delfim.base.geodesy import compass, from_plane, wrap
from delfim.base.modes import PAYLOADS, Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Node
from delfim.parts.mavlink.codec.aisvessel import guard, ordered, vessels
from delfim.parts.mavlink.codec.ardupilot import WaterDepth, Wind
from delfim.parts.mavlink.codec.params import ENERGY, LINE, SENSED, SENSED_VALUES, STATIONS, TROUBLES
from delfim.parts.mavlink.codec.plans import ALL
from delfim.parts.mavlink.codec.wire import Message, dialect
from delfim.parts.mavlink.table import Mavlink
from delfim.vehicle import sensors
from delfim.vehicle.failsafe.failsafe import Action, bits
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.failsafe.troubles import charge
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.propulsion import thrusters
from delfim.vehicle.state import State

ARRAY: Final = 58  # numbers of a DEBUG_FLOAT_ARRAY
SELDOM: Final = 30  # arrays of a trial to one of the energy
Profile = Literal["lean", "radio", "wifi"]
PROFILES: Final[tuple[Profile, ...]] = ("lean", "radio", "wifi")
COMPONENT: Final = 1

GUIDED: Final = frozenset({Mode.HEADING, Mode.COURSE, Mode.GOTO, Mode.GREX})
BY_HAND: Final = frozenset({Mode.MANUAL, Mode.TRIAL, Mode.IDLE})
NEVER_S: Final = 0.0  # an interval: not at all
_U16, _I16, _I8 = 0xFFFF, 0x7FFF, -1
EACH: Final = 4  # thrusters whose thrust is told one by one
_AHEAD: Final = 500.0  # of pulses between stop and full, us
_STILL: Final = 1500
_FLOAT_MAX: Final = 3.4e38
_SENSORS: Final = (
    dialect.MAV_SYS_STATUS_SENSOR_GPS | dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS | dialect.MAV_SYS_STATUS_SENSOR_BATTERY
)
_BATTERIES: Final = NAMES[Node.BATTERIES_PORT], NAMES[Node.BATTERIES_STARBOARD]


class TelemetryView(NamedTuple):
    """The data that a row is made from."""

    boat: VehicleLoop
    settings: Mavlink
    owner: int  # system that commands; 0: none
    item: Callable[[int], int]  # number of the item that a leg of the mission leads to
    checksum: Callable[[int], int | None]  # of the plans of a type; None: not now
    now_s: float
    turn: int = 0  # how often this peer was told such a message


class TelemetryRow(NamedTuple):
    """A message that comes by itself. Intervals are seconds, NEVER_S for not at all."""

    id: int
    lean_s: float
    radio_s: float
    wifi_s: float
    make: Callable[[TelemetryView], Iterable[Message]]
    fresh: Callable[[TelemetryView], object] | None = None  # sent only when this differs from the last time

    def interval_s(self, profile: Profile) -> float:
        return (self.lean_s, self.radio_s, self.wifi_s)[PROFILES.index(profile)]


def heartbeat(view: TelemetryView) -> Message:
    state = view.boat.state
    mode, base = state.mode, dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    base |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if state.armed else 0
    if mode in BY_HAND:
        base |= dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED if mode is Mode.MANUAL else 0
    else:
        base |= dialect.MAV_MODE_FLAG_GUIDED_ENABLED if mode in GUIDED else dialect.MAV_MODE_FLAG_AUTO_ENABLED
    acting = any(Action[notice.action.upper()] > Action.WARN for notice in state.notices)
    doing = dialect.MAV_STATE_ACTIVE if mode is not Mode.IDLE else dialect.MAV_STATE_STANDBY
    status = dialect.MAV_STATE_CRITICAL if acting else doing
    return dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, autopilot(view), base, shown_mode(view), status, 3)


def shown_mode(view: TelemetryView) -> int:
    """The number of the mode: that of the payload program that has the boat, whatever the boat does for it."""
    state, names = view.boat.state, view.boat.helm.settings.helmsmen
    return PAYLOADS + names.index(state.helmsman) if state.helmsman else int(state.mode)


def autopilot(view: TelemetryView) -> int:
    generic = view.settings.autopilot == "generic"
    return int(dialect.MAV_AUTOPILOT_GENERIC if generic else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)


def position(view: TelemetryView) -> Iterator[Message]:
    n, m = view.boat.state.navigation, view.boat.state.motion
    if n is None or n.latitude_rad is None or n.longitude_rad is None:
        return
    heading = _U16 if n.heading_rad is None else round(math.degrees(compass(n.heading_rad)) * 100) % 36000
    north, east = _clamped(m.north_mps * 100), _clamped(m.east_mps * 100)
    place = _e7(n.latitude_rad), _e7(n.longitude_rad)
    yield dialect.MAVLink_global_position_int_message(_boot_ms(view), *place, 0, 0, north, east, 0, heading)


def attitude(view: TelemetryView) -> Iterator[Message]:
    n = view.boat.state.navigation
    if n is None or n.heading_rad is None:
        return
    angles = n.roll_rad or 0.0, n.pitch_rad or 0.0, wrap(n.heading_rad)
    yield dialect.MAVLink_attitude_message(_boot_ms(view), *angles, 0.0, 0.0, n.yaw_rate_radps or 0.0)


def rpm(view: TelemetryView) -> Iterator[Message]:
    """Means of port, 0, and starboard, 1."""
    boat = view.boat
    for index, measured in enumerate(thrusters.revolutions(boat.helm.settings.thrusters, boat.state)):
        if measured is not None:
            yield dialect.MAVLink_raw_rpm_message(index, measured)


def thrust(view: TelemetryView) -> Iterator[Message]:
    """Thrust in force as servo pulses, 1 port and 3 starboard as ArduRover's skid-steered boats have them: 1000 is full astern,
    1500 stop, 2000 full ahead. 2 is the angle of the first that turns: 1500 in the middle, 2000 the most clockwise. 5 to 8 are
    the thrusters of a boat that has more than two, in the order of its file: 2000 is full along the angle of each."""
    rows, sent = view.boat.helm.settings.thrusters, view.boat.state.actuation
    port, starboard = (_pulse(part) for part in _thrust(view))
    angles = zip(rows, sent.angle_rad, strict=False)
    turned = (_pulse(angle_rad / row.steer.as_told[2]) for row, angle_rad in angles if row.steer is not None)
    parts = sent.thrust if sent.run else (0.0,) * len(rows)
    each = [_pulse(part) for part in parts[:EACH]] if len(rows) > 2 else []
    every = port, next(turned, 0), starboard, 0, *each, *(0,) * (EACH - len(each))
    yield dialect.MAVLink_servo_output_raw_message(_boot_us(view), 0, *every)


def status(view: TelemetryView) -> Iterator[Message]:
    """Health of navigation, propellers and batteries, and whether the boat could leave idle."""
    boat = view.boat
    checks = boat.helm.checks()
    lines = {line.name: line.ok for line in checks}
    health = dialect.MAV_SYS_STATUS_SENSOR_GPS if lines["navigation"] else 0
    health |= dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS if lines["sensors"] else 0
    health |= dialect.MAV_SYS_STATUS_SENSOR_BATTERY if lines["battery"] else 0
    health |= dialect.MAV_SYS_STATUS_PREARM_CHECK if boat.helm.unfit(checks) is None else 0
    near = any(notice.name == "fence" for notice in boat.state.notices)
    health |= 0 if near else dialect.MAV_SYS_STATUS_GEOFENCE  # set without a fence, too: MAVProxy reads 0 as a breach
    present = _SENSORS | dialect.MAV_SYS_STATUS_PREARM_CHECK
    present |= dialect.MAV_SYS_STATUS_GEOFENCE if boat.helm.plans.fence is not None else 0
    least, name = charge(boat.state)
    worst = _batteries(view, name) if name else None
    volts = _U16 if worst is None or worst.voltage_v is None else round(worst.voltage_v * 1000)
    amperes = _I8 if worst is None or worst.current_a is None else round(worst.current_a * 100)
    left = round(least * 100) if name else _I8
    yield dialect.MAVLink_sys_status_message(present, present, health, 0, volts, amperes, left, 0, 0, 0, 0, 0, 0)


def batteries(view: TelemetryView) -> Iterator[Message]:
    for index, node in enumerate(_BATTERIES):
        report = _batteries(view, node)
        if report is None:
            continue
        cells = [_U16 if report.voltage_v is None else round(report.voltage_v * 1000), *[_U16] * 9]
        celsius = _I16 if report.temperature_c is None else report.temperature_c * 100
        amperes = _I8 if report.current_a is None else round(report.current_a * 100)
        left = _I8 if report.charge is None else round(report.charge * 100)
        kind = dialect.MAV_BATTERY_FUNCTION_PROPULSION, dialect.MAV_BATTERY_TYPE_UNKNOWN
        yield dialect.MAVLink_battery_status_message(index, *kind, celsius, cells, amperes, -1, -1, left)


def satellites(view: TelemetryView) -> Iterator[Message]:
    n = view.boat.state.navigation
    if n is None:
        return
    fix = {2: 2, 3: 3, 4: 4, 5: 6, 6: 5}.get(n.fix, 1)  # "no fix", not "no GPS"
    dilution = _U16 if n.hdop is None else round(n.hdop * 100)
    known = n.latitude_rad is not None and n.longitude_rad is not None
    place = (_e7(n.latitude_rad or 0.0), _e7(n.longitude_rad or 0.0)) if known else (0, 0)
    m = view.boat.state.motion
    speed = round(math.hypot(m.north_mps, m.east_mps) * 100) if "velocity" in m.has else _U16
    course = round(math.degrees(compass(math.atan2(m.east_mps, m.north_mps))) * 100) % 36000 if speed != _U16 else _U16
    accuracy_mm = 0 if n.accuracy_m is None else max(round(n.accuracy_m * 1000.0), 1)  # 0: unknown
    yield dialect.MAVLink_gps_raw_int_message(
        n.utc_ns // 1000, fix, *place, 0, dilution, _U16, min(speed, _U16), course, n.satellites, h_acc=accuracy_mm
    )


def head_up(view: TelemetryView) -> Iterator[Message]:
    state = view.boat.state
    n, m = state.navigation, state.motion
    heading = 0 if n is None or n.heading_rad is None else round(math.degrees(compass(n.heading_rad))) % 360
    ahead = max(round(50.0 * sum(_thrust(view))), 0)
    yield dialect.MAVLink_vfr_hud_message(0.0, math.hypot(m.north_mps, m.east_mps), heading, ahead, 0.0, 0.0)


def _kept_rad(state: State) -> float:
    """The heading that control keeps; where it keeps none, as at rest in hold and in a trial, the one that the boat has."""
    wanted_rad = state.reference.heading_rad
    return wanted_rad if wanted_rad is not None else state.motion.heading_rad


def steering(view: TelemetryView) -> Iterator[Message]:
    """Where control is going; only in modes that go somewhere."""
    state, r = view.boat.state, view.boat.state.reference
    if r.heading_rad is None and r.distance_m is None:
        return
    heading = round(math.degrees(wrap(_kept_rad(state))))
    bearing, at = heading if r.course_rad is None else round(math.degrees(wrap(r.course_rad))), state.motion
    if r.north_m is not None and r.east_m is not None:
        bearing = round(math.degrees(math.atan2(r.east_m - at.east_m, r.north_m - at.north_m)))
    distance = min(round(r.distance_m or 0.0), _U16)
    slow = 0.0 if r.speed_mps is None else r.speed_mps - math.hypot(at.north_mps, at.east_mps)
    yield dialect.MAVLink_nav_controller_output_message(0.0, 0.0, heading, bearing, distance, 0.0, slow, r.cross_track_m or 0.0)
    if r.north_m is not None and r.east_m is not None and state.origin is not None:
        there = map(_e7, from_plane(state.origin, r.north_m, r.east_m))
        speed = r.speed_mps or 0.0
        yield dialect.MAVLink_position_target_global_int_message(
            _boot_ms(view), dialect.MAV_FRAME_GLOBAL_INT, _ONLY_PLACE_AND_SPEED, *there, 0.0, speed, 0, 0, 0, 0, 0, 0, 0
        )


_ONLY_PLACE_AND_SPEED: Final = 0x0FF0  # vx is the speed along the way, in m/s


def current(view: TelemetryView) -> Iterator[Message]:
    """MISSION_CURRENT: the item under way, or the one that play would begin with."""
    state = view.boat.state
    plan = state.setpoint.plan
    if plan is None:
        yield dialect.MAVLink_mission_current_message(0, 0, dialect.MISSION_STATE_NO_MISSION)
        return
    playing = state.mode is Mode.PLAY
    done = state.reason.startswith("play done")
    leg = state.reference.leg if playing else state.setpoint.leg
    paused = view.boat.helm.paused
    still = dialect.MISSION_STATE_PAUSED if paused and paused.mode is Mode.PLAY else dialect.MISSION_STATE_NOT_STARTED
    now = dialect.MISSION_STATE_ACTIVE if playing else still
    doing = dialect.MISSION_STATE_COMPLETE if done else now
    yield dialect.MAVLink_mission_current_message(view.item(leg), len(plan.waypoints), doing)


def checksum(view: TelemetryView) -> Iterator[Message]:
    """The checksum of all plans: a console that has other plans reads them again."""
    if (known := view.checksum(ALL)) is not None:
        yield dialect.MAVLink_mission_checksum_message(ALL, known)


def numbers(view: TelemetryView) -> Iterator[Message]:
    yield dialect.MAVLink_named_value_int_message(_boot_ms(view), TROUBLES.encode(), bits(view.boat.state.notices))
    yield dialect.MAVLink_named_value_int_message(_boot_ms(view), b"OWNER", view.owner)
    if (state := view.boat.state).setpoint.plan is not None and state.setpoint.plan.lines:
        yield dialect.MAVLink_named_value_int_message(_boot_ms(view), LINE.encode(), state.reference.line)
    yield from guard(view.boat.state, _boot_ms(view))


def floats(view: TelemetryView) -> Iterator[Message]:
    """The operator's speed in place of the plan's (NaN: none), and the values of sensors and of programs, each with the time
    when it was measured; those of messages of their own, too, because depth and wind need a position or a heading there."""
    boat = view.boat
    speed_mps = boat.state.setpoint.override_mps
    yield dialect.MAVLink_named_value_float_message(_boot_ms(view), b"OVERRIDE", math.nan if speed_mps is None else speed_mps)
    yield from ordered(boat.state, _boot_ms(view))
    names = [(value.told, value.name) for value in sensors.values(boat.helm.settings)]
    programs = boat.helm.settings.table("payload").items()
    names += [(name.encode(), f"{program}.{name}") for program, table in programs for name in table.shown]
    said = set[bytes]()
    for short, name in names:
        told = _young(view, name)
        if told is not None and short not in said:
            said.add(short)
            yield dialect.MAVLink_named_value_float_message(_ms(boat.state.measured[name][1]), short, told)


def depth(view: TelemetryView) -> Iterator[Message]:
    """Where the boat is known to be, as ArduPilot does it."""
    n, depth_m = view.boat.state.navigation, _young(view, "depth_m")
    if n is None or n.latitude_rad is None or n.longitude_rad is None or depth_m is None:
        return
    place, angles = (_e7(n.latitude_rad), _e7(n.longitude_rad), 0.0), (n.roll_rad, n.pitch_rad, n.heading_rad)
    attitude = (math.nan if each is None else wrap(each) for each in angles)
    warmth = _young(view, "water_c")
    yield WaterDepth(_boot_ms(view), 0, 1, *place, *attitude, depth_m, math.nan if warmth is None else warmth)


def wind(view: TelemetryView) -> Iterator[Message]:
    """The true wind, by the heading."""
    n, from_rad, speed_mps = view.boat.state.navigation, _young(view, "wind_true_rad"), _young(view, "wind_true_mps")
    if n is not None and n.heading_rad is not None and from_rad is not None and speed_mps is not None:
        yield Wind(math.degrees(compass(n.heading_rad + from_rad)), speed_mps, 0.0)


def energy(view: TelemetryView) -> Iterator[Message]:
    """DEBUG_FLOAT_ARRAY of the name ENERGY: Wh left, of the way home, of the plan with its way home, of the reserve (NaN: not
    known); then how far the boat gets, m, by direction from north clockwise. Nothing where the boat does not reckon it."""
    now = view.boat.state.energy
    if now is None:
        return
    told = [math.nan if each is None else each for each in (now.left_wh, now.home_wh, now.plan_wh, now.reserve_wh)]
    numbers = [*told, *now.range_m][:ARRAY]
    yield array(view, ENERGY, numbers)


def sensed(view: TelemetryView) -> Iterator[Message]:
    """DEBUG_FLOAT_ARRAY of the name SENSED, with the time unabridged: see SENSED_VALUES. NaN: not heard."""
    state = view.boat.state
    said = {each.name: (view.now_s - each.heard_s, *each.value) for each in state.inputs.get(state.source, ()) if each.heard}
    numbers = [value for name, count in SENSED_VALUES.items() for value in said.get(name, (math.nan,) * (1 + count))]
    if said:
        yield array(view, SENSED, numbers)


def arrays(view: TelemetryView) -> Iterator[Message]:
    """The energy, and stations that are done; in a trial, which asks for it often, what the sensors said, and the others now
    and then."""
    is_trial = view.boat.state.mode is Mode.TRIAL
    if is_trial:
        yield from sensed(view)
    if not is_trial or view.turn % SELDOM == 0:
        yield from energy(view)
        yield from stations(view)


def stations(view: TelemetryView) -> Iterator[Message]:
    """DEBUG_FLOAT_ARRAY of the name STATIONS: waypoints from 1 that have their sample; below 0: that go without one. Of more
    than an array holds, a part each time. Nothing while there are none."""
    state = view.boat.state
    told = [float(number if ok else -number) for number, ok in state.stations] if state.setpoint.plan is not None else []
    parts = [told[at : at + ARRAY] for at in range(0, len(told), ARRAY)]
    if parts:
        yield array(view, STATIONS, parts[view.turn % len(parts)])


def array(view: TelemetryView, name: str, numbers: list[float], number: int = 0) -> Message:
    """DEBUG_FLOAT_ARRAY; `number`: which it is of several."""
    filled = numbers + [0.0] * (ARRAY - len(numbers))
    return dialect.MAVLink_debug_float_array_message(int(view.now_s * 1e6), name.encode(), number, filled)


def others(view: TelemetryView) -> Iterator[Message]:
    """AIS_VESSEL; a part of them each time."""
    return vessels(view.boat.state, view.turn)


def _young(view: TelemetryView, name: str) -> float | None:
    """A value of the sensors, unless it is older than `sensors.stale_s` or none that a message can carry."""
    value, at_s = view.boat.state.measured.get(name, (math.nan, -math.inf))
    is_young = view.now_s - at_s <= view.boat.helm.settings.sensors.stale_s
    return value if is_young and abs(value) < _FLOAT_MAX else None


def all_in_one(view: TelemetryView) -> Iterator[Message]:
    """Everything that matters in 42 bytes. custom0: the owner; custom1, custom2: thrust of port and starboard, %."""
    state = view.boat.state
    n, m, r = state.navigation, state.motion, state.reference
    known = n is not None and n.latitude_rad is not None and n.longitude_rad is not None
    place = (_e7(n.latitude_rad or 0.0), _e7(n.longitude_rad or 0.0)) if n is not None and known else (0, 0)
    heading = 0 if n is None or n.heading_rad is None else round(math.degrees(compass(n.heading_rad)) / 2) % 180
    target = round(math.degrees(compass(_kept_rad(state))) / 2) % 180
    least, name = charge(state)
    left = round(least * 100) if name else _I8
    port, starboard = (round(100 * part) for part in _thrust(view))
    failures = (
        dialect.HL_FAILURE_FLAG_GPS if view.now_s - state.navigation_s > view.boat.helm.settings.navigation.stale_s else 0
    )
    failures |= dialect.HL_FAILURE_FLAG_BATTERY if any(notice.name.startswith("battery") for notice in state.notices) else 0
    failures |= dialect.HL_FAILURE_FLAG_GEOFENCE if any(notice.name == "fence" for notice in state.notices) else 0
    failures |= dialect.HL_FAILURE_FLAG_ENGINE if any(notice.name == "thruster" for notice in state.notices) else 0
    owner_id = view.owner - 256 if view.owner > 127 else view.owner
    speed, wanted = _fifths(math.hypot(m.north_mps, m.east_mps)), _fifths(r.speed_mps or 0.0)
    far, ahead = min(round((r.distance_m or 0.0) / 10), _U16), max(round((port + starboard) / 2), 0)
    kind = dialect.MAV_TYPE_SURFACE_BOAT, autopilot(view), shown_mode(view)
    yield dialect.MAVLink_high_latency2_message(
        _boot_ms(view), *kind, *place, 0, 0, heading, target, far, ahead,
        0, wanted, speed, 0, 0, 0xFF, 0xFF, 0, 0, left, r.leg & 0xFFFF, failures, owner_id, port, starboard,
    )  # fmt: skip


def _measured(view: TelemetryView) -> object:
    return view.boat.state.cycles


def _sounded(view: TelemetryView) -> object:
    return view.boat.state.measured.get("depth_m")


def _blown(view: TelemetryView) -> object:
    return view.boat.state.measured.get("wind_true_mps")


def _reported(view: TelemetryView) -> object:
    return tuple(report.heard_s for report in view.boat.state.thrusters.values())


# Intervals in seconds: lean, radio, wifi.
ROWS: Final = (
    TelemetryRow(dialect.MAVLINK_MSG_ID_HEARTBEAT, 1.0, 1.0, 1.0, lambda view: (heartbeat(view),)),
    TelemetryRow(dialect.MAVLINK_MSG_ID_HIGH_LATENCY2, 1.0, NEVER_S, NEVER_S, all_in_one),
    TelemetryRow(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, NEVER_S, 1.0, 0.1, position, _measured),
    TelemetryRow(dialect.MAVLINK_MSG_ID_ATTITUDE, NEVER_S, 1.0, 0.1, attitude, _measured),
    TelemetryRow(dialect.MAVLINK_MSG_ID_RAW_RPM, NEVER_S, 1.0, 0.1, rpm, _reported),
    TelemetryRow(dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, NEVER_S, 1.0, 0.2, thrust),
    TelemetryRow(dialect.MAVLINK_MSG_ID_SYS_STATUS, NEVER_S, 1.0, 1.0, status),
    TelemetryRow(dialect.MAVLINK_MSG_ID_VFR_HUD, NEVER_S, 1.0, 0.5, head_up, _measured),
    TelemetryRow(dialect.MAVLINK_MSG_ID_GPS_RAW_INT, NEVER_S, 1.0, 1.0, satellites, _measured),
    TelemetryRow(dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT, NEVER_S, 1.0, 0.5, steering),
    TelemetryRow(dialect.MAVLINK_MSG_ID_MISSION_CURRENT, NEVER_S, 1.0, 1.0, current),
    TelemetryRow(dialect.MAVLINK_MSG_ID_MISSION_CHECKSUM, 5.0, 5.0, 5.0, checksum),
    TelemetryRow(dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT, NEVER_S, 5.0, 1.0, numbers),
    TelemetryRow(dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, NEVER_S, 5.0, 1.0, floats),
    TelemetryRow(WaterDepth.id, NEVER_S, 1.0, 0.5, depth, _sounded),
    TelemetryRow(Wind.id, NEVER_S, 5.0, 1.0, wind, _blown),
    TelemetryRow(dialect.MAVLINK_MSG_ID_AIS_VESSEL, NEVER_S, 1.0, 0.25, others),
    TelemetryRow(dialect.MAVLINK_MSG_ID_BATTERY_STATUS, NEVER_S, 5.0, 1.0, batteries),
    TelemetryRow(dialect.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, NEVER_S, 15.0, 3.0, arrays),
)


def _pulse(part: float) -> int:
    return _STILL + round(_AHEAD * part)


def _thrust(view: TelemetryView) -> tuple[float, float]:
    """Thrust in force of port and starboard, as a fraction of the maximum: -1..1."""
    return thrusters.thrust(view.boat.helm.settings.thrusters, view.boat.state)


def _batteries(view: TelemetryView, name: str) -> BatteriesStatus | None:
    report = view.boat.state.sysstat.get(name)
    return report[0] if report is not None and isinstance(report[0], BatteriesStatus) else None


def _boot_ms(view: TelemetryView) -> int:
    return _ms(view.now_s)


def _ms(time_s: float) -> int:
    return int(time_s * 1e3) & 0xFFFFFFFF


def _boot_us(view: TelemetryView) -> int:
    return int(view.now_s * 1e6) & 0xFFFFFFFF


def _e7(angle_rad: float) -> int:
    return round(math.degrees(angle_rad) * 1e7)


def _clamped(value: float) -> int:
    return max(min(round(value), _I16), -_I16)


def _fifths(speed_mps: float) -> int:
    return max(min(round(speed_mps * 5), 0xFF), 0)
