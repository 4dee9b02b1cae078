"""What a worker does: a run of a point and a seed, and what is measured of it."""

import itertools

import pytest

from delfim.base.errors import DelfimError
from delfim.campaign import sailing
from delfim.campaign.measures import MEASURES, Sailed
from delfim.campaign.runplan import Batch, read
from delfim.simulator.scenarios.trial import Event
from tests.campaign.test_runplan import ETC, written


def test_a_run_that_cannot_be_sailed_is_a_row_with_its_error(tmp_path):
    _, plan = read(written(tmp_path, 'scenario = "mixed"', "limit_s = 1e-9", "seeds = {count = 1}"))
    (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
    assert not row["ok"]
    assert row["error"].startswith("TooLong: not over after 1e-09 s of computing")


def test_a_computer_that_slept_ends_no_run(tmp_path, monkeypatch):
    _, plan = read(written(tmp_path, 'scenario = "mixed"', "seeds = {count = 1}", "seconds = 60"))
    slept = itertools.count(0.0, 1e6)
    monkeypatch.setattr(sailing.time, "monotonic", lambda: next(slept))
    (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
    assert row["error"] == ""


def test_a_worker_with_other_code_is_refused_with_both_named(tmp_path):
    _, plan = read(written(tmp_path, 'scenario = "mixed"'))
    with pytest.raises(DelfimError, match=r"this worker has delfim .* code [0-9a-f]{8} .*, the campaign delfim 9\.9 code 0"):
        sailing.sail_batch(plan, Batch(0, ((0, 1),)), "delfim 9.9 code 0")


def test_values_of_the_campaign_lie_over_those_of_the_scenario(tmp_path):
    """The scenario of mixed faults has a sea of its own."""
    _, plan = read(written(tmp_path, 'scenario = "mixed"', "[vary]", '"simulation.sea.current_mps" = [0.0, 0.9]'))
    seen = [sailing.sailed_run(plan, point, 1)[0].run.settings.simulation.sea.current_mps for point in (0, 1)]
    assert seen == [0.0, 0.9]


def test_a_mission_is_measured(tmp_path):
    _, plan = read(written(tmp_path, f'mission = "{ETC}/missions/doca.toml"', "seeds = {count = 1}"))
    (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
    assert row["ok"], row
    assert row["end"].startswith("mission done")
    assert row["cross_rms_m"] < 1.0
    assert 100.0 < row["way_m"] < 3000.0
    assert row["energy_j"] > 1000.0
    assert row["faults"] == 0


def test_what_was_never_beside_a_swimmer_has_no_distance_to_one(tmp_path):
    """A page cannot draw how infinite distances are spread."""
    vary = "[vary]", '"simulation.things.world" = ["pocket"]'
    _, plan = read(written(tmp_path, f'mission = "{ETC}/missions/doca.toml"', "seeds = {count = 1}", "seconds = 20.0", *vary))
    (row,) = sailing.sail_batch(plan, Batch(0, ((0, 1),)), sailing.VERSION)
    assert (row["things"] > 0, row["still_m"]) == (True, None)
    assert row["clear_m"] > 0.0


def test_a_fault_of_a_scenario_is_varied_and_drawn(tmp_path):
    trial = f'scenario = "{ETC}/campaigns/trials/one-fault.toml"'
    vary = '"fault.kind" = ["navigation_silent", "gnss_poor"]'
    _, plan = read(written(tmp_path, trial, "[vary]", vary, "[draw]", '"fault.at_s" = {uniform = [30.0, 35.0]}'))
    for point, name in enumerate(("navigation_silent", "gnss_poor")):
        row, events = sailing.one(plan, 0, point, 1), sailing.sailed_run(plan, point, 1)[0].events
        (fault,) = [each for each in events if each.kind == "fault"]
        assert (fault.name, row["fault.kind"]) == (name, name)
        assert 30.0 <= row["fault.at_s"] <= fault.t_s < 35.5
        assert (row["faults"], row["unnoticed"]) == (1, 0)
        assert row["noticed_s"] == pytest.approx({"navigation_silent": 1.2, "gnss_poor": 5.2}[name], abs=0.3)


def test_a_mode_that_the_operator_asked_for_does_not_mean_that_a_fault_was_noticed():
    events = [Event(10.0, "fault", "thruster_dead", "port"), Event(12.0, "mode", "hold", "operator")]
    events += [Event(13.0, "mode", "hold", "goto done")]
    told = Sailed(*4 * [None], "")._replace(events=events)
    names = {measure.name: measure.value for measure in MEASURES}
    assert (names["faults"](told), names["unnoticed"](told), names["noticed_s"](told)) == (1, 1, None)
    events.append(Event(14.5, "mode", "idle", "port propeller turns 0 instead of 800 rpm"))
    assert (names["unnoticed"](told), names["noticed_s"](told)) == (0, 4.5)


def test_how_far_a_boat_goes_on_is_measured_from_where_it_was_told_to_stop():
    """The campaign of docs/failsafe.md, one seed: the columns of the table, in its order."""
    _, plan = read(ETC / "campaigns/failsafe.toml")
    far_m = [sailing.one(plan, 0, point, 1)["stop_m"] for point in range(len(plan.points))]
    assert far_m == pytest.approx([1.8, 3.1, 4.1, 5.3, 1.8, 3.1, 4.3, 8.4], abs=0.1)
