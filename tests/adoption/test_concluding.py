"""The end of a trial: what is written into the vehicle's file, and what is not."""

from pathlib import Path

import pytest

from delfim import config
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.concluding import conclude, corrections
from delfim.adoption.trial.hiddenhull import drawn
from delfim.adoption.trial.motors import MotorsFound
from delfim.adoption.trial.session import TrialProgress, TrialSession
from tests.adoption.test_session import NOISE, RADIUS_M, ROOT

EXCHANGED = 1  # a seed whose motors are exchanged


@pytest.fixture
def file(tmp_path: Path) -> Path:
    place = tmp_path / "otter.toml"
    place.write_text((ROOT / "etc/boats/otter.toml").read_text() + "\n[adopted]\nproven = false\n")
    return place


def test_the_file_gets_the_motors_and_then_the_hull_and_is_proven(file: Path) -> None:
    settings = config.load(file, NOISE)
    hidden = next(each for each in (drawn(settings, seed) for seed in range(1, 50)) if each.swapped and each.reversed[0])
    progress = TrialProgress(settings.thrusters)
    boat = SimulatedTrial(settings, hidden, 1, RADIUS_M)
    person = lambda words: True, lambda words: None
    assert TrialSession(boat, settings, progress, file.with_suffix(".trial"), RADIUS_M, *person).run() == ""
    said = list[str]()
    assert conclude(progress, file, file.with_suffix(".html"), "2026-11-27", lambda words: True, said.append) == ""
    written = config.load(file)
    assert written.adopted.proven
    assert [row.address for row in written.thrusters] == [row.address for row in settings.thrusters][::-1]
    wrong = [row.reversed != was.reversed for row, was in zip(written.thrusters, settings.thrusters[::-1], strict=True)]
    assert wrong == list(hidden.reversed)[::-1]
    assert written.boat.inertia_kgm2
    assert abs(written.thrusters[0].dead - hidden.rows[0].dead) < 0.03
    assert "; was 0" in file.read_text() or "; was 1" in file.read_text()
    assert file.with_suffix(".html").is_file()


def test_who_says_no_has_the_old_file(file: Path) -> None:
    before, settings = file.read_bytes(), config.load(file)
    progress = TrialProgress(settings.thrusters, motors=MotorsFound((-1, 1), (1, 1), (0.2, 0.2)), is_proven=True)
    for ask in (None, lambda words: False):
        assert conclude(progress, file, file.with_suffix(".html"), "2026-11-27", ask, lambda words: None)
        assert file.read_bytes() == before
    assert dict(corrections(progress))["adopted", "proven"] is True
    progress.is_proven = False
    assert list(corrections(progress)) == []
