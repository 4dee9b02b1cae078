"""What must stay as it was, against what was kept: behaviour, logs, frames, words. CONTRIBUTING.md says how it changes."""

import math
from functools import cache
from pathlib import Path

import pytest

from tests.oracles import replays
from tests.oracles.comparing import of_lines, of_trace
from tests.oracles.keeping import KEPT, Lines, arithmetic, kept_lines, kept_traces
from tests.oracles.kinds import LINES
from tests.oracles.traces import Trace
from tests.oracles.voyages import QUICK_S, VOYAGES, Voyage

SHOWN = 20  # differences
KEPT_BYTES = 450_000
PARTS = {"boats": 2, "scenarios": 5, "mixed": 1, "encounters": 5}  # a second or two each; whole ones take up to ten
QUICK = 2  # of these parts are sailed each time


def told(kind: str, differences: list[str], of: int) -> str:
    """For whoever reads it tired."""
    more = [f"... and {len(differences) - SHOWN} more"] if len(differences) > SHOWN else []
    advice = f'Where this is wanted: make oracles ARGS="{kind}", and say why in the commit.'
    return "\n".join([f"{kind}: {len(differences)} of {of} are not as they were kept", *differences[:SHOWN], *more, advice])


@cache
def voyages_of(kind: str) -> list[Voyage]:
    return list(VOYAGES[kind]())


@cache
def traces_of(kind: str) -> tuple[dict[str, Trace], str]:
    return kept_traces(kind)


def compare_voyages(kind: str, part: int, seconds: float) -> None:
    (kept, made), voyages, differences = traces_of(kind), voyages_of(kind)[part :: PARTS[kind]], list[str]()
    for voyage in voyages:
        name, then = voyage.name, kept.get(voyage.name)
        if then is None:
            differences.append(f"{name}: it is new: it was not kept")
        elif words := of_trace(name, then, voyage.sail(then.groups, seconds), made == arithmetic()):
            differences.append(words)
    if differences:
        pytest.fail(told(kind, differences, len(voyages)), pytrace=False)


@pytest.mark.parametrize(("kind", "part"), [(kind, part) for kind, parts in PARTS.items() for part in range(min(parts, QUICK))])
def test_voyages_are_the_same_to_the_last_bit(kind: str, part: int) -> None:
    """Their beginnings: a boat's as long as it is told all modes, others' a minute."""
    compare_voyages(kind, part, QUICK_S[kind])


@pytest.mark.long
@pytest.mark.parametrize(("kind", "part"), [(kind, part) for kind, parts in PARTS.items() for part in range(parts)])
def test_whole_voyages_are_the_same_to_the_last_bit(kind: str, part: int) -> None:
    compare_voyages(kind, part, math.inf)


@pytest.mark.parametrize("kind", PARTS)
def test_every_voyage_that_was_kept_is_sailed(kind: str) -> None:
    assert traces_of(kind)[0].keys() - {each.name for each in voyages_of(kind)} == set()


@pytest.mark.parametrize("kind", LINES)
def test_what_the_boat_writes_is_the_same(kind: str) -> None:
    kept, now = kept_lines(kind), LINES[kind].make()
    if kept.pop("arithmetic") != [arithmetic()]:
        kept, now = (_exact(each, LINES[kind].measured) for each in (kept, now))
    if differences := of_lines(kept, now, LINES[kind].explain):
        pytest.fail(told(kind, differences, len(kept)), pytrace=False)


def _exact(lines: Lines, measured: str) -> Lines:
    return {name: [line for line in each if not measured or measured not in line] for name, each in lines.items()}


@pytest.mark.parametrize("name", replays.BOATS)
def test_a_day_that_an_older_version_recorded_is_replayed_bit_by_bit(name: str) -> None:
    result = replays.replayed(name)
    assert result.cycles > 60
    if kept_lines("drivers")["arithmetic"] == [arithmetic()] and not result.exact:
        pytest.fail(f"{name}: {result.text()}\n{told('days', [], 1).splitlines()[-1]}", pytrace=False)


def test_all_that_is_kept_is_small() -> None:
    assert sum(file.stat().st_size for file in KEPT.rglob("*") if file.is_file()) <= KEPT_BYTES


def test_nothing_that_is_kept_names_a_place_of_the_machine_that_made_it() -> None:
    texts = {file: file.read_text() for file in KEPT.rglob("*") if file.suffix in (".txt", ".toml", ".jsonl")}
    assert [str(file) for file, text in texts.items() if "/tmp/" in text or str(Path.home()) + "/" in text] == []
