"""The quick summary of a run: distance, speed, modes, troubles, and latency of the critical path."""

import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from delfim.logging.ashore import tree
from delfim.logging.ashore.table import Columns
from delfim.logging.ashore.tree import LogFile, Span

if TYPE_CHECKING:
    from numpy.typing import NDArray


STAGES: Final = ("poll", "navigation", "control", "propulsion", "log")
STEPPED_NS: Final = 10_000_000_000  # no cycle takes as long: the wall clock was stepped during it
GAP: Final = 2.5  # periods without a record that are reported
EVENTS_MAX: Final = 20  # reported in full
QUIET: Final = ("start", "end", "command", "watchdog", "vessels", "sounding")  # events that are not troubles


def summary(files: Sequence[LogFile], span: Span, modes: dict[int, str]) -> dict[str, Any]:
    """Sum up a run, JSON-ready. `modes` are the names of mode numbers. Raises DelfimError where no state was logged."""
    from delfim.logging.ashore.table import table

    columns, schema = table((f for f in files if f.id == "state"), span)
    its = Span(int(columns["t1"][0]), int(columns["t1"][-1]))
    told = list(tree.events(files, span))
    return {
        "boat": schema.boat,
        "from": utc(its.from_ns),
        "to": utc(its.to_ns),
        "duration_s": round(float(_steps_s(columns).sum()), 3),
        "cycles": len(columns["t1"]),
        **_way(columns),
        "modes_s": _modes(columns, modes),
        "gaps": _gaps(columns),
        "batteries": _batteries(columns),
        "latency": latency(columns),
        "frames": _frames(files, span),
        "commands": _commands(told),
        "events": _events(told),
    }


def text(told: dict[str, Any]) -> str:
    """The summary as text for people."""
    speed, path, gaps = told["speed_mps"], told["latency"], told["gaps"]
    rows = [
        ("boat", told["boat"]),
        ("time", f"{told['from']} to {told['to']} UTC, {told['duration_s']:.0f} s, {told['cycles']} cycles"),
        ("track", f"{told['track_m']:.0f} m; speed {speed['mean']:.2f} m/s mean, {speed['max']:.2f} m/s maximum"),
        ("modes", ", ".join(f"{name} {seconds:.0f} s" for name, seconds in told["modes_s"].items())),
        ("batteries", ", ".join(f"{side} down to {volt:.1f} V" for side, volt in told["batteries"].items()) or "unknown"),
        ("critical path", _path(path)),
        ("stages", ", ".join(f"{name} {mean:.1f}" for name, mean in path.get("stages_us", {}).items()) + " us mean"),
        ("navigation", f"{gaps['count']} gaps, longest {gaps['longest_s']:.2f} s" if gaps["count"] else "no gaps"),
        ("black box", ", ".join(f"{name} {count} frames" for name, count in told["frames"].items()) or "none"),
        ("commands", ", ".join(f"{name} {count}" for name, count in told["commands"].items()) or "none"),
    ]
    lines = [f"{name:14} {words}" for name, words in rows]
    return "\n".join([*lines, *(f"{'' if i else 'events':14} {words}" for i, words in enumerate(told["events"]))])


def latency(columns: Columns) -> dict[str, Any]:
    """Percentiles of the critical path t0 to t4 and means of its stages, us; empty where none was measured."""
    import numpy as np

    path_us = critical_path_us(columns)
    if not len(path_us):
        return {}
    p50, p99, p999 = (float(value) for value in np.percentile(path_us, (50, 99, 99.9)))
    return {
        "n": len(path_us),
        "p50_us": round(p50, 1),
        "p99_us": round(p99, 1),
        "p999_us": round(p999, 1),
        "worst_us": round(float(path_us.max()), 1),
        "within_100_us": round(float(np.mean(path_us <= 100.0)), 5),
        "stages_us": dict(zip(STAGES, stages_us(columns), strict=True)),
    }


def critical_path_us(columns: "Mapping[str, NDArray[Any]]") -> "NDArray[Any]":
    """The critical path t0 to t4 of every cycle, us. Cycles during which the wall clock was stepped, and those of no length,
    are left out."""
    t0, t4 = columns["t0"], columns["t4"]
    path_us: NDArray[Any] = (t4 - t0)[(t0 > 0) & (t4 > t0) & (t4 - t0 < STEPPED_NS)] / 1e3
    return path_us


def stages_us(columns: "Mapping[str, NDArray[Any]]") -> list[float]:
    """Means of the stages of figure 3-11, us."""
    t = [columns[f"t{i}"] for i in range(5)]
    spans = [(t[i], t[i + 1]) for i in range(4)] + [(t[4][:-1], columns["previous_t5"][1:])]
    lengths = [(end - begin)[(begin > 0) & (end >= begin) & (end - begin < STEPPED_NS)] for begin, end in spans]
    return [round(float(each.mean()) / 1e3, 2) if len(each) else 0.0 for each in lengths]


def utc(t_ns: int) -> str:
    """UTC as "2010-01-01 09:30:00"."""
    return f"{datetime.fromtimestamp(t_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S}"


def _steps_s(columns: Columns) -> Any:
    """Seconds from each record to the next, by the clock that is never set."""
    import numpy as np

    return np.diff(columns["monotonic_s"])


def track_m(columns: Columns) -> float:
    """Length of the driven track, from the speed over ground: positions carry noise, which would add up."""
    import numpy as np

    dt_s = _steps_s(columns)
    moved_m = np.hypot(columns["north_speed"], columns["east_speed"])[1:] * dt_s
    return float(np.nansum(moved_m[(dt_s > 0) & (dt_s < 10 * (np.median(dt_s) if len(dt_s) else 0))]))


def _way(columns: Columns) -> dict[str, Any]:
    import numpy as np

    speeds = np.hypot(columns["north_speed"], columns["east_speed"])
    speeds = speeds[np.isfinite(speeds)]
    most, mean = (float(speeds.max()), float(speeds.mean())) if len(speeds) else (0.0, 0.0)
    return {"track_m": round(track_m(columns), 1), "speed_mps": {"mean": round(mean, 3), "max": round(most, 3)}}


def _modes(columns: Columns, names: dict[int, str]) -> dict[str, float]:
    """Seconds in each mode, in the order of the first entry."""
    import numpy as np

    dt_s = np.append(_steps_s(columns), 0.0)
    order = dict.fromkeys(int(mode) for mode in columns["mode"])
    return {names.get(mode, str(mode)): round(float(dt_s[columns["mode"] == mode].sum()), 1) for mode in order}


def _gaps(columns: Columns) -> dict[str, Any]:
    import numpy as np

    dt_s = _steps_s(columns)
    gaps = dt_s[dt_s > GAP * np.median(dt_s)] if len(dt_s) else dt_s
    return {"count": len(gaps), "longest_s": round(float(gaps.max()), 3) if len(gaps) else 0.0}


def _batteries(columns: Columns) -> dict[str, float]:
    import numpy as np

    its = ((side, columns[f"{side}_voltage"]) for side in ("starboard", "port") if f"{side}_voltage" in columns)
    return {side: round(float(np.nanmin(volts)), 2) for side, volts in its if np.isfinite(volts).any()}


def _frames(files: Iterable[LogFile], span: Span) -> dict[str, int]:
    from delfim.logging.ashore.table import lines

    counts: dict[str, int] = {}
    for file in files:
        if file.suffix.startswith(".log"):
            counts[file.id] = counts.get(file.id, 0) + sum(1 for _ in lines([file], span))
    return counts


def _commands(events: Iterable[dict[str, Any]]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for event in events:
        if event["event"] == "command":
            name = str(event["value"]["command"]) + (" (refused)" if event["refused"] else "")
            counts[name] = counts.get(name, 0) + 1
    return counts


def _events(events: Iterable[dict[str, Any]]) -> list[str]:
    """The events of the sidecars, oldest first, with only the refused ones of the commands."""
    told = []
    for event in sorted(events, key=lambda each: each["t_ns"]):
        words = " ".join(str(event[key]) for key in ("value", "reason") if event.get(key) not in (None, ""))
        if event["event"] == "command" and event["refused"]:
            words = event["refused"]
        elif event["event"] in QUIET:
            continue
        told.append(f"{utc(event['t_ns'])} {event['id']}: {event['event']}{': ' if words else ''}{words}")
    more = len(told) - EVENTS_MAX
    return told if more <= 0 else [*told[:EVENTS_MAX], f"... and {more} more (delfim log cat --events)"]


def _path(path: dict[str, Any]) -> str:
    if not path:
        return "not measured"
    named = {"p50": "p50", "p99": "p99", "p99.9": "p999", "worst": "worst"}
    figures = ", ".join(f"{name} {path[f'{key}_us']:.0f}" for name, key in named.items())
    share = path["within_100_us"]
    return f"{figures} us; {share if math.isfinite(share) else 0:.2%} within 100 us"
