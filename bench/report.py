"""From samples to figures, and what they allow to be said: percentiles, ratios against C, noise, a table, a picture.

Everything here is JSON-ready: what `describe` returns stands in critical-path.json, and table and picture are made of that.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.logging.ashore.plot import INK, LINE, SEA

PERCENTILES: Final = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
LIMITS: Final = {"p50": 1.25, "p99": 1.0, "p999": 1.0}  # of the ratio to the C program: the contract of the design
WITHIN, WITHIN_BY_C = 0.998, 0.995  # share of cycles within 100 us, and that of the C program from which on it is asked
STAGES: Final = ("poll", "navigation", "control", "propulsion", "log")
EDGES_US: Final = tuple(10 ** (k / 20) for k in range(101))  # 1 us .. 0.1 s, twenty bins a decade
BEYOND_MIN: Final = 5  # a percentile of fewer samples beyond it is an anecdote
OVER_BUDGET_MAX: Final = 1.0  # callbacks a second of one service; a few are the machine's, which interrupts whom it likes
TAKEN_MAX: Final = 0.1  # of the processors, by others, while the worst case is still the competitors' own
COLOURS: Final = {
    "c": INK,
    "realtime": "#8a8f98",
    "delfim": "#d1495b",
    "ordinary": "#9b5de5",
    "dronecan": "#00798c",
    "vesc": "#7d5a50",
    "empty": "#f28482",
    "apart": "#e8b04a",
    "asyncio": "#2e86ab",
    "uvloop": "#5b9a68",
}


class Cycle(NamedTuple):
    """The stamps of one critical path, ns (thesis figure 3-9)."""

    t0: int
    t1: int
    t2: int
    t3: int
    t4: int
    t5: int


def percentile(ordered: Sequence[float], part: float, due: int = 0) -> float | None:
    """The sample that `part` (0..1) of all `due` ones, or of those that there are, do not exceed. Those that are missing count
    as longer than all others; None where the answer is one of them."""
    n = max(len(ordered), due)
    at = min(int(n * part), n - 1)
    return ordered[at] if 0 <= at < len(ordered) else None


def paths_us(cycles: Sequence[Cycle]) -> list[float]:
    """Lengths of the critical path, t0 to t4, ascending."""
    return sorted((cycle.t4 - cycle.t0) / 1e3 for cycle in cycles)


def figures(cycles: Sequence[Cycle], due: int) -> dict[str, Any]:
    """Percentiles, the worst, the share within 100 us, the stage means and the histogram of these cycles.

    `due` is how many navigation messages were sent. A loop that is late may pass over one for the newer one behind it: its
    path never ended, so it counts as the longest of all.

    A loop that was awake already when the last frame came began to read before it: its poll stage is then zero, not negative.
    """
    path = paths_us(cycles)
    n = max(len(path), due)
    spans = [
        (max(c.t1 - c.t0, 0), c.t2 - max(c.t0, c.t1), c.t3 - c.t2, c.t4 - c.t3, c.t5 - c.t4) for c in cycles if c.t5 >= c.t4
    ]
    means = [sum(stage) / len(spans) / 1e3 for stage in zip(*spans, strict=True)] if spans else [0.0] * len(STAGES)
    return {
        "cycles": len(path),
        "lost": n - len(path),
        **{f"{name}_us": _rounded(percentile(path, part, due)) for name, part in PERCENTILES.items()},
        "worst_us": round(path[-1], 2) if path else 0.0,
        "within_100_us": round(sum(value <= 100.0 for value in path) / n, 6) if n else 0.0,
        "stages_us": {name: round(mean, 2) for name, mean in zip(STAGES, means, strict=True)},
        "histogram": histogram(path),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def histogram(ordered_us: Sequence[float]) -> list[int]:
    """Samples in each bin of EDGES_US; those outside stand in the first and the last bin."""
    counts = [0] * (len(EDGES_US) - 1)
    at = 0
    for value in ordered_us:
        while at < len(counts) - 1 and value >= EDGES_US[at + 1]:
            at += 1
        counts[at] += 1
    return counts


def noise(first: Sequence[Cycle], second: Sequence[Cycle]) -> dict[str, float | None]:
    """By which factor the same program differs from itself, in slices that took turns: 1 on a quiet machine. None where one
    of them has no samples."""
    return noise_of(paths_us(first), paths_us(second))


def noise_of(one: Sequence[float], other: Sequence[float]) -> dict[str, float | None]:
    """The same of lengths, ascending."""
    result: dict[str, float | None] = {}
    for name, part in PERCENTILES.items():
        pair = percentile(one, part) or 0.0, percentile(other, part) or 0.0
        result[name] = round(max(pair) / min(pair), 3) if pair[0] and pair[1] else None
    return result


def verdict(ratio: float | None, factor: float | None, limit: float, beyond: float) -> str:
    """What may be said of a ratio to C that shall not exceed `limit`.

    `factor` is the noise: C against C. The contract is held, or missed, where it is so on the unfavourable side of the noise;
    in between nobody can tell. `beyond` is how many samples lie beyond the percentile in question. No ratio: the percentile is
    a cycle that never ended.
    """
    if factor is None or beyond < BEYOND_MIN:
        return "too few cycles"
    if ratio is None:
        return "missed"
    if ratio * factor <= limit:
        return "held"
    if ratio / factor > limit:
        return "missed"
    return "too noisy to tell"


def compared(
    row: Mapping[str, Any],
    reference: Mapping[str, Any],
    factors: Mapping[str, float | None],
    taken: float,
    limits: Mapping[str, float] = LIMITS,
) -> dict[str, Any]:
    """Ratios of a row to another, and the verdict on each. `taken` is what others had of the processors, 0..1."""
    ratios: dict[str, float | None] = {}
    verdicts: dict[str, str] = {}
    for name, part in PERCENTILES.items():
        mine, base = row[f"{name}_us"], reference[f"{name}_us"]
        ratios[name] = ratio = round(mine / base, 3) if mine and base else None
        beyond = min(each["cycles"] + each["lost"] for each in (row, reference)) * (1.0 - part)
        quiet = taken <= TAKEN_MAX
        verdicts[name] = verdict(ratio, factors[name], limits[name], beyond) if quiet else "too noisy to tell"
    return {"ratio": ratios, "verdict": verdicts}


def table(results: Mapping[str, Any]) -> str:
    """The results as text: a block for each rate and load, and under each what the machine allows to be said."""
    head = (
        "us",
        "cycles",
        "lost",
        "p50",
        "p99",
        "p99.9",
        "worst",
        "<=100us",
        "cpu",
        "cpu all",
        "window",
        "x C: p50",
        "p99",
        "p99.9",
    )
    lines = []
    for group in results["groups"]:
        lines.append(f"\n{group['rate_hz']:g} Hz, {group['load']}")
        lines.append(f"{'':32}" + "".join(f"{name:>10}" for name in head[1:]))
        for row in group["rows"]:
            share = row["window_share"]
            cells = [
                f"{row['cycles']}",
                f"{row['lost']}",
                *("lost" if row[f"{name}_us"] is None else f"{row[f'{name}_us']:.0f}" for name in (*PERCENTILES, "worst")),
                f"{row['within_100_us']:.2%}",
                f"{row['cpu_us']:.0f}",
                f"{row['cpu_all_us']:.0f}",
                "-" if share is None else f"{share:.1%}",
                *("-" if ratio is None else f"{ratio:.2f}" for ratio in row["ratio"].values()),
            ]
            lines.append(f"{row['label']:32}" + "".join(f"{cell:>10}" for cell in cells))
        lines += _remarks(group)
    return "\n".join(lines).lstrip("\n")


def _remarks(group: Mapping[str, Any]) -> list[str]:
    factors = ", ".join(f"{_name(k)} x {v:.2f}" if v else f"{_name(k)} unknown" for k, v in group["noise"].items())
    taken = (
        f"{group['others_share']:.0%} of the processors taken by other programs, {group['steal_share']:.1%} by other machines"
    )
    lines = [f"  noise, C against C: {factors}; {taken}; navigation up to {group['late_us_max']:.0f} us late"]
    others = group["others_share"] + group["steal_share"]
    reference = next(row for row in group["rows"] if row["competitor"] == "c")
    for row in group["rows"]:
        if row["competitor"] == "delfim":
            said = "; ".join(f"{_name(k)} {v} (<= {LIMITS[k]:.2f} x C)" for k, v in row["verdict"].items())
            lines.append(f"  the contract: {said}")
            lines.append(f"  within 100 us: {within(row, reference, others)}")
            over = ", ".join(f"{name} {per_s:g}" for name, per_s in row["over_budget_per_s"].items() if per_s) or "none"
            beyond = over_budget(group)
            failed = f"; more than {OVER_BUDGET_MAX:g}: {', '.join(beyond)} FAILED" if beyond else ""
            lines.append(f"  callbacks longer than their budget, a second: {over}{failed}")
    return lines


def within(row: Mapping[str, Any], reference: Mapping[str, Any], taken: float) -> str:
    """The verdict on the share of cycles within 100 us, which is asked only where C shows that the machine allows it."""
    mine, base = row["within_100_us"], reference["within_100_us"]
    if base < WITHIN_BY_C:
        return f"not asked, for C has {base:.2%} (>= {WITHIN:.1%} where C has {WITHIN_BY_C:.1%})"
    said = "held" if mine >= WITHIN else "missed" if taken <= TAKEN_MAX else "too noisy to tell"
    return f"{said}, {mine:.2%} (>= {WITHIN:.1%} where C has {WITHIN_BY_C:.1%})"


def over_budget(group: Mapping[str, Any]) -> list[str]:
    """The services of this program whose callbacks are too long too often. None where others had too much of the machine to
    tell."""
    if group["others_share"] + group["steal_share"] > TAKEN_MAX:
        return []
    rows = [row for row in group["rows"] if row["competitor"] == "delfim"]
    return [name for row in rows for name, per_s in row["over_budget_per_s"].items() if per_s > OVER_BUDGET_MAX]


def _name(key: str) -> str:
    return "p99.9" if key == "p999" else key


def picture(results: Mapping[str, Any], file: Path) -> None:
    """Figure 3-10 for all competitors, a line for each rate: idle, under load, and the stage means of figure 3-11."""
    from matplotlib.figure import Figure

    rates = sorted({group["rate_hz"] for group in results["groups"]})
    loads = sorted({group["load"] for group in results["groups"]}, key=lambda load: load != "idle")
    sheet = Figure(figsize=(5.2 * (len(loads) + 1), 3.6 * len(rates)), layout="constrained", facecolor="white")
    grid = sheet.subplots(len(rates), len(loads) + 1, squeeze=False)
    groups = {(group["rate_hz"], group["load"]): group for group in results["groups"]}
    for line, rate_hz in zip(grid, rates, strict=True):
        for axes, load in zip(line, loads, strict=False):
            _histograms(axes, groups[rate_hz, load])
        _stages(line[-1], groups[rate_hz, loads[-1]])
    handles = {label: h for axes in grid.flat for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    sheet.legend(handles.values(), handles, loc="outside upper center", ncols=len(handles), frameon=False)
    sheet.savefig(file, dpi=110)


def _histograms(axes: Any, group: Mapping[str, Any]) -> None:
    _quiet(axes)
    for row in group["rows"]:
        n = max(row["cycles"], 1)
        shares = [count / n for count in row["histogram"]]
        axes.stairs(shares, EDGES_US, color=COLOURS[row["competitor"]], lw=1.4, label=row["label"])
    most = max([row["cycles"] for row in group["rows"]] + [1])
    axes.axvline(100.0, color=INK, lw=0.8, ls=":", zorder=0)
    axes.set(
        ylim=(0.5 / most, 1.0),
        xscale="log",
        yscale="log",
        xlim=(5, 2e4),
        title=f"{group['rate_hz']:g} Hz, {group['load']}: t0 to t4",
    )
    axes.set(xlabel="latency, µs", ylabel="share of cycles")


def _stages(axes: Any, group: Mapping[str, Any]) -> None:
    _quiet(axes)
    width = 0.8 / len(group["rows"])
    for place, row in enumerate(group["rows"]):
        means = [row["stages_us"][name] for name in STAGES]
        at = [x - 0.4 + width * (place + 0.5) for x in range(len(STAGES))]
        axes.bar(at, means, width * 0.9, color=COLOURS[row["competitor"]])
    axes.set_xticks(range(len(STAGES)), STAGES)
    axes.set(title=f"{group['rate_hz']:g} Hz, {group['load']}: stage means", ylabel="µs")


def _quiet(axes: Any) -> None:
    axes.set_facecolor(SEA)
    axes.grid(color=LINE, lw=0.5)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
