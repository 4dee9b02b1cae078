"""Other vessels on the boat's page: how many, how long ago, what the boat does for them, and those that matter first."""

from html import escape
from typing import Final

from delfim.services.page.wording import span
from delfim.vehicle.report import BoatReport, VesselSeen

ROWS_MAX: Final = 12  # they take 60 µs to write
SEES: Final = "Sees only who transmits."


def vessels(vehicle: BoatReport | None) -> str:
    """The line stands there always: silence is no clear water."""
    traffic = vehicle.traffic if vehicle else None
    if traffic is None:
        return f'<p class="none">Nobody was heard. {SEES}</p>'
    heard = f"last report {span(traffic.heard_s)} ago" if traffic.heard_s is not None else "nobody was heard"
    told = [f"{len(traffic.targets)} vessel{'' if len(traffic.targets) == 1 else 's'}, {heard}. {SEES}"]
    if traffic.order is not None:
        told.append(f"<b>{escape(traffic.order.words)}</b>")
    told.append(f"Keeps clear of them: {escape(traffic.guard)}")
    shown = sorted(traffic.targets, key=_first_met)[:ROWS_MAX]
    names = "<tr><th>name</th><th>CPA</th><th>in</th><th>course</th><th>speed</th><th>age</th></tr>"
    table = f'<table class="processes"><thead>{names}</thead>{"".join(map(_row, shown))}</table>' if shown else ""
    more = f'<p class="small">and {len(traffic.targets) - len(shown)} more</p>' if len(traffic.targets) > len(shown) else ""
    return f'<p class="small">{"<br/>".join(told)}</p>{table}{more}'


def _row(vessel: VesselSeen) -> str:
    name = escape(vessel.name if vessel.size_known else f"{vessel.name} (size unknown)")
    bad = vessel.danger != "none"
    tcpa = "–" if vessel.tcpa_s is None else "past" if vessel.tcpa_s < 0.0 else span(vessel.tcpa_s)
    age = f"{'lost, ' if vessel.lost else ''}{span(vessel.age_s)}"
    course = "–" if vessel.course_deg is None else f"{vessel.course_deg:03.0f}°"
    cells = "–" if vessel.cpa_m is None else f"{vessel.cpa_m:.0f} m", tcpa, course, f"{vessel.speed_mps:.1f} m/s", age
    shown = f"<b>{name}: {escape(vessel.danger)}</b>" if bad else name
    return f"<tr><th>{shown}</th>{''.join(f'<td>{each}</td>' for each in cells)}</tr>"


def _first_met(vessel: VesselSeen) -> tuple[int, float]:
    """Dangerous ones, then those that draw near by their time, then those that draw apart."""
    tcpa_s = vessel.tcpa_s if vessel.tcpa_s is not None else float("inf")
    return {"danger": 0, "near": 1}.get(vessel.danger, 2 if tcpa_s >= 0.0 else 3), abs(tcpa_s)
