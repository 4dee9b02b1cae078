"""From a state log to what is known of the boat: the steps of `delfim identify`."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from delfim import config
from delfim.adoption.fitting import Fit, fitted
from delfim.adoption.foretold import motors_of, prior
from delfim.adoption.found import BoatFindings, FoundKey, findings
from delfim.adoption.record import BoatRecord, read_log
from delfim.adoption.windows import windows_of
from delfim.adoption.writing import write as written
from delfim.base.errors import DelfimError
from delfim.logging.ashore.tree import LogFile


class Identified(NamedTuple):
    """What came of a record."""

    record: BoatRecord
    fit: Fit
    found: BoatFindings
    on: str  # the day of its end, YYYY-MM-DD


def of_log(files: Sequence[LogFile], vehicle: config.Vehicle) -> Identified:
    """Fit state logs. Raises DelfimError, in words, where they cannot tell what is asked."""
    record = read_log(files)
    ended = datetime.fromtimestamp(max(file.end_ns for file in files) / 1e9, UTC)
    return identified(record, vehicle, f"{ended:%Y-%m-%d}")


def identified(record: BoatRecord, vehicle: config.Vehicle, on: str) -> Identified:
    """Fit a record of the boat of this file, whose thrusters are those of the record. Raises DelfimError, in words."""
    motors, names = motors_of(vehicle), tuple(row.name for row in vehicle.thrusters)
    if record.thrusters != names:
        raise DelfimError(f"the record is of thrusters {', '.join(record.thrusters)}, the file has {', '.join(names)}")
    windows = windows_of(record, *((motor.row, motor.sign) for motor in (motors.starboard, motors.port)))
    fit = fitted(windows, prior(vehicle))
    return Identified(record, fit, findings(fit, vehicle, is_raw=record.is_raw), on)


def told(result: Identified) -> Iterator[str]:
    """What was found, in lines for a terminal."""
    fit, found = result.fit, result.found
    seconds = len(fit.windows.from_s) * fit.windows.steps * fit.windows.step_s
    yield f"{result.record.source}: {seconds:.0f} s of {result.record.seconds:.0f} s looked at; chi2 {fit.chi2:.2f}"
    if fit.refusal:
        yield f"refused: {fit.refusal}"
        return
    yield f"{'':44}{'found':>9}{'':>9}{'the file':>11}"
    for each in found.figures.values():
        beyond = "  extrapolated" if each.is_beyond else ""
        yield f"{each.words:44}{each.found:9.2f} ±{each.spread:<7.2g}{each.told:11.2f} {each.unit}{beyond}"
    yield from (f"changed: {each}" for each in found.changes)
    yield from (f"not seen: {each}" for each in found.unseen)


def report(result: Identified, vehicle: config.Vehicle, place: Path, command: str) -> None:
    """Write the page."""
    from delfim.adoption.report import page  # matplotlib: a quarter of a second, which a fit alone need not pay

    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(page(vehicle.boat.name, result.record, result.fit, result.found, command), encoding="utf-8")


def write(result: Identified, file: Path) -> None:
    """Write what was found into the vehicle's file. Raises DelfimError where the fit is refused."""
    if result.fit.refusal:
        raise DelfimError(f"{file}: not written: {result.fit.refusal}")
    facts = {"on": result.on, "log": result.record.digest, "chi2": round(result.fit.chi2, 2)}
    kept = [FoundKey(("adopted", key), value, None, None) for key, value in facts.items()]
    written(file, [*result.found.keys, *kept], f"found {result.on}")
