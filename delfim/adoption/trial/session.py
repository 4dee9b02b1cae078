"""A trial from its first question to its record: what is asked of a person, what is kept, where it goes on.

After each manoeuvre what was found and seen is kept in one file, which is replaced as a whole. A trial that was interrupted
goes on behind the last one that came to its end.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import msgspec

from delfim import config
from delfim.adoption.suited import hull_unfit, is_several, parts_told
from delfim.adoption.trial.manoeuvres import FAR, BoatOnTrial, MotionSeen, Played, SeaTrial, TrialEnded
from delfim.adoption.trial.motors import DriftNoise, MotorsFound, Wiring, wiring
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file

KEPT_BYTES: Final = 50_000_000  # a trial of twenty minutes has 3 MB
APART_S: Final = 60.0  # between the clocks of two sessions in one record
DRIFT_S: Final = 15.0
CIRCLES: Final = "circles"
VALUES: Final = {"position": 3, "velocity": 3, "heading": 2, "rate": 2}  # of a measurement, with its time
BENT_RAD: Final = math.radians(11.0)  # in a quick turn a compass that is bent by more is one that jumps, for the estimator ...
JUMPED: Final = "heading jumped"
BENT: Final = ": iron bends the compass too much for a quick turn; give it another place, or set [compass] before"
SLOW_RADPS: Final = math.radians(15.0)  # ... and in one as slow as this it is not
MOTORS_WORDS: Final = (
    *("Each motor by itself, with little power first, then both.", "Both motors push her ahead."),
    "A turn to starboard, which was not tried yet.",
)
STEERED_WORDS: Final = (
    *("The motor ahead and astern, then what turns it, with little power first.", "The motor pushes her ahead."),
    "Steers to starboard and to port, by what was found.",
)
SEVERAL_WORDS: Final = (
    *("Each motor by itself, with little power first, then all in patterns.", "Those that push ahead do."),
    "A turn to starboard by all, which was not tried yet.",
)
LAST: Final = "drift again"  # of the manoeuvres


class Written(msgspec.Struct, frozen=True):
    """What of a trial is in the vehicle's file."""

    on: str  # the day
    thrusters: tuple[config.ThrusterTable, ...]  # of the file since then
    gains: tuple[tuple[str, ...], ...] = ()  # its keys that a proof sail must prove
    proof: str = ""  # what became of it, in words


class TrialProgress(msgspec.Struct):
    """What is known of a trial so far."""

    thrusters: tuple[config.ThrusterTable, ...]  # of the file with which it began
    middle: tuple[float, float] | None = None  # of the circle: latitude and longitude, degrees
    quiet: DriftNoise = DriftNoise(0.0, 0.0)
    motors: MotorsFound | None = None
    is_proven: bool = False
    done: tuple[str, ...] = ()  # manoeuvres that came to their end
    tape: list[MotionSeen] = []
    played: list[Played] = []
    written: Written | None = None

    @property
    def is_whole(self) -> bool:
        """Whether every manoeuvre came to its end, of those that this boat sails."""
        return self.is_proven and (LAST in self.done or bool(hull_unfit(self.thrusters)))

    @property
    def wiring(self) -> Wiring | None:
        return None if self.motors is None else wiring(self.motors, self.thrusters)


def kept(place: Path, settings: config.Vehicle) -> TrialProgress:
    """The progress that was kept for a boat with these thrusters, before or after they were corrected, or a new one."""
    try:
        found = msgspec.json.decode(read_file(place, KEPT_BYTES), type=TrialProgress)
    except (OSError, msgspec.MsgspecError, ValueError):
        return TrialProgress(settings.thrusters)
    rows = (found.thrusters, found.written.thrusters) if found.written is not None else (found.thrusters,)
    return found if settings.thrusters in rows and _is_whole(found) else TrialProgress(settings.thrusters)


def _is_whole(kept: TrialProgress) -> bool:
    """Whether a trial can have left this: times in order, a part for each thruster, motors with a side each."""
    if (found := kept.motors) is not None:
        alike = len(found.sides) == len(found.signs) == len(found.least) == len(kept.thrusters)
        if not alike or not {*found.sides, *found.signs} <= {1, -1} or (not found.steers and set(found.sides) != {1, -1}):
            return False
        if found.places != () and (not is_several(kept.thrusters) or sorted(found.places) != [*range(len(kept.thrusters))]):
            return False
        if is_several(kept.thrusters) and not found.places:
            return False
    parts = parts_told(kept.thrusters)
    times_s = [each.at_s for each in kept.tape]
    if any(len(value) != VALUES.get(kind, 0) for each in kept.tape for kind, value in (each.measured or {}).items()):
        return False
    return times_s == sorted(times_s) and all(len(each.told) == parts for each in kept.tape)


def keep(place: Path, progress: TrialProgress) -> None:
    """Replace the file as a whole."""
    place.parent.mkdir(parents=True, exist_ok=True)
    replace_file(place, msgspec.json.encode(progress))


class TrialSession:
    """A trial with a person. `ask` is a question whose answer is yes or no, `tell` a sentence."""

    def __init__(
        self,
        boat: BoatOnTrial,
        settings: config.Vehicle,
        progress: TrialProgress,
        place: Path,
        radius_m: float,
        ask: Callable[[str], bool],
        tell: Callable[[str], object],
    ) -> None:
        self.progress, self._settings, self._place, self._ask, self._tell = progress, settings, place, ask, tell
        progress.middle = boat.middle
        rows = settings.thrusters
        length_m, several = settings.boat.length_m, rows if is_several(rows) else ()
        self.trial = SeaTrial(boat, length_m, radius_m, self._step, steers=len(rows) == 1, rows=several)
        self.trial.motors, self.trial.quiet = progress.motors, progress.quiet
        before = progress.tape[-1].at_s + APART_S if progress.tape else 0.0
        self._shift_s = before - self.trial.began_s
        self._boat, self._at, self._played = boat, 0, 0

    def run(self) -> str:
        """Play what is left of the trial. Returns why it ended before its time, in words; empty: it is whole."""
        try:
            with self._ended_safely():
                if not self.progress.is_proven:
                    self._motors()
                if hull_unfit(self.progress.thrusters):
                    return ""
                if CIRCLES in self.progress.done:
                    self._compass()
                self.trial.hull(self.progress.done, self._did)
        except TrialEnded as end:
            return f"{end}{BENT}" if str(end).startswith(JUMPED) else str(end)
        return ""

    @contextlib.contextmanager
    def _ended_safely(self) -> Iterator[None]:
        """Whatever happens, the trial ends with the motors off, or in hold where a failsafe may hold, too."""
        mode = "idle"
        try:
            yield
            mode = "hold" if self._settings.adopted.proven else "idle"
        finally:
            with contextlib.suppress(DelfimError):  # a boat that hears nothing any more has ended it by itself
                self._boat.end(mode)
            self._keep()

    def _motors(self) -> None:
        trial, progress = self.trial, self.progress
        trial.play("drift", "Motors off: what wind, current and noise do.", lambda: trial.drift(DRIFT_S))
        progress.quiet = trial.quiet
        each, both, proof = STEERED_WORDS if trial.steers else SEVERAL_WORDS if trial.rows else MOTORS_WORDS
        trial.play("motors", each, trial.find_motors)
        if trial.gyro_is_upside_down:  # and then the sides of the motors are exchanged
            progress.motors = None
            raise TrialEnded("the gyro says port where the compass says starboard: mend its sign first (delfim sensors --turn)")
        progress.motors = trial.motors
        for sentence in self.differences() or ["The motors are as the file says."]:
            self._tell(sentence)
        trial.play("bow first", both, trial.push_ahead)
        trial.pause()
        if not self._ask("Did she move bow first?"):
            progress.motors = None
            raise TrialEnded("she goes astern when she is to go ahead, by the compass: is it turned by 180 degrees?")
        if trial.seen.far_m > FAR * trial.radius_m:
            trial.play("back", "Back to the middle, by what was found.", lambda: trial.back(is_proven=False))
        trial.play("proof", proof, trial.prove_motors)
        progress.is_proven = True
        self._tell("The motors are proven.")
        self._keep()

    def differences(self) -> list[str]:
        """How the boat differs from its file, a sentence each."""
        found = self.progress.wiring
        return [] if found is None else found.words(self.progress.thrusters)

    def _did(self, name: str) -> None:
        self.progress.done = (*self.progress.done, name)
        self._keep()
        if name == CIRCLES:
            self._compass()

    def _compass(self) -> None:
        """What the circles tell of the compass: whether it can be set at this place, and how quickly she may turn with it."""
        from delfim.adoption.magnet import shape_of  # numpy, which the motors do not need
        from delfim.adoption.trial.taped import record_of

        try:
            shape = shape_of(record_of(self.progress, is_estimated=self._settings.navigation.estimator))
        except DelfimError as error:
            self._tell(f"The circles say nothing of the compass: {error}.")
            return
        if why := shape.hopeless:  # the circles are sailed again, about another place
            self.progress.done = tuple(each for each in self.progress.done if each != CIRCLES)
            self.progress.middle = None
            raise TrialEnded(why)
        self._tell(f"The boat's iron bends the compass by {math.degrees(shape.deviation_rad):.0f} degrees at most.")
        if shape.deviation_rad > BENT_RAD:
            self.trial.turn_most_radps = SLOW_RADPS

    def _step(self, words: str) -> None:
        self._tell(f"{self.trial.elapsed_s:5.0f} s  {self.trial.seen.far_m:3.0f} m  {words}")

    def _keep(self) -> None:
        new, self._at = self.trial.tape[self._at :], len(self.trial.tape)
        self.progress.tape += [_shifted(each, self._shift_s) for each in new]
        done, self._played, shift_s = self.trial.played[self._played :], len(self.trial.played), self._shift_s
        self.progress.played += [each._replace(from_s=each.from_s + shift_s, to_s=each.to_s + shift_s) for each in done]
        keep(self._place, self.progress)


def _shifted(seen: MotionSeen, by_s: float) -> MotionSeen:
    measured = seen.measured and {kind: (value[0] + by_s, *value[1:]) for kind, value in seen.measured.items()}
    return seen._replace(at_s=seen.at_s + by_s, measured=measured)
