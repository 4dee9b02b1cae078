"""The live view in a terminal: the track as a chart of dots beside the boat's state, set points and troubles."""

import math
from collections import deque
from itertools import zip_longest
from typing import Any

from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.constrain import Constrain
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

WIDTH, HEIGHT = 56, 20  # of the chart at most, characters; each holds 2 x 4 dots
HEIGHT_MIN = 6  # a chart that is lower shows nothing
BESIDE = 128  # a screen so wide has the chart beside the panels, a narrower one below them, as high as there is room
TEXT_ROWS = 24  # of the panels, while a warning or two are there
POINTS_MAX = 5000
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # Unicode braille, row by column
_ARROWS = "↑↗→↘↓↙←↖"


class View:
    """Feed it states; render it as often as you like. Waypoints are (latitude_deg, longitude_deg), of the mission `name`."""

    def __init__(self, waypoints: list[tuple[float, float]], name: str) -> None:
        self.waypoints, self.name = waypoints, name
        self.track: deque[tuple[float, float]] = deque(maxlen=POINTS_MAX)
        self.state: dict[str, Any] | None = None
        self.words = ""

    def feed(self, state: dict[str, Any], words: str = "") -> None:
        """A state, and the words above it."""
        self.state, self.words = state, words
        if state["mission"] not in (None, self.name):  # another one was sent: of it only the name is told here
            self.waypoints = []
        if state["latitude_deg"] is not None:
            self.track.append((state["latitude_deg"], state["longitude_deg"]))

    def render(self, width: int = BESIDE, height: int = 40) -> RenderableType:
        """For a screen of so many columns and rows. Warnings come first: what does not fit is cut off at the end."""
        if self.state is None:
            return Panel("waiting for the vehicle", title="delfim")
        words, panels = Text(self.words, style="bold"), self.panels(self.state)
        if width >= BESIDE:
            chart = Panel(Text("\n".join(self.chart()), style="cyan"), expand=False)
            return Columns([Group(chart, Constrain(words, WIDTH + 4)), Group(*panels)])
        words.truncate(width, overflow="ellipsis")
        rows = min(HEIGHT, height - TEXT_ROWS - 2)
        if rows < HEIGHT_MIN:
            return Group(words, *panels)
        return Group(words, *panels, Panel(Text("\n".join(self.chart(rows)), style="cyan"), expand=False))

    def title(self) -> str:
        state = self.state
        assert state is not None
        return f"{state.get('boat', 'boat')}  {state['mode']}  leg {state['reference']['leg'] + 1}/{state['legs']}"

    def chart(self, height: int = HEIGHT) -> list[str]:
        """Rows of text: the track in dots, waypoints as numbers, the boat as an arrow, north up, metres alike both ways."""
        points = [*self.track, *self.waypoints]
        if not points:
            return [" " * WIDTH] * height
        south, north = min(p[0] for p in points), max(p[0] for p in points)
        west, east = min(p[1] for p in points), max(p[1] for p in points)
        shrink = math.cos(math.radians((south + north) / 2))
        span = max((north - south) / (height * 4 - 8), (east - west) * shrink / (WIDTH * 2 - 4), 1e-6)
        middle = (south + north) / 2, (west + east) / 2

        def dot(p: tuple[float, float]) -> tuple[int, int]:
            x = WIDTH + (p[1] - middle[1]) * shrink / span
            y = height * 2 - (p[0] - middle[0]) / span
            return min(max(int(x), 0), WIDTH * 2 - 1), min(max(int(y), 0), height * 4 - 1)

        cells = [[0] * WIDTH for _ in range(height)]
        for x, y in map(dot, self.track):
            cells[y // 4][x // 2] |= _DOTS[y % 4][x % 2]
        rows = [[chr(0x2800 + cell) if cell else " " for cell in row] for row in cells]
        for waypoint in dict.fromkeys(self.waypoints):  # a mission may come back to where it began
            x, y = dot(waypoint)
            label = "/".join(str(number) for number, other in enumerate(self.waypoints, 1) if other == waypoint)
            for offset, digit in enumerate(label):
                rows[y // 4][min(x // 2 + offset, WIDTH - 1)] = digit
        if self.track and self.state is not None and self.state["heading_deg"] is not None:
            x, y = dot(self.track[-1])
            rows[y // 4][x // 2] = _ARROWS[round(self.state["heading_deg"] / 45) % 8]
        return ["".join(row) for row in rows]

    def panels(self, state: dict[str, Any]) -> list[RenderableType]:
        ages = [(name, _age(age)) for name, age in state["age_s"].items()]
        half = (len(ages) + 1) // 2
        pairs = [(*one, *other) for one, other in zip_longest(ages[:half], ages[half:], fillvalue=("", ""))]
        return [
            _rows(self.title(), warnings(state) or [("", Text("no warnings", style="green"))]),
            _rows("motion", _motion(state)),
            _rows("critical path", _critical_path(state)),
            _rows("inputs", pairs),
        ]


def warnings(state: dict[str, Any]) -> list[tuple[str, Text]]:
    """The present warnings: the reason of a stop, faults, refusals and losses."""
    found = []
    if state["mode"] == "idle":
        found.append(("idle", Text(state["reason"], style="yellow")))
    colours = {"warn": "yellow", "hold": "yellow", "back": "yellow", "unstick": "yellow", "home": "yellow"}
    found += [
        (
            notice["name"].replace("_", " "),
            Text(f"{notice['reason']}: {notice['action']}", colours.get(notice["action"], "red")),
        )
        for notice in state["notices"]
    ]
    bad = {name: report for name, report in state["sysstat"].items() if report["status"] != "good"}
    found += [(name, Text(f"{report['status']} {' '.join(report['faults'])}", style="red")) for name, report in bad.items()]
    for name, service in state.get("services", {}).items():
        if service["state"] not in ("running", "stopped", "starting"):
            found.append((name, Text(f"{service['state']}: {service['reason']}", style="red")))
    if log := state.get("log", {}).get("reason"):
        found.append(("log", Text(log, style="red")))
    found += [(name.replace("_", " "), Text(str(count), style="yellow")) for name, count in state["counts"].items()]
    return found


def _motion(state: dict[str, Any]) -> list[tuple[str, str | Text]]:
    reference = state["reference"]
    bars = Text("  ".join(f"{name} {_bar(each['thrust'])} {each['thrust']:4.0%}" for name, each in state["thrusters"].items()))
    return [
        ("position", f"{_number(state['latitude_deg'], '.6f')}  {_number(state['longitude_deg'], '.6f')}"),
        ("heading", f"{_number(state['heading_deg'], '.1f')}°  wanted {_number(reference['heading_deg'], '.1f')}°"),
        ("speed", f"{_number(state['speed_mps'], '.2f')} m/s  wanted {_number(reference['speed_mps'], '.2f')}"),
        ("thrust", bars),
        ("to go", f"{_number(reference['distance_m'], '.1f')} m  off track {_number(reference['cross_track_m'], '+.2f')} m"),
        ("batteries", "  ".join(_charge(state, side) for side in ("port", "starboard"))),
    ]


def _critical_path(state: dict[str, Any]) -> list[tuple[str, str | Text]]:
    latency = state["latency"]
    good = latency["within_100_us"] >= 0.99
    return [
        ("cycles", f"{latency['n']}"),
        ("p50  p99  worst", f"{latency['p50_us']:.0f}  {latency['p99_us']:.0f}  {latency['worst_us']:.0f} µs"),
        ("within 100 µs", Text(f"{latency['within_100_us']:.2%}", style="green" if good else "yellow")),
        ("stages", "  ".join(f"{name[:4]} {mean:.0f}" for name, mean in latency["stages_us"].items())),
    ]


def _rows(title: str, rows: list[Any]) -> Panel:
    table = Table.grid(padding=(0, 1))
    table.add_column(style="dim", min_width=14)
    table.add_column(min_width=12)
    table.add_column(style="dim")
    for row in rows:
        table.add_row(*row)
    return Panel(table, title=title, title_align="left")


def _age(age_s: float | None) -> Text:
    if age_s is None:
        return Text("never heard", style="dim")
    return Text(f"{age_s:.1f} s", style="green" if age_s < 1.5 else "yellow" if age_s < 3.5 else "red")


def _bar(thrust: float) -> str:
    return f"{'▁▂▃▄▅▆▇█'[min(int(abs(thrust) * 8), 7)]}" if thrust else "·"


def _charge(state: dict[str, Any], side: str) -> str:
    report = state["sysstat"].get(f"batteries_{side}", {})
    return f"{side} {_number(report.get('charge'), '.0%')} {_number(report.get('voltage_v'), '.1f')} V"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
