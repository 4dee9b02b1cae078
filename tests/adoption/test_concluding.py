"""The end of a trial for who agrees to nothing; what is written else, test_linked.py looks at."""

from pathlib import Path

import pytest

from delfim import config
from delfim.adoption.trial.concluding import RECEIVER_M, conclude, corrections, told_position_m
from delfim.adoption.trial.motors import MotorsFound
from delfim.adoption.trial.session import TrialProgress
from tests.adoption.test_session import ROOT


@pytest.fixture
def file(tmp_path: Path) -> Path:
    place = tmp_path / "otter.toml"
    place.write_text((ROOT / "etc/boats/otter.toml").read_text() + "\n[adopted]\nproven = false\n")
    return place


def test_who_says_no_has_the_old_file(file: Path) -> None:
    before, settings = file.read_bytes(), config.load(file)
    progress = TrialProgress(settings.thrusters, motors=MotorsFound((-1, 1), (1, 1), (0.2, 0.2)), is_proven=True)
    for ask in (None, lambda words: False):
        assert conclude(progress, file, file.with_suffix(".html"), "2026-11-27", ask, lambda words: None)
        assert file.read_bytes() == before
    assert dict(corrections(progress))["adopted", "proven"] is True
    progress.is_proven = False
    assert list(corrections(progress)) == []


def test_the_hold_answers_to_the_receiver_that_the_file_tells_of() -> None:
    file = ROOT / "etc/boats/otter.toml"
    assert told_position_m(config.load(file)) == RECEIVER_M
    estimated = config.load(file, ["navigation.estimator=true", "estimator.position_m=0.4"])
    assert told_position_m(estimated) == 0.4
