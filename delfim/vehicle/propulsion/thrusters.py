"""The thrusters as people and programs see them: the command of each row with its report, and the means of both sides."""

import math
from collections.abc import Sequence
from typing import Final

from delfim.config import ThrusterTable
from delfim.vehicle.report import ThrusterFacts
from delfim.vehicle.state import State

MIDDLE_M: Final = 0.1  # a thruster this near the middle belongs to both sides
AHEAD_DEG: Final = 60.0  # one that pushes farther off the bow or the stern than this belongs to neither


def facts(rows: Sequence[ThrusterTable], state: State, now_s: float) -> dict[str, ThrusterFacts]:
    """Command and report of each thruster by name."""
    found = dict[str, ThrusterFacts]()
    for row, thrust, angle_rad in zip(rows, state.actuation.thrust, state.actuation.angle_rad, strict=False):
        part, angle_deg = round(thrust, 4), _degrees(angle_rad) if row.steer else None
        if (report := state.thrusters.get(row.name)) is None:
            found[row.name] = ThrusterFacts(thrust=part, angle_deg=angle_deg)
            continue
        found[row.name] = ThrusterFacts(
            thrust=part,
            angle_deg=angle_deg,
            rpm=report.rpm,
            current_a=report.current_a,
            voltage_v=report.voltage_v,
            temperature_c=report.temperature_c,
            turned_deg=_degrees(report.angle_rad),
            faults=report.faults or (),
            age_s=round(now_s - report.heard_s, 3),
        )
    return found


def sides(rows: Sequence[ThrusterTable]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The rows to port and those to starboard, among those that push ahead. One in the middle belongs to both."""
    along = [(i, row.y_m) for i, row in enumerate(rows) if abs(math.cos(math.radians(row.angle_deg))) >= _AHEAD]
    return tuple(i for i, y_m in along if y_m < MIDDLE_M), tuple(i for i, y_m in along if y_m > -MIDDLE_M)


def thrust(rows: Sequence[ThrusterTable], state: State) -> tuple[float, float]:
    """Mean command of port and of starboard, -1..1 of full command, positive ahead."""
    sent = state.actuation
    if not sent.run:
        return 0.0, 0.0
    signs = [1.0 if abs(row.angle_deg) < 90.0 else -1.0 for row in rows]
    port, starboard = ([sent.thrust[i] * signs[i] for i in side] for side in sides(rows))
    return _mean(port) or 0.0, _mean(starboard) or 0.0


def revolutions(rows: Sequence[ThrusterTable], state: State) -> tuple[float | None, float | None]:
    """Mean of the reported revolutions of port and of starboard, 1/min; None: unknown."""
    reports = [state.thrusters.get(row.name) for row in rows]
    port, starboard = (
        [report.rpm for i in side if (report := reports[i]) is not None and report.rpm is not None] for side in sides(rows)
    )
    return _mean(port), _mean(starboard)


_AHEAD: Final = math.cos(math.radians(AHEAD_DEG))


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(angle_rad), 1)
