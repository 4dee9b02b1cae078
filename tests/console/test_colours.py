"""The page's colours, as tokens.css has them: words and marks stand out, things that must be told apart are, to every eye, and
nothing but an alert looks like one. What axe can see of it on the page itself: test_accessible.py."""

import itertools
import math
import re
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from delfim.console.boats.boat import COLOURS
from tests.kit.colours import SIGHTS, contrast, difference, lab, over, rgba

TOKENS: Final = Path(__file__).parents[2] / "delfim/console/web/src/tokens.css"
THEMES: Final = ("day", "bright", "dusk", "night")
WORDS, MARKS = 4.5, 3.0  # WCAG 2.2, 1.4.3 and 1.4.11
APART: Final = 10.0  # CIEDE2000; two are just seen side by side
ALERTS_APART: Final = 8.0  # their shapes differ, too
ALERTS: Final = ("bad", "warn", "alarm", "alarmlow", "amber", "yellow", "stop")  # and their backgrounds
BACKS: Final = ("badback", "warnback", "onalarm", "onstop", "danger")


def tokens() -> dict[str, dict[str, str]]:
    """By theme; day's hold where a theme says nothing else."""
    blocks = re.findall(r"([^{}]+)\{([^}]*)\}", re.sub(r"/\*.*?\*/", "", TOKENS.read_text(), flags=re.DOTALL))
    told = [dict(re.findall(r"--([a-z]+\d?):\s*([^;]+);", body)) for _, body in blocks]
    names = ["day", *(re.findall(r'data-theme="(\w+)"', head)[0] for head, _ in blocks[1:])]
    return {name: told[0] | its for name, its in zip(names, told, strict=True)}


def apart(one: str, other: str) -> tuple[float, str]:
    """The least difference, and to whom."""
    return min((difference(lab(one, sight), lab(other, sight)), sight) for sight in SIGHTS)


@pytest.mark.parametrize("theme", THEMES)
def test_words_and_marks_stand_out_from_what_they_stand_on(theme: str) -> None:
    its = tokens()[theme]
    paper = (
        [over(its["paper"], behind) for behind in ("#000000", "#ffffff")]
        if theme == "day"
        else [over(its["paper"], its["sea"])]
    )
    low = []
    for words, backs in (
        ("ink", (*paper, its["raised"], its["sea"], its["faint"], its["warnback"], its["badback"])),
        ("soft", (*paper, its["raised"])),
        ("accent", (*paper, its["raised"])),
        ("on", (its["accent"],)),
        ("warn", (*paper, its["warnback"])),
        ("bad", (*paper, its["raised"], its["badback"])),
        ("onalarm", (its["alarm"], its["alarmlow"])),
        ("onstop", (its["stop"],)),
    ):
        low += [f"{words} on {back}: {its_:.2f}" for back in backs if (its_ := contrast(its[words], back)) < WORDS]
    for mark in ("plan", "draft", "steer", "survey", "done", "limit", "accent", "ink", "edge", "soft"):
        low += [f"{mark} on the sea: {its_:.2f}" for back in (its["sea"],) if (its_ := contrast(its[mark], back)) < MARKS]
    assert low == []


@pytest.mark.parametrize("theme", THEMES)
def test_lines_that_have_one_stroke_are_told_apart_by_every_eye(theme: str) -> None:
    """The mission, the line that is sailed, those that were, those of a survey, a fence. Others differ by their strokes."""
    its = tokens()[theme]
    near = {
        (one, other): found
        for one, other in itertools.combinations(("plan", "steer", "survey", "done", "limit"), 2)
        if (found := apart(its[one], its[other]))[0] < APART
    }
    assert near == {}


def test_boats_are_told_apart_by_every_eye() -> None:
    """The five colours; the number on the hull tells boat 1 from boat 6."""
    near = {pair: found for pair in itertools.combinations(COLOURS, 2) if (found := apart(*pair))[0] < 2 * APART}
    assert near == {}


@pytest.mark.parametrize("theme", THEMES)
def test_alarm_warning_and_caution_differ_in_colour_too(theme: str) -> None:
    its = tokens()[theme]
    pairs = itertools.combinations(("bad", "amber", "yellow"), 2)
    near = {pair: found for pair in pairs if (found := apart(*(its[e] for e in pair)))[0] < ALERTS_APART}
    assert near == {}


@pytest.mark.parametrize("theme", THEMES)
def test_nothing_but_an_alert_and_stop_is_red_amber_or_yellow(theme: str) -> None:
    for name, colour in tokens()[theme].items():
        if name in (*ALERTS, *BACKS, "shadow", "land") or not re.match(r"#|rgba?\(", colour):
            continue
        assert not is_of_alerts(over("#" + "".join(f"{round(255 * x):02x}" for x in rgba(colour)[:3]), "#000")), name
    for colour in COLOURS:
        assert not is_of_alerts(colour), colour


def is_of_alerts(colour: str) -> bool:
    _, a, b = lab(colour)
    return math.hypot(a, b) > 20.0 and -10.0 < math.degrees(math.atan2(b, a)) < 115.0


@pytest.mark.parametrize(
    ("one", "other", "wanted"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (58.0, 24.0, 15.0), 19.4535),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
        ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
    ],
)
def test_the_difference_is_that_of_its_paper(one: tuple[float, ...], other: tuple[float, ...], wanted: float) -> None:
    assert difference(np.array(one), np.array(other)) == pytest.approx(wanted, abs=1e-4)


def test_black_on_white_has_all_the_contrast_there_is() -> None:
    assert contrast("#000", "rgb(255 255 255)") == pytest.approx(21.0)
    assert over("rgba(0, 0, 0, .5)", "#ffffff") == "#808080"
