"""What `delfim adopt` says and asks: a sentence a step, a key for yes or no, and the space bar that ends it."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Protocol

from delfim import config
from delfim.adoption.trial.boats import RunningTrial, SimulatedTrial
from delfim.adoption.trial.hiddenhull import drawn
from delfim.adoption.trial.session import TrialProgress
from delfim.services.bench import keys, pressed
from delfim.vehicle.operator.link import Link

BEFORE: Final = (
    "{name} will drive by herself for about 12 minutes, at times with full power, in a circle of {radius_m:g} m about here.\n"
    "Begin upstream and upwind, away from piers. Space or Ctrl-C ends it, STOP on the page, too. Is the circle free?"
)
NOISE: Final = {"position_noise_m": "1.0", "speed_noise_mps": "0.05", "heading_noise_deg": "2.0"}  # of a drawn boat's sensors


class Person(Protocol):
    """Who is asked and told."""

    def tell(self, words: str) -> object:
        """A sentence."""

    def ask(self, question: str) -> bool:
        """A question whose answer is yes or no."""


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


def running(
    settings: config.Vehicle, radius_m: float, progress: TrialProgress, dialogue: Dialogue, held: contextlib.ExitStack
) -> RunningTrial:
    """The boat that runs on this computer. Raises DelfimError."""
    link = held.enter_context(Link(settings.console.socket))
    held.enter_context(dialogue.listening())
    middle = progress.middle if progress.is_proven else None  # until then she only drifts: the circle is where she is
    return RunningTrial(link, radius_m, dialogue.is_ended, middle)


def at_the_berth(boat: RunningTrial | SimulatedTrial, settings: config.Vehicle, dialogue: Dialogue) -> None:
    """Each motor for a second: a dead or unarmed one shows. Side and direction do not, for the lines hold the boat."""
    if not dialogue.ask("Lines on, bow out, nobody near the propellers?"):
        return
    for row in settings.thrusters:
        told = boat.turn_alone(row.name)
        if not dialogue.ask(f"{row.name}: {told}. Did it turn, and stop?"):
            dialogue.tell(f"{row.name}: see docs/bench.md: power, arming, address, dead band.")
            return
    dialogue.tell("Both motors turn and stop. Now on the water.")


def outcome(progress: TrialProgress, ended: str, place: Path, file: str, on: str, dialogue: Person, *, may_write: bool) -> int:
    """Say what was found; of a whole trial the hull, too. Returns the exit code."""
    from delfim.adoption.trial.concluding import conclude, motors_told  # numpy, which a trial alone need not load

    if ended:
        dialogue.tell(f"The trial ended: {ended}.")
        motors_told(progress, dialogue.tell)
        dialogue.tell(f"It is kept in {place}: the same command goes on with it.")
        return 1
    ask = dialogue.ask if may_write else None
    refused = conclude(progress, Path(file), place.with_suffix(".html"), on, ask, dialogue.tell)
    if refused:
        dialogue.tell(f"The hull is not adopted: {refused}.")
    return 1 if refused else 0
