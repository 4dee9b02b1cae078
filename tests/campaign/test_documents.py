"""The figures of docs/control.md and docs/failsafe.md: each table names the campaign whose [[table]] it is."""

import re
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.campaign import queries, sailing
from delfim.campaign.runplan import read
from delfim.campaign.store import Store

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "etc/campaigns").glob("*.toml"))
NAMED = re.compile(r"etc/campaigns/[a-z-]+\.toml")
FIGURE = re.compile(r"-?\d+(\.\d+)?")


class Shown(NamedTuple):
    """A table of figures in a document."""

    document: str
    head: tuple[str, ...]
    campaigns: tuple[str, ...]  # that the words above it name


def shown() -> list[Shown]:
    found = list[Shown]()
    for document in ("control.md", "failsafe.md"):
        parts = re.split(r"((?:^\|.*\n)+)", (ROOT / "docs" / document).read_text(), flags=re.MULTILINE)
        for words, table in zip(parts[::2], parts[1::2], strict=False):
            head, _, *rows = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in table.splitlines())
            if all(FIGURE.fullmatch(row[-1]) for row in rows):
                found.append(Shown(document, tuple(head), tuple(NAMED.findall(words.rpartition("\n#")[2]))))
    return found


@pytest.mark.parametrize("table", shown(), ids=lambda table: f"{table.document}: {table.head[0]}, {table.head[-1]}")
def test_each_table_of_figures_names_the_campaign_that_makes_it_again(table: Shown) -> None:
    assert table.campaigns, "no campaign is named above it"
    files = [read(ROOT / name) for name in table.campaigns]
    heads = {tuple(each.columns) for file in files for each in queries.rehearse(*file)}
    assert table.head in heads, f"{table.campaigns} have a [[table]] with these columns: {heads}"


def test_the_documents_have_tables_of_figures() -> None:
    found = shown()
    assert {name for table in found for name in table.campaigns} == {
        f"etc/campaigns/{name}.toml" for name in ("boats", "control", "course", "failsafe", "faults", "sway")
    }


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_must_hold_and_the_tables_of_a_shipped_campaign_are_sql(path: Path) -> None:
    queries.rehearse(*read(path))


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", sorted({name for table in shown() for name in table.campaigns}))
def test_two_seeds_of_a_campaign_give_figures_for_its_tables(name: str, tmp_path: Path) -> None:
    """At the last point of each boat and trial, where the sea is worst."""
    file, plan = read(ROOT / name)
    points = {story: number for number, (story, _) in enumerate(plan.points)}
    store = Store(tmp_path, plan, 2, sailing.VERSION)
    for batch, point in enumerate(points.values()):
        store.add(batch, [sailing.one(plan, batch, point, seed) for seed in (1, 2)])
    store.flush()
    database = queries.connect(tmp_path)
    assert queries.failed(database) == []
    for _, columns, rows in queries.answered(database, file.answers):
        assert rows
        assert not [column for row in rows for column, value in zip(columns, row, strict=True) if value is None]
