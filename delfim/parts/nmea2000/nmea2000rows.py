"""The vehicle's state as NMEA 2000 messages: one row a PGN (docs/nmea2000.md). Unknown and old values are not sent."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from delfim import config
from delfim.base.geodesy import origin, to_plane
from delfim.base.parts import Part
from delfim.canproxy.nmea2000 import ownpgns, parcels, pgns
from delfim.vehicle.failsafe.troubles import NUMBERS
from delfim.vehicle.report import BoatReport, ThrusterFacts

COURSE_MPS: Final = 0.1  # a slower boat has no course over ground
_METHODS: Final = {2: 1, 3: 1, 4: 2, 5: 4, 6: 5}  # of PGN 129029, by `Navigation.fix`


class Telling(NamedTuple):
    """A state, with what else its messages need."""

    state: BoatReport
    settings: config.Vehicle
    alerts: "Alerts"


Said = tuple[int, bytes, int]  # PGN, data, priority


class Row(NamedTuple):
    pgn: int
    period_s: float  # of the standard
    make: Callable[[Telling], Iterable[Said]]
    of_navigation: bool = False  # told when navigation is new, and not while it is silent


def position(t: Telling) -> Iterable[Said]:
    s = t.state
    if s.latitude_deg is not None and s.longitude_deg is not None and s.fix:
        yield pgns.pack(pgns.PositionRapid(math.radians(s.latitude_deg), math.radians(s.longitude_deg)))


def gnss(t: Telling) -> Iterable[Said]:
    s = t.state
    if s.latitude_deg is not None and s.longitude_deg is not None and s.fix:
        place = math.radians(s.latitude_deg), math.radians(s.longitude_deg)
        yield pgns.pack(pgns.GnssPosition(s.utc_ns or None, *place, _METHODS.get(s.fix), s.satellites, s.hdop))


def time(t: Telling) -> Iterable[Said]:
    """UTC: navigation's time, carried on to now."""
    if t.state.utc_ns:
        yield pgns.pack(pgns.SystemTime(t.state.utc_ns + round((t.state.age_s.get("navigation") or 0.0) * 1e9)))


def course(t: Telling) -> Iterable[Said]:
    s = t.state
    if s.speed_mps is not None:
        known = s.course_deg if s.speed_mps >= COURSE_MPS else None
        yield pgns.pack(pgns.CourseSpeed(pgns.NorthReference.TRUE, _radians(known), s.speed_mps))


def heading(t: Telling) -> Iterable[Said]:
    if t.state.heading_deg is not None:
        yield pgns.pack(pgns.VesselHeading(math.radians(t.state.heading_deg), None, None, pgns.NorthReference.TRUE))


def turn(t: Telling) -> Iterable[Said]:
    if t.state.turn_dps is not None:
        yield pgns.pack(pgns.RateOfTurn(math.radians(t.state.turn_dps)))


def attitude(t: Telling) -> Iterable[Said]:
    s = t.state
    if s.pitch_deg is not None or s.roll_deg is not None:
        yield pgns.pack(pgns.Attitude(None, _radians(s.pitch_deg), _radians(s.roll_deg)))


def rudder(t: Telling) -> Iterable[Said]:
    """The message of thrusters that turn. At the stern, a push to starboard turns the bow to port."""
    for instance, (row, facts) in enumerate(_thrusters(t)):
        if row.steer is not None and facts.angle_deg is not None:
            sign = -1.0 if row.x_m < 0.0 else 1.0
            angle, order = (None if each is None else sign * math.radians(each) for each in (facts.turned_deg, facts.angle_deg))
            yield parcels.RUDDER, ownpgns.rudder(instance, angle if _is_fresh(t, facts) else None, order), 2


def engine_rapid(t: Telling) -> Iterable[Said]:
    for instance, (_, facts) in enumerate(_thrusters(t)):
        if facts.rpm is not None and _is_fresh(t, facts):
            yield parcels.ENGINE_RAPID, ownpgns.engine_rapid(instance, facts.rpm), 2


def engine(t: Telling) -> Iterable[Said]:
    for instance, (_, facts) in enumerate(_thrusters(t)):
        if facts.temperature_c is not None and _is_fresh(t, facts):
            yield parcels.ENGINE, ownpgns.engine(instance, facts.temperature_c), 2


def battery(t: Telling) -> Iterable[Said]:
    for instance, name in enumerate(_batteries(t)):
        node = t.state.sysstat[name]
        current_a = None if node.current_a is None else -node.current_a  # positive is discharging here, and charging there
        yield parcels.BATTERY, ownpgns.battery(instance, node.voltage_v, current_a, node.temperature_c), 6


def charge(t: Telling) -> Iterable[Said]:
    for instance, name in enumerate(_batteries(t)):
        if (known := t.state.sysstat[name].charge) is not None:
            yield parcels.DC_STATUS, ownpgns.dc_status(instance, known), 6


def cross_track(t: Telling) -> Iterable[Said]:
    if t.state.reference.cross_track_m is not None:
        yield parcels.CROSS_TRACK, ownpgns.cross_track(t.state.reference.cross_track_m), 3


def route(t: Telling) -> Iterable[Said]:
    """The message of the waypoint that the boat steers for."""
    s, r = t.state, t.state.reference
    if r.latitude_deg is None or r.longitude_deg is None or s.latitude_deg is None or s.longitude_deg is None:
        return
    here = origin(math.radians(s.latitude_deg), math.radians(s.longitude_deg))
    north_m, east_m = to_plane(here, math.radians(r.latitude_deg), math.radians(r.longitude_deg))
    bearing, closing = math.atan2(east_m, north_m), None
    if s.speed_mps is not None and s.course_deg is not None:
        closing = s.speed_mps * math.cos(math.radians(s.course_deg) - bearing)
    place = r.latitude_deg, r.longitude_deg
    yield parcels.ROUTE, ownpgns.route(r.distance_m, bearing, r.leg, *place, closing), 3


def alert(t: Telling) -> Iterable[Said]:
    yield from ((pgn, data, 2) for pgn, data in t.alerts.messages(t.state))


TOLD: Final[dict[str, tuple[Row, ...]]] = {
    "position": (
        Row(pgns.POSITION_RAPID, 0.1, position, True),
        Row(pgns.GNSS_POSITION, 1.0, gnss, True),
        Row(pgns.SYSTEM_TIME, 1.0, time, True),
    ),
    "course": (Row(pgns.COURSE_SPEED_RAPID, 0.25, course, True),),
    "heading": (Row(pgns.HEADING, 0.1, heading, True),),
    "turn": (Row(pgns.RATE_OF_TURN, 0.1, turn, True),),
    "attitude": (Row(pgns.ATTITUDE, 1.0, attitude, True),),
    "rudder": (Row(parcels.RUDDER, 0.1, rudder),),
    "engine": (Row(parcels.ENGINE_RAPID, 0.1, engine_rapid), Row(parcels.ENGINE, 0.5, engine)),
    "battery": (Row(parcels.BATTERY, 1.5, battery), Row(parcels.DC_STATUS, 1.5, charge)),
    "route": (Row(parcels.CROSS_TRACK, 1.0, cross_track, True), Row(parcels.ROUTE, 1.0, route, True)),
    "alerts": (Row(parcels.ALERT, 1.0, alert),),
}


def pgns_of(names: Iterable[str]) -> tuple[int, ...]:
    """The PGNs of these words of `nmea2000.send`."""
    own = tuple(row.pgn for name in names for row in TOLD[name])
    return own + ((parcels.ALERT_TEXT,) if parcels.ALERT in own else ())


class Alerts:
    """Troubles as alerts: each time that a trouble begins is an occurrence, and its end is sent once."""

    def __init__(self, name: int, aboard: Sequence[Part] = ()) -> None:
        self._name, self._numbers = name, NUMBERS | {row.name: row.number for part in aboard for row in part.troubles}
        self._present: dict[str, int] = {}  # kind of each
        self._occurrences: dict[str, int] = {}

    def messages(self, state: BoatReport) -> Iterable[tuple[int, bytes]]:
        """PGN and data of the troubles that are present, with their words, and of those that have ended."""
        now = {each.name: each for each in state.notices if each.name in self._numbers}
        for name in self._present.keys() - now.keys():
            yield parcels.ALERT, self._alert(name, self._present.pop(name), ownpgns.NORMAL)
        for name, notice in now.items():
            if name not in self._present:
                self._occurrences[name] = self._occurrences.get(name, 0) % 250 + 1
            kind = self._present[name] = ownpgns.WARNING if notice.action == "warn" else ownpgns.ALARM
            yield parcels.ALERT, self._alert(name, kind, ownpgns.ACTIVE)
            number, occurrence = self._numbers[name], self._occurrences[name]
            yield parcels.ALERT_TEXT, ownpgns.alert_text(number, kind, occurrence, self._name, notice.reason)

    def _alert(self, name: str, kind: int, state: int) -> bytes:
        return ownpgns.alert(self._numbers[name], kind, state, self._occurrences[name], self._name)


def _thrusters(t: Telling) -> list[tuple[config.ThrusterTable, ThrusterFacts]]:
    return [(row, t.state.thrusters.get(row.name, _NOTHING)) for row in t.settings.thrusters]


_NOTHING: Final = ThrusterFacts()


def _is_fresh(t: Telling, facts: ThrusterFacts) -> bool:
    return facts.age_s is not None and facts.age_s <= t.settings.sysstat.stale_s


def _batteries(t: Telling) -> list[str]:
    """The nodes with batteries that are heard at present."""
    names = [name for name in t.state.sysstat if name.startswith("batteries_")]
    return [name for name in sorted(names) if (t.state.age_s.get(name) or 0.0) <= t.settings.sysstat.stale_s]


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)
