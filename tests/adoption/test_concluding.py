"""The end of a trial for who agrees to nothing; what is written else, test_linked.py looks at."""

from pathlib import Path

import pytest

from delfim import config
from delfim.adoption.trial import concluding
from delfim.adoption.trial.concluding import RECEIVER_M, conclude, corrections, told_position_m
from delfim.adoption.trial.dialogue import Dialogue, adopted
from delfim.adoption.trial.motors import MotorsFound
from delfim.adoption.trial.session import LAST, TrialProgress, kept
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


def test_who_ends_it_behind_the_motors_goes_on_with_this_trial(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit takes long enough for a Ctrl-C, and its question waits: the file has other motors then, the trial is hers."""

    def ended(*words: object, **more: object) -> None:
        raise KeyboardInterrupt

    settings, place = config.load(file), file.with_suffix(".trial")
    motors = MotorsFound((-1, 1), (-1, 1), (0.2, 0.2))
    progress = TrialProgress(settings.thrusters, motors=motors, is_proven=True, done=(LAST,))
    monkeypatch.setattr(concluding, "record_of", ended)
    with pytest.raises(KeyboardInterrupt):
        adopted(progress, place, str(file), "2026-11-27", Dialogue(is_yes=True))
    corrected = config.load(file)
    assert corrected.thrusters != settings.thrusters
    assert kept(place, corrected).is_whole


def test_the_hold_answers_to_the_receiver_that_the_file_tells_of() -> None:
    file = ROOT / "etc/boats/otter.toml"
    assert told_position_m(config.load(file)) == RECEIVER_M
    estimated = config.load(file, ["navigation.estimator=true", "estimator.position_m=0.4"])
    assert told_position_m(estimated) == 0.4
