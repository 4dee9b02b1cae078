"""The state of the vehicle for people and programs, as it goes out to consoles, pages and services."""

import math
from dataclasses import asdict
from typing import Any

from delfim.base.geodesy import compass, from_plane
from delfim.canproxy.dsor.messages import Fault, SystemStatus
from delfim.vehicle.state import State


def snapshot(state: State, now_s: float, extra: dict[str, Any]) -> dict[str, Any]:
    """The state for people and programs: degrees, words, and the age of every input. JSON-ready, finite, bounded."""
    n, m, r = state.navigation, state.motion, state.reference
    return {
        "mode": state.mode.name.lower(),
        "reason": state.reason,
        "armed": state.armed,
        "operator": state.operator,
        "helmsman": state.helmsman,
        "cycle": state.cycles,
        "utc_ns": n.utc_ns if n else 0,
        "source": state.source,
        "latitude_deg": _degrees(n.latitude_rad) if n else None,
        "longitude_deg": _degrees(n.longitude_rad) if n else None,
        "heading_deg": _compass_degrees(n.heading_rad) if n else None,
        "course_deg": _compass_degrees(math.atan2(m.east_mps, m.north_mps)) if "velocity" in m.has else None,
        "speed_mps": round(math.hypot(m.north_mps, m.east_mps), 3) if "velocity" in m.has else None,
        "turn_dps": _degrees(n.yaw_rate_radps) if n else None,
        "roll_deg": _degrees(n.roll_rad) if n else None,
        "pitch_deg": _degrees(n.pitch_rad) if n else None,
        "fix": n.fix if n else 0,
        "satellites": n.satellites if n else 0,
        "hdop": n.hdop if n else None,
        "accuracy_m": _rounded(n.accuracy_m, 3) if n else None,
        "corrections_s": n.corrections_s if n else None,
        "run": state.actuation.run,
        "reference": {
            "heading_deg": _compass_degrees(r.heading_rad),
            "course_deg": _compass_degrees(r.course_rad),
            "speed_mps": r.speed_mps,
            "cross_track_m": _rounded(r.cross_track_m),
            "distance_m": _rounded(r.distance_m),
            "leg": r.leg,
            "speed_override_mps": state.setpoint.override_mps,
            **_position(state),
        },
        "mission": state.setpoint.plan.name if state.setpoint.plan else None,
        "legs": len(state.setpoint.plan.waypoints) if state.setpoint.plan else 0,
        "announced": [each._asdict() for each in state.announced],
        "guest_connected": state.guest_connected,
        "killed": state.killed._asdict(),
        "handset": state.handset._asdict() if state.handset else None,
        "age_s": {
            "navigation": _age(now_s, state.navigation_s),
            "console": _age(now_s, state.console_s),
            "guest": _age(now_s, state.guest_s),
            **{f"payload {name}": _age(now_s, at_s) for name, at_s in state.payloads_s.items()},
            **{name: _age(now_s, at_s) for name, (_, at_s) in (state.sysstat | state.measured).items()},
        },
        "measured": {name: value for name, (value, _) in state.measured.items()},
        "sysstat": {name: _status(report) for name, (report, _) in state.sysstat.items()},
        "clock": state.computer.clock._asdict(),
        "notices": [
            {"name": n.name, "reason": n.reason, "age_s": _age(now_s, n.since_s), "action": n.action} for n in state.notices
        ],
        "counts": dict(state.counts),
        **({"parts": {name: asdict(health) for name, health in state.parts.items()}} if state.parts else {}),
        **extra,
    }


def _status(report: SystemStatus) -> dict[str, Any]:
    fields: dict[str, Any] = report._asdict()
    faults: Fault = fields.pop("faults")
    return {
        **{key: value for key, value in fields.items() if key != "status"},
        "status": report.status.name.lower(),
        "faults": [fault.name.lower() for fault in Fault if fault in faults and fault.name],
    }


def _position(state: State) -> dict[str, float | None]:
    """Where the boat is steering, as a position."""
    r = state.reference
    if r.north_m is None or r.east_m is None or state.origin is None:
        return {"latitude_deg": None, "longitude_deg": None}
    latitude_rad, longitude_rad = from_plane(state.origin, r.north_m, r.east_m)
    return {"latitude_deg": _degrees(latitude_rad), "longitude_deg": _degrees(longitude_rad)}


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(angle_rad), 7)


def _compass_degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(compass(angle_rad)), 2)


def _rounded(value: float | None, digits: int = 2) -> float | None:
    return None if value is None else round(value, digits)


def _age(now_s: float, at_s: float) -> float | None:
    """The age of an input; None: it was never heard."""
    return None if at_s < -1e8 else round(now_s - at_s, 3)
