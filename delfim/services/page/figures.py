"""Figures as inline SVG: the latency histogram (thesis figure 3-10), bars, a compass. Numbers in, markup out.

Colours are classes of style.css, so that a figure follows the page by day and by night.
"""

import math
from collections.abc import Sequence
from typing import Final

from delfim.vehicle.report import LatencyFacts

M_PER_DEG: Final = 111_200.0
SEEN_M: Final = 40.0  # of the sea at least
MARGIN: Final = 26
SCALES_M: Final = tuple(m * 10**power for power in range(7) for m in (1, 2, 5))
LIMIT_US: Final = 100.0  # of the critical path
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 360, 180, 30, 26, 6


def histogram(latency: LatencyFacts) -> str:
    """Figure 3-10: cycles over latency, both logarithmic, so that one late cycle in a hundred thousand is seen."""
    highest_us = max([1000.0, latency.worst_us, *(edge for edge, _ in latency.histogram)])
    decades = math.ceil(math.log10(highest_us) - 1e-9) - 1
    most = max((n for _, n in latency.histogram), default=1)
    powers = max(1, math.ceil(math.log10(most) - 1e-9))

    def x(us: float) -> float:
        return round(LEFT + (WIDTH - LEFT - 6) * min(max(math.log10(max(us, 1e-3) / 10) / decades, 0.0), 1.0), 1)

    def y(n: float) -> float:
        """One cycle stands a little above the axis."""
        share = (math.log10(max(n, 1)) + 0.3) / (powers + 0.3) if n else 0.0
        return round(HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * share, 1)

    base = HEIGHT - BOTTOM
    parts = [f'<rect class="late" x="{x(LIMIT_US)}" y="{TOP}" width="{WIDTH - 6 - x(LIMIT_US)}" height="{base - TOP}"/>']
    for power in range(powers + 1):
        at = y(10**power)
        parts.append(f'<path class="grid" d="M{LEFT} {at}H{WIDTH - 6}"/>')
        parts.append(f'<text class="tick end" x="{LEFT - 4}" y="{at + 3.5}">{_count(10**power)}</text>')
    for power in range(1, decades + 2):
        at = x(10.0**power)
        parts.append(f'<path class="grid" d="M{at} {TOP}V{base}"/>')
        parts.append(f'<text class="tick middle" x="{min(at, WIDTH - 24)}" y="{HEIGHT - 10}">{micros(10.0**power)}</text>')
    bars = (f"M{x(edge / 10**0.1)} {base}V{y(n)}H{round(x(edge) - 0.8, 1)}V{base}Z" for edge, n in latency.histogram)
    parts.append(f'<path class="bars" d="{"".join(bars)}"/>')
    marks = (("median", latency.p50_us), ("p99", latency.p99_us), ("worst", latency.worst_us))
    parts += [f'<path class="mark {name}" d="M{x(us)} {TOP}V{base}"/>' for name, us in marks if us > 0]
    label = f"Histogram of {latency.n} cycles: median {latency.p50_us:.0f}, worst {latency.worst_us:.0f} microseconds"
    return f'<svg class="figure" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def chart(
    way: Sequence[tuple[float, float]], here: tuple[float, float], heading_deg: float | None, there: tuple[float, float] | None
) -> str:
    """North up, everything in sight, with a scale. Places are latitude and longitude in degrees."""
    places = [*way, here, *([there] if there else [])]
    south, north = min(lat for lat, _ in places), max(lat for lat, _ in places)
    west, east = min(lon for _, lon in places), max(lon for _, lon in places)
    east_m = M_PER_DEG * max(math.cos(math.radians(here[0])), 0.01)
    wide_m, high_m = max((east - west) * east_m, SEEN_M), max((north - south) * M_PER_DEG, SEEN_M)
    scale = min((WIDTH - 2 * MARGIN) / wide_m, (HEIGHT - 2 * MARGIN) / high_m)  # pixels a metre
    across, down = scale * east_m, -scale * M_PER_DEG
    middle = (south + north) / 2, (west + east) / 2

    def at(place: tuple[float, float]) -> str:
        return f"{WIDTH / 2 + (place[1] - middle[1]) * across:.1f} {HEIGHT / 2 + (place[0] - middle[0]) * down:.1f}"

    boat = at(here)
    parts = [f'<rect class="sea" width="{WIDTH}" height="{HEIGHT}" rx="6"/>']
    parts.append(f'<path class="way" d="M{"L".join([at(place) for place in way] + [boat])}"/>')
    if there:
        x, y = at(there).split()
        parts.append(f'<path class="to" d="M{boat}L{x} {y}"/><circle class="there" cx="{x}" cy="{y}" r="6"/>')
    turned = f" rotate({heading_deg:.0f})" if heading_deg is not None else ""
    shape = (
        "M0 -13C5 -6 6 2 5 10L0 7L-5 10C-6 2 -5 -6 0 -13Z" if heading_deg is not None else "M-6 0A6 6 0 1 0 6 0A6 6 0 1 0 -6 0Z"
    )
    parts.append(f'<path class="hull" d="{shape}" transform="translate({boat.replace(" ", ",")}){turned}"/>')
    length_m = next(m for m in SCALES_M if m * scale >= 40 or m == SCALES_M[-1])
    parts.append(f'<path class="rule" d="M10 {HEIGHT - 14}v5h{length_m * scale:.1f}v-5"/>')
    parts.append(f'<text class="tick" x="14" y="{HEIGHT - 14}">{length_m} m</text>')
    parts.append(f'<text class="tick end" x="{WIDTH - 10}" y="18">N ↑</text>')
    return f'<svg class="figure map" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="Map">{"".join(parts)}</svg>'


def bar(value: float, maximum: float, kind: str = "") -> str:
    """A horizontal bar that fills its place; beyond the maximum it is full."""
    share = 100 * min(max(value / maximum, 0.0), 1.0) if maximum > 0 and math.isfinite(value) else 0.0
    return (
        f'<svg class="bar {kind}" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">'
        f'<rect class="rail" width="100" height="8"/><rect class="fill" width="{share:.1f}" height="8"/></svg>'
    )


def thrust(part: float) -> str:
    """A bar from the middle for -1..1: ahead to the right, astern to the left."""
    share = 50 * min(max(part, -1.0), 1.0)
    return (
        '<svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">'
        f'<rect class="rail" width="100" height="8"/><rect class="fill" x="{50 + min(share, 0):.1f}" '
        f'width="{abs(share):.1f}" height="8"/><rect class="middle" x="49.6" width="0.8" height="8"/></svg>'
    )


def compass(heading_deg: float | None, wanted_deg: float | None) -> str:
    """A rose, north up: the boat as a hull, the wanted heading as a mark on the rim."""
    ticks = "".join(
        f'<path class="{"grid" if deg else "north"}" d="M50 3V{8 if deg % 90 else 12}" transform="rotate({deg} 50 50)"/>'
        for deg in range(0, 360, 30)
    )
    wanted, hull = "", ""
    if wanted_deg is not None:
        wanted = f'<path class="wanted" d="M50 14L44 3H56Z" transform="rotate({wanted_deg:.0f} 50 50)"/>'
    if heading_deg is not None:
        shape = "M50 16C58 30 60 48 59 78L50 72L41 78C40 48 42 30 50 16Z"
        hull = f'<path class="hull" d="{shape}" transform="rotate({heading_deg:.0f} 50 50)"/>'
    circle = '<circle class="rim" cx="50" cy="50" r="47"/>'
    return f'<svg class="compass" viewBox="0 0 100 100" aria-hidden="true">{circle}{ticks}{hull}{wanted}</svg>'


def micros(us: float) -> str:
    """A time as people read it: 87 µs, 1.2 ms, 3 s."""
    for size, unit in ((1e6, "s"), (1e3, "ms")):
        if us >= size * 0.9995:
            return f"{us / size:.3g} {unit}"
    return f"{us:.3g} µs" if us < 99.5 else f"{us:.0f} µs"


def _count(n: int) -> str:
    return f"{n // 1_000_000}M" if n >= 1_000_000 else f"{n // 1000}k" if n >= 1000 else str(n)
