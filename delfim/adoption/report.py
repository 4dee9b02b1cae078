"""The page of a fit: what was found beside what the file told, and the measured motion beside that of the model."""

from collections.abc import Iterator
from html import escape
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from delfim.adoption.figures import COAST_S, PUSH_S, RUNS, STEP_S, STOPS
from delfim.adoption.fitting import CHI2_MOST, Fit
from delfim.adoption.found import BoatFindings
from delfim.adoption.model import ACROSS, NAMES, NUMBERS, SIDES, STEERS, WITHIN, Array, ModelMotion, plain, said, values_of
from delfim.adoption.record import BoatRecord
from delfim.adoption.twin.gains import FIGURES, LEAST_WORDS, ChosenGains, voyage_figures
from delfim.adoption.twin.twintrack import TwinTrack
from delfim.adoption.writing import FoundKey
from delfim.desk.htmlpage import picture, table, whole

SHOWN: Final = 6  # windows, over the whole record
MEASURED, MODEL, TOLD = "#1b2a33", "#0a5fa8", "#e8b04a"
LANES: Final = (0, MODEL, "found"), (-1, TOLD, "by the file")  # of the runs in calm water


class OnTwin(NamedTuple):
    """What the twin sailed, if it did."""

    gains: ChosenGains | None
    sailed: TwinTrack | None


def page(name: str, record: BoatRecord, fit: Fit, found: BoatFindings, twin: OnTwin, command: str) -> str:
    """The text of the page. `name` is the boat's, `command` makes the page again."""
    gains = twin.gains
    body = [
        *_head(name, record, fit, command),
        *_words("What is not as the file says", found.changes, "Nothing is surely other than the file says."),
        *_words("What was not seen", found.unseen, ""),
        *_figures(found),
        *(_gains(gains) if gains is not None else ()),
        *(_track(twin.sailed) if twin.sailed is not None else ()),
        *_curves(fit),
        *_stopping(found.runs),
        *_speeds(fit, found.runs),
        *_compass(fit),
        *_residuals(fit),
        *_keys((*found.keys, *(gains.keys if gains is not None else ()))),
        *_numbers(fit),
    ]
    return whole(f"{name}: what was found", body)


def _head(name: str, record: BoatRecord, fit: Fit, command: str) -> Iterator[str]:
    minutes = fit.windows.steps * STEP_S * len(fit.windows.from_s) / 60.0
    yield f"<h1>{escape(name)}: what was found</h1>"
    digest = f", SHA-256 {record.digest[:16]}" if record.digest else ""  # a trial has none
    yield f"<p class=soft>{escape(record.source)}{digest}; {minutes:.1f} minutes of it were looked at, "
    yield f"{len(fit.windows.from_s)} windows. Again: <code>{escape(command)}</code></p>"
    if fit.refusal:
        yield f"<p class=fails>Refused: {escape(fit.refusal)}. Nothing of it is to be used.</p>"
    else:
        yield f"<p class=holds>The model follows the boat: &chi;&sup2; is {fit.chi2:.2f} per measurement, "
        yield f"of {CHI2_MOST:g} at most.</p>"
    yield "<p class=soft>Mass and thrust are known up to one factor, as nothing measured a force: the file's mass is kept.</p>"


def _words(title: str, words: tuple[str, ...], otherwise: str) -> Iterator[str]:
    if words or otherwise:
        items = "".join(f"<li>{escape(each)}</li>" for each in words)
        yield f"<h2>{escape(title)}</h2>" + (f"<ul>{items}</ul>" if items else f"<p>{escape(otherwise)}</p>")


def _figures(found: BoatFindings) -> Iterator[str]:
    rows = [
        (each.words, each.unit, each.found, f"±{each.spread:.2g}", each.told, "extrapolated" if each.is_beyond else "")
        for each in found.figures.values()
    ]
    yield "<h2>What she does in calm water</h2>" + table(("", "unit", "found", "deviation", "by the file", ""), rows)


def _gains(its: ChosenGains) -> Iterator[str]:
    """What the candidates did on the twin, the best first, and their margins."""
    rows = [
        (each.name, each.cost, *voyage_figures(each), *each.at_rest, *each.at_cruise, "" if each.is_steady else "margins")
        for each in its.tried
    ]
    head = ("heading's gains", "cost", *FIGURES, "phase at rest, deg", "gain", "phase at speed, deg", "gain", "below")
    yield "<h2>Gains, tried on the twin</h2><p class=soft>Each sailed it by the boat's own program, with the delay that was "
    yield f"found, and once more with 40 % more. The margins are {LEAST_WORDS}, at least.</p>"
    if not its.best.is_steady:
        yield "<p class=fails>None has these margins: those that come nearest were taken.</p>"
    yield table(head, rows)


def _track(its: TwinTrack) -> Iterator[str]:
    """The mission as it was sailed, and by the twin."""
    figure = Picture(figsize=(7, 5))
    axes = figure.subplots()
    for places, colour, words in ((its.measured, MEASURED, "as it was sailed"), (its.twin, MODEL, "the twin")):
        axes.plot(places[:, 1], places[:, 0], color=colour, lw=1.4, label=words)
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.legend(fontsize=8)
    figure.subplots_adjust(0.12, 0.12, 0.98, 0.97)
    _quiet(axes)
    yield f"<h2>The mission {escape(its.name)}, and the twin in it</h2><p class=soft>The twin sails the same mission in the "
    yield f"current that was found; it is {its.rms_m:.1f} m off the track of the boat (rms), {its.most_m:.1f} m at most, "
    yield f"and takes {its.twin_s:.0f} s for it; the boat took {its.measured_s:.0f} s.</p>"
    yield picture(figure, "Track of the boat and of its twin")


def _curves(fit: Fit) -> Iterator[str]:
    """The measured speed, rate of turn and commands of some windows, beside the model and what the file foretold."""
    count = len(fit.windows.from_s)
    chosen = np.unique(np.linspace(0, count - 1, min(SHOWN, count)).astype(int))
    figure = Picture(figsize=(11, 2.1 * len(chosen)))
    places = figure.subplots(len(chosen), 3, squeeze=False)
    figure.subplots_adjust(0.06, 0.5 / (2.1 * len(chosen)), 0.99, 1.0 - 0.5 / (2.1 * len(chosen)), 0.18, 0.35)
    at_s = STEP_S * np.arange(fit.windows.steps)
    bias = fit.values["gyro_bias"]
    for row, window in zip(places, chosen, strict=True):
        for motion, form, colour, words in (
            (fit.windows.measured, ".", MEASURED, "measured"),
            (fit.first, "-", TOLD, "by the file"),
            (fit.predicted, "-", MODEL, "found"),
        ):
            its = motion[:, window]
            size = {"ms": 2.5} if form == "." else {"lw": 1.4}
            row[0].plot(at_s, np.hypot(its[:, 0], its[:, 1]), form, color=colour, label=words, **size)
            row[1].plot(at_s, np.degrees(its[:, 3] - bias), form, color=colour, **size)
        commands = fit.windows.sides[window, fit.windows.back :]
        row[2].plot(at_s, commands[:, 0], color="#0f7a4d", lw=1.2, label="starboard" if fit.windows.gear is None else "motor")
        row[2].plot(at_s, commands[:, 1], color="#b4232f", lw=1.2, label="port" if fit.windows.gear is None else "angle, rad")
        row[2].set_ylim(-1.05, 1.05)
        row[0].set_ylabel(f"from {abs(fit.windows.from_s[window]):.0f} s", fontsize=8)
    for axes, title in zip(places[0], ("speed over ground, m/s", "rate of turn, deg/s", "commands"), strict=True):
        axes.set_title(title, fontsize=9)
    places[0][0].legend(fontsize=7)
    places[0][2].legend(fontsize=7)
    for axes in places.flat:
        _quiet(axes)
    yield "<h2>Measured, and by the model</h2><p class=soft>Each window begins where the boat was then; "
    yield f"after that the model has the commands alone.</p>{picture(figure, 'Measured motion beside that of the model')}"


def _stopping(motion: ModelMotion) -> Iterator[str]:
    """The speed after the motors go off, over the way."""
    begin, end = round(PUSH_S / STEP_S), round((PUSH_S + COAST_S) / STEP_S)
    at = {run.name: index for index, run in enumerate(RUNS)}
    figure = Picture(figsize=(7, 3.2))
    axes = figure.subplots()
    for lane, colour, words in LANES:
        for number, run in enumerate(STOPS.values()):
            speed = motion.surge[begin:end, lane, at[run]]
            way = STEP_S * np.cumsum(np.maximum(speed, 0.0))
            axes.plot(way, speed, color=colour, lw=1.6, label=words if number == 0 else None)
    axes.set(xlabel="way after the motors went off, m", ylabel="m/s")
    axes.legend(fontsize=8)
    _finished(figure, axes)
    yield "<h2>Stopping</h2><p class=soft>From full, 60 and 30 % of command.</p>"
    yield f"{picture(figure, 'Speed over the way to stop')}"


def _speeds(fit: Fit, motion: ModelMotion) -> Iterator[str]:
    """The steady speed, and the rate of a spin, over the command."""
    at = round(PUSH_S / STEP_S) - 1
    straight = [index for index, run in enumerate(RUNS) if run.parts[0] == run.parts[1]]
    figure = Picture(figsize=(7, 3.2))
    axes = figure.subplots()
    for lane, colour, words in LANES:
        points = sorted([(0.0, 0.0), *((RUNS[index].parts[0], float(motion.surge[at, lane, index])) for index in straight)])
        axes.plot(*zip(*points, strict=True), "o-", color=colour, lw=1.6, ms=3, label=words)
    fastest = float(np.nanmax(np.hypot(fit.windows.measured[..., 0], fit.windows.measured[..., 1])))
    axes.axhline(fastest, color=MEASURED, lw=0.8, ls=":", label="fastest over ground that was sailed")
    axes.set(xlabel="command", ylabel="m/s")
    axes.legend(fontsize=8)
    _finished(figure, axes)
    yield f"<h2>Speed</h2>{picture(figure, 'Speed over command')}"


def _compass(fit: Fit) -> Iterator[str]:
    headings = np.radians(np.arange(0.0, 361.0, 5.0))
    off = said(values_of(fit.theta[None]), headings[None])[0] - headings
    figure = Picture(figsize=(7, 2.6))
    axes = figure.subplots()
    axes.plot(np.degrees(headings), np.degrees(np.remainder(off + np.pi, 2.0 * np.pi) - np.pi), color=MODEL, lw=1.6)
    axes.set(xlabel="heading, deg", ylabel="deg", xticks=range(0, 361, 45))
    _finished(figure, axes)
    yield f"<h2>What the compass says too much</h2>{picture(figure, 'Deviation of the compass over the heading')}"


def _residuals(fit: Fit) -> Iterator[str]:
    off = fit.windows.measured - fit.predicted
    off[..., 2] = np.remainder(off[..., 2] + np.pi, 2.0 * np.pi) - np.pi
    kinds: tuple[tuple[str, Array], ...] = (
        ("velocity, m/s", off[..., :2]),
        ("heading, deg", np.degrees(off[..., 2])),
        ("rate of turn, deg/s", np.degrees(off[..., 3])),
    )
    figure = Picture(figsize=(11, 2.4))
    figure.subplots_adjust(0.05, 0.2, 0.99, 0.88, 0.2)
    for axes, (words, values) in zip(figure.subplots(1, 3), kinds, strict=True):
        known = values[np.isfinite(values)]
        axes.hist(known, bins=60, color=MODEL)
        deviation = float(known.std()) if len(known) else 0.0
        axes.set_title(f"{words}: deviation {deviation:.2g}", fontsize=9)
        _quiet(axes)
    yield f"<h2>Residuals</h2>{picture(figure, 'Histograms of measured less model')}"


def _keys(keys: tuple[FoundKey, ...]) -> Iterator[str]:
    rows = [(each.name, str(each.value), _deviation(each), "" if each.told is None else str(each.told)) for each in keys]
    yield "<h2>Keys of the vehicle's file</h2>" + table(("key", "found", "deviation", "told"), rows)


def _deviation(found: FoundKey) -> str:
    return "" if found.spread is None else f"±{found.spread:.2g}"


def _numbers(fit: Fit) -> Iterator[str]:
    now, was, missing = fit.values, plain(fit.prior.told), set(fit.unseen)
    rows = [
        (
            number.words,
            number.unit,
            now[name],
            f"±{spread:.0%}" if number.is_factor else f"±{spread:.2g}",
            was[name],
            "not seen: as before" if name in missing else "",
        )
        for number, name, spread in zip(NUMBERS, NAMES, fit.spread, strict=True)
        if number.of in _kinds(fit)
    ]
    yield "<h2>The numbers of the model</h2>" + table(("", "unit", "found", "deviation", "before", ""), rows)


def _kinds(fit: Fit) -> tuple[str, ...]:
    """The kinds of numbers that this boat has."""
    there = (ACROSS, fit.windows.pushes_aside), (WITHIN, any(row.within for row in fit.windows.rows))
    return "", SIDES if fit.windows.gear is None else STEERS, *(kind for kind, is_there in there if is_there)


def _finished(figure: Picture, axes: Axes) -> None:
    figure.subplots_adjust(0.1, 0.2, 0.98, 0.96)
    _quiet(axes)


def _quiet(axes: Axes) -> None:
    axes.grid(color="#dde5ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
