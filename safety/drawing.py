"""The pictures of the safety case, as SVG: who controls what, and trees from losses and hazards down to the functions."""

import math
import textwrap
from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

from safety.case import Case, ControlAction, Link, Unsafe

STYLE: Final = """<style>
  .box { fill: #f4f7fa; stroke: #33475b; stroke-width: 1.5; } .loss { fill: #fbeaea; stroke: #b3202c; stroke-width: 2; }
  .boat { fill: #e8f4ec; stroke: #1d6b3a; stroke-width: 2; } .line { fill: none; stroke: #8fa1b3; stroke-width: 1.5; }
  .acts { fill: none; stroke: #b3202c; stroke-width: 2; }
  .tells { fill: none; stroke: #1f6fb2; stroke-width: 1.5; stroke-dasharray: 6 4; }
  text { fill: #1b2733; } .small { font-size: 12px; fill: #41566b; } .told { font-size: 12.5px; } .head { font-weight: bold; }
  .code { font-family: monospace; font-size: 11.5px; fill: #1d6b3a; } .red { fill: #b3202c; } .blue { fill: #1f6fb2; }
  .mid { text-anchor: middle; } .halo { stroke: #fff; stroke-width: 4; paint-order: stroke; font-size: 12.5px; }
</style>"""
LINE: Final = 17.0  # from one line of text to the next
WIDE, HIGH = 230.0, 58.0  # of a controller's box
COLUMN, ROW = 390.0, 150.0  # from one box to the next
APART: Final = 9.0  # of the two lines between two boxes, from their middle
LOSS_X, HAZARD_X, ACTION_X, NUMBER_X, CODE_X, RIGHT = 10.0, 120.0, 320.0, 520.0, 632.0, 960.0  # columns of a loss's tree
WHEN_X, HELD_X = 150.0, 510.0  # and of a hazard's


def control_structure(case: Case) -> str:
    """Boxes, what they do to each other in red, and what they hear of each other in blue."""
    at = {name: (140.0 + COLUMN * box.place[0], 50.0 + ROW * box.place[1]) for name, box in case.controllers.items()}
    acts = dict[tuple[str, str], list[str]]()
    for name, action in case.actions.items():
        acts.setdefault((action.by, action.to), []).append(name)
    tells = {(other, name): [what] for name, box in case.controllers.items() for other, what in box.hears.items()}
    parts = list[str]()
    for kind, colour, arrows in (("tells", "blue", tells), ("acts", "red", acts)):
        for (start, end), words in arrows.items():
            parts += _arrow(at[start], at[end], kind, colour, words)
    for name, box in case.controllers.items():
        x, y = at[name]
        kind = "boat" if name not in {action.by for action in case.actions.values()} else "box"
        parts.append(f'<rect class="{kind}" x="{x - WIDE / 2}" y="{y - HIGH / 2}" width="{WIDE}" height="{HIGH}" rx="6"/>')
        lines = textwrap.wrap(box.is_, 34)
        parts.append(_text(x, y - 4.0 - 7.0 * (len(lines) - 1), name, "mid head"))
        parts += [_text(x, y + 13.0 + 14.0 * i - 7.0 * (len(lines) - 1), line, "mid small") for i, line in enumerate(lines)]
    return _picture("Who controls what: actions in red, what is heard in blue", 1090.0, 4.0 * ROW + 100.0, parts)


def _arrow(start: tuple[float, float], end: tuple[float, float], kind: str, colour: str, words: Sequence[str]) -> Iterator[str]:
    """From the edge of one box to that of the other, to the right hand of who goes there, with its words beside it."""
    (x0, y0), (x1, y1) = start, end
    far = math.dist(start, end)
    along = (x1 - x0) / far, (y1 - y0) / far
    out = -along[1] * APART, along[0] * APART
    leaves, comes = _edge(along, out, -1.0), _edge(along, out, 1.0) + 8.0
    ax, ay = x0 + along[0] * leaves + out[0], y0 + along[1] * leaves + out[1]
    bx, by = x1 - along[0] * comes + out[0], y1 - along[1] * comes + out[1]
    yield f'<path class="{kind}" marker-end="url(#{kind})" d="M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}"/>'
    lines = textwrap.wrap(words[0], 26) if kind == "tells" else list(words)
    part = 0.5 if 0.0 in along else 0.62 if kind == "tells" else 0.35
    x, y, high = ax + (bx - ax) * part, ay + (by - ay) * part, 15.0 * (len(lines) - 1)
    anchor, aside, top = ("start", 6.0, y - high / 2.0 + 4.0) if out[0] > 1.0 else ("end", -6.0, y - high / 2.0 + 4.0)
    if abs(out[0]) < 1.0:
        anchor, aside, top = "middle", 0.0, y + 16.0 if out[1] > 0.0 else y - 8.0 - high
    for i, line in enumerate(lines):
        place = f'text-anchor="{anchor}" x="{x + aside:.1f}" y="{top + 15.0 * i:.1f}"'
        yield f'<text class="halo {colour}" {place}>{escape(line)}</text>'


def _edge(along: tuple[float, float], out: tuple[float, float], side: float) -> float:
    """How far from the middle of a box a line leaves it that passes `out` of there."""
    ways = zip(along, out, (WIDE / 2.0, HIGH / 2.0), strict=True)
    return min((half + side * math.copysign(off, off * part)) / abs(part) for part, off, half in ways if abs(part) > 1e-9)


def loss_tree(case: Case, loss: str) -> str:
    """From a loss to its hazards, to the control actions that can lead there, to the functions that keep them from it."""
    parts, y, ends = (
        _heads(
            {LOSS_X: "loss", HAZARD_X: "hazards", ACTION_X: "control actions", NUMBER_X: "unsafe", CODE_X: "kept from it in"}
        ),
        50.0,
        [],
    )
    for name, hazard in case.hazards.items():
        if loss not in hazard.losses:
            continue
        top, middles = y, list[float]()
        for key, action in case.actions.items():
            if unsafe := [each for each in action.unsafe if name in each.hazards]:
                drawn, below = _numbered(key, action, unsafe, y)
                parts += drawn
                middles.append(y + LINE - 9.0)
                y = below
        lines = textwrap.wrap(f"{name}: {hazard.is_}", 22)
        y = max(y, top + LINE * len(lines) + 12.0) + 16.0
        parts += _boxed("box", HAZARD_X, top, 180.0, lines)
        ends.append(top + 18.0)
        parts += [_curve(HAZARD_X + 180.0, top + 18.0, ACTION_X - 6.0, middle) for middle in middles]
    parts += [_curve(LOSS_X + 95.0, 68.0, HAZARD_X, end) for end in ends]
    parts += _boxed("loss", LOSS_X, 50.0, 95.0, textwrap.wrap(f"{loss}: {case.losses[loss]}", 10))
    return _picture(f"{loss}: {case.losses[loss]}", RIGHT, y, parts)


def _numbered(key: str, action: ControlAction, unsafe: Sequence[Unsafe], y: float) -> tuple[list[str], float]:
    """Who does what, the numbers of the ways in which it is unsafe, the functions that keep it from that; and where it ends."""
    numbers = textwrap.wrap(" ".join(each.id for each in unsafe), 18)
    names = dict.fromkeys(link.function for each in unsafe for link in each.held)
    where = textwrap.wrap(", ".join(names), 45, break_on_hyphens=False)
    parts = [_text(ACTION_X, y + LINE - 4.0, f"{action.by}: {key}", "head"), *_lines(NUMBER_X, y, numbers, "small")]
    y += LINE * max(len(numbers), len(where)) + 6.0
    return [*parts, *_lines(CODE_X, y - LINE * max(len(numbers), len(where)) - 6.0, where, "code"), _rule(ACTION_X, y)], y


def hazard_tree(case: Case, name: str) -> str:
    """From a hazard to the ways in which actions lead there, each with its constraint and the functions that keep it."""
    parts, y = _heads({LOSS_X: "control action", WHEN_X: "unsafe when", HELD_X: "so, and kept in"}), 45.0
    for key, action in case.actions.items():
        unsafe = [each for each in action.unsafe if name in each.hazards]
        if not unsafe:
            continue
        parts += [
            _text(LOSS_X, y + LINE - 4.0, key, "head"),
            _text(LOSS_X, y + 2.0 * LINE - 4.0, f"by the {action.by}", "small"),
        ]
        for each in unsafe:
            when, constraint = textwrap.wrap(f"{each.id} {each.when}", 52), textwrap.wrap(each.constraint.replace("`", ""), 64)
            where = list(dict.fromkeys(map(_kept, each.held)))
            parts += _lines(WHEN_X, y, when, "told") + _lines(HELD_X, y, constraint, "told")
            parts += _lines(HELD_X, y + LINE * len(constraint), where, "code")
            y += LINE * max(len(when), len(constraint) + len(where), 2) + 6.0
        y += 4.0
        parts.append(_rule(LOSS_X, y))
    return _picture(f"{name}: {case.hazards[name].is_}", RIGHT, y + 6.0, parts)


def _kept(link: Link) -> str:
    return f"{link.code.removeprefix('delfim/')}: {link.function}"


def _heads(words: dict[float, str]) -> list[str]:
    return [_text(x, 28.0, each, "red") for x, each in words.items()]


def _lines(x: float, y: float, lines: Sequence[str], kind: str) -> list[str]:
    return [_text(x, y + LINE * (1 + i) - 4.0, line, kind) for i, line in enumerate(lines)]


def _rule(x: float, y: float) -> str:
    return f'<path class="line" stroke-opacity="0.5" d="M{x:.1f} {y - 4.0:.1f}H{RIGHT - 15.0:.1f}"/>'


def _boxed(kind: str, x: float, y: float, width: float, lines: Sequence[str]) -> list[str]:
    rect = f'<rect class="{kind}" x="{x}" y="{y:.1f}" width="{width}" height="{LINE * len(lines) + 12.0:.1f}" rx="6"/>'
    return [rect, *(_text(x + 10.0, y + LINE * (1 + i) + 2.0, line, "") for i, line in enumerate(lines))]


def _curve(x0: float, y0: float, x1: float, y1: float) -> str:
    half = (x0 + x1) / 2.0
    return f'<path class="line" d="M{x0:.1f} {y0:.1f}C{half:.1f} {y0:.1f} {half:.1f} {y1:.1f} {x1:.1f} {y1:.1f}"/>'


def _text(x: float, y: float, words: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(words)}</text>'


def _picture(title: str, width: float, height: float, parts: Sequence[str]) -> str:
    heads = "".join(
        f'<marker id="{kind}" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="8" markerHeight="8" orient="auto" '
        f'markerUnits="userSpaceOnUse"><path d="M0 0L8 4L0 8z" fill="{colour}"/></marker>'
        for kind, colour in (("acts", "#b3202c"), ("tells", "#1f6fb2"))
    )
    size = f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif" font-size="14"'
    body = "\n".join((f"<title>{escape(title)}</title>", STYLE, f"<defs>{heads}</defs>"))
    paper = f'<rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>'
    return "\n".join((f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', body, paper, *parts, "</svg>", ""))
