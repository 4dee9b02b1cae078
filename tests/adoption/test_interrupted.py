"""A trial that is interrupted at any second: the boat is idle or holds, its file is whole, and it goes on where it was."""

from collections.abc import Callable
from pathlib import Path
from random import Random

import msgspec
import pytest

from delfim import config
from delfim.adoption.trial import session
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.hiddenhull import drawn
from delfim.adoption.trial.session import TrialProgress, TrialSession, kept
from delfim.base.modes import Mode
from delfim.commands.operation.adopt import RADIUS_M
from delfim.vehicle import console
from tests.adoption.test_session import vehicle

SEED = 4
WAYS = "stop", "gone", "boat killed"
TIMES = 15  # that a trial is interrupted, in each of these ways as often
OFF_S = 3.0  # after which at the latest the motors are off: the silence that ends a trial, and what a motor takes
LOOK_S = 8.0
STEPS = ("circles", "legs", "spins", "wiggle slow", "wiggle fast", "drift again")


class Gone(BaseException):
    """The program of the trial is there no more."""


class Interrupted:
    """A trial on one boat, in session after session; each is interrupted in its own way, and the boat goes on by itself."""

    def __init__(self, settings: config.Vehicle, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.settings, self.place = settings, place
        hidden = drawn(settings, SEED)
        sea = msgspec.structs.replace(hidden.sea, current_mps=0.02, wind_mps=0.5)  # interrupted so often she drifts for long
        self.boat = SimulatedTrial(settings, hidden._replace(sea=sea), SEED, RADIUS_M, self.look)
        self.at_s, self.how, self.is_gone = float("inf"), "", False
        self.keep = session.keep
        monkeypatch.setattr(session, "keep", self.kept)
        monkeypatch.setattr(SimulatedTrial, "end", self.ended(SimulatedTrial.end))

    def kept(self, place: Path, progress: TrialProgress) -> None:
        if not self.is_gone:  # a program that was killed keeps nothing
            self.keep(place, progress)

    def ended(self, end: Callable[[SimulatedTrial, str], None]) -> Callable[[SimulatedTrial, str], None]:
        return lambda boat, mode: None if self.is_gone else end(boat, mode)

    def look(self, boat: SimulatedTrial) -> None:
        if boat.run.elapsed_s < self.at_s:
            return
        self.at_s = float("inf")
        if self.how == "stop":
            boat.run.command(console.Stop())
        elif self.how == "boat killed":
            boat.run.restart(1.0)
        else:
            self.is_gone = True
            raise Gone

    def sail(self, how: str = "", after_s: float = 0.0) -> str:
        """A session, interrupted so after this time. Returns why it ended; empty: it is whole."""
        self.is_gone, self.how = False, how
        self.at_s = self.boat.run.elapsed_s + after_s if how else float("inf")
        told = TrialSession(
            self.boat,
            self.settings,
            kept(self.place, self.settings),
            self.place,
            RADIUS_M,
            lambda words: True,
            lambda words: None,
        )
        try:
            return told.run()
        except Gone:
            return "gone"


@pytest.mark.parametrize("proven", [False, pytest.param(True, marks=pytest.mark.long)])
def test_whatever_ends_it_the_motors_are_off_the_file_is_whole_and_it_goes_on(
    proven: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, random = vehicle("heron", f"adopted.proven={str(proven).lower()}"), Random(f"interrupted {proven}")
    trial = Interrupted(settings, tmp_path / "a.trial", monkeypatch)
    done = tuple[str, ...]()
    ways = list(WAYS) * (TIMES // len(WAYS))
    random.shuffle(ways)
    for how in ways:
        ended = trial.sail(how, random.uniform(0.5, 90.0))
        assert ended, "it has its reason in words"
        run = trial.boat.run
        off_s = run.elapsed_s + OFF_S
        for state in run.cycles(LOOK_S):
            if run.elapsed_s > off_s:
                assert state.mode in (Mode.IDLE, Mode.HOLD), (how, state.mode, state.reason)
                assert proven or not state.actuation.run
        progress = kept(trial.place, settings)
        assert progress.done[: len(done)] == done, "what came to its end is not sailed again"
        done = progress.done
    assert trial.sail() == ""
    progress = kept(trial.place, settings)
    assert set(progress.done) >= set(STEPS)
    assert progress.is_proven
    times = [each.at_s for each in progress.tape]
    assert times == sorted(times)
