"""The end of a trial: the rows of the motors are corrected, the hull is fitted, gains are chosen on its twin, and all of it is
written into the file if asked."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from delfim import config
from delfim.adoption import identify, magnet
from delfim.adoption.identify import Identified
from delfim.adoption.record import scatter_m
from delfim.adoption.suited import hull_unfit
from delfim.adoption.trial.motors import corrected
from delfim.adoption.trial.session import TrialProgress, Written
from delfim.adoption.trial.taped import record_of
from delfim.adoption.twin import gains
from delfim.adoption.twin.child import in_child
from delfim.adoption.writing import Key, changed
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.tables import inline
from delfim.base.wholefile import replace_file

RECEIVER_M: Final = 1.0  # deviation of a receiver that nobody has told: it wanders more slowly than a trial is long

Ask = Callable[[str], bool]
Tell = Callable[[str], object]


def corrections(progress: TrialProgress) -> Iterator[tuple[Key, Any]]:
    """The keys of the file that change, once the motors are proven."""
    if progress.motors is None or not progress.is_proven:
        return
    for row, keys in zip(progress.thrusters, corrected(progress.motors, progress.thrusters), strict=True):
        for key, value in keys.items():
            yield ("thrusters", row.name, key), config.stated(value) if isinstance(value, config.Steer) else value
    yield ("adopted", "proven"), True


def motors_told(progress: TrialProgress, tell: Tell) -> None:
    """Tell the keys of the file that change."""
    for key, value in corrections(progress):
        tell(f"{'.'.join(key)} = {inline(value)}")


def conclude(
    progress: TrialProgress,
    file: Path,
    report: Path,
    on: str,
    ask: Ask | None,
    tell: Tell,
    keep: Callable[[], object] = lambda: None,
) -> str:
    """Correct the rows, fit the hull, choose gains on the twin, write what is agreed to; `ask` None: nothing is written.
    Returns why the fit was refused, in words; empty: it was not, or this boat has none. `on`: the day. `progress` has then what
    was written; `keep` is called before the motors are: a trial that does not know of it would be taken for another boat's."""
    text = changed(read_text(file), {key: (value, f"found {on}") for key, value in corrections(progress)}, str(file))
    vehicle = config.read(parse_toml(text), str(file))
    motors_told(progress, tell)
    is_written = ask is not None and ask(f"Write this into {file}?")
    if is_written:
        progress.written = Written(on, vehicle.thrusters)
        keep()
        replace_file(file, text)
        tell(f"{file} is written. The boat's program has the old one until it is started again.")
    if why := hull_unfit(vehicle.thrusters):
        tell(f"Hull, compass and gains stay as they are: {why}.")
        return ""
    try:
        record = record_of(progress, is_estimated=vehicle.navigation.estimator)
        for line in magnet.told(record):
            tell(line)
        result = identify.identified(record, vehicle, on)
    except DelfimError as error:
        return str(error)
    for line in identify.told(result):
        tell(line)
    if not result.fit.refusal:
        result = _with_gains(result, vehicle, text, file, tell)
    identify.report(result, vehicle, report, f"delfim adopt {file}")
    tell(f"{report}: the report, with measured and modelled motion")
    if not result.fit.refusal and is_written and ask is not None and ask(f"Write these, too, into {file}?"):
        identify.write(result, file)
        progress.written = _what_was_written(result, config.load(file))
    return result.fit.refusal


def told_position_m(vehicle: config.Vehicle) -> float:
    """The deviation of a boat's receiver as her file has it."""
    return vehicle.estimator.position_m if vehicle.navigation.estimator else RECEIVER_M


def _with_gains(result: Identified, vehicle: config.Vehicle, text: str, file: Path, tell: Tell) -> Identified:
    """The same with gains, which a process of its own chooses in ten seconds or so."""
    told = identify.with_found(result, text, str(file))
    position_m = max(scatter_m(result.record), told_position_m(vehicle))
    result = result._replace(gains=in_child(gains.chosen_of, text, told, str(file), position_m, tell=tell))
    assert result.gains is not None
    for line in gains.told(result.gains):
        tell(line)
    return result


def _what_was_written(result: Identified, vehicle: config.Vehicle) -> Written:
    """What a proof sail, which may come later, must know. What the fit itself has found stays whatever it says."""
    assert result.gains is not None
    kept = {each.key for each in result.found.keys}
    return Written(result.on, vehicle.thrusters, tuple(each.key for each in result.gains.keys if each.key not in kept))
