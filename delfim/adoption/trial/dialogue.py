"""What `delfim adopt` says and asks: a sentence a step, a key for yes or no, and the space bar that ends it."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from delfim import config
from delfim.adoption.suited import hull_unfit
from delfim.adoption.trial.boats import RunningTrial, SimulatedTrial
from delfim.adoption.trial.hiddenhull import drawn, rewired
from delfim.adoption.trial.proof import ProofBoat, RunningProof, SimulatedProof, proved
from delfim.adoption.trial.session import TrialProgress, keep
from delfim.adoption.writing import Key, changed, put_back
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.wholefile import replace_file
from delfim.services.bench import keys, pressed
from delfim.vehicle.operator.link import Link

BEFORE: Final = (
    "{name} will drive by herself for about {minutes} minutes, at times with {power} power, in a circle of {radius_m:g} m.\n"
    "Begin upstream and upwind, away from piers. {ends}. Is the circle free?"
)
ENDS: Final = "Space or Ctrl-C ends it, STOP on the page, too"
AGAIN: Final = (
    "{file} has what was found. {name} will turn twice, stop and hold for a minute: the proof sail, within {radius_m:g} m.\n"
    "{started}s the circle free?"
)
STARTED: Final = "Was her program started again since, and i"  # asked where she does not tell it
OTHER: Final = "{name} sails by another file than {file}, as it is now: put it aboard, and start her program again"
NOISE: Final = {"position_noise_m": "1.0", "speed_noise_mps": "0.05", "heading_noise_deg": "2.0"}  # of a drawn boat's sensors


class Person(Protocol):
    """Who is asked and told."""

    def tell(self, words: str) -> object:
        """A sentence."""

    def ask(self, question: str) -> bool:
        """A question whose answer is yes or no."""


class BerthBoat(Protocol):
    """A boat at the berth."""

    def turn_alone(self, name: str) -> str:
        """Turn a motor for a second; what it did, in words. Raises DelfimError."""


class Dialogue:
    """The person at the terminal, or who answers yes to all."""

    def __init__(self, *, is_yes: bool) -> None:
        self._is_yes, self._is_terminal = is_yes, sys.stdin.isatty()

    def tell(self, words: str) -> None:
        print(words, flush=True)

    def ask(self, question: str) -> bool:
        """A question whose answer is yes or no; the end of the input is no."""
        print(f"{question} [y/n] ", end="", flush=True)
        if self._is_yes:
            print("y")
            return True
        while True:
            read = os.read(sys.stdin.fileno(), 64).decode(errors="replace") if self._is_terminal else sys.stdin.readline()
            if not (word := read.lower()) or word[0] in "yn":
                print(word[:1].strip() or "n", flush=True)
                return word[:1] == "y"

    def is_ended(self) -> bool:
        """Whether a key was pressed: any ends the trial."""
        return self._is_terminal and pressed(0.0)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Hear single keys."""
        with keys() if self._is_terminal else contextlib.nullcontext():
            yield


def simulated(settings: config.Vehicle, seed: int, radius_m: float) -> tuple[SimulatedTrial, str]:
    """A drawn boat, and the truth about her in words."""
    hidden = drawn(settings, seed)
    return SimulatedTrial(settings, hidden, seed, radius_m), hidden.words()


def simulated_proof(was: config.Vehicle, file: str, seed: int, radius_m: float) -> SimulatedProof:
    """The boat that was drawn of the file as it was, started again with this one."""
    settings = config.load(file)
    hidden = rewired(drawn(was, seed), settings.thrusters)
    return SimulatedProof(SimulatedTrial(settings, hidden, seed, radius_m).run)


def running_proof(
    settings: config.Vehicle, radius_m: float, progress: TrialProgress, dialogue: Dialogue, held: contextlib.ExitStack
) -> RunningProof:
    """The boat that runs on this computer. Raises DelfimError."""
    link = held.enter_context(Link(settings.console.socket))
    held.enter_context(dialogue.listening())
    return RunningProof(link, progress.middle, radius_m, dialogue.is_ended)


def running(
    settings: config.Vehicle, radius_m: float, progress: TrialProgress, dialogue: Dialogue, held: contextlib.ExitStack
) -> RunningTrial:
    """The boat that runs on this computer. Raises DelfimError."""
    link = held.enter_context(Link(settings.console.socket))
    held.enter_context(dialogue.listening())
    middle = progress.middle if progress.is_proven else None  # until then she only drifts: the circle is where she is
    return RunningTrial(link, settings.thrusters, radius_m, dialogue.is_ended, middle)


def before(settings: config.Vehicle, radius_m: float, ends: str) -> str:
    """The question before a trial. `ends`: what ends it, in words."""
    minutes, power = ("3", "much") if hull_unfit(settings.thrusters) else ("12", "full")
    return BEFORE.format(name=settings.boat.name, minutes=minutes, power=power, radius_m=radius_m, ends=ends)


def other_file(settings: config.Vehicle, told: str, file: str | Path) -> str:
    """That a boat which tells this digest sails by another file, in words; empty: by this one, or nobody knows."""
    return OTHER.format(name=settings.boat.name, file=file) if told and told != settings.sails_by else ""


def may_begin(settings: config.Vehicle, told: str, file: str | Path, person: Person) -> None:
    """Ask where a boat sails by another file. Raises DelfimError where she is not to begin all the same."""
    if (other := other_file(settings, told, file)) and not person.ask(f"{other}. Begin all the same?"):
        raise DelfimError(other)


def may_prove(settings: config.Vehicle, told: str, file: str | Path, radius_m: float, person: Person) -> None:
    """Ask whether the proof sail may begin. Raises DelfimError where she has not what was found yet, or it may not."""
    if other := other_file(settings, told, file):
        raise DelfimError(f"{other}; then the proof sail is next")
    started = "I" if told else STARTED
    if not person.ask(AGAIN.format(file=file, name=settings.boat.name, radius_m=radius_m, started=started)):
        raise DelfimError("the proof sail waits: the same again begins with it")


def at_the_berth(boat: BerthBoat, settings: config.Vehicle, dialogue: Person) -> None:
    """Each motor for a second: a dead or unarmed one shows. Side and direction do not, for the lines hold the boat."""
    if not dialogue.ask("Lines on, bow out, nobody near the propellers?"):
        return
    for row in settings.thrusters:
        told = boat.turn_alone(row.name)
        if not dialogue.ask(f"{row.name}: {told}. Did it turn, and stop?"):
            dialogue.tell(f"{row.name}: see docs/bench.md: power, arming, address, dead band.")
            return
    dialogue.tell("The motors turn and stop. Now on the water.")


def interrupted(progress: TrialProgress, ended: str, place: Path, dialogue: Person) -> int:
    """Say what is known of a trial that ended before its time. Returns the exit code."""
    from delfim.adoption.trial.concluding import motors_told  # numpy, which a trial alone need not load

    dialogue.tell(f"The trial ended: {ended}.")
    motors_told(progress, dialogue.tell)
    dialogue.tell(f"It is kept in {place}: the same goes on with it.")
    return 1


def adopted(progress: TrialProgress, place: Path, file: str, on: str, dialogue: Person) -> int:
    """Say what a whole trial found of the boat, and write what is agreed to. Returns the exit code."""
    from delfim.adoption.trial.concluding import conclude

    report = place.with_suffix(".html")
    refused = conclude(progress, Path(file), report, on, dialogue.ask, dialogue.tell, lambda: keep(place, progress))
    keep(place, progress)
    if refused:
        dialogue.tell(f"The hull is not adopted: {refused}. Begin afresh (--afresh) where that is mended.")
    if progress.written is not None and progress.written.gains:
        dialogue.tell(f"{file} is written. Start her program again with it; the same then goes on with the proof sail.")
    return 1 if refused else 0


def copied(file: str, place: Path, *, afresh: bool) -> str:
    """A copy of the vehicle's file for a boat that is drawn, whose sensors are not good; the name of it."""
    if afresh or not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        text, words = read_text(file), "of a drawn boat"
        other: dict[Key, tuple[Any, str]] = {("simulation", key): (float(of), words) for key, of in NOISE.items()}
        if mission := parse_toml(text).get("simulation", {}).get("mission"):
            beside = os.path.relpath(Path(file).parent / mission, place.parent)  # from where the copy is
            other["simulation", "mission"] = beside, words
        replace_file(place, changed(text, other, file))
    return str(place)


def proof(progress: TrialProgress, place: Path, file: str, boat: ProofBoat, radius_m: float, dialogue: Person) -> int:
    """The proof sail. Gains that it does not prove are put back in the file. Returns the exit code."""
    written = progress.written
    assert written is not None
    try:
        worse = proved(boat, config.load(file), radius_m, dialogue.tell)
    except DelfimError as error:
        dialogue.tell(f"{error}. Nothing is changed: the same command tries again.")
        return 1
    if worse:
        replace_file(Path(file), put_back(read_text(file), written.gains, file))
        dialogue.tell(f"Not proven: {worse}. The gains before are in {file} again: start the boat's program again.")
    else:
        dialogue.tell("Proven: she does as her twin foretold, or better.")
    progress.written = msgspec.structs.replace(written, proof=f"not proven: {worse}" if worse else "proven")
    keep(place, progress)
    return 1 if worse else 0
