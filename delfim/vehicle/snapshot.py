"""The boat's report, filled from its state: degrees, words, and the age of every input. Finite, bounded, ready for JSON."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec

from delfim.base.geodesy import compass, from_plane
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import Fault, SystemStatus
from delfim.config import ThrusterTable
from delfim.vehicle.propulsion import thrusters
from delfim.vehicle.report import KillFacts, LocalReference, LocalReport, NodeFacts, NoticeFacts, Service
from delfim.vehicle.state import State

_TYPES: Final[dict[str, Any]] = {"services": dict[str, Service], "deadman": dict[str, Any]}
_encode: Final = msgspec.json.Encoder().encode


def report(state: State, now_s: float, rows: Sequence[ThrusterTable] = (), **more: Any) -> LocalReport:
    """The report of a state. `rows`: the thrusters that it names; `more`: fields that the state has not."""
    n, m, plan = state.navigation, state.motion, state.setpoint.plan
    return LocalReport(
        mode=state.mode.name.lower(),
        reason=state.reason,
        armed=state.armed,
        operator=state.operator,
        helmsman=state.helmsman,
        resting=tuple(sorted(state.resting)),
        cycle=state.cycles,
        utc_ns=n.utc_ns if n else 0,
        source=state.source,
        latitude_deg=_degrees(n.latitude_rad) if n else None,
        longitude_deg=_degrees(n.longitude_rad) if n else None,
        heading_deg=_compass_degrees(n.heading_rad) if n else None,
        course_deg=_compass_degrees(math.atan2(m.east_mps, m.north_mps)) if "velocity" in m.has else None,
        speed_mps=round(math.hypot(m.north_mps, m.east_mps), 3) if "velocity" in m.has else None,
        turn_dps=_degrees(n.yaw_rate_radps) if n else None,
        roll_deg=_degrees(n.roll_rad) if n else None,
        pitch_deg=_degrees(n.pitch_rad) if n else None,
        fix=n.fix if n else 0,
        satellites=n.satellites if n else 0,
        hdop=n.hdop if n else None,
        accuracy_m=_rounded(n.accuracy_m, 3) if n else None,
        corrections_s=n.corrections_s if n else None,
        thrusters=thrusters.facts(rows, state, now_s),
        run=state.actuation.run,
        reference=_reference(state),
        mission=plan.name if plan else None,
        legs=len(plan.waypoints) if plan else 0,
        announced=state.announced,
        sample=state.sample,
        guest_connected=state.guest_connected,
        killed=KillFacts(**state.killed._asdict()),
        handset=state.handset,
        heard=_heard(state, now_s) if state.mode is Mode.TRIAL else {},
        energy=state.energy,
        age_s=_ages(state, now_s),
        measured={name: value for name, (value, _) in state.measured.items()},
        sysstat={name: _node(told) for name, (told, _) in state.sysstat.items()},
        clock=state.computer.clock,
        notices=tuple(
            [NoticeFacts(name=n.name, reason=n.reason, age_s=_age(now_s, n.since_s), action=n.action) for n in state.notices]
        ),
        counts=state.counts.copy(),
        parts={name: msgspec.structs.replace(health) for name, health in state.parts.items()} if state.parts else {},
        **more,
    )


def _heard(state: State, now_s: float) -> dict[str, tuple[float, ...]]:
    """What the sensors behind the estimator said last, before it smoothed them."""
    inputs = state.inputs.get(state.source, ())
    return {each.name: (now_s - each.heard_s, *each.value) for each in inputs if each.heard and math.isfinite(sum(each.value))}


class Figures(NamedTuple):
    """The figures of the runtime and of what it runs, for many reports."""

    fields: dict[str, Any]  # of the report
    others: bytes  # an object in JSON, which stands among its words, under names that it has not


def figures(board: Mapping[str, object]) -> Figures:
    """The board as it goes into reports. What it has not yet, they have not either."""
    others = {name: value for name, value in board.items() if name not in _TYPES}
    return Figures({name: msgspec.convert(board[name], _TYPES[name]) for name in _TYPES if name in board}, _encode(others))


def in_json(told: LocalReport, others: bytes = b"{}") -> bytes:
    """The report in JSON. `others`: of its `Figures`."""
    return _encode(told) if others == b"{}" else b"%b,%b" % (_encode(told)[:-1], others[1:])


def _reference(state: State) -> LocalReference:
    r = state.reference
    latitude_deg = longitude_deg = None
    if r.north_m is not None and r.east_m is not None and state.origin is not None:
        latitude_rad, longitude_rad = from_plane(state.origin, r.north_m, r.east_m)
        latitude_deg, longitude_deg = _degrees(latitude_rad), _degrees(longitude_rad)
    return LocalReference(
        heading_deg=_compass_degrees(r.heading_rad),
        course_deg=_compass_degrees(r.course_rad),
        speed_mps=r.speed_mps,
        cross_track_m=_rounded(r.cross_track_m),
        distance_m=_rounded(r.distance_m),
        leg=r.leg,
        line=r.line,
        speed_override_mps=state.setpoint.override_mps,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
    )


def _ages(state: State, now_s: float) -> dict[str, float | None]:
    return {
        "navigation": _age(now_s, state.navigation_s),
        "console": _age(now_s, state.console_s),
        "guest": _age(now_s, state.guest_s),
        **{f"payload {name}": _age(now_s, at_s) for name, at_s in state.payloads_s.items()},
        **{name: _age(now_s, at_s) for name, (_, at_s) in state.sysstat.items()},
        **{name: _age(now_s, at_s) for name, (_, at_s) in state.measured.items()},
    }


def _node(told: SystemStatus) -> NodeFacts:
    return NodeFacts(
        status=told.status.name.lower(),
        faults=tuple([each.name.lower() for each in Fault if each in told.faults and each.name]) if told.faults else (),
        rpm=getattr(told, "rpm", None),
        voltage_v=getattr(told, "voltage_v", None),
        current_a=getattr(told, "current_a", None),
        charge=getattr(told, "charge", None),
        temperature_c=getattr(told, "temperature_c", None),
    )


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(angle_rad), 7)


def _compass_degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(compass(angle_rad)), 2)


def _rounded(value: float | None, digits: int = 2) -> float | None:
    return None if value is None else round(value, digits)


def _age(now_s: float, at_s: float) -> float | None:
    """The age of an input; None: it was never heard."""
    return None if at_s < -1e8 else round(now_s - at_s, 3)
