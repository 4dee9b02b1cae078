"""One adoption from the first doublet to a mission beside the twin: a row of figures. The boat is the one that
`delfim adopt FILE --sim SEED` draws."""

import math
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec

from delfim import config
from delfim.adoption import identify
from delfim.adoption.suited import BY_HAND, unfit
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.concluding import conclude
from delfim.adoption.trial.dialogue import NOISE
from delfim.adoption.trial.hiddenhull import Hidden, drawn, rewired
from delfim.adoption.trial.motors import corrected
from delfim.adoption.trial.proof import SimulatedProof, proved
from delfim.adoption.trial.session import TrialProgress, TrialSession
from delfim.adoption.trial.taped import record_of
from delfim.adoption.twin.twinvoyage import TwinVoyage
from delfim.base import tables
from delfim.base.errors import DelfimError
from delfim.campaign.adopted.columns import VOYAGE
from delfim.campaign.adopted.truth import figures_off, is_right, truth
from delfim.campaign.adopted.voyages import RADIUS_M, least_s, of_truth, twin_off_m, voyage

DAY: Final = "2026-11-28"  # of what is found: no clock
BEYOND: Final = 1.25  # radii of the circle: never

Look = Callable[[], None]  # called in each cycle of the trial; it raises what ends the run


def figures(boat: dict[str, Any], name: str, seed: int, look: Look) -> tuple[dict[str, Any], list[str]]:
    """Adopt the boat of this seed. `boat`: the vehicle's file as a tree; returns the columns, and what must never be, in words.
    Raises DelfimError."""
    of_seed = {key: float(value) for key, value in NOISE.items()}
    tree = boat | {"adopted": {"proven": False}, "simulation": boat.get("simulation", {}) | of_seed}
    tree["simulation"].pop("mission", None)
    was = config.read(tree, name)
    if why := unfit(was.thrusters):
        raise DelfimError(f"{name}: this boat cannot be adopted: {why}; {BY_HAND}")
    hidden, most_m = drawn(was, seed), [0.0]

    def looks(its: SimulatedTrial) -> None:
        most_m[0] = max(most_m[0], math.hypot(its.model.north_m - its.middle_m[0], its.model.east_m - its.middle_m[1]))
        look()

    with TemporaryDirectory(prefix="delfim-adoption-") as folder:
        file, progress = Path(folder) / f"{name}.toml", TrialProgress(was.thrusters)
        file.write_text(tables.text_of(tree), encoding="utf-8")
        sails = SimulatedTrial(was, hidden, seed, RADIUS_M, looks)
        trial = TrialSession(sails, was, progress, file.with_suffix(".trial"), RADIUS_M, lambda words: True, _quiet)
        ended = trial.run()
        found = progress.wiring
        motors = "none" if found is None else "right" if is_right(found, hidden, was.thrusters) else "wrong"
        row = {"ended": ended, "motors": motors, "sailed_s": trial.trial.elapsed_s}
        row |= {"most_m": most_m[0], "most_part": most_m[0] / RADIUS_M}
        never = [] if motors != "wrong" else ["motors were told wrong"]
        never += [] if most_m[0] <= BEYOND * RADIUS_M else ["she left the circle by more than its quarter"]
        return row | ({} if ended else _concluded(was, hidden, progress, file, seed)), never


def _concluded(was: config.Vehicle, hidden: Hidden, progress: TrialProgress, file: Path, seed: int) -> dict[str, Any]:
    """What a whole trial has found, and how she sails with it."""
    assert progress.motors is not None
    rows = zip(was.thrusters, corrected(progress.motors, was.thrusters), strict=True)
    owner = msgspec.structs.replace(was, thrusters=tuple(msgspec.structs.replace(each, **keys) for each, keys in rows))
    try:
        result = identify.identified(record_of(progress, is_estimated=was.navigation.estimator), owner, DAY)
    except DelfimError as error:
        return {"refused": str(error)}
    if result.fit.refusal:
        return {"refused": result.fit.refusal}
    row = figures_off(result, was, hidden, truth(was, hidden))
    refused = conclude(progress, file, file.with_suffix(".html"), DAY, lambda words: True, _quiet)
    return row | {"refused": refused} | ({} if refused else sailed_with(was, config.load(file), hidden, seed))


def sailed_with(was: config.Vehicle, adopted: config.Vehicle, hidden: Hidden, seed: int) -> dict[str, Any]:
    """The voyages of the true boat, and of her twin."""
    true, cruise_mps = rewired(hidden, adopted.thrusters), adopted.control.speed.cruise_mps
    today = msgspec.structs.replace(adopted, control=was.control, boat=was.boat)
    files = {"": adopted, "today_": today, "truth_": of_truth(was, adopted, true)}
    row = dict[str, Any]()
    for of, settings in files.items():
        its = voyage(settings, true, seed, cruise_mps)
        row |= {f"{of}{name}": value for name, value in _told(its).items()}
    worse = not_proven(adopted, true, seed)
    rms_m, twin_m = twin_off_m(adopted, true, seed)
    row |= {"proof": worse, "proven": int(not worse), "twin_rms_m": rms_m, "twin_most_m": twin_m}
    return row | ({} if adopted.thrusters[0].steer is not None else {"least_s": least_s(adopted, true, seed)})


def _told(its: TwinVoyage) -> dict[str, float]:
    told = its.quarter.over_deg, its.quarter.settled_s, its.path_m, its.hold_m, its.speed_off
    return dict(zip(VOYAGE, told, strict=True))


def not_proven(adopted: config.Vehicle, true: Hidden, seed: int) -> str:
    """Why the proof sail does not prove her, in words; empty: it does."""
    try:
        return proved(SimulatedProof(SimulatedTrial(adopted, true, seed + 1, RADIUS_M).run), adopted, RADIUS_M, _quiet)
    except DelfimError as error:
        return str(error)


def _quiet(words: str) -> None:
    pass
