"""The pairs that a campaign met: counted run by run, told as a table and a picture."""

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.input.untrusted import parse_toml
from delfim.campaign import pairtable, queries, sailing
from delfim.campaign.runplan import read
from delfim.campaign.store import Store
from delfim.simulator.scenarios.pairs import ALL, PAIRS, possible
from delfim.simulator.scenarios.searching import searching
from tests.campaign.test_runplan import ETC, written


def test_pairs_are_kept_where_the_campaign_counts_them_and_too_few_are_told(tmp_path, capsys):
    _, plan = read(written(tmp_path, 'scenario = "searching"', "pairs = 0.99", "seeds = { count = 2 }"))
    rows = [sailing.one(plan, 0, 0, seed) for seed in (1, 2)]
    assert all(row["pairs"] for row in rows), rows
    store = Store(tmp_path / "out", plan, 2, sailing.VERSION)
    store.add(0, rows)
    store.flush()
    database = queries.connect(tmp_path / "out")
    assert not pairtable.tell(database, 0.99, tmp_path)
    assert pairtable.tell(database, 0.001, tmp_path)
    counts = pairtable.counted(database)
    assert {*counts.values()} <= {1, 2}
    assert len(counts) == len({place for row in rows for place in row["pairs"].split()})
    told = capsys.readouterr().out
    assert f"pairs met: {len(counts)} of {len(PAIRS)} that are possible" in told
    assert (tmp_path / "pairs.txt").read_text() in told


def test_the_picture_has_a_square_for_each_pair_and_what_cannot_be_is_told():
    counts = dict.fromkeys(PAIRS, 120) | {PAIRS[0]: 7}
    del counts[PAIRS[1]]
    wrong = next(pair for pair in ALL if not possible(*pair))
    squares = "".join(
        line[26:] for line in pairtable.picture(counts).splitlines() if line.startswith(("trouble", "action", "order"))
    )
    assert (squares.count("3"), squares.count("1"), squares.count(".")) == (len(PAIRS) - 2, 1, 1)
    assert squares.count("-") == len(ALL) - len(PAIRS)
    told = pairtable.lines(counts | {wrong: 3})
    assert f"  never met: {' with '.join(PAIRS[1])}" in told
    assert told[-1] == f"  MET, and held to be impossible: {' with '.join(wrong)}, 3 runs"


def test_any_scenario_can_be_written_as_a_file():
    tree = msgspec.to_builtins(searching(3, config.load(ETC / "delfimx.toml")))
    tree |= {"odd key": {"a.b": 'quo"te\n', "none": None, "rows": [{"x": 1e-7, "y": [True, {"z": "ü"}]}, {}], "empty": {}}}
    again = parse_toml(tables.text_of(tree))
    assert again == _without_none(tree)


def _without_none(value):
    if isinstance(value, dict):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    return [_without_none(each) for each in value] if isinstance(value, list | tuple) else value
