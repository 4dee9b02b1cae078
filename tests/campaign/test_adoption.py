"""A campaign of adoptions: what its file may say, a run as a row, and what its tables ask."""

from pathlib import Path

import pytest

from delfim.base.errors import ConfigError, DelfimError
from delfim.campaign import queries, sailing
from delfim.campaign.adopted.columns import COLUMNS
from delfim.campaign.runplan import Batch, read
from delfim.campaign.store import Store
from tests.campaign.test_runplan import ETC, written

SHIPPED = ETC / "campaigns/adoption.toml"


def of(folder: Path, boat: str | Path, *more: str) -> Path:
    text = f'version = 1\nname = "Try"\nvehicle = "{ETC / "boats" / boat}.toml"\nscenario = "adoption"\nseeds = {{count = 1}}\n'
    place = folder / "try.toml"
    place.write_text("\n".join([text, *more]))
    return place


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ((), "page = false"),
        (("page = false", "audit = true"), "no tracks, audit and pairs"),
        (("page = false", 'mission = "../missions/doca.toml"'), "no other scenario, and no mission"),
    ],
)
def test_what_an_adoption_has_not_is_refused_in_words(tmp_path: Path, more: tuple[str, ...], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        read(of(tmp_path, "heron", *more))


def test_it_goes_with_no_other_scenario(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no other scenario"):
        read(written(tmp_path, 'scenario = ["adoption", "mixed"]', "page = false"))


def test_a_boat_that_cannot_be_adopted_and_one_that_takes_too_long_are_rows_with_their_reason(tmp_path: Path) -> None:
    askew = (ETC / "boats/float.toml").read_text().replace("angle_deg = -45.0", "angle_deg = 45.0", 1)
    (tmp_path / "askew.toml").write_text(askew.replace('"../missions', f'"{ETC}/missions'))
    refused = "DelfimError: askew: this boat cannot be adopted: bow_starboard hardly turns the boat by itself"
    for boat, why in ((tmp_path / "askew", refused), ("heron", "TooLong")):
        _, plan = read(of(tmp_path, boat, "page = false", "limit_s = 0.5"))
        (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
        assert not row["ok"]
        assert row["error"].startswith(why)


def test_of_a_boat_whose_thrusters_push_across_a_run_has_the_motors_and_says_why_no_hull(tmp_path: Path) -> None:
    _, plan = read(of(tmp_path, "float", "page = false", "limit_s = 600.0"))
    (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
    assert (row["error"], row["ok"], row["motors"], row["ended"]) == ("", True, "right", "")
    assert row["refused"].startswith("the hull of this boat cannot be identified: her thrusters push across")


def test_a_run_is_had_again_by_the_command_that_draws_the_same_boat() -> None:
    _, plan = read(SHIPPED)
    with pytest.raises(DelfimError, match=r"delfim adopt etc/boats/otter.toml --sim 7 --yes has it again"):
        sailing.sailed_run(plan, 1, 7)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("boat", ["heron", "skiff"])
def test_a_run_has_every_figure_and_the_shipped_campaign_judges_it(tmp_path: Path, boat: str) -> None:
    file, _ = read(SHIPPED)
    _, plan = read(of(tmp_path, boat, "page = false", "limit_s = 600.0"))
    (row,) = rows = sailing.sail_batch(plan, Batch(0, ((0, 3),)), sailing.VERSION)
    assert (row["error"], row["ok"], row["motors"], row["ended"], row["refused"]) == ("", True, "right", "", "")
    missing = {each.name for each in COLUMNS} - row.keys()
    assert missing == (set() if boat == "skiff" else {"straight_off_deg"}) | (set() if boat == "heron" else {"least_s"})
    assert abs(row["full_off"]) < 0.05
    store = Store(tmp_path / "out", plan, 1, sailing.VERSION)
    store.add(0, rows)
    store.flush()
    database = queries.connect(tmp_path / "out")
    assert queries.answered(database, file.answers)[0].rows[-1][1:3] == (1, 1)
    assert {each.name for each in queries.quantities(database)} >= {"twin_most_m", "most_part"}
