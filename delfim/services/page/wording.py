"""Figures as people write them, and the small pieces of HTML that hold them."""

from collections.abc import Iterable
from datetime import UTC, datetime
from html import escape
from typing import Final

from delfim.services.page import figures
from delfim.services.page.api import Computer, LogLine
from delfim.vehicle.report import NodeFacts, ThrusterFacts


def tile(name: str, value: str, unit: str, more: str) -> str:
    return f'<div class="tile"><b>{name}</b><p class="big">{value}<small>{unit}</small></p><p class="small">{more}</p></div>'


def knots(speed_mps: float | None) -> str:
    """A line of its own; none for an unknown speed."""
    return "" if speed_mps is None else f"{speed_mps * 3600.0 / 1852.0:.1f} kn<br/>"


def gauges(rows: Iterable[tuple[str, float, float, str]]) -> str:
    lines = (
        f'<tr><th>{name}</th><td class="gauge">{figures.bar(value, most, "warn" if value > 0.9 * most else "")}</td>'
        f'<td class="value">{text}</td></tr>'
        for name, value, most, text in rows
    )
    return f"<table>{''.join(lines)}</table>"


def number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def span(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 60:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    for limit, big, small, names in ((3600, 60, 1, "min s"), (86_400, 3600, 60, "h min"), (1e12, 86_400, 3600, "d h")):
        if seconds < limit:
            first, second = names.split()
            return f"{seconds // big:.0f} {first} {seconds % big // small:.0f} {second}"
    return "for ever"


def size(count: float) -> str:
    for limit, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= limit:
            return f"{count / limit:.1f} {unit}" if count < 100 * limit else f"{count / limit:.0f} {unit}"
    return f"{count:.0f} B"


def rate(bps: float) -> str:
    return f"{bps / 1e6:.1f} Mbit/s" if bps >= 1e6 else f"{bps / 1e3:.1f} kbit/s" if bps >= 1e3 else f"{bps:.0f} bit/s"


def as_told(figure: object) -> str:
    """A figure as people write it."""
    if isinstance(figure, dict) and figure:
        return ", ".join(f"{worded(name)} {as_told(each)}" for name, each in figure.items())
    if isinstance(figure, list | tuple) and figure:
        return ", ".join(map(as_told, figure))
    if isinstance(figure, bool):
        return "yes" if figure else "no"
    return escape(str(figure)) if figure or figure == 0 else "none"


def worded(name: str) -> str:
    return escape(name.replace("_", " "))


def loglines(lines: Iterable[LogLine]) -> str:
    """Lines of the system log."""
    kinds = {"debug": "", "info": "", "warning": "warn", "error": "bad", "critical": "bad"}
    rows = []
    for line in lines:
        at = f"{datetime.fromtimestamp(line.t_ns // 10**9, UTC):%m-%d %H:%M:%S}"
        head = f'<span class="small">{at} {escape(line.level)}</span> <b>{escape(line.service)}</b>'
        rows.append(f'<li class="{kinds.get(line.level, "bad")}">{head} {escape(line.text)}</li>')
    return f'<ul class="lines log">{"".join(rows)}</ul>' if rows else '<p class="none">no line</p>'


def last_words(computer: Computer | None) -> str:
    """The end of the system log, newest line first."""
    return loglines(computer.log if computer else ()) + '<p class="small"><a href="/system">More, by level and text</a></p>'


_MEASURED: Final = {
    "rpm": "{:.0f}\N{NO-BREAK SPACE}rpm",
    "turned_deg": "at\N{NO-BREAK SPACE}{:.0f}°",
    "charge": "{:.0%}",
    "voltage_v": "{:.1f}\N{NO-BREAK SPACE}V",
    "current_a": "{:.1f}\N{NO-BREAK SPACE}A",
    "temperature_c": "{:.0f}\N{NO-BREAK SPACE}°C",
}


def measured(part: NodeFacts | ThrusterFacts) -> str:
    """The values that a node or a thruster reports."""
    return " ".join(form.format(value) for name, form in _MEASURED.items() if (value := getattr(part, name, None)) is not None)


def of_thruster(thruster: ThrusterFacts) -> str:
    """Its command, and its report."""
    asked = f"{thruster.thrust:.0%}" + ("" if thruster.angle_deg is None else f" to {thruster.angle_deg:.0f}°")
    return f"{asked} {measured(thruster)} <b>{escape(', '.join(thruster.faults))}</b>"


def of_node(node: NodeFacts) -> str:
    told = measured(node)
    return told if node.status == "good" else f"<b>{escape(node.status)} {escape(', '.join(node.faults))}</b> {told}"
