"""The fields of the state log's record of a cycle: one row a field, in the order of the record. SI units; NaN is unknown."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from delfim import config
from delfim.canproxy.dsor.messages import BatteriesStatus, Node
from delfim.vehicle import sensors
from delfim.vehicle.failsafe import bits
from delfim.vehicle.nodehealth import NAMES
from delfim.vehicle.state import State

NAN = math.nan


class Field(NamedTuple):
    name: str
    code: str  # of the struct module
    unit: str
    description: str
    value: Callable[[State, float], object]


def _of_navigation(name: str) -> Callable[[State, float], object]:
    def value(s: State, now_s: float) -> object:
        known = getattr(s.navigation, name, None)
        return NAN if known is None else known

    return value


def _source(names: tuple[str, ...]) -> Callable[[State, float], object]:
    return lambda s, now_s: names.index(s.source) if s.source else 0


def _heard(payload: str) -> Callable[[State, float], object]:
    return lambda s, now_s: s.payloads_s.get(payload, -1e9)


def _helmsman(names: tuple[str, ...]) -> Callable[[State, float], object]:
    return lambda s, now_s: names.index(s.helmsman) + 1 if s.helmsman else 0


def _of_reference(name: str) -> Callable[[State, float], object]:
    def value(s: State, now_s: float) -> object:
        known = getattr(s.reference, name)
        return NAN if known is None else known

    return value


def _of_thruster(row: str, name: str) -> Callable[[State, float], object]:
    def value(s: State, now_s: float) -> object:
        known = getattr(s.thrusters.get(row), name, None)
        return NAN if known is None else known

    return value


def _sent(index: int, times: float = 1.0) -> Callable[[State, float], object]:
    return lambda s, now_s: s.actuation.thrust[index] * times if s.actuation.thrust else NAN


def _turned(index: int) -> Callable[[State, float], object]:
    return lambda s, now_s: s.actuation.angle_rad[index] if s.actuation.angle_rad else NAN


def _of_batteries(node: Node, name: str) -> Callable[[State, float], object]:
    def value(s: State, now_s: float) -> object:
        report = s.sysstat.get(NAMES[node])
        known = getattr(report[0], name) if report and isinstance(report[0], BatteriesStatus) else None
        return NAN if known is None else known

    return value


def _measured(name: str, stale_s: float) -> Callable[[State, float], object]:
    def value(s: State, now_s: float) -> object:
        known, at_s = s.measured.get(name, (NAN, now_s))
        return known if now_s - at_s <= stale_s else NAN

    return value


def _known(value: float | None) -> float:
    return NAN if value is None else value


def _ordered(name: str) -> Callable[[State, float], object]:
    return lambda s, now_s: NAN if s.traffic.order is None else getattr(s.traffic.order, name)


def _nearness(s: State, now_s: float) -> float:
    return s.traffic.nearness


def _stage(name: str) -> Field:
    return Field(name, "q", "ns", f"profile stamp {name}, wall clock since 1970", lambda s, now_s: getattr(s.profile, name))


FIELDS = (
    Field("monotonic_s", "d", "s", "time since boot", lambda s, now_s: now_s),
    Field("utc_ns", "q", "ns", "of the navigation message", lambda s, now_s: s.navigation.utc_ns if s.navigation else 0),
    *(_stage(name) for name in ("t0", "t1", "t2", "t3", "t4")),
    Field("previous_t5", "q", "ns", "profile stamp t5 of the cycle before", lambda s, now_s: s.profile.t5),
    Field("cycle", "Q", "", "navigation cycles since start", lambda s, now_s: s.cycles),
    Field("mode", "B", "", "mode number of the console's link", lambda s, now_s: int(s.mode)),
    Field("troubles", "I", "", "bit n: trouble n of docs/failsafe.md", lambda s, now_s: bits(s.notices)),
    Field("latitude", "d", "rad", "WGS 84", _of_navigation("latitude_rad")),
    Field("longitude", "d", "rad", "WGS 84", _of_navigation("longitude_rad")),
    Field("north", "d", "m", "local plane", lambda s, now_s: s.motion.north_m if "position" in s.motion.has else NAN),
    Field("east", "d", "m", "local plane", lambda s, now_s: s.motion.east_m if "position" in s.motion.has else NAN),
    Field("north_speed", "f", "m/s", "over ground", _of_navigation("north_mps")),
    Field("east_speed", "f", "m/s", "over ground", _of_navigation("east_mps")),
    Field("heading", "f", "rad", "true", _of_navigation("heading_rad")),
    Field("yaw_rate", "f", "rad/s", "positive to starboard", _of_navigation("yaw_rate_radps")),
    Field("roll", "f", "rad", "positive to starboard", _of_navigation("roll_rad")),
    Field("pitch", "f", "rad", "positive bow up", _of_navigation("pitch_rad")),
    Field(
        "fix", "B", "", "0 none, 4 differential, 5 RTK, 6 RTK float", lambda s, now_s: s.navigation.fix if s.navigation else 0
    ),
    Field("satellites", "B", "", "in use", lambda s, now_s: s.navigation.satellites if s.navigation else 0),
    Field("accuracy", "f", "m", "of the position, as the receiver states it", _of_navigation("accuracy_m")),
    Field("corrections_age", "f", "s", "of the receiver's last correction", _of_navigation("corrections_s")),
    Field("reference_heading", "f", "rad", "heading set point of control", _of_reference("heading_rad")),
    Field("reference_speed", "f", "m/s", "speed set point of control", _of_reference("speed_mps")),
    Field("cross_track", "f", "m", "positive: boat to starboard of the line", _of_reference("cross_track_m")),
    Field("distance", "f", "m", "to the point steered for", _of_reference("distance_m")),
    Field("leg", "H", "", "leg of the mission", lambda s, now_s: s.reference.leg & 0xFFFF),
    Field("run", "?", "", "thrusters enabled", lambda s, now_s: s.actuation.run),
    Field("starboard_voltage", "f", "V", "batteries", _of_batteries(Node.BATTERIES_STARBOARD, "voltage_v")),
    Field("port_voltage", "f", "V", "batteries", _of_batteries(Node.BATTERIES_PORT, "voltage_v")),
    Field("starboard_charge", "f", "", "batteries, 0..1", _of_batteries(Node.BATTERIES_STARBOARD, "charge")),
    Field("port_charge", "f", "", "batteries, 0..1", _of_batteries(Node.BATTERIES_PORT, "charge")),
    Field("vessels", "H", "", "other vessels that are known, lost ones too", lambda s, now_s: len(s.traffic.targets)),
    Field("order_course", "f", "rad", "over ground, to keep clear of others; nan: there is none", _ordered("course_rad")),
    Field("order_speed", "f", "m/s", "the same", _ordered("speed_mps")),
    Field("nearness", "f", "", "least to come to another vessel, in domains: 1 is the edge", _nearness),
    # With the black box and the commands in the sidecar, these suffice to replay the cycle bit by bit.
    Field("console_s", "d", "s", "time since boot of the console's last word", lambda s, now_s: s.console_s),
    Field("guest_s", "d", "s", "time since boot of the guest's last reference", lambda s, now_s: s.guest_s),
    Field("guest_heading", "d", "rad", "last asked for by the guest", lambda s, now_s: _known(s.setpoint.guest_heading_rad)),
    Field("guest_speed", "d", "m/s", "last asked for by the guest", lambda s, now_s: s.setpoint.guest_speed_mps),
    Field("watchdog_s", "d", "s", "time since boot when the watchdog looked last", lambda s, now_s: s.watchdog_s),
)


def fields(settings: config.Vehicle) -> tuple[Field, ...]:
    """The fields of every boat, then those of this boat's payload programs that may have it, of its sources, where there are
    several, of its thrusters and sensors."""
    stale_s, sources = settings.sensors.stale_s, settings.navigation.sources
    source = Field(
        "source", "B", "", "of navigation: its place in navigation.sources", lambda s, now_s: sources.index(s.source)
    )
    thrusters = tuple(each for index, row in enumerate(settings.thrusters) for each in _of_row(settings, index, row))
    measured = [
        Field(each.name, "d", each.unit, each.description, _measured(each.name, stale_s)) for each in sensors.values(settings)
    ]
    payloads = [
        Field(f"payload_{name}_s", "d", "s", f"time since boot of the last word of payload {name}", _heard(name))
        for name in settings.helmsmen
    ]
    if payloads:
        helmsman = "payload program that has the boat, by its place in the vehicle's file, from 1; 0: none"
        payloads.append(Field("helmsman", "B", "", helmsman, _helmsman(settings.helmsmen)))
    return (*FIELDS, *payloads, *([source] if len(sources) > 1 else []), *thrusters, *measured)


def _of_row(settings: config.Vehicle, index: int, row: config.ThrusterTable) -> Iterator[Field]:
    name, rpm_max = row.name, settings.rpm_max(row)
    yield Field(f"{name}_command", "f", "", "commanded, -1..1 of full command", _sent(index))
    if rpm_max:
        yield Field(f"{name}_rpm", "f", "1/min", "commanded", _sent(index, rpm_max))
    yield Field(f"{name}_rpm_measured", "f", "1/min", "reported", _of_thruster(name, "rpm"))
    yield Field(f"{name}_current", "f", "A", "reported", _of_thruster(name, "current_a"))
    if row.steer is not None:
        yield Field(f"{name}_angle", "f", "rad", "commanded, from its own direction, clockwise", _turned(index))
        yield Field(f"{name}_angle_measured", "f", "rad", "reported", _of_thruster(name, "angle_rad"))


def values(fields: tuple[Field, ...], state: State, now_s: float) -> tuple[object, ...]:
    """The record of this cycle, in the order of the fields."""
    return tuple([field.value(state, now_s) for field in fields])
