"""The fields of the state log's record of a cycle: one row a field, in the order of the record. SI units; NaN is unknown.

The rows stand in groups, each beside the function that gives its values in the same order: a record is made in every cycle,
and a function for each of some fifty fields took a tenth of it.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Navigation, Node, Status
from delfim.vehicle import sensors
from delfim.vehicle.failsafe.failsafe import bits
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.state import State, ThrusterReport

NAN = math.nan
Values = Callable[[State, float], Sequence[float]]


class Field(NamedTuple):
    name: str
    code: str  # of the struct module
    unit: str
    description: str


class Group(NamedTuple):
    fields: tuple[Field, ...]
    values: Values


class Record(NamedTuple):
    """The fields of a boat, and what gives their values."""

    fields: tuple[Field, ...]
    groups: tuple[Values, ...]


_NO_NAVIGATION: Final = Navigation(0, *(None,) * 8, fix=0, satellites=0, hdop=None, counter=0)
_NO_REPORT: Final = ThrusterReport(0.0)
_NO_BATTERIES: Final = BatteriesStatus(Status.GOOD, Fault(0), None, None, None, None), 0.0
_STARBOARD, _PORT = NAMES[Node.BATTERIES_STARBOARD], NAMES[Node.BATTERIES_PORT]


def _cycle(s: State, now_s: float) -> Sequence[float]:
    p = s.profile
    utc_ns = s.navigation.utc_ns if s.navigation else 0
    return now_s, utc_ns, p.t0, p.t1, p.t2, p.t3, p.t4, p.t5, s.cycles, s.mode.value, bits(s.notices)


_CYCLE = (
    Field("monotonic_s", "d", "s", "time since boot"),
    Field("utc_ns", "q", "ns", "of the navigation message"),
    *(Field(name, "q", "ns", f"profile stamp {name}, wall clock since 1970") for name in ("t0", "t1", "t2", "t3", "t4")),
    Field("previous_t5", "q", "ns", "profile stamp t5 of the cycle before"),
    Field("cycle", "Q", "", "navigation cycles since start"),
    Field("mode", "B", "", "mode number of the console's link"),
    Field("troubles", "I", "", "bit n: trouble n of docs/failsafe.md"),
)


def _navigation(s: State, now_s: float) -> Sequence[float]:
    n, m = s.navigation or _NO_NAVIGATION, s.motion
    place = (m.north_m, m.east_m) if "position" in m.has else (NAN, NAN)
    moving = n.north_mps, n.east_mps, n.heading_rad, n.yaw_rate_radps, n.roll_rad, n.pitch_rad
    return _known((n.latitude_rad, n.longitude_rad, *place, *moving, n.fix, n.satellites, n.accuracy_m, n.corrections_s))


_NAVIGATION = (
    Field("latitude", "d", "rad", "WGS 84"),
    Field("longitude", "d", "rad", "WGS 84"),
    Field("north", "d", "m", "local plane"),
    Field("east", "d", "m", "local plane"),
    Field("north_speed", "f", "m/s", "over ground"),
    Field("east_speed", "f", "m/s", "over ground"),
    Field("heading", "f", "rad", "true"),
    Field("yaw_rate", "f", "rad/s", "positive to starboard"),
    Field("roll", "f", "rad", "positive to starboard"),
    Field("pitch", "f", "rad", "positive bow up"),
    Field("fix", "B", "", "0 none, 4 differential, 5 RTK, 6 RTK float"),
    Field("satellites", "B", "", "in use"),
    Field("accuracy", "f", "m", "of the position, as the receiver states it"),
    Field("corrections_age", "f", "s", "of the receiver's last correction"),
)


def _control(s: State, now_s: float) -> Sequence[float]:
    r = s.reference
    return _known((r.heading_rad, r.speed_mps, r.cross_track_m, r.distance_m, r.leg & 0xFFFF, r.line, s.actuation.run))


_CONTROL = (
    Field("reference_heading", "f", "rad", "heading set point of control"),
    Field("reference_speed", "f", "m/s", "speed set point of control"),
    Field("cross_track", "f", "m", "positive: boat to starboard of the line"),
    Field("distance", "f", "m", "to the point steered for"),
    Field("leg", "H", "", "leg of the mission"),
    Field("line", "H", "", "line of the survey that the boat is on; 0: none"),
    Field("run", "?", "", "thrusters enabled"),
)


def _batteries(s: State, now_s: float) -> Sequence[float]:
    starboard, port = s.sysstat.get(_STARBOARD, _NO_BATTERIES)[0], s.sysstat.get(_PORT, _NO_BATTERIES)[0]
    if not isinstance(starboard, BatteriesStatus):
        starboard = _NO_BATTERIES[0]
    if not isinstance(port, BatteriesStatus):
        port = _NO_BATTERIES[0]
    return _known((starboard.voltage_v, port.voltage_v, starboard.charge, port.charge))


_BATTERIES = (
    Field("starboard_voltage", "f", "V", "batteries"),
    Field("port_voltage", "f", "V", "batteries"),
    Field("starboard_charge", "f", "", "batteries, 0..1"),
    Field("port_charge", "f", "", "batteries, 0..1"),
)


def _traffic(s: State, now_s: float) -> Sequence[float]:
    t = s.traffic
    return len(t.targets), *((NAN, NAN) if t.order is None else (t.order.course_rad, t.order.speed_mps)), t.nearness


_TRAFFIC = (
    Field("vessels", "H", "", "other vessels that are known, lost ones too"),
    Field("order_course", "f", "rad", "over ground, to keep clear of others; nan: there is none"),
    Field("order_speed", "f", "m/s", "the same"),
    Field("nearness", "f", "", "least to come to another vessel, in domains: 1 is the edge"),
)


def _replay(s: State, now_s: float) -> Sequence[float]:
    return _known((s.console_s, s.guest_s, s.setpoint.guest_heading_rad, s.setpoint.guest_speed_mps, s.watchdog_s))


_REPLAY = (  # with the black box and the commands in the sidecar, these suffice to replay the cycle bit by bit
    Field("console_s", "d", "s", "time since boot of the console's last word"),
    Field("guest_s", "d", "s", "time since boot of the guest's last reference"),
    Field("guest_heading", "d", "rad", "last asked for by the guest"),
    Field("guest_speed", "d", "m/s", "last asked for by the guest"),
    Field("watchdog_s", "d", "s", "time since boot when the watchdog looked last"),
)

GROUPS: Final = (
    Group(_CYCLE, _cycle),
    Group(_NAVIGATION, _navigation),
    Group(_CONTROL, _control),
    Group(_BATTERIES, _batteries),
    Group(_TRAFFIC, _traffic),
    Group(_REPLAY, _replay),
)


def of(settings: config.Vehicle) -> Record:
    """The record of a boat: the fields of every boat, then those of this boat's payload programs that may have it, of its
    sources, where there are several, of its thrusters and sensors."""
    groups = *GROUPS, *_of_payloads(settings), *_of_sources(settings), *_of_thrusters(settings), _of_sensors(settings)
    return Record(tuple(field for group in groups for field in group.fields), tuple(group.values for group in groups))


def values(record: Record, state: State, now_s: float) -> list[float]:
    """The record of this cycle, in the order of the fields."""
    found: list[float] = []
    for of_group in record.groups:
        found += of_group(state, now_s)
    return found


def _known(values: Iterable[float | None], nan: float = NAN) -> list[float]:
    return [nan if value is None else value for value in values]


def _of_payloads(settings: config.Vehicle) -> Iterator[Group]:
    names = settings.helmsmen
    if not names:
        return

    def heard(s: State, now_s: float) -> Sequence[float]:
        return *[s.payloads_s.get(name, -1e9) for name in names], names.index(s.helmsman) + 1 if s.helmsman else 0

    fields = [Field(f"payload_{name}_s", "d", "s", f"time since boot of the last word of payload {name}") for name in names]
    helmsman = "payload program that has the boat, by its place in the vehicle's file, from 1; 0: none"
    yield Group((*fields, Field("helmsman", "B", "", helmsman)), heard)


def _of_sources(settings: config.Vehicle) -> Iterator[Group]:
    names = settings.navigation.sources
    if len(names) > 1:
        place = Field("source", "B", "", "of navigation: its place in navigation.sources")
        yield Group((place,), lambda s, now_s: (names.index(s.source) if s.source else 0,))


def _of_sensors(settings: config.Vehicle) -> Group:
    told, stale_s = sensors.values(settings), settings.sensors.stale_s
    names = [each.name for each in told]

    def measured(s: State, now_s: float) -> Sequence[float]:
        fresh = [s.measured.get(name, (NAN, now_s)) for name in names]
        return tuple([value if now_s - at_s <= stale_s else NAN for value, at_s in fresh])

    return Group(tuple(Field(each.name, "d", each.unit, each.description) for each in told), measured)


def _of_thrusters(settings: config.Vehicle) -> Iterator[Group]:
    for index, row in enumerate(settings.thrusters):
        yield _of_row(index, row.name, settings.rpm_max(row), row.steer is not None)


def _of_row(index: int, name: str, rpm_max: float, turns: bool) -> Group:
    def told(s: State, now_s: float) -> Sequence[float]:
        report, sent = s.thrusters.get(name, _NO_REPORT), s.actuation
        thrust = sent.thrust[index] if sent.thrust else NAN
        command = (thrust, thrust * rpm_max) if rpm_max else (thrust,)
        if not turns:
            return _known((*command, report.rpm, report.current_a))
        angle_rad = sent.angle_rad[index] if sent.angle_rad else NAN
        return _known((*command, report.rpm, report.current_a, angle_rad, report.angle_rad))

    return Group(tuple(_row_fields(name, rpm_max, turns)), told)


def _row_fields(name: str, rpm_max: float, turns: bool) -> Iterator[Field]:
    yield Field(f"{name}_command", "f", "", "commanded, -1..1 of full command")
    if rpm_max:
        yield Field(f"{name}_rpm", "f", "1/min", "commanded")
    yield Field(f"{name}_rpm_measured", "f", "1/min", "reported")
    yield Field(f"{name}_current", "f", "A", "reported")
    if turns:
        yield Field(f"{name}_angle", "f", "rad", "commanded, from its own direction, clockwise")
        yield Field(f"{name}_angle_measured", "f", "rad", "reported")
