"""From a state log to what is known of the boat: the steps of `delfim identify`."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from delfim import config
from delfim.adoption.fitting import Fit, fitted
from delfim.adoption.foretold import gear_of, motors_of, prior, pushes_of
from delfim.adoption.found import BoatFindings, findings
from delfim.adoption.record import TRIAL, BoatRecord, read_log
from delfim.adoption.suited import hull_unfit, place_of
from delfim.adoption.twin.gains import ChosenGains
from delfim.adoption.twin.twintrack import TwinTrack, twin_track
from delfim.adoption.windows import windows_of
from delfim.adoption.writing import FoundKey, with_keys
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.wholefile import replace_file
from delfim.logging.ashore.tree import LogFile, events
from delfim.vehicle.plans.mission import Mission


class Identified(NamedTuple):
    """What came of a record."""

    record: BoatRecord
    fit: Fit
    found: BoatFindings
    on: str  # the day of its end, YYYY-MM-DD
    gains: ChosenGains | None = None  # chosen on the twin, if they were asked for
    sailed: TwinTrack | None = None  # a mission of the record, and the twin in it


def of_log(files: Sequence[LogFile], vehicle: config.Vehicle) -> Identified:
    """Fit state logs. Raises DelfimError, in words, where they cannot tell what is asked."""
    record = read_log(files)
    ended = datetime.fromtimestamp(max(file.end_ns for file in files) / 1e9, UTC)
    return identified(record, vehicle, f"{ended:%Y-%m-%d}")


def vehicle_of(files: Sequence[LogFile]) -> config.Vehicle:
    """The vehicle's file with which the boat sailed last, as the sidecars of its logs have it. Raises DelfimError."""
    found = [each["settings"] for each in events(files) if each.get("event") == "start" and "settings" in each]
    if not found:
        raise DelfimError("these logs do not say with which vehicle's file the boat sailed: --vehicle FILE")
    return config.read(found[-1], "the log")


def since(files: Sequence[LogFile], vehicle: config.Vehicle) -> str:
    """What has changed since the hull in this file was found, in one line of words, as people hear it after each voyage."""
    known = vehicle.adopted.on
    if not known:
        return "hull and motors: the vehicle's file has none that was measured: delfim adopt, or delfim identify --write"
    try:
        result = of_log(files, vehicle)
    except DelfimError as error:
        return f"hull and motors since {known}: nobody knows: {error}"
    if result.fit.refusal:
        return f"hull and motors since {known}: nobody knows: {result.fit.refusal}"
    return f"hull and motors since {known}: {'; '.join(result.found.changes) or 'nothing has surely changed'}"


def identified(record: BoatRecord, vehicle: config.Vehicle, on: str) -> Identified:
    """Fit a record of the boat of this file, whose thrusters are those of the record. Raises DelfimError, in words."""
    motors, names = motors_of(vehicle), tuple(row.name for row in vehicle.thrusters)
    if record.source == TRIAL and (why := hull_unfit(vehicle.thrusters)):
        raise DelfimError(f"the hull of this boat cannot be identified: {why}")
    if record.thrusters != names:
        raise DelfimError(f"the record is of thrusters {', '.join(record.thrusters)}, the file has {', '.join(names)}")
    columns = [(motor.row, motor.sign) for motor in motors] if (gear := gear_of(vehicle)) is None else [(0, 1.0), (1, 1.0)]
    pushes = () if record.source == TRIAL else pushes_of(vehicle)  # a trial commands all at a side alike
    if pushes:
        columns = [(index, float(place_of(row).way or 1)) for index, row in enumerate(vehicle.thrusters)]
    windows = windows_of(record, columns, gear, pushes)
    fit = fitted(windows, prior(vehicle))
    return Identified(record, fit, findings(fit, vehicle, is_raw=record.is_raw), on)


def with_twin(result: Identified, files: Sequence[LogFile], mission: Mission, file: str) -> Identified:
    """The same with the mission of these logs as the twin sails it, where one was sailed. `file`: the vehicle's."""
    found = config.read(parse_toml(with_found(result, read_text(file), file)), file)
    return result._replace(sailed=twin_track(files, mission, result.fit, found))


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
    if result.sailed is not None:
        its = result.sailed
        yield f"mission {its.name}: the twin is {its.rms_m:.1f} m off her track (rms), {its.most_m:.1f} m at most"


def report(result: Identified, vehicle: config.Vehicle, place: Path, command: str) -> None:
    """Write the page."""
    from delfim.adoption.report import OnTwin, page  # matplotlib: a quarter of a second, which a fit alone need not pay

    place.parent.mkdir(parents=True, exist_ok=True)
    twin = OnTwin(result.gains, result.sailed)
    text = page(vehicle.boat.name, result.record, result.fit, result.found, twin, command)
    place.write_text(text, encoding="utf-8")


def with_found(result: Identified, text: str, file: str) -> str:
    """The text of the vehicle's file with what was found. Raises DelfimError where the fit is refused, or the text has no place
    for a key."""
    if result.fit.refusal:
        raise DelfimError(f"{file}: not written: {result.fit.refusal}")
    facts = {"on": result.on, "log": result.record.digest, "chi2": round(result.fit.chi2, 2)}
    kept = [FoundKey(("adopted", key), value, None, None) for key, value in facts.items()]
    chosen = result.gains.keys if result.gains is not None else ()
    return with_keys(text, [*result.found.keys, *kept, *chosen], f"found {result.on}", file)


def write(result: Identified, file: Path) -> None:
    """Write what was found into the vehicle's file. Raises DelfimError where the fit is refused."""
    replace_file(file, with_found(result, read_text(file), str(file)))
