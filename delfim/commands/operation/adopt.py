"""`delfim adopt`: the boat finds out about itself, by a trial of its motors and its hull on the water (docs/adopt.md)."""

import argparse
import contextlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from delfim.commands import shipped, vehicle_file

RADIUS_M = 60.0


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--radius", type=metres, default=RADIUS_M, metavar="M", help="Of her circle: 15 to 160.")
    parser.add_argument("--output", default="adopt", metavar="FOLDER", help="Keep the trial here; it goes on from there.")
    parser.add_argument("--afresh", action="store_true", help="Forget a trial that was interrupted.")
    parser.add_argument("--berth", action="store_true", help="Turn each motor for a second, with lines on, and no more.")
    parser.add_argument("--yes", action="store_true", help="Answer each question with yes.")
    parser.add_argument("--sim", type=int, metavar="SEED", help="Try it on a boat that is drawn, and is not as the file says.")


def metres(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 15.0 <= float(text) <= 160.0:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is not a number of metres from 15 to 160")


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns 1 where the trial did not come to its end, or its proof failed."""
    from delfim import config
    from delfim.adoption.suited import BY_HAND, unfit
    from delfim.adoption.trial import dialogue, session
    from delfim.base.errors import DelfimError

    asked.file = asked.file if asked.sim is None else shipped(asked.file)
    name = Path(asked.file).stem if asked.sim is None else f"{Path(asked.file).stem}-{asked.sim}"
    place, file = Path(asked.output) / f"{name}.trial", asked.file
    if asked.afresh:
        place.unlink(missing_ok=True)
    if asked.sim is not None and not asked.berth:
        file = dialogue.copied(asked.file, place.with_suffix(".toml"), afresh=not place.exists())
    settings = config.load(file, asked.set)
    if why := unfit(settings.thrusters):
        raise DelfimError(f"{asked.file}: this boat cannot be adopted: {why}; {BY_HAND}")
    progress, person = session.kept(place, settings), dialogue.Dialogue(is_yes=asked.yes)
    if asked.berth or not progress.is_whole:
        code = _trial(asked, settings, progress, place, person)
        if code is not None:
            return code
    if progress.written is None or not progress.written.gains:
        refused = dialogue.adopted(progress, place, file, f"{datetime.now(UTC):%Y-%m-%d}", person)
        if refused or asked.sim is None or progress.written is None or not progress.written.gains:
            return refused
    elif progress.written.proof:
        print(f"Adopted already, on {progress.written.on}: {progress.written.proof}. --afresh begins anew.")
        return 0
    return _proof(asked, file, settings, progress, place, person)


def _trial(asked: argparse.Namespace, settings: Any, progress: Any, place: Path, person: Any) -> int | None:
    """Sail the trial, or the rest of it. Returns the code with which the command ends; None: the trial is whole."""
    from delfim.adoption.trial import dialogue, session

    if progress.is_proven:
        print(f"Goes on with {place}, behind: {', '.join(('motors', *dict.fromkeys(progress.done)))}. --afresh begins anew.")
    with contextlib.ExitStack() as held:
        boat: Any
        if asked.sim is not None:
            boat, truth = dialogue.simulated(settings, asked.sim, asked.radius)
            print(f"A boat is drawn: {truth}")
        else:
            boat = dialogue.running(settings, asked.radius, progress, person, held)
        if asked.berth:
            dialogue.at_the_berth(boat, settings, person)
            return 0
        if asked.sim is None:
            dialogue.may_begin(settings, boat.sails_by, asked.file, person)
        if not person.ask(dialogue.before(settings, asked.radius, dialogue.ENDS)):
            return 1
        try:
            ended = session.TrialSession(boat, settings, progress, place, asked.radius, person.ask, person.tell).run()
        except KeyboardInterrupt:
            ended = "Ctrl-C"
    return dialogue.interrupted(progress, ended, place, person) if ended else None


def _proof(asked: argparse.Namespace, file: str, settings: Any, progress: Any, place: Path, person: Any) -> int:
    """Sail the proof. Returns the exit code."""
    from delfim import config
    from delfim.adoption.trial import dialogue

    with contextlib.ExitStack() as held:
        boat: Any
        if asked.sim is not None:
            boat = dialogue.simulated_proof(config.load(asked.file), file, asked.sim, asked.radius)
        else:
            boat = dialogue.running_proof(settings, asked.radius, progress, person, held)
            dialogue.may_prove(settings, boat.sails_by, file, asked.radius, person)
        return dialogue.proof(progress, place, file, boat, asked.radius, person)
